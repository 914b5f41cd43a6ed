"""What columns share with the total is what it is draw by draw, and sums are the same by a shorter way."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
import small_session as small
import torch
from torch.testing import assert_close

import torchid.observation.trial as observed_trials
from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.diagnosis.columns.assemble import make_design, retaken, trial_columns
from torchid.diagnosis.columns.corrected_scores import noise_scores
from torchid.diagnosis.columns.design import Columns, Design, only
from torchid.diagnosis.columns.marker_columns import response_of
from torchid.diagnosis.evidence.spectra import trial_spectra
from torchid.dynamics.equations_of_motion import base_rows, body_rows, wrench_about
from torchid.dynamics.whitening import BAND_EDGES_HZ, band_of, coefficients, column_spectra, cosine_matrix, frequencies
from torchid.effects.catalogue import effect
from torchid.effects.columns import columns
from torchid.extension.diagnosing import observe_outcome
from torchid.observation.trial import TrialObservation
from torchid.storage.snapshot import in_memory

pytestmark = pytest.mark.slow

TRIED = (
    "body_mass", "payload", "grasped_object", "wobbling_mass",
    "plate_gain", "plate_pose", "plate_crosstalk", "skin_lag",
)  # fmt: skip
"""Every effect whose columns follow accelerations."""


@pytest.fixture(scope="module")
def observed() -> Iterator[TrialObservation]:
    with pytest.MonkeyPatch.context() as every_frame:
        every_frame.setattr(observed_trials, "OVER_CUTOFF", math.inf)
        yield next(iter(observe_outcome(small.outcome(), "fit").values()))


@pytest.fixture(scope="module")
def design(observed) -> Design:
    return make_design([observed], [effect(name) for name in TRIED], small.outcome().fit)


def seen(observed: TrialObservation, k: int, source: ColumnSource) -> torch.Tensor:
    """Columns of a source under a draw, about the root's origin."""
    scene, response = observed.under(observed.noise_draws[k].motion), observed.response
    if source.effect.moves_markers:
        found = response.wrench([response_of(response, source, replace(response.sight, scene=scene))])
    else:
        found = columns(source.effect, scene, observed.bore(scene), source.place)
    root = observed.rows.motion.q[:, :3].expand(found.shape[1], -1, -1)
    return wrench_about(found.permute(1, 2, 0), root).permute(2, 0, 1)


def inertial(observed: TrialObservation, k: int) -> torch.Tensor:
    state = observed.under(observed.noise_draws[k].motion).state
    return base_rows(state.plan, body_rows(state, observed.rows.motion.q[:, :3].T))


def products(observed: TrialObservation, change: torch.Tensor, total: torch.Tensor) -> torch.Tensor:
    """Of cosine coefficients, block by block and band by band, columns shrunk as they are believed."""
    found = total.new_zeros(len(BAND_EDGES_HZ) + 1, 6, 6, change.shape[1])
    for part in observed.rows.blocks():
        frames = part.stop - part.start
        kept = coefficients(observed.rows, frames)
        C = cosine_matrix(frames, kept)[1:]
        frequency = frequencies(frames, kept, observed.rows.rate)
        reliability, band = observed.noise_budget.reliability(frequency)[1:], band_of(frequency[1:])
        own, other = torch.einsum("jct,kt,kj->jck", change[:, :, part], C, reliability), total[:, part] @ C.T
        for b in range(len(BAND_EDGES_HZ) + 1):
            found[b] += torch.einsum("jck,ik->ijc", own[:, :, band == b], other[:, band == b])
    return found


def test_what_is_shared_is_what_every_draw_shares(observed, design):
    """Combinations of the inertia's columns and of plates' channels stand for the effects' own columns."""
    trial = design.trials[0]
    live = trial.terms.live.tolist()
    some = [s for s in design.sources if s.effect.follows_acceleration]
    assert {s.effect.name for s in some} == set(TRIED)
    for source in (None, *some[:: max(1, len(some) // 40)], some[-1]):
        at = range(design.inertia) if source is None else range(source.columns.start, source.columns.stop)
        at = [live.index(k) for k in at]
        plain = observed.inertial if source is None else trial.extra[:, [k - design.inertia for k in at]]
        draws = range(len(observed.noise_draws))
        change = [(inertial(observed, k) if source is None else seen(observed, k, source)) - plain for k in draws]
        exact = [products(observed, c, one.total) for c, one in zip(change, observed.noise_draws, strict=True)]
        exact = torch.stack(exact).mean(0) * observed.noise_budget.there[:, :, None, None]
        found = trial.terms.noise_scores[..., at]
        assert_close(found, exact, rtol=1e-6, atol=1e-7 * float(exact.abs().max()))


def test_a_design_of_some_columns_has_them_as_the_whole_has(design):
    """Chosen from twice: columns, and what they add with some parameters."""
    rng = np.random.default_rng([small.SEED, 21])
    some = [design.candidates[k] for k in sorted(rng.choice(len(design.candidates), 40, replace=False))]
    few, own, first = only(design, some)
    fewer, _, second = only(few, own[::3])
    (whole,), (found,) = design.trials, fewer.trials
    wanted = whole.extra[:, first[second][design.inertia :] - design.inertia]
    theta = torch.tensor(rng.normal(size=wanted.shape[1]))
    assert_close(found.extra, wanted, rtol=0.0, atol=0.0)
    assert_close(found.added(theta), torch.einsum("p,ipt->ti", theta, wanted))


def test_columns_taken_elsewhere_are_those_of_a_design_made_there(observed, design):
    """Markers' sums of the few that moved, against all, and what they share with the total."""
    place = next(s for s in design.sources if s.effect.name == "skin_lag")
    there = replace(place, at=(2e-3,) * len(place.scale))
    sources = [there if s is place else s for s in design.sources]
    found, exact = retaken(observed, design.trials[0], sources, [there]), trial_columns(observed, sources)
    assert not math.isclose(float((exact.extra - design.trials[0].extra).norm()), 0.0)
    assert_close(found.extra, exact.extra, rtol=1e-9, atol=1e-9)
    for name in ("gram", "moment", "energy", "count"):
        was, now = getattr(found.terms.markers, name), getattr(exact.terms.markers, name)
        assert_close(was, now, rtol=1e-7, atol=1e-9 * float(now.abs().max()))
    assert_close(found.terms.noise_scores, exact.terms.noise_scores, rtol=1e-7, atol=1e-9)


def test_few_frames_say_what_all_of_them_do(observed, design):
    """Every second one of a hundred a second: no column changes by more than the draws leave it uncertain."""
    assert observed.thinning == 1
    some = [s for s in design.sources if s.effect.follows_acceleration]
    every = noise_scores(observed, observed.noise_budget, some, inertia=True)
    few = replace(observed)
    with pytest.MonkeyPatch.context() as half:
        cutoff_hz = observed.rows.motion.smoother.cutoff_hz
        half.setattr(observed_trials, "OVER_CUTOFF", 0.49 * observed.rows.rate / cutoff_hz)
        assert few.thinning == 2
        found = noise_scores(few, observed.noise_budget, some, inertia=True)
    halves = []
    for draws in (observed.noise_draws[::2], observed.noise_draws[1::2]):
        own = replace(observed)
        own.__dict__["noise_draws"] = draws
        halves.append(noise_scores(own, observed.noise_budget, some, inertia=True))
    # The standard error of all draws, from the difference of half of them and the others.
    scatter = 0.5 * torch.sub(*halves).flatten(0, 2).norm(dim=0)
    off = (found - every).flatten(0, 2).norm(dim=0)
    assert bool((off <= scatter).all())


def test_only_what_accelerations_give_is_doubted(observed):
    """A rope pulls by what it is: its columns stay whole where those of a load are shrunk to what is believed."""
    design = make_design([observed], [effect("tether"), effect("payload")], small.outcome().fit)
    rows = trial_spectra(observed, design.trials[0], design.noisy)
    doubted = {name: [] for name in ("tether", "payload")}
    for block, plain in zip(rows.forces, column_spectra(observed.rows, design.trials[0].extra), strict=True):
        reliability = observed.noise_budget.reliability(block.frequency).T[:, None]
        assert float(reliability.min()) < 0.9
        for source in design.sources:
            if source.effect.name in doubted:
                part = slice(source.columns.start - design.inertia, source.columns.stop - design.inertia)
                own = block.Y[:, design.inertia :][:, part]
                assert_close(own, (reliability if source.effect.noisy else 1.0) * plain[:, part])
                doubted[source.effect.name].append(source.effect.noisy)
    assert not any(doubted["tether"]) and all(doubted["payload"]) and doubted["payload"]


def test_what_grows_with_columns_lies_where_room_is_made(observed, design):
    """Columns, Gram matrices of markers and spectra of forces lie in the room that was made, the same as in memory."""
    made = []

    def room(shape: Sequence[int]) -> torch.Tensor:
        made.append(in_memory(shape))
        return made[-1]

    there = replace(observed, room=room)
    found, plain = large(there, trial_columns(there, design.sources), design), large(observed, design.trials[0], design)
    assert {x.data_ptr() for x in found} <= {x.data_ptr() for x in made}
    for one, other in zip(found, plain, strict=True):
        assert_close(one, other, rtol=0.0, atol=0.0)


def large(observed: TrialObservation, columns: Columns, design: Design) -> list[torch.Tensor]:
    """What a trial has of every column that may lie elsewhere than in memory."""
    rows = trial_spectra(observed, columns, design.noisy)
    return [columns.wide, columns.terms.markers.gram, *(block.Y for block in rows.forces)]
