"""One clock for markers and forces."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt
from torch import Tensor

from torchid.errors import InputError, Note
from torchid.recording import Forces, Trial

PASS_BAND = 0.4
"""Cut-off before decimation as a share of the new rate; half would be the Nyquist limit."""
ORDER = 4
SAME_RATE = 1e-6
SAME_TIME = 1e-6
"""Part of a period up to which two times are one."""


def to_clock(forces: Forces, time: Float[Tensor, " frames"], source: str = "", place: str = "") -> Forces:
    """Forces on another uniform clock, band-limited to what it can carry.

    Towards a lower rate a zero-lag Butterworth low-pass (order 4 run forward and back, cut-off 0.4 of the new rate)
    goes first; cubic splines interpolate. Constants and straight lines pass unchanged up to the ends. NaN outside the
    forces' own time and within a new period of a missing sample. What a program wrote as zero passes the same way, so
    that it stays known (``Forces.zeroed``).

    Args:
        time: the other clock [s].
        source, place: the file and the trial, for errors.

    Raises:
        InputError: ``forces.short`` for fewer than two samples.
    """
    if len(forces.time) < 2:
        raise InputError(
            "forces.short", "forces have fewer than two samples", source=source, place=place,
            found=str(len(forces.time)),
            remedy="Export the whole trial's forces, or leave forces: out",
        )  # fmt: skip
    own, new = forces.time.detach().cpu().numpy(), time.detach().cpu().numpy()
    zeroed = forces.zeroed_share
    tables = [forces.wrench.flatten(1), *([zeroed] if bool(zeroed.any()) else [])]
    columns = [column for one in tables for column in one.detach().cpu().numpy().T]
    rate = (len(new) - 1) / (new[-1] - new[0]) if len(new) > 1 else forces.rate
    missing = np.zeros(len(own), bool)
    for column in columns:
        missing |= ~np.isfinite(column)
    slack = 1e-6 / forces.rate
    inside = (new >= own[0] - slack) & (new <= own[-1] + slack)
    resampled = np.full((len(new), len(columns)), np.nan)
    cutoff = PASS_BAND * rate / forces.rate if forces.rate > rate * (1 + SAME_RATE) else None
    for k, column in enumerate(columns):  # one at a time: filter and spline take ten times the memory of their input
        column = _bridged(column, missing, own)
        column = column if cutoff is None else _low_pass(column, cutoff)
        resampled[inside, k] = _at(own, column, np.clip(new[inside], own[0], own[-1]))
    resampled[_near(new, own[missing], max(1.0 / rate, 1.0 / forces.rate))] = np.nan
    wrench, *share = torch.from_numpy(resampled).to(forces.wrench).split([one.shape[1] for one in tables], 1)
    return Forces(time, wrench.reshape(len(new), len(forces.plates), 6), forces.plates, *share)


def _bridged(values: np.ndarray, missing: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Missing samples on straight lines, so that a filter can pass; they are masked again afterwards."""
    if not missing.any() or missing.all():
        return np.nan_to_num(values)
    return np.interp(time, time[~missing], values[~missing])


def _at(time: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Samples where the wanted times are the signal's own, as they are in a C3D; else through a cubic spline."""
    nearest = np.rint((wanted - time[0]) * ((len(time) - 1) / (time[-1] - time[0]))).astype(int)
    if np.abs(time[nearest] - wanted).max(initial=0.0) < SAME_TIME * (time[1] - time[0]):
        return values[nearest]
    return CubicSpline(time, values)(wanted)


def _low_pass(values: np.ndarray, cutoff: float) -> np.ndarray:
    """Zero-lag low-pass along axis 0; ``cutoff`` in cycles per sample."""
    if len(values) < 4:
        return values
    sections = butter(ORDER, cutoff, fs=1.0, output="sos")
    return sosfiltfilt(sections, values, axis=0, padlen=min(len(values) - 1, int(10 / cutoff)))


def _near(time: np.ndarray, gaps: np.ndarray, distance: float) -> np.ndarray:
    """Which times lie within ``distance`` of a gap."""
    if not len(gaps):
        return np.zeros(len(time), bool)
    after = np.clip(np.searchsorted(gaps, time), 0, len(gaps) - 1)
    before = np.maximum(after - 1, 0)
    return np.minimum(np.abs(gaps[after] - time), np.abs(gaps[before] - time)) < distance


def synchronise(trial: Trial) -> Trial:
    """The trial with its forces on the clock of its markers; frames without forces are NaN, and said.

    Raises:
        InputError: ``trial.no_overlap`` where markers and forces share no frame.
    """
    if trial.forces is None:
        return trial
    source = trial.parameters.get("forces", trial.parameters.get("file", ""))
    place = f"trial {trial.name}"
    forces = to_clock(trial.forces, trial.markers.time, source, place)
    shared = int(forces.wrench.isfinite().flatten(1).all(dim=1).sum())
    if shared == 0:
        raise InputError(
            "trial.no_overlap", "markers and forces share no frame", source=source, place=place,
            remedy="Give the forces of the same trial, on the same clock",
        )  # fmt: skip
    frames, notes = len(trial.markers.time), trial.notes
    if shared < frames:
        notes = (
            *notes,
            Note("trial.frames", f"{shared} of {frames} frames have forces; only they are used", trial.name),
        )
    return replace(trial, forces=forces, notes=notes)
