"""How much skin slides is learned from the session."""

from dataclasses import replace

import numpy as np
import pytest
import small_session as small
import torch

from torchid.diagnosis.candidates.nuisances import SkinSlide
from torchid.diagnosis.columns.assemble import make_design
from torchid.diagnosis.evidence.model import Identification, make_model
from torchid.diagnosis.evidence.skin_prior import SLIDES_M, TOGETHER, with_slides
from torchid.effects.markers import SoftTissue
from torchid.effects.place import Place
from torchid.observation.trial import TrialObservation


def learned(observed: list[TrialObservation], effects: list[SoftTissue]) -> set[float]:
    """Prior of what segments' markers slide as one [m]."""
    outcome = small.outcome()
    assert outcome.identified is not None
    known = Identification(
        outcome.prior, outcome.identified.fit.omega_2, outcome.identified.whitening, outcome.fit
    )  # fmt: skip
    found = with_slides(make_model(observed, make_design(observed, effects, outcome.fit), known))
    return {s.scale[0] for s in found.design.sources if isinstance(s.effect, SkinSlide)}


def slid(observed: list[TrialObservation], size: float) -> list[TrialObservation]:
    """The trials with markers that slide on their segments."""
    rng, found = np.random.default_rng([small.SEED, 61]), observed
    for place in SoftTissue().places([one.view for one in observed]):
        theta = torch.tensor(size * rng.normal(size=3 * len(place.markers)))
        found = [_slid(one, place, theta) for one in found]
    return found


def _slid(one: TrialObservation, place: Place, theta: torch.Tensor) -> TrialObservation:
    assert one.response is not None
    more, error = SoftTissue().slide(one.response.sight, place, theta), one.response.error.clone()
    which = list(more.which)
    error[which] += more.by * (one.response.weight[which, None] > 0.0)
    return replace(one, response=replace(one.response, error=error))


@pytest.mark.slow
@pytest.mark.parametrize("slides", [False, True])
def test_segments_may_slide_as_far_as_their_markers_do_against_each_other(slides):
    """From nothing, on a robot's shell, up to what a person's skin does."""
    size = slides * float(np.exp(np.random.default_rng(small.SEED).uniform(np.log(4e-4), np.log(6e-3))))
    observed = slid(list(small.observed().values()), size)
    (scale,) = learned(observed, [SoftTissue()])
    usual = SkinSlide.parameters[0].scale
    if size == 0.0:
        assert scale < 3.0 * TOGETHER * SLIDES_M[0]
    else:
        assert 0.6 * min(usual, TOGETHER * size) < scale <= min(usual, 1.7 * TOGETHER * size)
    assert learned(observed, []) == {usual}, "without sliding skin among the effects nothing is learned"
