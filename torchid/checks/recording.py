"""What a recording holds and what is wrong with it, before any fit; nothing is repaired here."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from torchid.checks.finding import Finding, InstrumentFault, Severity
from torchid.checks.instruments import other_weight, unloaded_reading
from torchid.checks.marker_tracks.clusters import Clusters
from torchid.checks.marker_tracks.session import look_at_trial
from torchid.checks.marker_tracks.statement import notes_of
from torchid.checks.plates import PlateCheck, check_plate, moved_mass, plate_weight
from torchid.conventions import ZERO_WRONG_N
from torchid.errors import Note
from torchid.recording import Trial

WEIGHT_MISMATCH = 0.05
"""Relative difference of mean vertical force and recorded weight worth saying."""
OUTSIDE = 0.02
"""Share of a plate's loaded time that its centre of pressure may lie beside it."""
MANY_GAPS = 40.0
"""Share of missing samples [%] above which a marker is worth naming."""
MOST_MARKERS = 200
"""Resolution. Labels above which tracks are not looked at without a marker set: such files hold points of programs."""

FAULTS = {
    "markers.held": InstrumentFault.FROZEN,
    "markers.duplicates": InstrumentFault.EXCHANGE,
    "markers.never_seen": InstrumentFault.HIDDEN,
    "markers.spikes": InstrumentFault.JUMP,
    "markers.steps": InstrumentFault.JUMP,
    "markers.leaping": InstrumentFault.JUMP,
    "plates.sign": InstrumentFault.GAIN,
    "plates.force": InstrumentFault.LIMIT,
    "plates.spikes": InstrumentFault.JUMP,
    "axes.markers": InstrumentFault.AXES,
    "trial.overlap": InstrumentFault.CLOCK,
}
"""Faults that notes of reading are about; others are of the file."""
CURES = {
    "markers.held": "check the marker in the recording system; torchid treats the run as a gap",
    "markers.duplicates": "rename them in the recording system, or leave the numbered ones out of the marker map",
    "markers.order": "export the trial again; where it was put together by hand, put those frames in order",
    "markers.repeated": "check that no frame was lost while recording; export the trial again",
    "markers.none": "label the points in the recording system and export the trial again",
    "markers.never_seen": "leave them out of the marker map",
    "plates.sign": "reverse the plate's channels where they are recorded, or leave the plate out",
    "plates.refused": "correct FORCE_PLATFORM in the file, or leave the plate out",
    "plates.force": "correct scale or wiring of its channels, or say it: plates: {N: {gain: ...}} or {exchange: ...}",
    "plates.used": "correct FORCE_PLATFORM:USED in the file",
    "plates.invalid": "export the analog channels again",
    "plates.none": "give forces: beside a TRC, or use the trial for geometry only",
    "axes.markers": "give up: if the vertical axis is wrong; a person lying or with arms spread looks the same",
    "trial.overlap": "frames without forces are left out of the inertia; export the whole trial if there is more",
    "c3d.truncated": "copy or export the file again",
    "c3d.trailing": "copy or export the file again",
    "c3d.frames": "check that the whole trial was read",
    "text.last_row": "export the file again",
    "time.gaps": "export the rows that are missing; torchid treats them as gaps",
    "trc.frame_numbers": "check that no frame was cut out or doubled",
    "trc.partial": "correct those cells; torchid treats the points as gaps",
    "markers.spikes": "correct those samples in the recording system; torchid treats them as gaps",
    "markers.steps": "look whether labels are exchanged from that frame on, and correct them in the recording system",
    "markers.leaping": "check the rate, the unit and the labels",
    "mot.leaping": "check the rate and the units of these columns",
    "mot.spikes": "correct those cells; torchid treats the rows as gaps",
    "mot.gaps": "export the forces without gaps; torchid leaves those frames out of the inertia",
    "plates.spikes": "look for loose cables and noise on the channels; torchid treats the samples as gaps",
}
"""What to do about the notes of reading that are problems or warnings."""
HARMLESS = frozenset({
    "markers.held", "markers.never_seen", "markers.spikes", "mot.gaps", "mot.spikes", "plates.spikes",
    "text.last_row", "time.gaps", "trc.partial", "trial.overlap",
})  # fmt: skip
"""Choice. Of these, the ones after which a result is right all the same: what is at fault is a gap to torchid."""
MOST = 0.5
"""Choice. Share of the markers with many gaps above which the recording has a problem; few can be done without."""


@dataclass(frozen=True)
class TrialCheck:
    """Facts about a trial and the problems found."""

    name: str
    source: str
    subject: str
    markers: int
    frames: int
    rate: float
    duration: float
    gaps: dict[str, float]
    """Missing samples [%] of every marker."""
    force_rate: float | None
    plates: tuple[PlateCheck, ...]
    weight: float | None
    """Mean vertical force over the frames where the plates carry somebody, as a mass [kg]."""
    mass: float | None
    """The same with gravity plus the markers' vertical acceleration for gravity [kg]: fit for runs and jumps too."""
    recorded_mass: float | None
    units: str
    up: str
    events: int
    problems: tuple[Finding, ...]
    """What makes a result wrong or impossible until it is mended; each with its cure."""
    warnings: tuple[Finding, ...]
    """What is at fault and harms no result, for torchid takes it for a gap or does without; each with its cure."""
    notes: tuple[Note, ...]
    """What reading chose or repaired without it being a problem."""
    to_sole: Mapping[str, float] = field(default_factory=dict)
    """Distance of the pressure of each loaded plate from the nearest foot, by the plate's name [m]."""

    @property
    def gap_share(self) -> float:
        """Missing samples [%] of all markers together."""
        return float(np.mean(list(self.gaps.values()))) if self.gaps else 0.0


def check_trial(
    trial: Trial,
    mass_kg: float | None = None,
    disagreements: tuple[Finding, ...] = (),
    to_sole: Mapping[str, float] | None = None,
) -> TrialCheck:
    """Look at a trial without changing it.

    Args:
        trial: as read.
        mass_kg: the subject's mass on record; by default what the file states.
        disagreements: of its forces with the feet (``torchid.checks.plates_against_feet``), each with its cure.
        to_sole: distance of the pressure of each plate from the nearest foot, by the plate's name [m].
    """
    facts, markers, forces = trial.parameters, trial.markers, trial.forces
    mass = mass_kg if mass_kg is not None else stated_mass(trial)
    missing = 100.0 * markers.position.isnan().any(dim=-1).double().mean(dim=0)
    gaps = {label: float(share) for label, share in zip(markers.labels, missing, strict=True)}
    plates = _plates(trial)
    weight = plate_weight(trial)
    source = facts.get("file", trial.name)
    found = [*disagreements, *_from_notes(trial), *_gap_problems(gaps, source), *plate_problems(trial, mass, plates)]
    harmless = HARMLESS if len(_many(gaps)) > MOST * len(gaps) else HARMLESS | {"markers.gaps"}
    found = [replace(one, severity=Severity.WARNING) if one.code in harmless else one for one in found]
    frames = len(markers.time)
    return TrialCheck(
        name=trial.name, source=source, subject=facts.get("subject", ""), markers=len(markers.labels), frames=frames,
        rate=markers.rate if frames > 1 else float("nan"),
        duration=float(markers.time[-1] - markers.time[0]) if frames else 0.0, gaps=gaps,
        force_rate=forces.rate if forces and len(forces.time) > 1 else None, plates=plates, weight=weight,
        mass=moved_mass(trial),
        recorded_mass=mass, units=facts.get("units", ""), up=facts.get("up", ""), events=len(trial.events),
        problems=tuple(one for one in found if one.severity is Severity.PROBLEM),
        warnings=tuple(one for one in found if one.severity is Severity.WARNING), to_sole=to_sole or {},
        notes=(*(note for note in trial.notes if note.code not in CURES), *_track_notes(trial)),
    )  # fmt: skip


def stated_mass(trial: Trial) -> float | None:
    """The subject's mass [kg] that the file states, None where it states none."""
    try:
        return float(trial.parameters.get("mass_kg", "")) or None
    except ValueError:
        return None


def _track_notes(trial: Trial) -> tuple[Note, ...]:
    """What is wrong with the tracks of its markers, as far as one trial without a marker set tells."""
    if trial.role == "static" or len(trial.markers.labels) > MOST_MARKERS:
        return ()
    return notes_of(look_at_trial(trial, Clusters.unknown(trial.markers.labels), []))


def _from_notes(trial: Trial) -> list[Finding]:
    return [
        Finding(FAULTS.get(n.code, InstrumentFault.RECORD), n.code, n.message, n.source, advice=CURES[n.code])
        for n in trial.notes
        if n.code in CURES
    ]


def _many(gaps: dict[str, float]) -> list[str]:
    """Markers with many gaps that are seen at times."""
    return [f"{label} ({share:.0f} %)" for label, share in gaps.items() if MANY_GAPS < share < 100.0]


def _gap_problems(gaps: dict[str, float], source: str) -> list[Finding]:
    many = _many(gaps)
    if not many:
        return []
    seen = f"markers with many gaps: {', '.join(many[:12])}"
    places = tuple(label for label, share in gaps.items() if MANY_GAPS < share < 100.0)
    advice = "label them again, or leave them out of the marker map"
    worst = max(share for share in gaps.values() if share < 100.0)
    return [Finding(InstrumentFault.HIDDEN, "markers.gaps", seen, source, places, worst, unit="%", advice=advice)]


def _plates(trial: Trial) -> tuple[PlateCheck, ...]:
    forces, facts = trial.forces, trial.parameters
    kinds = [facts.get(f"{plate.name} type", "") for plate in forces.plates] if forces else []
    return tuple(check_plate(forces, k, kind) for k, kind in enumerate(kinds)) if forces else ()


def plate_problems(
    trial: Trial, mass: float | None, plates: tuple[PlateCheck, ...] | None = None
) -> tuple[Finding, ...]:
    """What is wrong with the plates of a trial by themselves: zeros, places, limits, and the weight on them.

    Args:
        trial: the trial.
        mass: of the body, on record [kg].
        plates: facts about each, by default those of the trial.
    """
    source = trial.parameters.get("file", trial.name)
    weighed = weight_problem(trial, mass, source=source)
    found = _of_plates(_plates(trial) if plates is None else plates, source)
    return tuple(found) if weighed is None else (*found, weighed)


def _of_plates(plates: tuple[PlateCheck, ...], source: str) -> list[Finding]:
    found = []
    for plate in plates:
        if plate.baseline is not None and abs(plate.baseline) > ZERO_WRONG_N:
            found.append(unloaded_reading(plate.name, plate.baseline, "plates.offset", source))
        if plate.outside > OUTSIDE:
            seen = (
                f"{plate.name}: centre of pressure beside the plate for {100 * plate.outside:.0f} % of its loaded time"
            )
            found.append(
                Finding(
                    InstrumentFault.PLACE, "plates.outside", seen, source, (plate.name,), 100 * plate.outside, unit="%",
                    advice="check CORNERS, ORIGIN and the channel order",
                )
            )  # fmt: skip
        if plate.saturated:
            seen = f"{plate.name} stays on its largest value for {plate.saturated} samples: saturated"
            found.append(
                Finding(
                    InstrumentFault.LIMIT, "plates.saturated", seen, source, (plate.name,), float(plate.saturated),
                    unit="samples", advice="lower its gain, leave those frames out",
                )
            )  # fmt: skip
    return found


def weight_problem(trial: Trial, mass: float | None, known: str = "on record", source: str = "") -> Finding | None:
    """That the plates of a trial carry another weight than the body's; None where they do not, or nothing can tell.

    Args:
        trial: the trial.
        mass: of the body [kg].
        known: how that is known, as the end of ``70.0 kg are ...``.
        source: the file, by default the trial's name.
    """
    moved = moved_mass(trial)
    if moved is None or not mass or abs(moved / mass - 1.0) <= WEIGHT_MISMATCH:
        return None
    return other_weight(moved, mass, source or trial.name, known)


def format_check(check: TrialCheck) -> Group:
    """The check for a terminal: facts, plates, problems and warnings with their cures, notes."""
    table = Table(show_header=False, box=None, pad_edge=False)
    for key, value in _facts(check):
        table.add_row(Text(key, style="dim"), Text(value))
    problems = [Text(f"! {note}", style="yellow") for note in check.problems]
    warnings = [Text(f"~ {note}") for note in check.warnings]
    notes = [Text(f"  {note.message} [{note.code}]", style="dim") for note in check.notes]
    return Group(
        Text(f"{check.name}", style="bold"),
        table,
        *(problems or [Text("no problems found", "green")]),
        *warnings,
        *notes,
    )


def _facts(check: TrialCheck) -> list[tuple[str, str]]:
    worst = sorted(check.gaps.items(), key=lambda item: -item[1])[:3]
    gaps = f"{check.gap_share:.1f} %" + "".join(f", {label} {share:.0f} %" for label, share in worst if share)
    facts = [
        ("file", check.source), ("subject", check.subject or "not stated"),
        ("markers", f"{check.markers} at {check.rate:.6g} Hz, {check.frames} frames, {check.duration:.2f} s"),
        ("gaps", gaps), ("axes", f"{check.up.upper()} up in the file, unit {check.units or 'not stated'}"),
        ("events", str(check.events)), ("forces", f"{check.force_rate:.6g} Hz" if check.force_rate else "none"),
    ]  # fmt: skip
    for plate in check.plates:
        kind = f"type {plate.kind}, " if plate.kind else ""
        free = "never free" if plate.baseline is None else f"{plate.baseline:.1f} N unloaded"
        facts.append((plate.name, f"{kind}vertical mean {plate.mean:.1f} N, peak {plate.peak:.0f} N, {free}"))
    if check.weight is not None:
        stated = f", {check.recorded_mass:g} kg on record" if check.recorded_mass else ""
        moved = f", {check.mass:.2f} kg by the markers' acceleration" if check.mass else ""
        facts.append(("weight", f"{check.weight:.2f} kg on the plates{moved}{stated}"))
    return facts
