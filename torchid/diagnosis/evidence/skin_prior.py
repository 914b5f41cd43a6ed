"""Prior of sliding skin in a session, from what the markers of a segment do against each other."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.diagnosis.candidates.candidate import Candidate, Source
from torchid.diagnosis.candidates.nuisances import SkinSlide
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.posterior import fit
from torchid.effects.markers import SoftTissue

log = logging.getLogger(__name__)
SLIDES_M = (0.0001, 0.0002, 0.0004, 0.0008, 0.0016, 0.0032)
"""Resolution. Slides of one marker against its neighbours on a segment that are tried, at 90 degrees of a joint near
[m]."""
TOGETHER = 2.0
"""Estimator. Times that all markers of a segment may slide as one, a choice: on a thigh as much as against each other
(Grimpampi et al., IEEE Trans Biomed Eng 61:362 (2014)), or more (Barre et al., J Biomech 62:21 (2017))."""


def with_slides(model: LinearModel) -> LinearModel:
    """Return the model with the prior of a slide that no residual shows drawn to the slides that residuals do show.

    Markers on a robot's shell do not slide at all, a person's do; what the markers of a segment do against each other
    tells which. Where no sliding skin is among the effects of the design, the prior stays a person's.

    Args:
        model: model without any effect.
    """
    skin = [s for s in model.design.sources if isinstance(s.effect, SkinSlide)]
    places = [(s.place.where, s.place.follows) for s in skin]
    each = [c for c in model.design.candidates if isinstance(c.effect, SoftTissue)]
    each = [c for c in each if (c.place.where, c.place.follows) in places]
    if not each:
        return model
    size = _size(model, each)
    log.info("skin slides by %.1f mm", 1e3 * size)
    part = min(1.0, TOGETHER * size / SkinSlide.parameters[0].scale)
    sources = tuple(_narrower(s, part) if s in skin else s for s in model.design.sources)
    design = replace(model.design, sources=sources)
    return replace(model, design=design, prior=model.prior.widened(design))


def _size(model: LinearModel, each: Sequence[Candidate]) -> float:
    """Return the root mean square of the markers' own slides [m], as their evidence has it, beside slides of whole
    segments."""
    small, own = model.restrict(each)
    statistics = small.marker_statistics
    widths = [size / SoftTissue.parameters[0].scale for size in SLIDES_M]
    evidence = [fit(statistics, [replace(c, widened=width) for c in own]).log_evidence for width in widths]
    weight = torch.softmax(torch.tensor(evidence, dtype=torch.float64), 0)
    return float(weight @ torch.tensor(SLIDES_M, dtype=torch.float64))


def _narrower(source: Source, part: float) -> Source:
    """Return a source with its prior's standard deviations times a factor."""
    return replace(source, scale=tuple(part * s for s in source.scale))
