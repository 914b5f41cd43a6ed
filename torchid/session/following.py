"""What each stage of an experiment computes from the stages before."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.config import Config
from torchid.config.sections import MotionOptions
from torchid.contact.contact import Contact, find_contact
from torchid.contact.options import ContactOptions
from torchid.contact.sharing.records import ContactWrenches, WrenchSource
from torchid.dynamics.rows import WrenchTrial
from torchid.filters import Smoother
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import points, poses
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion, choose_cutoff, smooth_motion
from torchid.motion.impossible_rates import frames_of, impossible_steps
from torchid.recording import Trial
from torchid.session import Followed, Session
from torchid.session.opening import SHORTEST
from torchid.session.other_contacts import others_of
from torchid.storage.results import OutputFolder
from torchid.torque.inverse import CHUNK, Load, joint_torques

FEET = ("foot", "calcn")
"""Wording. Bodies that stand on the ground, by the beginning of their names: the built-in model's, and OpenSim's."""
SOLE = ("heel", "mt5", "mt1", "toe")
"""Landmarks of a sole, heel first, toes last."""
TIP = 1.01 / 0.80
"""From the heel to the tip of the toes, as a multiple of the way to the toe's landmark, which lies on the head of the
second metatarsal: 0.79 of the foot's length before the heel, whose own lies 0.01 behind it (``model/landmarks.py``)."""
SPREAD = 0.25
"""Frames closer to an unmeasured one than this part of the cut-off's period are left out."""
ENDS = 0.2
"""So are frames closer to an end of the recording: a filter that knows one side only knows no acceleration. On exact
synthetic data the residual is 110 N in the two outermost frames, 50 N a fifth of a period in, 9 N inside."""


@dataclass(frozen=True)
class Following:
    """How trials are followed by a model."""

    cutoff_hz: float
    """Of the filter of motion and forces."""
    filter: Literal["spline", "butterworth"]
    contact: ContactOptions
    recorded_kg: float | None
    """The subject's mass on record."""

    @staticmethod
    def of(config: Config, cutoff_hz: float) -> "Following":
        """As a config asks."""
        return Following(cutoff_hz, config.motion.filter, config.contact, config.subject.mass_kg)


def cutoff(motion: MotionOptions, session: Session) -> float:
    """Cut-off of the filter [Hz]: as configured, or the largest that a fit trial asks for."""
    wanted = motion.cutoff_hz
    if wanted != "auto":
        return float(wanted)
    labels = session.assignment.attachment.labels
    trials = session.role("fit") or session.trials
    return max(choose_cutoff(t.markers.select(labels).position, t.markers.rate) for t in trials.values())


def follow(
    fit: GeometryFit,
    trial: Trial,
    tracked: Tracked,
    way: Following,
    short: Callable[[Motion], Bool[Tensor, " frames"]] | None = None,
) -> Followed:
    """Smooth motion of a tracked trial, its contacts, and the wrench of the plates.

    ``short`` tells the frames in which the plates miss a part of the weight, where standing has told it.
    """
    tree = fit.model.tree
    if len(trial.markers.time) < SHORTEST:
        return _still(trial, tracked, way)
    rate = trial.markers.rate
    smoother = Smoother(min(way.cutoff_hz, 0.4 * rate), rate, way.filter)
    wild = frames_of(impossible_steps(tree, tracked.q, rate), len(tracked.q), rate)
    seen = torch.isfinite(tracked.error).any(dim=1) & ~wild.to(tracked.q.device)
    motion = smooth_motion(tree, trial.markers.time, tracked.q, smoother, seen)
    if trial.forces is None:
        return Followed(trial.name, tracked, motion)
    sure = seen & _inside(len(seen), round(ENDS / smoother.cutoff_hz * rate)).to(seen.device)
    contact = find_contact(
        soles(fit, tracked),
        trial.forces,
        sure,
        rate,
        SPREAD / smoother.cutoff_hz,
        way.contact,
        None if short is None else short(motion),
        others_of(fit, tracked, trial, way.contact),
    )
    total = smoother(torch.nan_to_num(trial.forces.total), contact.measured.to(torch.float64))
    wrench = WrenchTrial(trial.name, tree, fit.geometry, motion, total, contact.used)
    return Followed(trial.name, tracked, motion, contact, wrench)


def put_aside(followed: Followed, folder: OutputFolder) -> Followed:
    """The same, its motion and wrench in a file; the tracked coordinates are in their stage's."""
    return Followed(
        followed.name, followed.tracked, *folder.aside((followed.motion, followed.contact, followed.wrench))
    )


def _still(trial: Trial, tracked: Tracked, way: Following) -> Followed:
    """A static trial of a few frames: posture without motion, and no use of its forces."""
    still = torch.zeros_like(tracked.q)
    smoother = Smoother(way.cutoff_hz, float("inf"), way.filter)
    return Followed(trial.name, tracked, Motion(tracked.time, tracked.q, still, still, smoother))


def _inside(frames: int, margin: int) -> Bool[Tensor, " frames"]:
    index = torch.arange(frames)
    return (index >= margin) & (index < frames - margin)


def soles(fit: GeometryFit, tracked: Tracked) -> dict[str, Float[Tensor, "frames points 3"]]:
    """Points of each foot's sole in W: the template's landmarks on the feet of the model."""
    tree, marks = fit.model.tree, fit.model.landmarks
    sides = [[f"{name}_{side}" for name in SOLE] for side in ("l", "r")]
    feet = {marks[names[0]].segment: names for names in sides if set(names) <= set(marks)}
    if not feet:
        return {}
    local = torch.stack([_outline(fit.xi.new_tensor([marks[n].p_BM_B for n in names])) for names in feet.values()])
    plan, count = plan_tree(tree), local.shape[1]
    body = torch.tensor([plan.position[tree.index(foot)] for foot in feet for _ in range(count)], device=fit.xi.device)
    both = fit.xi.new_empty(len(tracked.q), len(feet) * count, 3)
    for q, out in zip(tracked.q.split(CHUNK), both.split(CHUNK), strict=True):
        placed = points(poses(plan, q.T.contiguous(), fit.geometry), body, local.reshape(-1, 3))
        out.copy_(placed.permute(2, 0, 1))
    return dict(zip(feet, both.split(count, dim=1), strict=True))


def _outline(p_BM_B: Float[Tensor, "4 3"]) -> Float[Tensor, "5 3"]:
    """Points of a sole, the tip of the toes after those of ``SOLE``."""
    return torch.cat([p_BM_B, p_BM_B[:1] + TIP * (p_BM_B[-1:] - p_BM_B[:1])])


def torques(
    followed: Followed,
    tree: Tree,
    geometry: Geometry,
    phi: Float[Tensor, "bodies 10"],
    trial: Trial,
    under: ContactWrenches | None = None,
) -> Float[Tensor, "frames dofs"]:
    """Generalised forces of a trial; rows of the base are the residual wrench. NaN where a contact is not known.

    The torques of a limb need the wrenches of its contacts: they are masked where nobody tells them. Everything is
    masked in frames without motion, the base in frames that are not used.

    Args:
        under: wrenches of the contacts, each with its source (``session.contact_wrenches.wrenches_under``); None takes
            what plates measure of one contact alone.
    """
    out = joint_torques(tree, geometry, phi, followed.motion, contact_loads(followed, trial, under))
    return _masked(out, followed, tree, under)


def contact_loads(followed: Followed, trial: Trial, under: ContactWrenches | None) -> list[Load]:
    """Return the filtered wrench of each contact about the world's origin.

    Args:
        under: wrenches of the contacts; None takes what plates measure of one contact alone.
    """
    if under is not None:
        return [Load(body, under.of(name)) for name, body in zip(under.contacts, under.body, strict=True)]
    if trial.forces is None or followed.contact is None:
        return []
    contact, raw = followed.contact, torch.nan_to_num(trial.forces.wrench)
    return [
        Load(body, followed.motion.smoother((raw * (contact.plate == k)[..., None]).sum(dim=1)))
        for k, body in enumerate(contact.bodies)
    ]


def _masked(tau: Tensor, followed: Followed, tree: Tree, under: ContactWrenches | None) -> Tensor:
    """``tau`` with NaN where it is not known, in place."""
    contact = followed.contact
    seen = torch.isfinite(followed.tracked.error).any(dim=1)
    tau[~seen] = torch.nan
    tau[:, :6] = torch.nan if contact is None else torch.where(contact.used[:, None], tau[:, :6], torch.nan)
    for body, unknown in _unknown(contact, tree, under):
        for row in limb(tree, body):
            tau[:, row] = torch.where(unknown, torch.nan, tau[:, row])
    return tau


def _unknown(
    contact: Contact | None, tree: Tree, under: ContactWrenches | None
) -> Iterator[tuple[str, Bool[Tensor, "..."]]]:
    """Body of every contact, and the frames in which nobody tells its wrench."""
    if under is not None:
        yield from zip(under.body, (under.source == WrenchSource.UNKNOWN).unbind(1), strict=True)
    elif contact is not None:
        yield from zip(contact.bodies, (contact.beside | contact.untold).unbind(1), strict=True)
    if contact is None:
        told = () if under is None else under.body
        yield from ((foot, torch.tensor(True)) for foot in legs(tree) if foot not in told)


def legs(tree: Tree) -> dict[str, list[int]]:
    """Rows of q of the joints between the root and each foot."""
    return {body.name: limb(tree, body.name) for body in tree.bodies if body.name.startswith(FEET)}


def limb(tree: Tree, body: str) -> list[int]:
    """Return the rows of q of the joints between the root and a body, whose torques bear what loads the body."""
    above = sorted(tree.ancestors[tree.index(body)])
    return list(dict.fromkeys(row for j in above for row in tree.driving(j)))
