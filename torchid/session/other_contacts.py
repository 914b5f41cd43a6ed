"""Contacts other than feet on the body of a session: where they touch it, when they bear, and what is refused."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.options import ContactOptions, OtherContact, Point
from torchid.contact.others import Others, find_others
from torchid.contact.sharing.patches import Patch, axes_about
from torchid.errors import ConfigError, DataError
from torchid.geometry.assign import Assignment
from torchid.geometry.attachment import Attachment
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked
from torchid.io.mend import number_of
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import points, poses
from torchid.model.tree import Tree
from torchid.recording import Forces, Plate, Trial
from torchid.torque.inverse import CHUNK

GRIPS = ("hand",)
"""Wording. Bodies that hold on, by the beginning of their names: at the middle of their markers, in any direction."""


@dataclass(frozen=True)
class Usual:
    """How a segment is usually supported."""

    segments: tuple[str, ...]
    """Beginnings of names."""
    corners: tuple[Point, ...]
    """Of the patch, from the middle of the joints to ``limbs``, or from the segment's origin, in its axes [m]."""
    push: Literal["up", "forward"]
    limbs: tuple[str, ...] = ()
    """Beginnings of the names of the bodies whose joints are meant."""


USUAL = (
    Usual(
        ("pelvis",), tuple((x, y, -0.09) for x in (-0.08, 0.04) for y in (-0.11, 0.11)), "up", ("thigh", "femur")
    ),
    Usual(("thigh", "femur"), tuple((-0.07, y, z) for y in (-0.06, 0.06) for z in (-0.3, -0.05)), "up"),
    Usual(
        ("thorax", "torso"), tuple((-0.11, y, z) for y in (-0.12, 0.12) for z in (-0.25, -0.05)), "forward",
        ("upper_arm", "humerus"),
    ),
)  # fmt: skip
"""Chosen, of adults of 1.75 m: ischial tuberosities 0.09 m below the hip centres and 0.11 to 0.13 m apart with soft
tissue around them, thighs 0.14 m and trunks 0.22 m deep, shoulder blades behind the shoulders and below them."""


def check_others(contact: ContactOptions, assignment: Assignment, trials: Mapping[str, Trial]) -> None:
    """Refuse contacts that the body or the recordings do not have.

    Args:
        contact: with the contacts other than feet.

    Raises:
        ConfigError: ``contact.segment``, ``contact.name``, ``contact.points``, ``contact.push``.
        DataError: ``contact.interval`` where an interval lies outside its trial.
    """
    for name, one in contact.others.items():
        place = f"contact.others.{name}"
        known = assignment.model.tree.names
        if one.segment not in known:
            raise ConfigError(
                "contact.segment", "the model has no such segment", place=f"{place}.segment", found=one.segment,
                remedy=f"Name one of {', '.join(known)}",
            )  # fmt: skip
        if name in known:
            raise ConfigError(
                "contact.name", "a contact cannot be named as a segment", place=place, found=name,
                remedy="Give it a name of its own, such as rail or seat",
            )  # fmt: skip
        _push(one, place)
        tree, attachment = assignment.model.tree, assignment.attachment
        local_points(one, tree, torch.zeros(len(known), 3), attachment, torch.zeros(len(attachment.labels), 3), place)
        _refuse_times(one, trials, place)


def refuse_unknown_plates(contact: ContactOptions, trials: Iterable[Trial]) -> None:
    """Refuse contacts whose plate no recording has; a plate may be in some trials only.

    Args:
        contact: with the contacts other than feet.
        trials: all that the config lists; read no further than plates are missing.

    Raises:
        ConfigError: ``contact.plate``.
    """
    wanted, seen = {one.plate for one in contact.others.values()} - {None}, []
    for trial in trials:
        seen += [trial.forces.plates] if trial.forces else []
        if wanted <= _numbers(seen):
            return
    refuse_plates(contact, *seen)


def _numbers(plates: Sequence[Sequence[Plate]]) -> set[int]:
    return {number_of(plate, k) for own in plates for k, plate in enumerate(own)}


def refuse_plates(contact: ContactOptions, *plates: Sequence[Plate]) -> None:
    """Refuse contacts whose plate is not there.

    Args:
        contact: with the contacts other than feet.

    Raises:
        ConfigError: ``contact.plate``.
    """
    known = _numbers(plates)
    for name, one in contact.others.items():
        if one.plate is not None and one.plate not in known:
            raise ConfigError(
                "contact.plate", "no recording has this plate", place=f"contact.others.{name}.plate",
                found=str(one.plate),
                remedy=f"Plates that there are: {', '.join(map(str, sorted(known))) or 'none'}; leave plate: out "
                "for a contact that nothing measures",
            )  # fmt: skip


def _refuse_times(one: OtherContact, trials: Mapping[str, Trial], place: str) -> None:
    for name, parts in (one.when if isinstance(one.when, dict) else {}).items():
        if name not in trials:
            continue
        first, last = (float(trials[name].markers.time[k]) for k in (0, -1))
        for t0, t1 in parts:
            if t0 > last or t1 < first:
                raise DataError(
                    "contact.interval", "the interval lies outside the trial", source=name, place=f"{place}.when",
                    found=f"{t0} to {t1} s", remedy=f"The trial is from {first:.2f} to {last:.2f} s",
                )  # fmt: skip


def _push(one: OtherContact, place: str = "") -> str | Point:
    """Where a contact's support pushes: as said, or as is usual for its segment."""
    if one.push is not None:
        return one.push
    if one.segment.startswith(GRIPS):
        return "free"
    usual = _usual(one)
    if usual is not None:
        return usual.push
    raise ConfigError(
        "contact.push", "nothing usual is known of contacts of this segment", place=place, found=one.segment,
        remedy="Give push: up, forward, free, or a direction in W",
    )  # fmt: skip


def _usual(one: OtherContact) -> Usual | None:
    return next((usual for usual in USUAL if one.segment.startswith(usual.segments)), None)


def local_points(
    one: OtherContact,
    tree: Tree,
    offset: Float[Tensor, "bodies 3"],
    attachment: Attachment,
    p_BM_B: Float[Tensor, "markers 3"],
    place: str = "",
) -> Float[Tensor, "points 3"]:
    """Return where a contact touches its segment, in the segment's axes [m].

    Args:
        offset: from each body's parent to its joint, in the parent's axes [m].
        p_BM_B: places of these markers [m].

    Raises:
        ConfigError: ``contact.points`` where a marker is not one of the segment's, or no contact points are defined;
            so where the limbs are not found from whose joints its usual place is told.
    """
    body = tree.index(one.segment)
    own = {label: p for label, k, p in zip(attachment.labels, attachment.body, p_BM_B, strict=True) if int(k) == body}
    if one.points:
        strange = [point for point in one.points if isinstance(point, str) and point not in own]
        if strange:
            raise ConfigError(
                "contact.points", f"no marker of {one.segment} has this name", place=f"{place}.points",
                found=", ".join(map(str, strange)),
                remedy=f"Name one of {', '.join(own) or 'none that there are'}, or give [x, y, z] in its axes [m]",
            )  # fmt: skip
        each = [own[point] if isinstance(point, str) else p_BM_B.new_tensor(point) for point in one.points]
        return torch.stack(each)
    usual = _usual(one)
    if usual is not None:
        return p_BM_B.new_tensor(usual.corners) + _middle(usual, one, tree, offset, place)
    if not own:
        raise ConfigError(
            "contact.points", f"no contact points are defined for {one.segment}, and it has no markers", place=place,
            found="no points", remedy="Give points: [[x, y, z]] in the segment's axes [m]",
        )  # fmt: skip
    return torch.stack(list(own.values())).mean(dim=0, keepdim=True)


def _middle(usual: Usual, one: OtherContact, tree: Tree, offset: Tensor, place: str) -> Float[Tensor, "3"]:
    """What corners are counted from, in the segment's axes [m]."""
    if not usual.limbs:
        return torch.zeros_like(offset[0])
    own = [k for k, b in enumerate(tree.bodies) if b.parent == tree.index(one.segment)]
    limbs = [k for k in own if tree.bodies[k].name.startswith(usual.limbs)]
    if not limbs:
        raise ConfigError(
            "contact.points",
            f"no contact points are defined for {one.segment}: none of {', '.join(usual.limbs)} is joined to it",
            place=place, found=", ".join(tree.bodies[k].name for k in own) or "no limbs",
            remedy="Give points: [[x, y, z]] in the segment's axes [m], or markers of it",
        )  # fmt: skip
    return offset[limbs].mean(dim=0)


def place_others(
    fit: GeometryFit, tracked: Tracked, options: ContactOptions
) -> dict[str, tuple[Float[Tensor, "frames _ 3"], Float[Tensor, "frames 3"]]]:
    """Return the points of every contact in W [m], and the forward axis of its segment, frame by frame."""
    tree, plan = fit.model.tree, plan_tree(fit.model.tree)
    given = tree, fit.geometry.offset, fit.attachment, fit.place
    local = {name: local_points(one, *given) for name, one in options.others.items()}
    found = {name: (fit.xi.new_empty(len(tracked.q), len(p), 3), fit.xi.new_empty(len(tracked.q), 3))
             for name, p in local.items()}  # fmt: skip
    for start in range(0, len(tracked.q) if local else 0, CHUNK):
        part = slice(start, start + CHUNK)
        at = poses(plan, tracked.q[part].T.contiguous(), fit.geometry)
        for name, one in options.others.items():
            body = plan.position[tree.index(one.segment)]
            own = torch.full((len(local[name]),), body, device=fit.xi.device)
            found[name][0][part] = points(at, own, local[name]).permute(2, 0, 1)
            found[name][1][part] = at.R[body, 0].T
    return found


def others_of(fit: GeometryFit, tracked: Tracked, trial: Trial, options: ContactOptions) -> Others | None:
    """Return which contacts other than feet bear in a trial; None where the config names none."""
    middles = {name: points.mean(dim=1) for name, (points, _) in place_others(fit, tracked, options).items()}
    forces: Forces | None = trial.forces
    return find_others(options, middles, trial.name, trial.markers.time, forces)


def patches_of(
    fit: GeometryFit, tracked: Tracked, options: ContactOptions, bearing: Bool[Tensor, "frames others"]
) -> dict[str, Patch]:
    """Return what every contact presses with.

    Args:
        bearing: frames in which each bears, over which a forward axis is averaged.
    """
    found = {}
    for k, (name, (p, forward)) in enumerate(place_others(fit, tracked, options).items()):
        one, known = options.others[name], torch.isfinite(forward).all(dim=1)
        push = _push(one)
        if push == "forward":
            some = bearing[:, k] & known
            normal = forward[some if bool(some.any()) else known].mean(dim=0)
        else:
            normal = p.new_tensor(push if isinstance(push, tuple) else (0.0, 0.0, 1.0))
        found[name] = Patch(p, axes_about(normal), torch.inf if push == "free" else one.friction)
    return found
