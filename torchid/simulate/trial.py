"""One synthetic recording and the truth behind it."""

import zlib
from dataclasses import dataclass, replace

import numpy as np
import scipy.interpolate
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.effects.marker_scene import Sight
from torchid.effects.scene import make_scene
from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import points, poses
from torchid.model.skeleton import SIDES
from torchid.motion.motion import Motion
from torchid.recording import Forces, Markers, Trial
from torchid.simulate.balance import Moving, balance
from torchid.simulate.flight import leap
from torchid.simulate.ground import WEIGHTLESS, FootLoad, force_plates, plate_wrenches, share_load
from torchid.simulate.motions import make_script
from torchid.simulate.noise import lose_markers, noisy_markers, noisy_plates, skin_shift
from torchid.simulate.options import ANALOG_RATIO, SimulateOptions
from torchid.simulate.planting import misread
from torchid.simulate.script import Script
from torchid.simulate.subject import SimulatedSubject

MARGIN_S = 0.8
"""Simulated before and after the trial and cut away: filters and splines behave differently at ends."""
STATIC_S = 3.0
MISS = 0.01
"""Largest miss of the centre of pressure that a trial may have [m]."""
ATTEMPTS = 12
SINK = 0.0005
"""Deepest that a sole may be below the floor [m]."""
BEARS = 0.01
"""Vertical force of a foot that counts as contact [N]."""


@dataclass(frozen=True)
class TrialTruth:
    """What no laboratory knows about a trial; frames of the markers."""

    motion: Motion
    markers: Float[Tensor, "frames markers 3"]
    """Where the markers are, skin motion included, without noise or gaps."""
    wrench: Float[Tensor, "frames 6"]
    """Total wrench on the subject about the origin of W."""
    feet: FootLoad
    complete: Bool[Tensor, " frames"]
    """Every foot that bears stands on a plate."""
    miss: float
    """Largest distance of the centre of pressure from the one intended [m]."""


@dataclass(frozen=True)
class SimulatedTrial:
    """A recording with its truth."""

    trial: Trial
    truth: TrialTruth


def simulate_trial(
    subject: SimulatedSubject,
    motion: str,
    options: SimulateOptions | None = None,
    seed: int = 0,
    *,
    name: str | None = None,
    role: str = "fit",
) -> SimulatedTrial:
    """Move the subject, let plates carry it, then measure.

    Args:
        subject: from ``simulate_subject``.
        motion: a name of ``motions.MOTIONS``.
        options: duration, rates and noise.
        seed: of the motion and of the noise.
        name: of the trial; the motion's if absent.
        role: static, fit or heldout.

    Raises:
        ConfigError: no such motion, or the subject cannot do it in balance.
    """
    options = options or SimulateOptions()
    key = (seed, zlib.crc32((name or motion).encode()))
    subject = replace(subject, trial=name or motion)
    seconds = STATIC_S if motion == "static" else options.duration_s
    frames = round(seconds * options.rate_hz)
    script, moving = _possible(subject, motion, with_margins(seconds, options.rate_hz), frames / options.rate_hz, key)
    simulated = record(subject, script, moving, options, role)
    return measure(subject, simulated, options, np.random.default_rng((*key, 2)))


def with_margins(seconds: float, rate_hz: float) -> Float[Tensor, " frames"]:
    """Times of the frames of a trial that begins at zero, and of those before and after it that are cut away [s]."""
    margin = round(MARGIN_S * rate_hz)
    return torch.arange(-margin, round(seconds * rate_hz) + margin, dtype=torch.float64) / rate_hz


def record(
    subject: SimulatedSubject, script: Script, moving: Moving, options: SimulateOptions, role: str = "fit"
) -> SimulatedTrial:
    """Record a motion by markers and plates without noise, and keep its truth.

    Args:
        subject: who moves; its ``trial`` names the recording.
        script: what was intended, at the times of ``with_margins``.
        moving: what came of it, at the same times.
        options: rates, plates, motion of the skin.
        role: static, fit or heldout.

    Returns:
        The recording without the margins, as plates with the subject's hidden effects read it.
    """
    rate, margin = options.rate_hz, round(MARGIN_S * options.rate_hz)
    time, frames = script.time, len(script.time) - 2 * margin
    plates = force_plates(options.plates)
    load = share_load(subject, script, moving.wrench, plates)
    cut = slice(margin, margin + frames)
    fine = _upsample(time, plate_wrenches(load, len(plates)), rate, frames)
    kept = _cut_motion(moving.motion, cut)
    load = FootLoad(load.wrench[cut], load.plate[cut], load.pressure[cut])
    position = _markers(subject, kept, options)
    bears = load.wrench[:, :, 2] > BEARS
    truth = TrialTruth(kept, position, moving.wrench[cut], load, ~(bears & (load.plate < 0)).any(1), moving.miss)
    clock = torch.arange(frames * ANALOG_RATIO, dtype=torch.float64) / (rate * ANALOG_RATIO)
    trial = Trial(
        name=subject.trial,
        markers=Markers(subject.labels, kept.time, position),
        forces=Forces(clock, fine, plates),
        role=role,
        parameters={"subject": f"S{subject.seed:02d}", "mass_kg": f"{subject.recorded_mass:.1f}",
                    "height_m": f"{subject.recorded_height:.3f}"},
    )  # fmt: skip
    return SimulatedTrial(misread(trial, subject.hidden), truth)


def _possible(
    subject: SimulatedSubject, motion: str, time: Tensor, duration: float, key: tuple[int, int]
) -> tuple[Script, Moving]:
    """Draw motions, each somewhat easier, until one is in balance, within the joints' limits and above the floor."""
    rate = float(1.0 / (time[1] - time[0]))
    found = ""
    for attempt in range(ATTEMPTS):
        effort, rng = 1.0 - 0.07 * attempt, np.random.default_rng((*key, 1, attempt))
        script = make_script(motion, rng, subject, time, duration, effort)
        moving = balance(subject, script, rate) if script.rise is None else leap(subject, script, rate)
        found = impossible(subject, moving)
        if not found:
            return script, moving
    raise ConfigError(
        "simulate.balance", "the subject cannot do this motion in balance", place=subject.trial, found=found,
        remedy="Take another seed",
    )  # fmt: skip


def impossible(subject: SimulatedSubject, moving: Moving) -> str:
    """Return what keeps a person from a motion: balance, the floor, limits of joints; empty where nothing does.

    Args:
        subject: who moves.
    """
    dofs, q = subject.model.tree.dofs, moving.motion.q
    low, high = (q.new_tensor([getattr(dof, side) for dof in dofs]) for side in ("lower", "upper"))
    beyond = ((q < low) | (q > high)).any(0)
    low_sole = float(lowest_sole(subject, moving.motion).min())
    if moving.miss <= MISS and not bool(beyond.any()) and low_sole > -SINK:
        return ""
    limits = [dof.name for dof, out in zip(dofs, beyond.tolist(), strict=True) if out]
    return (
        f"centre of pressure {1e3 * moving.miss:.0f} mm off, soles at {1e3 * low_sole:.1f} mm, "
        f"beyond limits: {', '.join(limits) or 'none'}"
    )


def _upsample(time: Tensor, wrench: Float[Tensor, "frames plates 6"], rate: float, frames: int) -> Tensor:
    """Quintic spline through the wrenches at the plates' rate, from time zero on; zero where all about it are."""
    spline = scipy.interpolate.make_interp_spline(time.numpy(), wrench.flatten(1).numpy(), k=5)
    fine = spline(np.arange(frames * ANALOG_RATIO) / (rate * ANALOG_RATIO))
    fine = torch.as_tensor(fine).reshape(-1, *wrench.shape[1:])
    empty = wrench.abs().amax((1, 2)) < WEIGHTLESS
    between = (empty & empty.roll(-1))[round(-float(time[0]) * rate) :][:frames]
    return torch.where(between.repeat_interleave(ANALOG_RATIO)[:, None, None], 0.0, fine)


def _cut_motion(motion: Motion, cut: slice) -> Motion:
    rate = motion.smoother.rate_hz
    return Motion(motion.time[cut], motion.q[cut], motion.v[cut], motion.a[cut], Smoother(rate, rate))


def lowest_sole(subject: SimulatedSubject, motion: Motion) -> Float[Tensor, " frames"]:
    """Height of the lowest corner of both soles over the floor [m]."""
    tree, plan = subject.model.tree, plan_tree(subject.model.tree)
    at = poses(plan, motion.q.T.contiguous(), subject.geometry)
    feet = [plan.position[tree.index(f"foot_{side}")] for side in SIDES]
    corners = at.p.new_tensor(subject.sole.corners())
    heights = [at.p[k].T[:, 2:3] + at.R[k].permute(2, 1, 0)[:, 2] @ corners.T for k in feet]
    return torch.cat(heights, 1).amin(1)


def _markers(subject: SimulatedSubject, motion: Motion, options: SimulateOptions) -> Float[Tensor, "frames markers 3"]:
    """Marker positions with skin motion."""
    tree = subject.model.tree
    plan = plan_tree(tree)
    at = poses(plan, motion.q.T.contiguous(), subject.geometry)
    body = torch.tensor([plan.position[tree.index(segment)] for segment in subject.segments])
    p = points(at, body, subject.p_BM_B).permute(2, 0, 1)
    if options.skin_motion_mm > 0.0:
        shift = skin_shift(subject, motion, 1e-3 * options.skin_motion_mm)
        p = p + torch.einsum("mait,tma->tmi", at.R[body], shift)
    if subject.hidden:
        scene = make_scene(subject.trial, tree, subject.geometry, motion, subject.phi)
        sight = Sight(scene, subject.labels, body, subject.p_BM_B)
        p = p + torch.stack([one.seen(sight) for one in subject.hidden]).sum(0).permute(2, 0, 1)
    return p.contiguous()


def measure(
    subject: SimulatedSubject, simulated: SimulatedTrial, options: SimulateOptions, rng: np.random.Generator
) -> SimulatedTrial:
    """Return a recording with the noise and the gaps that a laboratory adds.

    Args:
        simulated: from ``record``.
        options: sizes of the noise.
    """
    trial = simulated.trial
    assert trial.forces is not None
    position = noisy_markers(rng, trial.markers.position, 1e-3 * options.marker_noise_mm)
    position = lose_markers(rng, position, subject.segments, options.gap_fraction, options.rate_hz)
    wrench = noisy_plates(rng, trial.forces.wrench, trial.forces.plates, options.force_noise_n)
    trial = replace(
        trial,
        markers=replace(trial.markers, position=position),
        forces=replace(trial.forces, wrench=wrench),
    )
    return replace(simulated, trial=trial)
