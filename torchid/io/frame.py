"""Units and the vertical axis of a file, from what it states and from what the data show."""

import re
import warnings

import numpy as np
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import SAMPLE_LOADED_N
from torchid.errors import InputError, Note
from torchid.io.options import ReadOptions
from torchid.recording import Forces

METRES = {"mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0, "in": 0.0254}
"""Length of each unit [m]."""

WORDS = {
    "millimetres": "mm", "millimeters": "mm", "centimetres": "cm", "centimeters": "cm", "metres": "m", "meters": "m",
    "inches": "in",
}  # fmt: skip
"""Units spelled out; files cut them short (``mete``)."""
POSSIBLE = (0.1, 6.0)
"""Extent of a marker cloud [m] that raises no doubt."""
LIKELY = (0.3, 3.0)
"""Extent [m] that another unit must give before the stated one is called wrong."""
CLEAR_EXTENT = 1.3
"""A cloud this much taller than wide shows which axis is vertical."""
BELOW_FLOOR = (-0.05, -0.2)
"""Along the vertical axis no marker lies lower [m] than the first; where they lie lower than the second along another
axis, that one is not vertical. Between the two a floor that was levelled badly, or a plate of markers, may lie."""
SAMPLES = 100_000
"""Of a long recording's forces so many tell axis, signs and offsets."""
LOADED_SHARE = 0.3
"""Of the largest force; plates that bear less say nothing about the vertical."""
CLEAR_FORCE = 0.8
"""Share of the mean ground reaction along one axis that shows it to be vertical."""


def length_unit(
    stated: str, position: Float[np.ndarray, "frames markers 3"], options: ReadOptions, source: str
) -> tuple[str, list[Note]]:
    """Unit of the positions (frames, markers, 3), a key of ``METRES``.

    Raises:
        InputError: ``units.missing`` or ``units.implausible`` where the file and its data leave it open.
    """
    if options.units is not None:
        return options.units, [Note("units.override", f"positions read in {options.units} as asked", source)]
    cleaned = re.sub(r"[^a-z]", "", stated.lower())
    words = [unit for word, unit in WORDS.items() if len(cleaned) > 2 and word.startswith(cleaned)]
    unit = words[0] if words else cleaned
    extent = _extent(position)
    likely = [u for u in METRES if LIKELY[0] <= extent * METRES[u] <= LIKELY[1]]
    if unit in METRES:
        if likely and not POSSIBLE[0] <= extent * METRES[unit] <= POSSIBLE[1]:
            raise _ask("units.implausible", "the unit stated does not fit the markers", stated, extent, likely, source)
        return unit, []
    if len(likely) == 1 and not cleaned:
        text = f"no unit stated; {likely[0]} taken from the size of the marker cloud"
        return likely[0], [Note("units.assumed", text, source)]
    if not np.isfinite(extent) and not cleaned:
        return "mm", [Note("units.assumed", "no unit stated and no markers; mm taken", source)]
    raise _ask("units.missing", "the unit of the positions is not known", stated, extent, likely, source)


def _ask(code: str, message: str, stated: str, extent: float, likely: list[str], source: str) -> InputError:
    found = f"{stated!r}, markers {extent:.4g} units apart"
    return InputError(
        code, message, source=source, place="units", found=found,
        remedy=f"Give units: ({' or '.join(likely) if likely else 'mm, cm, m or in'})",
    )  # fmt: skip


def _extent(position: np.ndarray) -> float:
    """Median over the frames of the largest side of the box around the markers; NaN for fewer than three markers."""
    return float(np.max(_extents(position), initial=-np.inf)) if position.shape[1] >= 3 and len(position) else np.nan


def _extents(position: np.ndarray) -> np.ndarray:
    """Sides (3,) of the box around the markers, median over at most 500 frames."""
    some = position[:: max(1, len(position) // 500)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmedian(np.nanmax(some, axis=1) - np.nanmin(some, axis=1), axis=0)


def vertical_axis(
    position: Float[np.ndarray, "frames markers 3"],
    forces: Forces | None,
    stated: str,
    customary: str,
    options: ReadOptions,
    source: str,
    beside: Forces | None = None,
) -> tuple[str, list[Note]]:
    """``y`` or ``z``: the vertical axis of a file.

    The plates' surfaces decide, then the ground reaction, then what the file states, then the markers; an override
    stands above the file but not above the plates. Where nothing shows it, it is asked for.

    Args:
        position: (frames, markers, 3) in m.
        forces: in the file's axes, or None.
        stated: ``y``, ``z`` or empty.
        customary: the axis that the format usually has, taken where there is nothing to turn.
        beside: forces of another file, whose axes may be others; asked last.

    Raises:
        InputError: ``axes.contradiction``, ``axes.unsupported`` and ``axes.unknown``.
    """
    facing = _plate_axis(forces)
    pushed = facing or force_axis(forces)
    refuse_axis(pushed, options.up or stated, "config" if options.up else "file", source)
    seen = _marker_axis(position)
    nothing = not np.isfinite(position).any()
    signs = (
        (lambda: options.up, "as asked"),
        (lambda: pushed, "by the surfaces of the plates" if facing else "by the ground reaction"),
        (lambda: stated, "stated by the file"),
        (lambda: seen, "by the markers"),
        (lambda: _floor_axis(position), "by the floor: along the other axis markers would lie below it"),
        (lambda: force_axis(beside).strip("x"), "by the ground reaction of the other file"),
        (lambda: customary if nothing else "", "by custom of the format; there is nothing to turn"),
    )
    axis, reason = next(((up, why) for sign, why in signs if (up := sign())), ("", ""))
    if not axis:
        raise _unknown_axis(position, source)
    turned = "; rotated to Z up" if axis == "y" else ""
    notes = [Note("axes.up", f"vertical axis {axis.upper()} {reason}{turned}", source)]
    if seen and seen != axis:
        text = f"the marker cloud is tallest along {seen.upper()}, not {axis.upper()}"
        notes.append(Note("axes.markers", text, source))
    return axis, notes


def _unknown_axis(position: np.ndarray, source: str) -> InputError:
    sides = ", ".join(f"{side:.2f} m along {name}" for name, side in zip("XYZ", _extents(position), strict=True))
    return InputError(
        "axes.unknown", "nothing in the file shows which axis is vertical", source=source, place="axes",
        found=f"no loaded plate, no stated axis, and a marker cloud of {sides}",
        remedy="Name it in the config, beside file:, with up: z or up: y",
    )  # fmt: skip


def refuse_axis(pushed: str, chosen: str, by: str, source: str) -> None:
    """Refuse an axis of the ground reaction that cannot be turned up, or that config or file (``by``) deny.

    Raises:
        InputError: ``axes.unsupported`` and ``axes.contradiction``.
    """
    if pushed == "x":
        raise InputError(
            "axes.unsupported", "the ground reaction points along X", source=source, place="force plates",
            found="X vertical", remedy="Rotate the laboratory's axes so that Y or Z is vertical",
        )  # fmt: skip
    if pushed and chosen and pushed != chosen:
        raise InputError(
            "axes.contradiction",
            f"the vertical axis is {chosen.upper()} by the {by}, but the ground reaction points along {pushed.upper()}",
            source=source,
            place="axes",
            found=f"{pushed.upper()} vertical by force",
            remedy=f"Give up: {pushed} if markers and forces have {pushed.upper()} up, or, if the forces alone do, "
            f"up: {chosen}, forces_as: {{up: {pushed}}}",
        )


def force_axis(forces: Forces | None) -> str:
    """Axis (x, y or z) of the mean force of each plate while loaded, whatever its sign, empty where none stands out."""
    if forces is None or not len(forces.time) or not forces.plates:
        return ""
    force = forces.wrench[:: max(1, len(forces.wrench) // SAMPLES), :, :3].nan_to_num()
    size = force.norm(dim=-1)
    if float(size.max()) < SAMPLE_LOADED_N:
        return ""
    loaded = (size > LOADED_SHARE * size.max())[..., None]
    mean = (force * loaded).sum(dim=0).abs().sum(dim=0)
    share, axis = (mean / mean.norm().clamp_min(1e-9)).max(dim=0)
    return "xyz"[int(axis)] if float(share) > CLEAR_FORCE else ""


def _marker_axis(position: np.ndarray) -> str:
    """Y or Z along which the cloud is clearly the tallest, else empty."""
    if position.shape[1] < 6 or not len(position):
        return ""
    extents = _extents(position)
    order = np.argsort(extents)
    clear = np.isfinite(extents).all() and extents[order[2]] > CLEAR_EXTENT * extents[order[1]]
    return "xyz"[order[2]] if clear and order[2] > 0 else ""


def _plate_axis(forces: Forces | None) -> str:
    """Y or Z along which the surfaces of all plates face, empty where they have none or face elsewhere."""
    corners = [plate.corners for plate in forces.plates if plate.corners is not None] if forces else []
    if not corners:
        return ""
    stacked = np.stack([np.asarray(four) for four in corners])
    normal = np.abs(np.cross(stacked[:, 2] - stacked[:, 0], stacked[:, 3] - stacked[:, 1])).sum(axis=0)
    axis = int(normal.argmax())
    return "xyz"[axis] if axis and normal[axis] > CLEAR_FORCE * np.linalg.norm(normal) else ""


def _floor_axis(position: np.ndarray) -> str:
    """Y or Z along which nothing lies below the floor, where much does along the other; else empty."""
    some = position[:: max(1, len(position) // 500), :, 1:]
    some = some[np.isfinite(some).all(axis=-1)]
    if not len(some):
        return ""
    low = np.quantile(some, 0.01, axis=0)
    above, below = low > BELOW_FLOOR[0], low < BELOW_FLOOR[1]
    return "y" if above[0] and below[1] else "z" if above[1] and below[0] else ""


def to_world(vectors: Float[Tensor, "*batch n"], axis: str) -> Float[Tensor, "*batch n"]:
    """Vectors (*batch, 3) or six-vectors (*batch, 6) of a file with this vertical axis, in W."""
    return vectors if axis == "z" else turn_to_world(vectors.clone(), axis)


def turn_to_world(vectors: Float[Tensor, "*batch n"], axis: str) -> Float[Tensor, "*batch n"]:
    """``to_world`` in place: an hour of samples has no room for a copy."""
    if axis != "z":
        for k in range(0, vectors.shape[-1], 3):
            y = vectors[..., k + 1].clone()
            vectors[..., k + 1] = -vectors[..., k + 2]
            vectors[..., k + 2] = y
    return vectors
