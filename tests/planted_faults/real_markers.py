"""Faults of markers that files can carry, planted into a session's recordings."""

from collections.abc import Sequence

import numpy as np
import scipy.signal
import torch

from planted_faults.real_files import Recorded, with_markers
from planted_faults.real_forces import Draw
from planted_faults.real_truth import Answer, Inapplicable, Truth
from torchid.recording import Trial
from torchid.runs import runs

CHEST = ("thorax", "abdomen")
"""Segments whose markers do not keep their distances: shoulders are part of them."""
SEEN = 0.8
"""Choice. Part of a trial's frames in which a marker must be seen for a fault of it to be planted."""
PAIR_M = (0.04, 0.30)
"""Choice. Distance of two markers whose labels are exchanged [m]: what anybody sees, and what programs mix up."""
SWAP_S = (0.3, 1.0)
FILTER_HZ = 4.0


def plant_scale(recorded: Recorded, scale: float) -> tuple[Recorded, Truth]:
    """All positions of markers times a factor; plates stay where they are."""
    for k, trial in enumerate(recorded.trials):
        recorded = recorded.with_trial(k, with_markers(trial, scale * trial.markers.position))
    return recorded, Truth((Answer("marker_scale", ("session",), {"scale": [scale]}),), f"{100 * (scale - 1):+.0f} %")


def plant_filter(recorded: Recorded, cutoff_hz: float = FILTER_HZ) -> tuple[Recorded, Truth]:
    """All markers passed a second-order Butterworth low-pass both ways, each stretch between gaps by itself."""
    for k, trial in enumerate(recorded.trials):
        if len(trial.markers.time) > 1:
            smooth = _low_passed(trial.markers.position.numpy(), cutoff_hz, trial.markers.rate)
            recorded = recorded.with_trial(k, with_markers(trial, torch.from_numpy(smooth)))
    return recorded, Truth((Answer("filter_lag", ("session",), {"cutoff_hz": [cutoff_hz]}),), f"{cutoff_hz:g} Hz")


def _low_passed(position: np.ndarray, cutoff_hz: float, rate_hz: float) -> np.ndarray:
    smooth, sections = position.copy(), scipy.signal.butter(2, cutoff_hz, fs=rate_hz, output="sos")
    pad = round(rate_hz / cutoff_hz)
    for k in range(position.shape[1]):
        for a, b in runs(torch.from_numpy(np.isfinite(position[:, k]).all(1))):
            if b - a > 2:
                smooth[a:b, k] = scipy.signal.sosfiltfilt(
                    sections, position[a:b, k], axis=0, padlen=min(pad, b - a - 1)
                )
    return smooth


def movable(recorded: Recorded, scored: bool) -> list[str]:
    """Markers that can be moved in their segment's frame: of at least four markers outside the chest if ``scored``,
    else the others, of at least three."""
    seen = [label for label in recorded.segments if all(_seen(t, label) for t in recorded.trials)]
    count = {s: sum(recorded.segments[label] == s for label in seen) for s in set(recorded.segments.values())}
    return [
        label for label in seen
        if count[recorded.segments[label]] >= 3
        and (recorded.segments[label] not in CHEST and count[recorded.segments[label]] > 3) is scored
    ]  # fmt: skip


def _seen(trial: Trial, label: str) -> bool:
    if label not in trial.markers.labels:
        return False
    known = trial.markers.position[:, trial.markers.labels.index(label)].isfinite().all(1)
    return float(known.double().mean()) > SEEN


def plant_shift(recorded: Recorded, label: str, shift: Sequence[float], first: int) -> tuple[Recorded, Truth]:
    """A marker sits elsewhere on its segment, along axes that its markers carry [m], from the trial ``first`` on."""
    segment = recorded.segments[label]
    cluster = [one for one, own in recorded.segments.items() if own == segment]
    shape = _shape(recorded, cluster)
    for k in recorded.moving:
        trial = recorded.trials[k]
        if k >= first and label in trial.markers.labels:
            position = trial.markers.position.clone()
            moved = torch.from_numpy(_turns(trial, cluster, shape) @ np.asarray(shift))
            position[:, trial.markers.labels.index(label)] += moved
            recorded = recorded.with_trial(k, with_markers(trial, position))
    told = f"{label} by {1e3 * np.linalg.norm(shift):.0f} mm from {recorded.trials[first].name} on"
    # Axes of the segment are torchid's to choose: the true size is a length.
    own = Answer("marker_shift", (label,), {"shift_seg_m": list(shift)})
    return recorded, Truth((own,), told)


def _shape(recorded: Recorded, cluster: Sequence[str]) -> np.ndarray:
    """Places of a segment's markers in a frame of the session in which most are seen."""
    best, found = -1, np.zeros((len(cluster), 3))
    for trial in recorded.trials:
        p = trial.markers.select(tuple(cluster)).position.numpy()
        number = np.isfinite(p).all(2).sum(1)
        if number.max() > best:
            best, found = int(number.max()), p[int(number.argmax())]
    return found


def _turns(trial: Trial, cluster: Sequence[str], shape: np.ndarray) -> np.ndarray:
    """Rotations (frames, 3, 3) of a segment against its shape; where under three markers are seen, the nearest one."""
    p = trial.markers.select(tuple(cluster)).position.numpy()
    known = np.asarray(np.isfinite(p).all(2) & np.isfinite(shape).all(1))
    whole = np.flatnonzero(known.sum(1) >= 3)
    if not len(whole):
        raise Inapplicable("fewer than three markers of the segment are seen together")
    turns = np.stack([_kabsch(shape[known[k]], p[k, known[k]]) for k in whole])
    nearest = np.abs(np.arange(len(p))[:, None] - whole).argmin(1)
    return turns[nearest]


def _kabsch(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation that takes points a to b best (Kabsch, Acta Cryst A32 (1976))."""
    u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt


def plant_swap(recorded: Recorded, k: int, pair: tuple[str, str], frames: slice) -> tuple[Recorded, Truth]:
    """Two labels of a trial are exchanged in some of its frames."""
    trial = recorded.trials[k]
    a, b = (trial.markers.labels.index(label) for label in pair)
    position = trial.markers.position.clone()
    position[frames, [[a], [b]]] = trial.markers.position[frames, [[b], [a]]]
    time = trial.markers.time[frames]
    alike = tuple(Answer("marker_shift", (label,)) for label in pair)
    told = f"{pair[0]} and {pair[1]} in {trial.name}, {float(time[0]):.2f} to {float(time[-1]):.2f} s"
    return recorded.with_trial(k, with_markers(trial, position)), Truth((Answer("marker_swap", pair),), told, alike)


def exchangeable(recorded: Recorded, k: int, frames: slice) -> list[tuple[str, str]]:
    """Pairs of listed markers near each other that are seen in nearly all of some frames."""
    trial = recorded.trials[k]
    labels = [label for label in trial.markers.labels if label in recorded.segments]
    p = trial.markers.select(tuple(labels)).position[frames]
    often = torch.gt(p.isfinite().all(2).double().mean(0), 0.9)
    apart = (p[:, :, None] - p[:, None]).norm(dim=3).nanmedian(0).values
    near = torch.gt(apart, PAIR_M[0]) & torch.lt(apart, PAIR_M[1])
    near &= often.unsqueeze(0) & often.unsqueeze(1)
    return [(labels[i], labels[j]) for i, j in near.nonzero().tolist() if i < j]


def some_frames(trial: Trial, kept: slice, draw: Draw) -> slice:
    """A stretch of the frames that are written, of a drawn length."""
    rate, count = trial.markers.rate, kept.stop - kept.start
    length = min(round(rate * float(draw.uniform(*SWAP_S))), count // 2)
    first = kept.start + int(draw.integers(count - length))
    return slice(first, first + length)
