"""Colours of the page: readable in a bright room, and told apart by everybody."""

import numpy as np
from jaxtyping import Float, UInt8

Rgb = tuple[int, int, int]
UNKNOWN: Rgb = (213, 94, 0)
"""Cited. Vermilion of the palette for all kinds of colour vision (Okabe & Ito, Color Universal Design (2008)), for red;
..."""
HALFWAY: Rgb = (230, 159, 0)
"""Cited. ... its orange; ..."""
KNOWN: Rgb = (0, 158, 115)
"""Cited. ... and its bluish green."""
MEASURED: Rgb = (204, 51, 17)
"""Choice. Red of what was measured, as the source method has it (Venture, Ayusawa & Nakamura, IEEE EMBC (2009)), ..."""
PREDICTED: Rgb = (0, 90, 181)
"""Choice. ... and blue of what the model says; the two differ in lightness as well."""
EXTENDED: Rgb = (0, 158, 115)
"""Choice. What the extended model says."""
MARKER: Rgb = (30, 30, 30)
SCALED: Rgb = (120, 120, 120)
PLATE: Rgb = (190, 202, 214)
FAINT, SOLID = 0.55, 1.0
"""Choice. Opacity of a segment of which nothing is known, and of a known one: the second cue beside its colour."""
ASTRAY_MM = 20.0
"""Choice. Distance of a marker from the model at which its colour says that nothing of it fits."""


def by_progress(progress: Float[np.ndarray, " some"]) -> UInt8[np.ndarray, "some 3"]:
    """Return colours from red through yellow to green, for shares from 0 to 1."""
    stops = np.array([UNKNOWN, HALFWAY, KNOWN], dtype=np.float64)
    at = np.clip(np.nan_to_num(progress), 0.0, 1.0)
    return np.stack([np.interp(at, (0.0, 0.5, 1.0), column) for column in stops.T], 1).round().astype(np.uint8)


def opacity(progress: Float[np.ndarray, " some"]) -> Float[np.ndarray, " some"]:
    """Return how solid a segment is drawn, for shares from 0 to 1."""
    return FAINT + (SOLID - FAINT) * np.clip(np.nan_to_num(progress), 0.0, 1.0)


def by_distance(distance_m: Float[np.ndarray, " some"]) -> UInt8[np.ndarray, "some 3"]:
    """Return colours of markers from green to red, for distances from the model of 0 to ``ASTRAY_MM``."""
    return by_progress(1.0 - 1e3 * distance_m / ASTRAY_MM)
