"""Motion that obeys its forces, for the trials of a finished outcome: in pieces that memory holds."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.rows import residual_rms
from torchid.effects.scene import make_scene
from torchid.errors import Note
from torchid.geometry.tracking import modelled
from torchid.observation.trial import make_response
from torchid.session import Followed, Outcome
from torchid.session.following import torques
from torchid.storage.results import OutputFolder
from torchid.torque.consistent import Agreement, ConsistentMotion, ConsistentTrial, changed, consistent_motion

PIECE = 1024
"""Resolution. Frames whose motion is found at a time; their system takes 150 MB."""
BESIDE_S = 1.0
"""Resolution. Time on either side that is found with a piece, where one goes over into the next [s]: as long as errors
of markers last."""
TRUSTED = 0.5
"""Choice. Mean weight of the measured wrench below which plates and body are said to be apart: most of them are no
errors of motion."""


def with_consistent(outcome: Outcome, folder: OutputFolder) -> Outcome:
    """Return an outcome with the motion that obeys the forces, of every moving trial of which frames are used.

    Args:
        outcome: with its torques and the wrenches under its feet.
        folder: holds what is as long as a recording.
    """
    if outcome.identified is None:
        said = "no motion that obeys the forces was sought: no inertia was identified"
        return replace(outcome, notes=(*outcome.notes, Note("consistent.none", said)))
    still = outcome.session.role("static")
    rows = {k: one.wrench for k, one in outcome.followed.items() if one.wrench is not None and k not in still}
    with folder.timed("consistent"):
        found = {name: folder.aside(_consistent(outcome, name)) for name, own in rows.items() if bool(own.used.any())}
    notes = [note for name, one in found.items() for note in _notes(name, one)]
    said = "no motion that obeys the forces was sought: in no frame do plates measure every contact"
    notes += [Note("consistent.none", said, name) for name in rows if name not in found]
    return replace(outcome, consistent=found, notes=(*outcome.notes, *notes))


def _notes(name: str, found: ConsistentTrial) -> Iterator[Note]:
    if not found.settled:
        said = "the motion that obeys the forces was still changing when the search for it ended; do not rely on it"
        yield Note("consistent.unsettled", said, name)
    if found.trusted < TRUSTED:
        said = (
            "forces or moments are off by more than plates in good order err and motion explains; the motion that "
            "should obey them does so only in part"
        )
        yield Note("consistent.apart", said, name)


@dataclass(frozen=True)
class _Piece:
    """A part of a trial, and how much each of its frames counts where the next piece has it as well."""

    part: slice
    share: Float[Tensor, " frames"]

    def add(self, x: Float[Tensor, "some *columns"], to: Float[Tensor, "frames *columns"]) -> None:
        """Add the piece's part of a course to that of the whole trial."""
        to[self.part] += self.share.to(x).view(-1, *[1] * (x.ndim - 1)) * x


def _pieces(frames: int, rate_hz: float) -> Iterator[_Piece]:
    beside = round(BESIDE_S * rate_hz)
    count = max(1, round(frames / PIECE))
    edges = [round(k * frames / count) for k in range(count + 1)]
    for start, stop in zip(edges, edges[1:], strict=False):
        part = slice(max(0, start - beside), min(frames, stop + beside))
        t = torch.arange(part.start, part.stop, dtype=torch.float64)
        rising = torch.ones_like(t) if start == 0 else ((t - start + beside) / (2 * beside)).clamp(0.0, 1.0)
        falling = torch.zeros_like(t) if stop == frames else ((t - stop + beside) / (2 * beside)).clamp(0.0, 1.0)
        yield _Piece(part, rising - falling)


def _consistent(outcome: Outcome, name: str) -> ConsistentTrial:
    """The motion of one trial with its torques, and its deviations where any are drawn."""
    item, count = outcome.followed[name], outcome.config.torques.draws
    assert item.wrench is not None
    rows, frames = item.wrench, len(item.wrench.used)
    generator = torch.Generator().manual_seed(outcome.config.seed + zlib.crc32(name.encode()))
    change, settled = torch.zeros_like(rows.motion.q), True
    trust = torch.zeros_like(rows.used, dtype=change.dtype)
    variance = change.new_zeros(len(change), 3, change.shape[1])
    for piece in _pieces(frames, rows.rate):
        found = _found(outcome, item, piece.part)
        settled &= found.settled
        piece.add(found.change, change)
        piece.add(found.trust, trust)
        if count:
            piece.add(_variance(found, count, generator), variance)
    motion = changed(rows, change)
    followed = replace(item, motion=motion, wrench=replace(rows, motion=motion))
    torque = torques(followed, rows.tree, rows.geometry, outcome.phi, outcome.right(name), outcome.under.get(name))
    sd = variance.sqrt().unbind(1) if count else None
    before, after = (_agreement(outcome, one) for one in (item, followed))
    trusted = float(trust[rows.used].mean())
    return ConsistentTrial(motion, torque, change, settled, trusted, before, after, sd)


def _found(outcome: Outcome, item: Followed, part: slice) -> ConsistentMotion:
    """The consistent motion of a part of a trial."""
    assert item.wrench is not None
    rows = item.wrench.frames(part)
    scene = make_scene(item.name, rows.tree, rows.geometry, rows.motion, outcome.phi)
    markers = outcome.right(item.name).markers.frames(part)
    response = make_response(scene, outcome.fit, markers, item.tracked.frames(part))
    return consistent_motion(response, rows, outcome.phi)


def _variance(found: ConsistentMotion, count: int, generator: torch.Generator) -> Float[Tensor, "frames 3 dofs"]:
    """Variances of q, v and a, from draws of the motion."""
    square = found.change.new_zeros(len(found.change), 3, found.change.shape[1])
    for error, drawn in found.draw(count, generator):
        square += torch.stack((error, drawn.v - found.motion.v, drawn.a - found.motion.a), 1).square()
    return square / count


def _agreement(outcome: Outcome, item: Followed) -> Agreement:
    """How far a motion is from what was measured."""
    assert item.wrench is not None
    p = outcome.right(item.name).markers.select(outcome.fit.attachment.labels).position
    off = (p - modelled(outcome.fit, item.motion.q)).square().sum(2)
    return Agreement(*residual_rms([item.wrench], outcome.phi), float(off[torch.isfinite(off)].mean().sqrt()))
