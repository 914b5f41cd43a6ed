"""One plate under every reading on a list: which agree with the feet, and how much better than as read."""

from dataclasses import dataclass

import torch
from jaxtyping import Float

from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.evidence import (
    AIM_MOST_M,
    FREE_MOST_M,
    PRESSURE_MOST_M,
    Evidence,
    agrees,
    gather,
)
from torchid.checks.plates_against_feet.feet import FRAMES, Feet, find_feet
from torchid.io.mend import mend, reframed
from torchid.recording import Forces, Trial

BETTER = 1.6
"""Another reading of a plate that agrees with the feet is taken for the right one from this gain on, in logarithms a
frame: a witness at twice its usual value instead of none. Pressures of sound recordings lie up to 26 mm from the
nearest foot, which is 1.4 if a change happens to bring them to it; of 52 public recordings none gains
more than 0.6."""
MENDS = 1.0
"""The same of a plate that does not agree: that it is read wrongly is known, and only asked how."""
ALIKE = 0.3
"""Readings whose gains differ by less are not told apart."""
PULLED_N = 150.0
"""A plate that bears nothing and is pulled up by this much [N] is no idle one: those read some 20 N at most."""
PULLED_SHARE = 0.05
"""For this share of the frames that bear load."""
FEWEST = 8
"""Loaded frames of the hundred that witness, below which a plate is not judged."""
SAME_N = 1e-6
"""Two readings with wrenches this close are one."""


@dataclass(frozen=True)
class FeetScene:
    """A trial as its plates are judged: feet and forces at frames that bear load."""

    feet: Feet
    forces: Forces

    @property
    def heights(self) -> list[float]:
        """Height of each plate's surface in W [m]."""
        return [0.0 if p.corners is None else float(p.corners[:, 2].mean()) for p in self.forces.plates]

    def astray(self, wrench: Float[torch.Tensor, "n plates 6"]) -> float | None:
        """Distance of the line of all forces together from the middle of the body [m], if no body could have it so."""
        mean = sum(self.heights) / max(len(self.heights), 1)
        aim = float(gather(self.feet, wrench.sum(dim=1)[None], mean).aim[0])
        return aim if aim > AIM_MOST_M else None


def scene_of(trial: Trial) -> FeetScene | None:
    """The frames of a trial that bear load, None without forces or feet."""
    if trial.forces is None:
        return None
    force = trial.forces.wrench[..., :3].nan_to_num().norm(dim=-1).amax(dim=1)
    active = (force > 0.1 * force.max()).nonzero()[:, 0] if bool(force.any()) else torch.zeros(0, dtype=torch.long)
    frames = active[torch.linspace(0, len(active) - 1, min(FRAMES, len(active))).round().long()]
    feet = find_feet(trial.markers, frames)
    if feet is None:
        return None
    forces = trial.forces
    return FeetScene(feet, Forces(forces.time[feet.frames], forces.wrench[feet.frames].nan_to_num(), forces.plates))


@dataclass(frozen=True)
class Tried:
    """One plate under a list of changes; the first reading is the one as it is."""

    changes: tuple[Change, ...]
    evidence: Evidence
    wrench: Float[torch.Tensor, "readings n 6"]

    @property
    def right(self) -> list[Change]:
        """Changes under which the plate agrees best, and those that are not told apart from it."""
        gain, better = self.evidence.gain, self._better
        # Of what is told apart by less than its scatter, the list's own order says what happens more often.
        alike = [i for i in better if float(gain[better].max() - gain[i]) < ALIKE]
        kept: list[int] = []
        for i in alike:
            if all(float((self.wrench[i] - self.wrench[j]).abs().max()) > SAME_N for j in kept):
                kept.append(i)
        return [self.changes[i - 1] for i in kept]

    @property
    def best(self) -> float:
        """Gain of the best of them; minus infinity without any.

        Smaller moments do not count: next to none agree with every foot, and of moments that are too large no place
        would keep the pressure under one.
        """
        kept = [i for i in self._better if not self.changes[i - 1].shrinks_moments]
        return max((float(self.evidence.gain[i]) for i in kept), default=-torch.inf)

    @property
    def _better(self) -> list[int]:
        """Readings that agree, and enough better than as read."""
        gain, least = self.evidence.gain, BETTER if self.agrees(0) else MENDS
        return [i for i in range(1, len(gain)) if self.agrees(i) and float(gain[i]) > least and self._may_speak(i)]

    @property
    def disagrees(self) -> bool:
        """The plate as read is beyond what a foot can do or pulls down, or a change makes it agree much better."""
        pulls = not self.bears(0) and float(self.wrench[0, :, 2].quantile(PULLED_SHARE)) < -PULLED_N
        return pulls or (self.enough(0) and not self.agrees(0)) or bool(self.right)

    def agrees(self, i: int) -> bool:
        """Whether the plate is within what a foot can do under reading i (0: as read), in frames enough to say so."""
        return self.enough(i) and bool(agrees(self.evidence)[i])

    def bears(self, i: int) -> bool:
        """Whether the plate is loaded under reading i."""
        return bool(self.evidence.loaded[i] > 0)

    def enough(self, i: int) -> bool:
        """Whether it is loaded in frames enough to be judged."""
        return float(self.evidence.loaded[i]) * self.wrench.shape[1] >= FEWEST

    def _may_speak(self, i: int) -> bool:
        """Moments of next to nothing agree with every foot: only what is impossible speaks for N mm."""
        possible = float(self.evidence.free[0]) < FREE_MOST_M and float(self.evidence.pressure[0]) < PRESSURE_MOST_M
        return not (self.changes[i - 1].shrinks_moments and possible)


def tried(scene: FeetScene, k: int, changes: list[Change]) -> Tried:
    """Plate k of a scene under all changes."""
    forces = scene.forces
    wrench = torch.stack([forces.wrench[:, k], *(changed(forces, change)[:, k] for change in changes)])
    others = forces.wrench[..., 2].abs().sum(dim=1) - forces.wrench[:, k, 2].abs()
    return Tried(tuple(changes), gather(scene.feet, wrench, scene.heights[k], others), wrench)


def pressures_to_soles(trial: Trial) -> dict[str, float]:
    """Median distance of the pressure of each loaded plate from the nearest foot, by the plate's name [m].

    Args:
        trial: forces on the clock of its markers; without feet or loads nothing is known.
    """
    scene = scene_of(trial)
    if scene is None:
        return {}
    each = {plate.name: tried(scene, k, []) for k, plate in enumerate(scene.forces.plates)}
    return {name: float(one.evidence.pressure[0]) for name, one in each.items() if one.bears(0)}


def changed(forces: Forces, change: Change) -> Float[torch.Tensor, "n plates 6"]:
    """Wrenches under a change."""
    other = mend(reframed(forces, change.plates), change.forces_as, change.plates)
    assert other is not None
    return other.wrench


def shared_changes(scene: FeetScene, each: dict[int, Tried]) -> list[Change]:
    """Changes of the whole file under which every plate agrees best, and those that are not told apart from it."""
    if not each:
        return []
    helpful: list[tuple[float, Change]] = []
    sound = all(plate.agrees(0) or not plate.enough(0) for plate in each.values())
    least = BETTER if sound else MENDS
    for i, change in enumerate(next(iter(each.values())).changes, start=1):
        # Exchanged plates may leave one idle, but somebody stands on as many as before.
        bearing = [sum(plate.enough(j) for plate in each.values()) for j in (0, i)]
        fits = all(plate.agrees(i) or not plate.enough(i) for plate in each.values())
        if not fits or bearing[1] < max(1, bearing[0]):
            continue
        if change.shrinks_moments and sound:
            continue
        if scene.astray(changed(scene.forces, change)) is not None:
            continue
        gain = sum(float(plate.evidence.gain[i]) for plate in each.values()) / max(bearing)
        helpful += [(gain, change)] if gain > least else []
    return [change for gain, change in helpful if gain > max(g for g, _ in helpful) - ALIKE]
