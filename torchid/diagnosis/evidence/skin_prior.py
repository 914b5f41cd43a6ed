"""How much skin slides in a session, from what the markers of a segment do against each other."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.diagnosis.candidates.candidate import Candidate, Source
from torchid.diagnosis.candidates.nuisances import SkinSlide
from torchid.diagnosis.columns.design import Design
from torchid.diagnosis.evidence.noise import Noise, unforced
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.spectra import TrialSpectra, narrowed
from torchid.effects.markers import SoftTissue

log = logging.getLogger(__name__)
SLIDES_M = (0.0001, 0.0002, 0.0004, 0.0008, 0.0016, 0.0032)
"""Of one marker against its neighbours on a segment, at 90 degrees of a joint near."""
TOGETHER = 2.0
"""Times that all markers of a segment may slide as one: on a thigh as much as against each other (Grimpampi et al.,
IEEE Trans Biomed Eng 61 (2014)), or more (Barre et al., J Biomech 62:21 (2017))."""


def with_slides(rows: Sequence[TrialSpectra], prior: Prior, design: Design, noise: Noise) -> Design:
    """With the prior of a slide that no residual shows drawn to those that residuals do show.

    Markers on a robot's shell do not slide at all. A glide of 7 mm at a knee had an sd of 5 mm there, because thigh and
    shank might have slid by as much as a person's; with what these markers said it had 1.5 mm.

    Args:
        rows: of every trial.
        prior: of all columns.
        design: of everything; where it has no sliding skin among its effects, the prior stays a person's.
        noise: of the markers.
    """
    skin = [s for s in design.sources if isinstance(s.effect, SkinSlide)]
    places = [(s.place.where, s.place.follows) for s in skin]
    each = [c for c in design.candidates if isinstance(c.effect, SoftTissue)]
    each = [c for c in each if (c.place.where, c.place.follows) in places]
    if not each:
        return design
    size = _size(rows, prior, design, noise, each)
    log.info("skin slides by %.1f mm", 1e3 * size)
    part = min(1.0, TOGETHER * size / SkinSlide.parameters[0].scale)
    return replace(design, sources=tuple(_narrower(s, part) if s in skin else s for s in design.sources))


def _size(rows: Sequence[TrialSpectra], prior: Prior, design: Design, noise: Noise, each: Sequence[Candidate]) -> float:
    """Root mean square of the markers' own slides, as their evidence has it, beside slides of whole segments."""
    rows, prior, small, own = narrowed(rows, prior, design, each)
    statistics = unforced(rows, prior, small, noise)
    widths = [size / SoftTissue.parameters[0].scale for size in SLIDES_M]
    told = [fit(statistics, [replace(c, widened=width) for c in own]).log_evidence for width in widths]
    weight = torch.softmax(torch.tensor(told, dtype=torch.float64), 0)
    return float(weight @ torch.tensor(SLIDES_M, dtype=torch.float64))


def _narrower(source: Source, part: float) -> Source:
    return replace(source, scale=tuple(part * s for s in source.scale))
