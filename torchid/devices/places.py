"""Which segment carries each part of a device: the sheet's, or a neighbour of it that base rows like better."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torchid.devices.device import Device
from torchid.devices.joint_fit import Extra, fit_jointly
from torchid.devices.parts import parts_prior
from torchid.devices.result import BodyBelief
from torchid.dynamics.rows import WrenchTrial
from torchid.model.pseudo import com
from torchid.model.tree import Tree

ELSEWHERE = 5.0
"""Log evidence by which another segment must beat the sheet's, chosen: odds of 150, for a handful of segments."""


@dataclass(frozen=True)
class CarriedPart:
    """One part, and the neighbour of its segment that fits best."""

    part: str
    sheet: str
    """Segment that the sheet says."""
    segment: str
    evidence: float
    """Log evidence for the other segment against the sheet's, other parts moved that are sure to be elsewhere."""
    sure: bool
    rivals: tuple[str, ...] = ()
    """Other parts that, elsewhere instead of this one, explain the recordings nearly as well: within ``ELSEWHERE``."""


def carried_elsewhere(device: Device, body: BodyBelief, trials: Sequence[WrenchTrial]) -> tuple[CarriedPart, ...]:
    """Hold the place of each part against the neighbours of its segment.

    The part with the largest evidence is moved first, and the others are looked at anew: a part in a wrong place makes
    others look misplaced that are not.

    Args:
        body: inertia as trials without the device told it.
        trials: with the device; without used frames nothing comes back.
    """
    trials = [trial for trial in trials if any(True for _ in trial.blocks())]
    if not device.parts or not trials:
        return ()
    at, left, found = replace(device, mass_kg=None), list(range(len(device.parts))), {}
    while left:
        best = _best_places(at, left, body, trials)
        first = max(left, key=lambda k: best[k][1])
        sure = best[first][1] > ELSEWHERE
        near = [k for k in left if k != first and best[k][1] > max(ELSEWHERE, best[first][1] - ELSEWHERE)]
        rivals = tuple(f"{device.parts[k].name} on {best[k][0]}" for k in near) if sure else ()
        for k in [first] if sure else left:
            found[k] = CarriedPart(device.parts[k].name, device.parts[k].segment, *best[k], sure, rivals)
        left = [k for k in left if k not in found]
        at = _carried(at, first, best[first][0]) if sure else at
    return tuple(found[k] for k in sorted(found))


def moved(device: Device, places: Sequence[CarriedPart]) -> Device:
    """Return the device with the parts that are sure to be elsewhere on the segments that carry them."""
    other = {one.part: one.segment for one in places if one.sure}
    for k, part in enumerate(device.parts):
        device = _carried(device, k, other[part.name]) if part.name in other else device
    return device


def _best_places(
    device: Device, parts: Sequence[int], body: BodyBelief, trials: Sequence[WrenchTrial]
) -> dict[int, tuple[str, float]]:
    """For some parts, the neighbour of its segment that fits best, and its log evidence against the segment."""
    tree, none = trials[0].tree, body.phi.new_zeros(0)
    extra = Extra(none, none, tuple(body.phi.new_zeros(6, 0, len(t.wrench)) for t in trials))
    sheet = fit_jointly(trials, body, parts_prior(device, tree, com(body.phi)), extra)
    found = {}
    for k in parts:
        scores = {}
        for segment in neighbours(tree, device.parts[k].segment):
            prior = parts_prior(_carried(device, k, segment), tree, com(body.phi))
            scores[segment] = fit_jointly(trials, body, prior, extra, sheet.whitening).log_evidence
        best = max(scores, key=lambda name: scores[name])
        found[k] = best, scores[best] - sheet.log_evidence
    return found


def _carried(device: Device, k: int, segment: str) -> Device:
    """The device with a part somewhere on another segment."""
    parts = list(device.parts)
    parts[k] = replace(parts[k], segment=segment, com_m=None)
    return replace(device, parts=tuple(parts))


def neighbours(tree: Tree, segment: str) -> tuple[str, ...]:
    """Return the segments that a segment is joined to."""
    k = tree.index(segment)
    above = [tree.bodies[k].parent] if tree.bodies[k].parent >= 0 else []
    below = [j for j, body in enumerate(tree.bodies) if body.parent == k]
    return tuple(tree.names[j] for j in (*above, *below))
