"""What differs between two readings, in the words of the rules about what reading cannot know.

``UNDETECTABLE`` is the table of docs/reading.md. A change that none of its rules covers is named with a ``!`` before
it; the fuzzer counts those as failures of the reader.
"""

import numpy as np

from fuzzing.reading import Reading, Values

UNDETECTABLE = {
    "sample": "A sample of a marker or force channel that changed to a value which is possible there.",
    "gap": "A sample that the file marks as not seen, or no longer so.",
    "label": "Another name, or two names exchanged: a marker, a column or a link is what its name says.",
    "rounding": "A change below the last digit that matters: 0.02 mm, 0.1 N and N m, 0.1 of a period of the clock.",
    "calibration": "Scale, offset or sensitivity of a force channel, as long as forces stay possible; whether they "
    "agree with weight and feet, `torchid check` tells.",
    "plate place": "Corners and origin of a plate whose corners are a possible rectangle; `torchid check` compares "
    "pressure and feet.",
    "event": "Name or time of an event.",
    "fact": "What a file says beside its numbers: subject, mass, software.",
    "choice": "Another valid value of a config or marker set: it is another wish.",
    "number": "Another number of a model: a mass, a length, an axis, a limit that a body may have.",
    "part": "A part of a model that is there, or not, and leaves a whole tree.",
}
NEAR = 1.5
"""A marker sample stays within this of where the trial's markers are, else it is impossible [m]."""
STRONGEST = 20e3
"""Largest force [N] that a plate can have."""
LARGEST_MOMENT = 20e3
"""Moment [N m] about the origin of 2 kN that act 10 m away; a laboratory has no more."""
TOGETHER, MARKERS = 1e-3, 5
"""All of so many markers that move by so much [m] in one frame are no samples, but a frame in another's place."""
LOADED, BESIDE = 100.0, 0.2
"""Vertical force [N] under which a centre of pressure counts, and how far [m] it may lie from its plate in the median:
twice what readers must say."""
PLACE_M, FORCE_N, PERIODS = 2e-5, 0.1, 0.1
FEW = 0.5
"""Share of a marker's or plate's samples below which single samples changed, not their calibration."""


def changes(kind: str, before: Reading, after: Reading) -> tuple[str, ...]:
    """Names of the rules, or ``!what``, by which two readings differ; empty where they are equal."""
    old, new = before.values, after.values
    if kind in ("config", "marker_set"):
        return () if old == new else ("choice",)
    if kind in ("urdf", "mjcf"):
        return _model(old, new)
    return tuple(sorted({*_markers(old, new), *_forces(old, new), *_words(old, new)}))


def _model(old: Values, new: Values) -> tuple[str, ...]:
    if len(old["bodies"]) != len(new["bodies"]) or len(old["marks"]) != len(new["marks"]):
        return ("part",)
    arrays = ("offset", "constant", "inertia", "scatter", "places")
    shapes = all(old[key].shape == new[key].shape for key in arrays)
    if not shapes or old["parents"] != new["parents"]:
        return ("part",)
    bad = [key for key in arrays if not np.isfinite(new[key]).all()]
    if bad:
        return tuple(f"!{key} is not finite" for key in bad)
    same = all(np.array_equal(old[key], new[key]) for key in arrays) and old["height"] == new["height"]
    found = set() if same else {"number"}
    if old["bodies"] != new["bodies"] or old["marks"] != new["marks"]:
        found.add("label")
    elif old["tree"] != new["tree"]:
        found |= {"label"} if old["tree"].dof_names != new["tree"].dof_names else {"number"}
    return tuple(sorted(found))


def _words(old: Values, new: Values) -> set[str]:
    """Labels, events and facts; rates and units among the facts are seen in the numbers."""
    found = {"event"} if old["events"] != new["events"] else set()
    if old["facts"] != new["facts"]:
        found.add("fact")
    if old["labels"] != new["labels"] or old.get("plates") != new.get("plates"):
        found.add("label")
    return found


def _clock(old: np.ndarray, new: np.ndarray, what: str) -> set[str]:
    if len(old) != len(new):
        return {f"!number of {what}"}
    if len(old) < 2 or np.array_equal(old, new):
        return set()
    off = np.abs(new - old).max() / (old[1] - old[0])
    return {"rounding"} if off <= PERIODS else {f"!clock of {what}"}


def _markers(old: Values, new: Values) -> set[str]:
    found = _clock(old["time"], new["time"], "frames")
    was, now = old["position"], new["position"]
    if was.shape != now.shape:
        return found | ({"!number of markers"} if was.shape[1] != now.shape[1] else {"!number of frames"})
    moved = ~((was == now) | (np.isnan(was) & np.isnan(now))).all(axis=2)
    if not moved.any():
        return found
    seen, still = ~np.isnan(was).any(axis=2), ~np.isnan(now).any(axis=2)
    if (seen != still).any():
        found.add("gap")
        moved &= seen & still
    far = np.abs(now - was).max(axis=2, initial=0.0, where=moved[..., None])
    if not moved.any() or far.max() <= PLACE_M:
        return found | ({"rounding"} if moved.any() else set())
    whole = moved.mean(axis=0) > FEW
    if whole.any() and not _renamed(was, now):
        found.add("!all of a marker" if whole.sum() < moved.shape[1] / 2 else "!all markers")
    if (moved & ~whole).any():
        low, high = np.nanmin(was, axis=(0, 1)) - NEAR, np.nanmax(was, axis=(0, 1)) + NEAR
        possible = ((now >= low) & (now <= high)).all(axis=2) | ~moved | whole
        found.add("sample" if possible.all() else "!impossible sample")
        if _whole_frame(far, still):
            found.add("!whole frames")
    return found | ({"label"} if whole.any() and not any("!all" in one for one in found) else set())


def _whole_frame(far: np.ndarray, seen: np.ndarray) -> bool:
    """Whether every marker seen in some frame is elsewhere in it, by ``far`` (frames, markers)."""
    moved = ((far > 0.0) & seen).sum(axis=1)
    return bool(((moved >= MARKERS) & (moved == seen.sum(axis=1)) & (np.median(far, axis=1) > TOGETHER)).any())


def _renamed(was: np.ndarray, now: np.ndarray) -> bool:
    """Whether every column stands somewhere in ``was``, but for a few samples; signs aside, as Y up is turned to Z."""
    before, after = (np.nan_to_num(np.abs(x), nan=1e9).reshape(len(x), -1).T for x in (was, now))
    same = [max(float((column == other).mean()) for other in before) > FEW for column in after]
    return all(same) and before.shape == after.shape


def _forces(old: Values, new: Values) -> set[str]:
    if "wrench" not in old and "wrench" not in new:
        return set()
    if "wrench" not in old or "wrench" not in new or old["wrench"].shape[1] != new["wrench"].shape[1]:
        return {"!number of plates"}
    found = _clock(old["force time"], new["force time"], "force samples")
    was, now = old["wrench"], new["wrench"]
    if was.shape != now.shape:
        return found
    if old["corners"] != new["corners"]:
        found.add("plate place")
    moved = ~((was == now) | (np.isnan(was) & np.isnan(now))).all(axis=2)
    if not moved.any():
        return found
    if (np.isnan(was) != np.isnan(now)).any():
        found.add("gap")
    if np.nanmax(np.abs(now - was), initial=0.0) <= FORCE_N:
        return found | {"rounding"}
    found |= _impossible(new)
    if (moved.mean(axis=0) > FEW).any():
        return found | {"calibration"}
    return found | {"sample"}


def _impossible(values: Values) -> set[str]:
    wrench = np.abs(values["wrench"])
    if np.nanmax(wrench[..., :3]) > STRONGEST or np.nanmax(wrench[..., 3:]) > LARGEST_MOMENT:
        return {"!impossible force"}
    return {"!impossible pressure"} if _beside_its_plate(values) else set()


def _beside_its_plate(values: Values) -> bool:
    """Whether most of the pressure on some plate lies beside the box around its corners."""
    for wrench, corners in zip(values["wrench"].transpose(1, 0, 2), values["corners"], strict=True):
        loaded = wrench[np.abs(wrench[:, 2]) > LOADED]
        if corners is None or not len(loaded):
            continue
        box = np.reshape(corners, (4, 3))
        low, high, height = box[:, :2].min(axis=0), box[:, :2].max(axis=0), box[:, 2].mean()
        x = (-loaded[:, 4] + height * loaded[:, 0]) / loaded[:, 2]
        y = (loaded[:, 3] + height * loaded[:, 1]) / loaded[:, 2]
        point = np.stack([x, y], axis=1)
        if np.nanmedian(np.maximum(low - point, point - high).max(axis=1)) > BESIDE:
            return True
    return False
