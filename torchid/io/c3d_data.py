"""Points and analog channels of a C3D file, decoded from its data section."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from torchid.errors import Note
from torchid.io.c3d_header import C3dHeader
from torchid.io.c3d_layout import C3dLayout
from torchid.io.files import FileBytes

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
