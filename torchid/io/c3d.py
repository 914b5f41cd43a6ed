"""C3D files: header, parameters, points, analog channels, plates and events to one `Trial`."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from torchid.errors import InputError, Note
from torchid.io.c3d_header import C3dHeader, read_header
from torchid.io.c3d_layout import C3dLayout, resolve_layout
from torchid.io.files import FileBytes
from torchid.io.frame import METRES, length_unit
from torchid.io.labels import OUTPUT_LISTS, select_markers
from torchid.io.options import ReadOptions
from torchid.io.plates import read_plates
from torchid.io.raw import Measured, RawTrial, assemble
from torchid.recording import Event, Forces, Trial


def read_c3d(
    path: str | Path,
    name: str | None = None,
    role: str = "fit",
    options: ReadOptions | None = None,
    measured: Measured = (None, (), ()),
) -> Trial:
    """A trial from a C3D file.

    Args:
        name: of the trial; the file's stem by default.
        role: static, fit or heldout; markers that stand still are not suspect in a static trial.
        measured: forces of another file, in its axes and on its clock; the plates of this one are then left out.

    Raises:
        InputError: the file cannot be read or contradicts itself; codes ``c3d.*``, ``markers.*``,
            ``units.*``, ``axes.*``.

    Reference: the C3D file format user guide, https://www.c3d.org.
    """
    path, options = Path(path), options or ReadOptions()
    data = FileBytes(path)
    header = read_header(data, path)
    _refuse_rotations(header)
    layout = resolve_layout(header, data, options.allow_truncated)
    raw = _raw(data, header, layout, options)
    return assemble(_with_forces(raw, measured), name or path.stem, role, options)


def _with_forces(raw: RawTrial, measured: Measured) -> RawTrial:
    """With forces of another file, the file's own plates only tell its vertical axis."""
    beside, said, facts = measured
    if beside is None:
        return raw
    notes = tuple(note for note in raw.notes if not note.code.startswith("plates."))
    if raw.forces is not None:
        text = f"{len(raw.forces.plates)} plates of the C3D left out for the forces given beside it"
        notes = (*notes, Note("plates.replaced", text, raw.source))
    parameters = tuple((key, value) for key, value in raw.parameters if not key.startswith("plate "))
    return replace(raw, beside=beside, notes=(*notes, *said), parameters=(*parameters, *facts))


def _refuse_rotations(header: C3dHeader) -> None:
    if header.number("ROTATION", "USED"):
        raise InputError(
            "c3d.rotations", "rotations are not supported", source=header.source, place="ROTATION:USED",
            found=f"{header.number('ROTATION', 'USED'):g} rotations", remedy="Export marker positions",
        )  # fmt: skip


def _raw(data: FileBytes, header: C3dHeader, layout: C3dLayout, options: ReadOptions) -> RawTrial:
    labels = (header.strings("POINT", "LABELS") + [""] * layout.points)[: layout.points]
    chosen = select_markers(labels, header.source, _outputs(header), options.subject, options.wanted)
    position = read_points(data, layout, header, chosen.columns)
    unit, said = length_unit(" ".join(header.strings("POINT", "UNITS")[:1]), position, options, header.source)
    begin = (layout.first_frame - 1) / layout.rate
    forces, force_notes, plate_facts = _forces(data, header, layout, METRES[unit], begin, options)
    time = begin + np.arange(layout.frames) / layout.rate
    position *= METRES[unit]
    events, event_notes = _events(header, layout, begin)
    return RawTrial(
        source=header.source,
        labels=chosen.labels,
        time=time,
        position=position,
        forces=forces,
        up=_screen_axis(header),
        customary="z",
        events=events,
        notes=(*header.notes, *layout.notes, *chosen.notes, *said, *force_notes, *event_notes),
        parameters=(*_facts(header, layout, unit).items(), *plate_facts.items()),
    )


def _outputs(header: C3dHeader) -> frozenset[str]:
    """Labels that the file lists as outputs of a model (POINT:TYPE_GROUPS and the lists it names)."""
    groups = {*OUTPUT_LISTS, *(g.upper() for g in header.strings("POINT", "TYPE_GROUPS")[::2])}
    return frozenset(label for group in groups if group for label in header.strings("POINT", group))


def _screen_axis(header: C3dHeader) -> str:
    """Vertical axis by POINT:Y_SCREEN, empty where it names none that can be vertical."""
    text = " ".join(header.strings("POINT", "Y_SCREEN")[:1]).strip("+ ").lower()
    return text if text in ("y", "z") else ""


def _forces(
    data: FileBytes, header: C3dHeader, layout: C3dLayout, metres: float, begin: float, options: ReadOptions
) -> tuple[Forces | None, list[Note], dict[str, str]]:
    if not layout.channels or not layout.frames:
        return None, [Note("plates.none", "the file has no analog data", header.source)], {}
    _, said = read_analogs(data, layout, header, ())
    read = lambda columns: analog_pieces(data, layout, header, columns)  # noqa: E731
    samples = layout.frames * layout.ratio
    wrench, plates, notes, facts = read_plates(header, read, (samples, layout.channels), metres, options.plates)
    if not plates:
        return None, [*said, *notes, Note("plates.none", "the file has no usable force plate", header.source)], facts
    notes += _invalid(wrench, header.source)
    time = begin + torch.arange(samples, dtype=torch.float64) / (layout.rate * layout.ratio)
    return Forces(time, wrench, plates), [*said, *notes], facts


def _invalid(wrench: torch.Tensor, source: str) -> list[Note]:
    count = int(wrench.isnan().any(dim=-1).sum())
    return [Note("plates.invalid", f"{count} plate samples are not numbers", source)] if count else []


def _miscounted(header: C3dHeader, held: dict[str, int]) -> list[Note]:
    """A note where EVENT:USED and the lists of the group do not count alike; contexts may be absent."""
    used = header.number("EVENT", "USED")
    counts = {name: count for name, count in held.items() if count or name != "contexts"}
    stated = counts if used is None else {"used": int(used), **counts}
    if len(set(stated.values())) < 2:
        return []
    text = f"the group EVENT counts {', '.join(f'{count} {name}' for name, count in stated.items())}"
    return [Note("events.count", f"{text}; {min(counts['labels'], counts['times'])} read", header.source)]


def _facts(header: C3dHeader, layout: C3dLayout, unit: str) -> dict[str, str]:
    facts = {
        "format": "C3D",
        "storage": f"{header.processor.name} {'real' if layout.is_float else 'integer'}",
        "units": unit,
        "rate_hz": f"{layout.rate:.10g}",
        "analog_rate_hz": f"{layout.rate * layout.ratio:.10g}",
        "first_frame": str(layout.first_frame),
    }
    stated = {
        "subject": " ".join(header.strings("SUBJECTS", "NAMES")[:1]),
        "marker_set": " ".join(header.strings("SUBJECTS", "MARKER_SETS")[:1]),
        "software": " ".join(header.strings("MANUFACTURER", "SOFTWARE")[:1]),
        "mass_kg": _text(header.number("PROCESSING", "BODYMASS"), 1.0),
        "height_m": _text(header.number("PROCESSING", "HEIGHT"), METRES[unit]),
    }
    return facts | {key: value for key, value in stated.items() if value}


def _text(value: float | None, factor: float) -> str:
    return f"{value * factor:.6g}" if value else ""


def _events(header: C3dHeader, layout: C3dLayout, begin: float) -> tuple[tuple[Event, ...], list[Note]]:
    """Events of the group EVENT; their times [min, s] count from frame 1, as the trial's clock does.

    Some programs count from the first frame stored; where only that puts them inside the trial, they are shifted.
    """
    labels, sides = header.strings("EVENT", "LABELS"), header.strings("EVENT", "CONTEXTS")
    times = header.numbers("EVENT", "TIMES")
    times = times[: len(times) // 2 * 2].reshape(-1, 2) @ np.array([60.0, 1.0])
    count = min(len(labels), len(times))
    notes = _miscounted(header, {"labels": len(labels), "times": len(times), "contexts": len(sides)})
    times = times[:count]
    if not np.isfinite(times).all():
        return (), [*notes, Note("events.invalid", "events whose times are no numbers are left out", header.source)]
    if not count:
        return (), notes
    end, slack = begin + layout.frames / layout.rate, 2.0 / layout.rate
    inside = (times >= begin - slack) & (times <= end + slack)
    shifted = (times + begin >= begin - slack) & (times + begin <= end + slack)
    if shifted.all() and not inside.any():
        times = times + begin
        notes.append(Note("events.shifted", "event times count from the first stored frame; shifted", header.source))
    elif not inside.all():
        notes.append(Note("events.outside", f"{int((~inside).sum())} events lie outside the trial", header.source))
    found = [Event(labels[k], (sides + [""] * count)[k], float(times[k])) for k in range(count)]
    return tuple(sorted(found, key=lambda event: event.time)), notes


PIECE = 1 << 22
"""Bytes of the data section that are decoded at a time."""


def read_points(
    data: bytes | FileBytes, layout: C3dLayout, header: C3dHeader, columns: Sequence[int] | None = None
) -> Float[np.ndarray, "frames points 3"]:
    """Points (or those at ``columns``) in file units as float64; NaN where the residual is negative or not finite."""
    chosen = list(range(layout.points) if columns is None else columns)
    points = np.empty((layout.frames, len(chosen), 3))
    for part, values in _pieces(data, layout, header):
        raw = values[:, : 4 * layout.points].reshape(len(values), layout.points, 4)[:, chosen]
        with np.errstate(invalid="ignore"):
            # A signalling NaN in a damaged file would warn where it is cast.
            points[part] = raw[..., :3].astype(float) * (1.0 if layout.is_float else layout.scale)
            unseen = raw[..., 3] < 0
        points[part][unseen | ~np.isfinite(points[part]).all(axis=-1)] = np.nan
    return points


def read_analogs(
    data: bytes | FileBytes, layout: C3dLayout, header: C3dHeader, columns: Sequence[int] | None = None
) -> tuple[Float[np.ndarray, "samples channels"], tuple[Note, ...]]:
    """Analog channels (or those at ``columns``) in their units: (stored - OFFSET) SCALE GEN_SCALE.

    A channel without scale or offset is NaN throughout, and said.
    """
    count = layout.channels if columns is None else len(columns)
    found = np.empty((layout.frames * layout.ratio, count))
    for part, values in analog_pieces(data, layout, header, range(count) if columns is None else columns):
        found[part] = values
    scaled = min(len(header.numbers("ANALOG", name)) for name in ("SCALE", "OFFSET"))
    if scaled >= layout.channels:
        return found, ()
    text = f"{layout.channels - scaled} of {layout.channels} analog channels have no SCALE or OFFSET and are left out"
    return found, (Note("c3d.analog_scale", text, header.source),)


def analog_pieces(
    data: bytes | FileBytes, layout: C3dLayout, header: C3dHeader, columns: Sequence[int]
) -> Iterator[tuple[slice, Float[np.ndarray, "samples channels"]]]:
    """``read_analogs`` a few samples at a time, each time with where they lie among all."""
    if not len(columns):
        return
    unsigned = header.strings("ANALOG", "FORMAT")[:1] == ["UNSIGNED"]
    scale, offset = header.numbers("ANALOG", "SCALE"), header.numbers("ANALOG", "OFFSET", unsigned)
    known = min(len(scale), len(offset), layout.channels)
    general = header.number("ANALOG", "GEN_SCALE")
    missing = np.full(layout.channels - known, np.nan)
    scale, offset = (np.concatenate([x[:known], missing])[list(columns)] for x in (scale, offset))
    for part, values in _pieces(data, layout, header):
        raw = values[:, 4 * layout.points :].reshape(-1, layout.channels)[:, list(columns)]
        if unsigned and not layout.is_float:
            raw = raw.astype(raw.dtype.str.replace("i", "u"))
        with np.errstate(invalid="ignore", over="ignore"):
            scaled = (raw - offset) * scale * (1.0 if general is None else general)
        scaled[~np.isfinite(scaled)] = np.nan
        yield slice(part.start * layout.ratio, part.stop * layout.ratio), scaled


def _pieces(data: bytes | FileBytes, layout: C3dLayout, header: C3dHeader) -> Iterator[tuple[slice, np.ndarray]]:
    """Stored values (frames, values) of some frames after the other."""
    size = layout.bytes_per_frame
    several = max(1, PIECE // max(1, size))
    for start in range(0, layout.frames, several):
        stop = min(layout.frames, start + several)
        view = data[layout.offset + start * size : layout.offset + stop * size]
        flat = header.processor.floats(view) if layout.is_float else np.frombuffer(view, header.processor.order + "i2")
        yield slice(start, stop), flat.reshape(stop - start, layout.values)
