"""What no plate can have measured: forces that nobody bears, and loads that no contact within its edges gives."""

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.conventions import SAMPLE_LOADED_N
from torchid.errors import Note
from torchid.io.mend import number_of
from torchid.io.plate_axes import frame_of
from torchid.recording import Forces, Plate

MOST_FORCE = 20e3
"""Force [N] on one plate that nobody bears for two samples; plates are built for less. Physical."""
MOST_MOMENT = 20e6
"""Moment [N m] about the origin that no unit explains: ``MOST_FORCE`` a metre away, in N mm."""
LIMITS = f"{MOST_FORCE / 1e3:g} kN or {MOST_MOMENT / 1e3:g} kN m"
MANY = 0.1
"""Share of a plate's samples beyond ``MOST_FORCE`` above which its scale is wrong, and not these samples. A choice, as
for single samples that leap (``torchid.io.spikes``)."""
BESIDE = 0.1
"""Distance [m] beside its plate at which no centre of pressure lies in the median: what only pushes has it between its
contacts. Physical, with room for corners that were measured badly; in public recordings the median is 0 and the worst
sample 64 mm."""
GRIP = 1.0
"""Coefficient of friction that shoes on plates do not reach: the horizontal force stays below so many times the
vertical, the free moment below so many times that with half the plate's diagonal for a lever. Physical."""
SAMPLES = 20_000
"""Of a long recording so many show where pressure lies."""


def within_limits(forces: Forces, source: str) -> tuple[Forces | None, list[Note], list[int]]:
    """Forces without plates whose forces nobody bears, and a note for each that cannot be what was measured.

    Single samples beyond become NaN in place. Loads that no contact gives are said and left: a change of their unit or
    wiring may put them right, which ``torchid.checks.plates_against_feet`` tries.

    Args:
        forces: in W, as the user says that they are.

    Returns:
        Forces, None where no plate is left; notes; and the numbers of the plates that are left out.
    """
    kept, notes, left_out = [], [], []
    for k, plate in enumerate(forces.plates):
        beyond = _beyond(forces.wrench[:, k])
        if beyond.mean() > MANY:
            text = f"{plate.name} exceeds {LIMITS} in {beyond.mean():.0%} of its samples, which no person bears: left"
            remedy = f"out; if its scale is known, give plates: {{{number_of(plate, k)}: {{gain: ...}}}}"
            notes.append(Note("plates.force", f"{text} {remedy}", source))
            left_out.append(number_of(plate, k))
            continue
        kept.append(k)
        if beyond.any():
            forces.wrench[torch.from_numpy(beyond), k] = torch.nan
            text = f"{plate.name}: {beyond.sum()} samples over {LIMITS}, which no person bears; left as gaps"
            notes.append(Note("plates.force", text, source))
        notes += _impossible_load(forces.wrench[:, k], plate, source)
    if len(kept) == len(forces.plates):
        return forces, notes, left_out
    left = forces.of(kept)
    return left if kept else None, notes, left_out


def _beyond(wrench: Float[Tensor, "samples 6"]) -> Bool[np.ndarray, " samples"]:
    """Samples with a component beyond what anybody bears."""
    values = wrench.numpy()
    found = np.zeros(len(values), bool)
    for axis in range(6):
        most = MOST_FORCE if axis < 3 else MOST_MOMENT
        found |= (values[:, axis] > most) | (values[:, axis] < -most)
    return found


def _impossible_load(wrench: Float[Tensor, "samples 6"], plate: Plate, source: str) -> list[Note]:
    """What is impossible about the load of a plate with corners, in the median over the samples that load it."""
    if plate.corners is None:
        return []
    R_WF, p_WF = frame_of(plate.corners)
    some = wrench[:: max(1, len(wrench) // SAMPLES)]
    force, about = some[:, :3] @ R_WF, some[:, 3:] - torch.linalg.cross(p_WF.expand(len(some), 3), some[:, :3])
    loaded = force[:, 2].abs() > SAMPLE_LOADED_N
    if not bool(loaded.any()):
        return []
    force, moment = force[loaded], (about @ R_WF)[loaded]
    upright = force[:, 2]
    point = torch.stack([-moment[:, 1] / upright, moment[:, 0] / upright], dim=1)
    free = (moment[:, 2] - (point[:, 0] * force[:, 1] - point[:, 1] * force[:, 0])).abs()
    half = torch.stack([(plate.corners[0] - plate.corners[k]).norm() / 2 for k in (1, 3)])
    beside = float((point.abs() - half).clamp_min(0.0).norm(dim=1).nanmedian())
    lever, slope = (float((x / upright.abs()).nanmedian()) for x in (free, force[:, :2].norm(dim=1)))
    told = [f"its pressure lies {beside:.3g} m beside it"] if beside > BESIDE else []
    told += [f"its free moment is {lever:.3g} m times its force"] if lever > GRIP * float(half.norm()) else []
    told += [f"it is pushed sideways {slope:.3g} times as hard as down"] if slope > GRIP else []
    if not told:
        return []
    text = f"{plate.name} bears what no contact on it gives: {', '.join(told)}, in the median under load"
    return [Note("plates.load", f"{text}; scale, unit or wiring of its channels or its place are wrong", source)]
