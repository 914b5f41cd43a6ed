"""Whether the forces of a trial agree with its feet; if not, which one change of reading puts them right.

Every change on a finite list is tried on the recording itself and judged by the same witnesses, so that what is advised
helps; reading then applies it by the same functions (``torchid.io.mend``).
"""

from dataclasses import replace

from torchid.checks.plates_against_feet.changes import file_changes, pair_changes, plate_changes
from torchid.checks.plates_against_feet.clock import clock_findings
from torchid.checks.plates_against_feet.finding import ForceFinding, in_figures, together, without
from torchid.checks.plates_against_feet.left_out import Reread, left_out_plates
from torchid.checks.plates_against_feet.place import FoundPlace, find_place, place_changes, shared_place
from torchid.checks.plates_against_feet.readings import FeetScene, Tried, scene_of, shared_changes, tried
from torchid.checks.plates_against_feet.scales import dead_plates, scale_findings
from torchid.checks.plates_against_feet.units import unit_findings
from torchid.checks.plates_against_feet.worlds import (
    moments_of_origins,
    off_the_floor,
    other_size,
    other_up,
    upside_down,
)
from torchid.io.mend import mend, number_of
from torchid.io.resample import to_clock
from torchid.recording import Trial

ON_ITS_HEAD = (
    "the recording is upside down: forces and feet agree once all of it is turned by 180 degrees about X; "
    "export it upright"
)


def judge(trial: Trial, mass_kg: float | None = None, reread: Reread | None = None) -> tuple[ForceFinding, ...]:
    """What is wrong with the forces of a trial; empty where they agree with the feet or nothing can tell.

    Args:
        trial: its forces on the clock of its markers (``torchid.io.resample.synchronise``).
        mass_kg: of the subject, on record.
        reread: reads the trial again with a change, None where it refuses; for what cannot be tried without.
    """
    scene, refused = scene_of(trial), () if reread is None else left_out_plates(trial, reread)
    if upside_down(trial):
        return (ForceFinding(ON_ITS_HEAD),)
    lying = _lying(trial, reread) if scene is None or off_the_floor(trial) else ()
    if scene is None or lying:
        return together((*lying, *refused)) or together(scale_findings(trial, scene))
    units = unit_findings(trial, mass_kg)
    return units or together((*_scales_or_axes(scene, trial, reread), *refused))


def _scales_or_axes(scene: FeetScene, trial: Trial, reread: Reread | None) -> tuple[ForceFinding, ...]:
    """What has been scaled away, unless a line mends what looks so: of exchanged channels one may be too small."""
    scales = scale_findings(trial, scene)
    if any(one.changes for one in scales) or dead_plates(trial):
        return scales
    axes = _axes_or_clock(scene, trial, reread)
    return scales if scales and not any(one.changes for one in axes) else axes


def _lying(trial: Trial, reread: Reread | None) -> tuple[ForceFinding, ...]:
    """No feet on the floor because markers and forces of two files have other verticals; else empty."""
    turned = other_up(reread) if reread is not None and trial.forces is not None and _own_axes(trial) else None
    return () if turned is None else (ForceFinding("no marker shows a foot on the floor under the forces", (turned,)),)


def _own_axes(trial: Trial) -> bool:
    """Whether the forces stand in a file of their own, whose axes may be others than those of the markers."""
    return "forces" in trial.parameters


def _axes_or_clock(scene: FeetScene, trial: Trial, reread: Reread | None) -> tuple[ForceFinding, ...]:
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


def _axes(scene: FeetScene, trial: Trial, reread: Reread | None) -> tuple[ForceFinding, ...]:
    """Plates turned, mirrored, miswired, in other units of moment, or exchanged; files with other axes."""
    plates, own_axes = scene.forces.plates, _own_axes(trial)
    single = {k: tried(scene, k, plate_changes(plates, k)) for k in range(len(plates))}
    whole = {k: tried(scene, k, [*pair_changes(plates), *file_changes(own_axes)]) for k in range(len(plates))}
    shared = shared_changes(scene, whole)
    bad = [k for k, plate in single.items() if plate.disagrees or (shared and whole[k].disagrees)]
    astray = scene.astray(scene.forces.wrench)
    if astray is not None and not bad:
        bad = [k for k, plate in single.items() if plate.bears(0)]
    if not bad:
        return ()
    seen = _said(scene, whole, bad) + (f", together aimed {1e3 * astray:.0f} mm beside the body" if astray else "")
    if shared and (len(bad) > 1 or not single[bad[0]].right):
        return (ForceFinding(seen, tuple(shared)),)
    if reread is not None and own_axes and not all(single[k].right for k in bad):
        change = other_up(reread) or moments_of_origins(reread)
        if change is not None:
            return (ForceFinding(seen, (change,)),)
    size = None if any(single[k].right for k in bad) else other_size(trial)
    if size is not None:
        said = f"{seen}, and would if the markers were {size:g} times as large: check their unit and calibration"
        return (ForceFinding(said),)
    places = {k: found for k in bad if not single[k].agrees(0) and (found := find_place(scene, k, single[k]))}
    together_moved = shared_place(scene, tuple(places.values())) if len(places) == len(bad) else ()
    if together_moved:
        return (ForceFinding(seen, together_moved),)
    return tuple(_of_plate(scene, k, single[k], places.get(k)) for k in bad)


def _of_plate(scene: FeetScene, k: int, plate: Tried, place: FoundPlace | None) -> ForceFinding:
    name, n = scene.forces.plates[k].name, number_of(scene.forces.plates[k], k)
    said = f"{name} does not agree with the feet: {in_figures(plate.evidence, 0)}"
    changes = tuple(plate.right) if place is None else place_changes(scene, place)
    if not changes:
        said += "; forces of another trial would look so"
    return ForceFinding(said, changes, without(n))


def _said(scene: FeetScene, each: dict[int, Tried], bad: list[int]) -> str:
    seen = [f"{scene.forces.plates[k].name}: {in_figures(each[k].evidence, 0)}" for k in bad]
    return f"forces do not agree with the feet ({'; '.join(seen)})"
