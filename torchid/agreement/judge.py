"""Whether the forces of a trial agree with its feet; if not, which one change of reading puts them right.

Every change on a finite list is tried on the recording itself and judged by the same witnesses, so that what is advised
helps; reading then applies it by the same functions (``torchid.io.mend``).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.agreement.changes import Change, Up, corner_changes, file_changes, pair_changes, plate_changes
from torchid.agreement.clock import clock_findings
from torchid.agreement.evidence import FREE_MOST_M, PRESSURE_MOST_M, Evidence, agrees, gather
from torchid.agreement.feet import FRAMES, Feet, find_feet
from torchid.agreement.finding import Finding, in_figures
from torchid.agreement.units import unit_findings
from torchid.conventions import SAMPLE_LOADED_N
from torchid.io.mend import ForcesAs, mend, number_of, reframed
from torchid.io.resample import to_clock
from torchid.recording import Forces, Plate, Trial

BETTER = 1.0
"""Another reading is taken for the right one from this gain on, in logarithms a frame: a witness at 1.3 times its usual
value instead of none. Of 52 recordings none gains more than 0.6 by any change."""
ALIKE = 0.3
"""Readings whose gains differ by less are not told apart."""
PULLED_N = 150.0
"""A plate that bears nothing and is pulled up by this much [N] is no idle one: those read some 20 N at most."""
SAME_N = 1e-6
"""Two readings with wrenches this close are one."""

Reread = Callable[[Change], Trial | None]


@dataclass(frozen=True)
class Scene:
    """A trial as its plates are judged: feet and forces at frames that bear load."""

    feet: Feet
    forces: Forces

    @property
    def heights(self) -> list[float]:
        """Height of each plate's surface in W [m]."""
        return [0.0 if p.corners is None else float(p.corners[:, 2].mean()) for p in self.forces.plates]


def judge(trial: Trial, mass_kg: float | None = None, reread: Reread | None = None) -> tuple[Finding, ...]:
    """What is wrong with the forces of a trial; empty where they agree with the feet or nothing can tell.

    Args:
        trial: its forces on the clock of its markers (``torchid.io.resample.synchronise``).
        mass_kg: of the subject, on record.
        reread: reads the trial again with a change, None where it refuses; for what cannot be tried without.
    """
    scene, refused = scene_of(trial), () if reread is None else _refused(trial, reread)
    if scene is None:
        return refused
    units = unit_findings(trial, scene.feet, scene.forces, scene.heights, mass_kg)
    return units or (*_axes_or_clock(scene, trial, reread), *refused)


def _axes_or_clock(scene: Scene, trial: Trial, reread: Reread | None) -> tuple[Finding, ...]:
    """Plates and axes, or a clock where that alone explains what they do not."""
    axes, clock = _axes(scene, trial, reread), clock_findings(trial)
    if not axes or not clock or trial.forces is None:
        return axes or clock
    change = clock[0].changes[0]
    plates = {n: p for finding in clock for n, p in finding.changes[0].plates.items()}
    forces = mend(trial.forces, change.forces_as, plates)
    in_time = None if forces is None else replace(trial, forces=to_clock(forces, trial.markers.time))
    later = None if in_time is None else scene_of(in_time)
    return clock if later is not None and in_time is not None and not _axes(later, in_time, None) else axes


def scene_of(trial: Trial) -> Scene | None:
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
    return Scene(feet, Forces(forces.time[feet.frames], forces.wrench[feet.frames].nan_to_num(), forces.plates))


def _axes(scene: Scene, trial: Trial, reread: Reread | None) -> tuple[Finding, ...]:
    """Plates turned, mirrored, miswired, in other units of moment, or exchanged; files with other axes."""
    plates = scene.forces.plates
    single = {k: _tried(scene, k, plate_changes(plates, k)) for k in range(len(plates))}
    bad = [k for k, tried in single.items() if tried.disagrees]
    together = [*pair_changes(plates), *file_changes("forces" in trial.parameters)]
    whole = {k: _tried(scene, k, together) for k in range(len(plates))}
    bad += [k for k, tried in whole.items() if k not in bad and tried.disagrees and _all_gain(whole)]
    if not bad:
        return ()
    shared = _shared(whole, bad)
    if shared and (len(bad) > 1 or not single[bad[0]].right):
        return (Finding(_said(scene, whole, bad), tuple(shared)),)
    if reread is not None and "forces" in trial.parameters and not all(single[k].right for k in bad):
        turned = _other_up(trial, reread)
        if turned is not None:
            return (Finding(_said(scene, whole, bad), (turned,)),)
    world = None if any(single[k].right for k in bad) else _other_world(trial)
    if world:
        return (Finding(f"{_said(scene, whole, bad)}, and would {world}"),)
    return tuple(_of_plate(scene, k, single[k], shared) for k in bad)


SIZES = (0.5, 2.0)
"""Factors of all markers that are tried where no reading of the forces helps."""


def _other_world(trial: Trial) -> str:
    """What else than the forces would have to change so that they agree, as the end of a sentence; else empty."""
    assert trial.forces is not None
    half = trial.markers.position.new_tensor([1.0, -1.0, -1.0])
    upright = replace(
        trial,
        markers=replace(trial.markers, position=trial.markers.position * half),
        forces=replace(trial.forces, wrench=trial.forces.wrench * half.repeat(2), plates=_bare(trial.forces)),
    )
    if _all_agree(upright):
        return "if everything stood on its feet: the recording is upside down (turn it by 180 degrees about X)"
    for size in SIZES:
        other = replace(trial, markers=replace(trial.markers, position=trial.markers.position / size))
        if _all_agree(other):
            return f"if the markers were {1 / size:g} times as large: check their unit and the cameras' calibration"
    return ""


def _bare(forces: Forces) -> tuple[Plate, ...]:
    return tuple(replace(plate, corners=None) for plate in forces.plates)


def _all_agree(trial: Trial) -> bool:
    scene = scene_of(trial)
    if scene is None:
        return False
    loaded = [
        bool(agrees(gather(scene.feet, scene.forces.wrench[None, :, k], scene.feet.position.new_tensor([height])))[0])
        for k, height in enumerate(scene.heights)
        if bool((scene.forces.wrench[:, k, 2] > SAMPLE_LOADED_N).any())
    ]
    return bool(loaded) and all(loaded)


@dataclass(frozen=True)
class Tried:
    """One plate under a list of changes; the first reading is the one as it is."""

    changes: tuple[Change, ...]
    evidence: Evidence
    wrench: Float[Tensor, "readings n 6"]

    @property
    def right(self) -> list[Change]:
        """Changes under which the plate agrees best, and those that are not told apart from it."""
        order = [i for i in self.evidence.gain.argsort(descending=True).tolist() if i and self._agrees(i)]
        if not order or not self._much_better(order[0]):
            return []
        # Of what is told apart by less than its scatter, the list's own order says what happens more often.
        alike = [i for i in order if float(self.evidence.gain[order[0]] - self.evidence.gain[i]) < ALIKE]
        kept: list[int] = []
        for i in sorted(alike):
            if all(float((self.wrench[i] - self.wrench[j]).abs().max()) > SAME_N for j in kept):
                kept.append(i)
        return [self.changes[i - 1] for i in kept]

    @property
    def disagrees(self) -> bool:
        """The plate as read is beyond what a foot can do or pulls down, or a change makes it agree much better."""
        pulls = not self.bears(None) and float(self.wrench[0, :, 2].min()) < -PULLED_N
        return pulls or (self.bears(None) and not self._agrees(0)) or bool(self.right)

    def gain(self, change: Change) -> float:
        """How much the plate gains by a change."""
        return float(self.evidence.gain[1 + self.changes.index(change)])

    def agrees(self, change: Change) -> bool:
        """Whether the plate is within what a foot can do under the change, or idle."""
        return self._agrees(1 + self.changes.index(change)) or not self.bears(change)

    def bears(self, change: Change | None) -> bool:
        """Whether the plate is loaded under the change, or as read."""
        return bool(self.evidence.loaded[0 if change is None else 1 + self.changes.index(change)] > 0)

    def _much_better(self, i: int) -> bool:
        smaller = self.changes[i - 1].forces_as.moment_gain < 1 or any(
            p.moment_gain < 1 for p in self.changes[i - 1].plates.values()
        )
        # Moments of next to nothing agree with every foot: only what is impossible speaks for N mm.
        possible = float(self.evidence.free[0]) < FREE_MOST_M and float(self.evidence.pressure[0]) < PRESSURE_MOST_M
        return float(self.evidence.gain[i]) > BETTER and not (smaller and possible)

    def _agrees(self, i: int) -> bool:
        return bool(agrees(self.evidence)[i])


def _tried(scene: Scene, k: int, changes: list[Change]) -> Tried:
    forces = scene.forces
    wrench = torch.stack([forces.wrench[:, k], *(changed(forces, change)[:, k] for change in changes)])
    height = wrench.new_full((len(wrench),), scene.heights[k])
    return Tried(tuple(changes), gather(scene.feet, wrench, height), wrench)


def changed(forces: Forces, change: Change) -> Float[Tensor, "n plates 6"]:
    """Wrenches under a change."""
    other = mend(reframed(forces, change.plates), change.forces_as, change.plates)
    assert other is not None
    return other.wrench


def _all_gain(whole: dict[int, Tried]) -> bool:
    return bool(_shared(whole, [k for k, tried in whole.items() if bool((tried.evidence.loaded > 0).any())]))


def _shared(whole: dict[int, Tried], bad: list[int]) -> list[Change]:
    """Changes of the whole file under which every plate agrees best, and those that are not told apart from it."""
    if not bad:
        return []
    total = {}
    for change in whole[bad[0]].changes:
        # Exchanged plates may leave one idle, but somebody stands on as many as before.
        bearing = [sum(tried.bears(c) for tried in whole.values()) for c in (None, change)]
        if all(tried.agrees(change) for tried in whole.values()) and bearing[1] >= max(1, bearing[0]):
            total[change.line] = (sum(whole[k].gain(change) for k in whole) / len(bad), change)
    small = all(tried._agrees(0) for tried in whole.values())
    helpful = [(g, c) for g, c in total.values() if g > BETTER and not (small and c.forces_as.moment_gain < 1)]
    return [change for gain, change in helpful if gain > max(g for g, _ in helpful) - ALIKE]


def _of_plate(scene: Scene, k: int, tried: Tried, shared: list[Change]) -> Finding:
    plate = scene.forces.plates[k]
    n = number_of(plate, k)
    said = f"{plate.name} does not agree with the feet: {in_figures(tried.evidence, 0)}"
    changes = tried.right or [change for change in shared if n in change.plates]
    if not changes:
        said += "; forces of another trial would look so"
    return Finding(said, tuple(changes), f"plates: {{{n}: {{use: false}}}}")


def _said(scene: Scene, tried: dict[int, Tried], bad: list[int]) -> str:
    each = [f"{scene.forces.plates[k].name}: {in_figures(tried[k].evidence, 0)}" for k in bad]
    return f"forces do not agree with the feet ({'; '.join(each)})"


def _refused(trial: Trial, reread: Reread) -> tuple[Finding, ...]:
    """Plates that reading refused and that carry a foot once their corners are put right."""
    found = []
    for number in map(int, trial.parameters.get("plates refused", "").split()):
        changes = [change for change in corner_changes(number) if _carries(reread(change), number)]
        if changes:
            said = f"plate {number} is refused for its corners, yet somebody stands on it"
            found.append(Finding(said, tuple(changes), f"plates: {{{number}: {{use: false}}}}"))
    return tuple(found)


def _carries(trial: Trial | None, number: int) -> bool:
    scene = None if trial is None else scene_of(trial)
    if scene is None:
        return False
    for k, plate in enumerate(scene.forces.plates):
        if number_of(plate, k) == number:
            wrench = scene.forces.wrench[None, :, k]
            return bool(agrees(gather(scene.feet, wrench, wrench.new_tensor([scene.heights[k]])))[0])
    return False


def _other_up(trial: Trial, reread: Reread) -> Change | None:
    """The change of the vertical of markers or forces alone under which they agree."""
    axes: tuple[tuple[Up, Up], ...] = (("y", "z"), ("z", "y"))
    for markers, forces in axes:
        change = Change(f"the markers have {markers.upper()} up and the forces {forces.upper()}",
                        ForcesAs(up=forces), up=markers)  # fmt: skip
        other = reread(change)
        scene = None if other is None else scene_of(other)
        if scene is None or other is None:
            continue
        tried = {k: _tried(scene, k, file_changes(True)) for k in range(len(scene.forces.plates))}
        loaded = [t for t in tried.values() if bool(t.evidence.loaded[0] > 0)]
        if loaded and all(t._agrees(0) for t in loaded):
            return change
        shared = _shared(tried, list(tried))
        if shared:
            return replace(shared[0], up=markers, forces_as=replace(shared[0].forces_as, up=forces),
                           what=f"{change.what}, and {shared[0].what}")  # fmt: skip
    return None
