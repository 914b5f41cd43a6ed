"""A hand or a seat that bears a simulated person for a while, taken out of what the plates read or given a plate."""

import math
from dataclasses import dataclass, replace

import torch
from benchmarks.contact_measures import merged
from jaxtyping import Float
from torch import Tensor

from torchid.contact.options import OtherContact
from torchid.effects.place import Interval
from torchid.effects.scene import make_scene
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import points, poses
from torchid.motion import smooth_motion
from torchid.recording import Forces, Plate, Trial
from torchid.session import Outcome
from torchid.session.contact_wrenches import wrenches_under
from torchid.session.fitting import identify
from torchid.session.following import Following, follow, limb, torques
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.session import SimulatedSession
from torchid.torque.inverse import Load, joint_torques

HAND_N, SEAT_N = (20.0, 70.0), (60.0, 150.0)
"""Chosen: largest vertical force of a hand and of a seat that one leans on; more, and feet of a body that balances
alone could not bear what is left [N]."""
SEATED_N = 100.0, 300.0
"""Chosen: vertical force of a seat that a squat is held by [N]."""
SEAT = (-0.08, -0.11, -0.09), (0.04, 0.11, -0.09)
"""Opposite corners of the patch under a pelvis, in its axes [m]."""
EDGE_S = 0.3
"""Time in which the force comes and goes."""
PLACE_M = 0.01
"""Standard deviation of where a hand holds on, about the middle of its markers."""


@dataclass(frozen=True)
class Hidden:
    """What bears a person in one trial."""

    trial: str
    name: str
    contact: OtherContact
    wrench: Float[Tensor, "frames 6"]
    """On the subject about the world's origin, on the clock of the markers [N, N m]."""
    balanced: bool = False
    """Whether the person moves as one who is borne so: the simulated feet bear what is left."""

    def measured(self, plate: int) -> OtherContact:
        """The contact with a plate."""
        return replace(self.contact, plate=plate)


def draw_hand(session: SimulatedSession, trial: str, generator: torch.Generator, side: str = "r") -> Hidden:
    """A hand that holds on to something, with a drawn force, course and place.

    Args:
        session: the simulated person.
        trial: in which the hand holds on.
        generator: source of chance.
        side: l or r.
    """
    subject, body = session.subject, f"hand_{side}"
    own = [k for k, segment in enumerate(subject.segments) if segment == body]
    place = subject.p_BM_B[own].mean(0) + PLACE_M * torch.randn(3, generator=generator, dtype=torch.float64)
    size = float(torch.empty(1).uniform_(*HAND_N, generator=generator))
    sign = 1.0 if float(torch.rand(1, generator=generator)) < 0.5 else -1.0
    aside = 0.2 * size * torch.randn(2, generator=generator, dtype=torch.float64)
    force = torch.tensor([float(aside[0]), float(aside[1]), sign * size], dtype=torch.float64)
    return _hidden(session, trial, "rail", body, place, force, generator)


def draw_seat(session: SimulatedSession, trial: str, generator: torch.Generator) -> Hidden:
    """A seat that bears a part of the weight somewhere on the usual patch.

    Args:
        session: the simulated person.
        trial: in which he is seated.
        generator: source of chance.
    """
    low, high = (torch.tensor(corner, dtype=torch.float64) for corner in SEAT)
    place = low + torch.rand(3, generator=generator, dtype=torch.float64) * (high - low)
    size = float(torch.empty(1).uniform_(*SEAT_N, generator=generator))
    aside = 0.1 * size * torch.randn(2, generator=generator, dtype=torch.float64)
    force = torch.tensor([float(aside[0]), float(aside[1]), size], dtype=torch.float64)
    return _hidden(session, trial, "seat", "pelvis", place, force, generator)


def seated_options(options: SimulateOptions, generator: torch.Generator) -> SimulateOptions:
    """Options of a session in which a seat bears a person during the squats, who balances accordingly.

    Args:
        options: of a session with one trial of squats.
        generator: source of chance.
    """
    low, high = (torch.tensor(corner, dtype=torch.float64) for corner in SEAT)
    place = low + torch.rand(3, generator=generator, dtype=torch.float64) * (high - low)
    size = float(torch.empty(1).uniform_(*SEATED_N, generator=generator))
    aside = 0.03 * size * torch.randn(2, generator=generator, dtype=torch.float64)
    ends = torch.rand(2, generator=generator, dtype=torch.float64)
    when = Interval("squats", 0.6 + 0.4 * float(ends[0]), options.duration_s - 0.6 - 0.4 * float(ends[1]))
    values: dict[str, float | list] = {"force_N": [*aside.tolist(), size], "point_seg_m": place.tolist()}
    return replace(options, effects=(PlantedOptions("unmeasured_contact", ("pelvis",), (when,), values),))


def seated(session: SimulatedSession) -> Hidden:
    """The seat of a session with ``seated_options``.

    Args:
        session: simulated.
    """
    (planted,), subject = session.subject.hidden, session.subject
    assert planted.place.when is not None
    (when,) = planted.place.when
    truth = session.trial(when.trial).truth
    scene = make_scene(when.trial, subject.model.tree, subject.geometry, truth.motion, subject.phi)
    contact = OtherContact("pelvis", {when.trial: ((when.t0 - 0.1, when.t1 + 0.1),)})
    return Hidden(when.trial, "seat", contact, -planted.load(scene).T.contiguous(), balanced=True)


def with_plate(trial: Trial, hidden: Hidden, generator: torch.Generator) -> Trial:
    """The trial with what bears on a plate of its own, which has no corners and 2 N of noise."""
    assert trial.forces is not None
    noise = torch.randn(hidden.wrench.shape, generator=generator, dtype=torch.float64)
    noise = noise * noise.new_tensor([2.0, 2.0, 2.0, 0.4, 0.4, 0.4])
    wrench = torch.cat([trial.forces.wrench, (hidden.wrench + noise)[:, None]], dim=1)
    plates = (*trial.forces.plates, Plate("handle", None, number=len(trial.forces.plates) + 1))
    return replace(trial, forces=Forces(trial.forces.time, wrench, plates))


def _hidden(
    session: SimulatedSession,
    trial: str,
    name: str,
    body: str,
    place: Tensor,
    force: Tensor,
    generator: torch.Generator,
) -> Hidden:
    subject, motion = session.subject, session.trial(trial).truth.motion
    time, plan = motion.time, plan_tree(subject.model.tree)
    at = poses(plan, motion.q.T.contiguous(), subject.geometry)
    index = torch.tensor([plan.position[subject.model.tree.index(body)]])
    p = points(at, index, place[None])[0].T
    start = float(time[0]) + 0.5 + 0.5 * float(torch.rand(1, generator=generator))
    stop = float(time[-1]) - 0.5 - 0.5 * float(torch.rand(1, generator=generator))
    rise = torch.minimum((time - start) / EDGE_S, (stop - time) / EDGE_S).clamp(0.0, 1.0)
    wave = 1.0 + 0.3 * torch.sin(2.0 * math.pi * (time - start) / 1.3)
    course = (0.5 - 0.5 * torch.cos(math.pi * rise)) * wave
    f = course[:, None] * force
    wrench = torch.cat([f, torch.linalg.cross(p, f)], dim=1)
    return Hidden(trial, name, OtherContact(body, {trial: ((start, stop),)}), wrench)


def without(trial: Trial, hidden: Hidden) -> Trial:
    """The trial as its plates read it: what the contact bears they bear less, in proportion to their loads."""
    assert trial.forces is not None
    read = trial.forces.wrench
    share = read[..., 2].clamp(min=0.0) / read[..., 2].clamp(min=0.0).sum(dim=1, keepdim=True).clamp(min=1.0)
    return replace(trial, forces=replace(trial.forces, wrench=read - share[..., None] * hidden.wrench[:, None]))


def with_handle(trial: Trial, hidden: Hidden, generator: torch.Generator) -> Trial:
    """The trial with the contact on a plate of its own, and feet that bear what is left."""
    return with_plate(without(trial, hidden), hidden, generator)


def on_one_plate(trial: Trial, more: Hidden) -> Trial:
    """The trial with the feet, and what bears besides, on one plate as large as all."""
    assert trial.forces is not None
    forces = merged(trial.forces)
    return replace(trial, forces=replace(forces, wrench=forces.wrench + more.wrench[:, None]))


def told(outcome: Outcome, trial: Trial, hidden: Hidden, contact: OtherContact | None) -> Outcome:
    """The experiment with another recording of one trial, identified anew; its geometry stays.

    Args:
        outcome: of the session without anything hidden.
        trial: as it is read now.
        hidden: what bears in it.
        contact: what the config says of it; None for nothing.
    """
    others = {} if contact is None else {hidden.name: contact}
    options = replace(outcome.config.contact, others=others, torques="predicted")
    config = outcome.config.model_copy(update={"contact": options})
    one = outcome.followed[trial.name]
    followed = follow(outcome.fit, trial, one.tracked, Following.of(config, outcome.cutoff_hz))
    session = replace(outcome.session, trials=outcome.session.trials | {trial.name: trial})
    changed = replace(
        outcome, config=config, session=session, followed=outcome.followed | {trial.name: followed}, identified=None
    )
    return replace(changed, identified=identify(config.inertia, config.subject, changed, lambda *_: None))


@dataclass(frozen=True)
class Answers:
    """What a run finds of a hidden contact, as RMS over the frames in which it bears."""

    force_N: float
    """Error of its force."""
    moment_Nm: float
    """Error of its moment about the point that it bears at."""
    inside: float
    """Share of the force's components within 1.96 of their standard deviations; NaN where none are given."""
    torque_Nm: float
    """Largest RMS error of a torque of its limb's joints, of the feet's for a seat."""
    plain_Nm: float
    """The same, had nothing been hidden."""
    untold_Nm: float
    """The same, had nothing been said of it."""
    hidden_N: float
    """RMS of the force itself."""
    frames: int


def answers(outcome: Outcome, found: Outcome, session: SimulatedSession, hidden: Hidden) -> Answers:
    """Compare what is found with what was hidden.

    Args:
        outcome: without anything hidden.
        found: with it, as ``told``.
        session: the simulated person.
        hidden: what bears.
    """
    name = hidden.trial
    item, trial = found.followed[name], found.session.trials[name]
    under = wrenches_under(item, found.fit, found.phi, trial, found.config.contact)
    assert under is not None
    smoother = item.motion.smoother
    truth = smoother(hidden.wrench)
    bears = truth[:, :3].norm(dim=1) > 0.2 * float(truth[:, :3].norm(dim=1).max())
    own = under.of(hidden.name)
    gap = (own - truth)[bears]
    raw = hidden.wrench[bears]
    # The nearest point to the origin on the force's line stands for the place.
    place = torch.linalg.cross(raw[:, :3], raw[:, 3:]) / raw[:, :3].square().sum(1, keepdim=True).clamp(min=1e-6)
    moment = gap[:, 3:] - torch.linalg.cross(place, gap[:, :3])
    sd = under.sd[bears, under.contacts.index(hidden.name), :3]
    within = float((gap[:, :3].abs() < 1.96 * sd).double().mean()) if bool((sd > 0.0).all()) else math.nan
    rows = [r for r in _rows(found, hidden)]
    exact = true_torques(session, outcome, hidden)[bears][:, rows]
    with_it = torques(item, found.fit.model.tree, found.fit.geometry, found.phi, trial, under)[bears][:, rows]
    plain = outcome.torque[name][bears][:, rows] - true_torques(session, outcome, None, name)[bears][:, rows]
    rms = (with_it - exact).square().nanmean(0).sqrt()
    worst = int(rms.nan_to_num().argmax())
    return Answers(
        _rms(gap[:, :3]), _rms(moment), within, float(rms[worst]), float(plain[:, worst].square().nanmean().sqrt()),
        float((outcome.torque[name][bears][:, rows[worst]] - exact[:, worst]).square().nanmean().sqrt()),
        _rms(truth[bears, :3]), int(bears.sum()),
    )  # fmt: skip


def _rows(found: Outcome, hidden: Hidden) -> list[int]:
    tree = found.fit.model.tree
    bodies = [hidden.contact.segment] if hidden.contact.segment.startswith("hand") else ["thigh_l", "thigh_r"]
    return list(dict.fromkeys(row for body in bodies for row in limb(tree, body)))


def true_torques(
    session: SimulatedSession, outcome: Outcome, hidden: Hidden | None, name: str | None = None
) -> Float[Tensor, "frames dofs"]:
    """Torques of the true body in its true motion under its true loads, through the run's filter.

    Args:
        session: the simulated person.
        outcome: of a run, for its filter.
        hidden: what bears besides the feet.
        name: of the trial, where nothing is hidden.
    """
    name = hidden.trial if hidden is not None else name
    assert name is not None
    subject, truth = session.subject, session.trial(name).truth
    smoother = outcome.followed[name].motion.smoother
    motion = smooth_motion(subject.model.tree, truth.motion.time, truth.motion.q, smoother)
    feet = truth.feet.wrench
    loads = []
    if hidden is not None and not hidden.balanced:
        share = feet[..., 2].clamp(min=0.0) / feet[..., 2].clamp(min=0.0).sum(dim=1, keepdim=True).clamp(min=1.0)
        feet = feet - share[..., None] * hidden.wrench[:, None]
    if hidden is not None:
        loads = [Load(hidden.contact.segment, smoother(hidden.wrench))]
    loads += [Load(f"foot_{side}", smoother(feet[:, k])) for k, side in enumerate("lr")]
    return joint_torques(subject.model.tree, subject.geometry, subject.phi, motion, loads)


def mass_error(found: Outcome, session: SimulatedSession) -> float:
    """RMS error of the segments' masses [kg]."""
    return _rms(found.phi[:, :1] - session.subject.phi[:, :1])


def _rms(x: Tensor) -> float:
    return float(x.square().sum(1).mean().sqrt())
