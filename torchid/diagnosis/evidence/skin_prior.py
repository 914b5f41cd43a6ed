"""Prior of sliding skin in a session, from what the markers of a segment do against each other."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.posterior import fit

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
    named = {id(c.source) for c in model.design.candidates}
    whole = [s for s in model.design.sources if id(s) not in named]
    pairs = [(s, c) for c in model.design.candidates if c.effect.moves_markers for s in whole if _part(s, c)]
    if not pairs:
        return model
    slide = pairs[0][0].effect
    size = _size(model, list({id(c): c for _, c in pairs}.values()))
    log.info("skin slides by %.1f mm", 1e3 * size)
    part = min(1.0, TOGETHER * size / slide.parameters[0].scale)
    sources = tuple(_narrower(s, part) if s.effect.name == slide.name else s for s in model.design.sources)
    design = replace(model.design, sources=sources)
    return replace(model, design=design, prior=model.prior.for_design(design))


def _part(whole: ColumnSource, one: Candidate) -> bool:
    """Return whether what a nuisance does is part of what an effect does at a place."""
    return whole.effect.part_of(whole.place, one.effect, one.place) is not None


def _size(model: LinearModel, each: Sequence[Candidate]) -> float:
    """Return the root mean square of the markers' own slides [m], as their evidence has it, beside slides of whole
    segments."""
    small, own = model.restrict(each)
    statistics = small.marker_statistics
    widths = [size / each[0].effect.parameters[0].scale for size in SLIDES_M]
    evidence = [fit(statistics, [replace(c, widened=width) for c in own]).log_evidence for width in widths]
    weight = torch.softmax(torch.tensor(evidence, dtype=torch.float64), 0)
    return float(weight @ torch.tensor(SLIDES_M, dtype=torch.float64))


def _narrower(source: ColumnSource, part: float) -> ColumnSource:
    """Return a source with its prior's standard deviations times a factor."""
    return replace(source, scale=tuple(part * s for s in source.scale))
