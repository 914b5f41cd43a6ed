"""A simulated subject without and with a device: recordings, channels of the device, and the truth by MuJoCo."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from harness.runs import ran
from mujoco_laboratory.device import Truth, inverse, worn

from benchmarks.device_cases import NOISE, OFF, ON, Case, command, draw_case
from torchid.conventions import INERTIA_PAIRS
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import points, poses
from torchid.session import Outcome
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession, write_session
from torchid.simulate.subject import SimulatedSubject, simulate_subject
from torchid.simulate.trial import SimulatedTrial, simulate_trial

AGREE = 1e-8
"""Largest disagreement of the two simulators about the ground's wrench, relative to its norm."""


@dataclass(frozen=True)
class Recorded:
    """One subject's recordings and what is true of them."""

    session: SimulatedSession
    case: Case
    channels: dict[str, dict[str, torch.Tensor]]
    """By trial with the device: what it recorded."""
    truth: dict[str, Truth]
    """By trial with the device."""


def record(kind: str, seed: int, out: Path, options: SimulateOptions) -> Recorded:
    """Simulate, and write C3D files with a config that knows of no device."""
    rng = np.random.default_rng((seed, 77))
    subject = simulate_subject(options, seed)
    places = {label: (segment, tuple(place)) for label, segment, place in
              zip(subject.labels, subject.segments, subject.p_BM_B.tolist(), strict=True)}  # fmt: skip
    case = draw_case(kind, rng, places, standing(subject))
    bare = [simulate_trial(subject, m, options, seed, name=m, role="static" if m == "static" else "fit")
            for m in ("static", *OFF)]  # fmt: skip
    carrying = replace(subject, phi=with_parts(subject, case))
    loaded = [simulate_trial(carrying, m, options, seed, name=f"on_{m}", role="heldout") for m in ON[kind]]
    session = write_session(SimulatedSession(subject, tuple(bare + loaded)), options, out)
    channels, truth = {}, {}
    for item in loaded:
        channels[item.trial.name], truth[item.trial.name] = _device_side(subject, case, item, rng)
    return Recorded(session, case, channels, truth)


def identified(kind: str, seed: int, out: Path, options: SimulateOptions) -> tuple[Recorded, Outcome]:
    """One subject's recordings, and what a run that knows of no device makes of them."""
    folder = out / f"{kind}_{seed}"
    recorded = record(kind, seed, folder / "recordings", options)
    return recorded, ran(recorded.session.config, folder / "result")


def standing(subject: SimulatedSubject) -> dict[str, np.ndarray]:
    """Where the markers are in W in the neutral pose (3,) [m]."""
    tree, plan = subject.model.tree, plan_tree(subject.model.tree)
    rest = subject.xi.new_tensor([[dof.rest] for dof in tree.dofs])
    body = torch.tensor([plan.position[tree.index(segment)] for segment in subject.segments])
    p = points(poses(plan, rest, subject.geometry), body, subject.p_BM_B)[:, :, 0]
    return dict(zip(subject.labels, p.numpy(), strict=True))


def with_parts(subject: SimulatedSubject, case: Case) -> torch.Tensor:
    """True inertia of the body with the true parts on it."""
    phi = subject.phi.clone()
    for part in case.true.parts:
        k, m = subject.model.tree.index(part.segment), part.mass_kg.value
        c = phi.new_tensor([x.value for x in part.com_m])
        inertia = phi.new_tensor([x.value for x in part.inertia_kgm2])
        steiner = torch.stack([m * (float(i == j) * (c @ c) - c[i] * c[j]) for i, j in INERTIA_PAIRS])
        phi[k] += torch.cat([phi.new_tensor([m]), m * c, inertia + steiner])
    return phi


def _device_side(
    subject: SimulatedSubject, case: Case, item: SimulatedTrial, rng: np.random.Generator
) -> tuple[dict[str, torch.Tensor], Truth]:
    """What the device records in a trial, and what MuJoCo says of it."""
    tree, motion = subject.model.tree, item.truth.motion
    time = motion.time.numpy()
    q, v, a = (x.numpy() for x in (motion.q, motion.v, motion.a))
    channels, motors = {}, {}
    for dof, name in case.motors.items():
        drive = case.true.element(name).drive
        wanted = command(rng, time)
        channels[drive.channel] = torch.as_tensor(wanted)
        motors[dof] = drive.gain.value * np.interp(time - drive.lag.value, time, wanted)
    own = worn(tree, subject.geometry, subject.phi.numpy(), case.true)
    feet = {f"foot_{s}": item.truth.feet.wrench[:, k].numpy() for k, s in enumerate("lr")}
    truth = inverse(own, q, v, a, feet, motors)
    wrench = item.truth.wrench.numpy()
    assert np.abs(truth.ground - wrench).max() < AGREE * np.linalg.norm(wrench, axis=1).max()
    for element in case.true.elements:
        force = _force(element, truth, tree, q, motors)
        truth.force[element.name] = force
        noise = NOISE * np.abs(force).max() * rng.normal(size=len(force))
        channels[element.sensor.force] = torch.as_tensor(force + noise)
    return channels, truth


def _force(element, truth: Truth, tree, q: np.ndarray, motors: dict[str, np.ndarray]) -> np.ndarray:
    """True tension or torque of an element, from MuJoCo's lengths."""
    if element.drive is not None:
        return motors[element.line.name]
    k, rest = element.law.stiffness.value, element.law.rest.value
    if element.turns:
        return -k * (q[:, tree.dof_names.index(element.line.name)] - rest)
    return np.maximum(0.0, k * (truth.length[element.name] - rest))
