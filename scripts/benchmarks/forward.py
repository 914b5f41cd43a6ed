"""Motion that obeys its forces, replayed forward by Pinocchio from its own torques and ground forces."""

import numpy as np
import pinocchio as pin
import torch
from scipy.interpolate import BSpline, make_interp_spline
from trees import pinocchio_state, pinocchio_twin

from torchid.motion import Motion
from torchid.session import Outcome
from torchid.session.following import contact_loads

SECONDS = 0.3
"""Goal. Time that is integrated [s]."""
STEP_S = 5e-4
"""Resolution. Step of the midpoint rule."""
BESIDE = 6
"""Resolution. Frames on either side that the splines of torques and loads know."""
INSTANTS = 6
"""Choice. Instants of a trial from which it is integrated, at most."""


def drifts(outcome: Outcome, name: str) -> list[tuple[float, float, float, float]]:
    """Return how far the replay is from the motion of a trial after ``SECONDS``, from several instants.

    Returns:
        Turn [deg] and way [mm] of the pelvis, and the largest of any other body; none where no torque is known for so
        long.
    """
    found, item = outcome.consistent[name], outcome.followed[name]
    assert item.wrench is not None
    rate = item.wrench.rate
    span = round(SECONDS * rate)
    known = (torch.isfinite(found.torque).all(1) & item.wrench.used).double()
    whole = known.unfold(0, span + 2 * BESIDE + 1, 1).min(1).values if len(known) > span + 2 * BESIDE else known[:0]
    starts = (whole.nonzero()[:, 0] + BESIDE).tolist()
    every = max(1, -(-len(starts) // INSTANTS))
    replay = Replay(outcome, name, found.motion, torch.nan_to_num(found.torque))
    return [replay.drift(start, span) for start in starts[::every]]


class Replay:
    """A trial as Pinocchio integrates it."""

    def __init__(self, outcome: Outcome, name: str, motion: Motion, torque: torch.Tensor) -> None:
        fit, item = outcome.fit, outcome.followed[name]
        self.tree, self.motion, self.rate = fit.model.tree, motion, motion.smoother.rate_hz
        self.model = pinocchio_twin(self.tree, fit.geometry, outcome.phi)
        self.data = self.model.createData()
        time = np.arange(len(motion.q)) / self.rate
        self.torque = make_interp_spline(time, torque.numpy(), k=5)
        self.loads: list[tuple[int, BSpline]] = []
        for load in contact_loads(item, outcome.right(name), outcome.under.get(name)):
            joint = self.model.frames[self.model.getFrameId(load.body)].parentJoint
            self.loads.append((joint, make_interp_spline(time, load.wrench.numpy(), k=5)))
        self.rows = [self.model.joints[self.model.getJointId(f"q{k}")].idx_v for k in range(6, len(self.tree.dofs))]

    def drift(self, start: int, span: int) -> tuple[float, float, float, float]:
        """Turn [deg] and way [mm] from the motion at the end, of the pelvis and the largest of the other bodies."""
        Q, V, _ = self._state(start)
        t = start / self.rate
        steps = round(span / self.rate / STEP_S)
        for _ in range(steps):
            a = self._acceleration(Q, V, t)
            middle, rate = pin.integrate(self.model, Q, 0.5 * STEP_S * V), V + 0.5 * STEP_S * a
            a = self._acceleration(middle, rate, t + 0.5 * STEP_S)
            Q, V, t = pin.integrate(self.model, Q, STEP_S * rate), V + STEP_S * a, t + STEP_S
        ends = [self._places(Q), self._places(self._state(start + span)[0])]
        off = [
            (float(np.degrees(np.linalg.norm(pin.log3(one.rotation.T @ other.rotation)))),
             1e3 * float(np.linalg.norm(one.translation - other.translation)))
            for one, other in zip(*ends, strict=True)
        ]  # fmt: skip
        turns, ways = zip(*off[1:], strict=True)
        return *off[0], max(turns), max(ways)

    def _state(self, frame: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return pinocchio_state(
            self.model, self.tree, *(x[frame] for x in (self.motion.q, self.motion.v, self.motion.a))
        )

    def _places(self, Q: np.ndarray) -> list[pin.SE3]:
        pin.framesForwardKinematics(self.model, self.data, Q)
        return [self.data.oMf[self.model.getFrameId(name)].copy() for name in self.tree.names]

    def _acceleration(self, Q: np.ndarray, V: np.ndarray, t: float) -> np.ndarray:
        """Forward dynamics under the torques, what is left at the pelvis and the loads of an instant."""
        pin.forwardKinematics(self.model, self.data, Q)
        tau, own = np.zeros(self.model.nv), self.torque(t)
        tau[self.rows], turn = own[6:], self.data.oMi[1].rotation.T
        tau[:3], tau[3:6] = turn @ own[:3], turn @ own[3:6]
        forces = [pin.Force.Zero() for _ in range(self.model.njoints)]
        for joint, load in self.loads:
            wrench = load(t)
            forces[joint] += self.data.oMi[joint].actInv(pin.Force(wrench[:3], wrench[3:]))
        loads = pin.StdVec_Force()
        loads.extend(forces)
        return pin.aba(self.model, self.data, Q, V, tau, loads).copy()
