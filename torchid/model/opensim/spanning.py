"""Which joints of a file are the tree, where joints and welds close loops.

A joint that leaves all six freedoms holds nothing. Of a loop with such a joint and a weld the weld is exactly what the
file means: the body hangs there. Of any other loop something must be opened, and what stands last in the file is, but
that bodies which no marker tells hang by a weld on one that a marker tells, not by a joint whose coordinates none does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from torchid.model.opensim.joint_values import is_floating
from torchid.model.opensim.model import GROUND, Coupler, Marker, OsimCoordinate, OsimJoint


@dataclass(frozen=True)
class Spanning:
    """Joints and welds of a file, as a tree and what closes its loops."""

    joints: tuple[OsimJoint, ...]
    """Those of the tree, from ground outwards; one whose child is nearer to ground is turned round."""
    closing: tuple[OsimJoint, ...]
    """Joints that close loops."""
    opened: tuple[OsimJoint, ...]
    """Welds that close loops."""


def spanning(
    joints: Sequence[OsimJoint],
    welds: Sequence[OsimJoint],
    coordinates: Sequence[OsimCoordinate],
    couplers: Sequence[Coupler],
    markers: Sequence[Marker],
) -> Spanning:
    """Return the tree of a file's joints and welds.

    Joints that hold something come first, in the order of the file, then the free joint of the body that is the
    person's (of what hangs together, what most markers are on), which a contact must not replace, then welds, then the
    other free joints.
    """
    used = {row for one in couplers for row in (one.dependent, *one.independents)}
    used |= {row for row, one in enumerate(coordinates) if one.locked}
    free = [joint for joint in joints if not used & set(joint.rows) and is_floating(joint)]
    parts = _Parts()
    kept = parts.joined([joint for joint in joints if joint not in free])
    bodies = {frame.body for joint in joints for frame in (joint.parent, joint.child)} - {GROUND}
    person = _persons(free, parts, markers, sorted(bodies))
    kept += parts.joined(person)
    kept += parts.joined(welds)
    kept += parts.joined([joint for joint in free if joint not in person])
    tree = _outwards([joint for joint in (*joints, *welds) if joint in kept])
    seen = {marker.frame.body for marker in markers} - {GROUND}
    loose = {joint.name for joint in joints if joint.rows and not used & set(joint.rows)}
    for weld in welds:
        if weld.name not in {joint.name for joint in tree}:
            tree = _hung(weld, tree, seen, loose)
    names = {joint.name for joint in tree}
    closing, opened = (tuple(one for one in some if one.name not in names) for some in (joints, welds))
    return Spanning(tree, closing, opened)


def _hung(weld: OsimJoint, tree: tuple[OsimJoint, ...], seen: set[int], loose: set[str]) -> tuple[OsimJoint, ...]:
    """The tree with a weld instead of the joint, one that nothing else moves or locks, of a body that no marker tells,
    nor any that it carries."""
    moving = {joint.carried.body for joint in tree if joint.name in loose}
    for on, body in ((weld.parent.body, weld.child.body), (weld.child.body, weld.parent.body)):
        below = {body}
        for joint in tree:
            below |= {joint.carried.body} if joint.carrier.body in below else set()
        if on in seen and body in moving and not below & {on, *seen}:
            return _outwards([*(joint for joint in tree if joint.carried.body != body), weld])
    return tree


@dataclass
class _Parts:
    """Bodies that hang together, by disjoint sets."""

    above: dict[int, int] = field(default_factory=dict)

    def part(self, body: int) -> int:
        """The body that stands for all that hang together with one."""
        while body in self.above:
            body = self.above[body]
        return body

    def joined(self, joints: Sequence[OsimJoint]) -> list[OsimJoint]:
        """Join bodies; return the joints that were needed for it."""
        needed = []
        for joint in joints:
            first, second = self.part(joint.parent.body), self.part(joint.child.body)
            if first != second:
                self.above[first] = second
                needed.append(joint)
        return needed


def _persons(
    free: Sequence[OsimJoint], parts: _Parts, markers: Sequence[Marker], bodies: Sequence[int]
) -> list[OsimJoint]:
    """The free joint of the person, who has most markers, else most bodies; none where ground holds the person."""
    on = [parts.part(marker.frame.body) for marker in markers if marker.frame.body != GROUND]
    of = [parts.part(body) for body in bodies]

    def weight(body: int) -> tuple[int, int]:
        part = parts.part(body)
        return on.count(part), of.count(part)

    carried = [joint for joint in free if parts.part(joint.child.body) != parts.part(GROUND)]
    best = max(carried, key=lambda joint: weight(joint.child.body), default=None)
    return [best] if best is not None and weight(best.child.body) >= weight(GROUND) else []


def _outwards(joints: list[OsimJoint]) -> tuple[OsimJoint, ...]:
    """Order the joints that lead to ground, from there outwards; one whose child is nearer is turned round."""
    order: list[OsimJoint] = []
    reached, waiting = {GROUND}, dict(enumerate(joints))
    while near := [k for k, joint in waiting.items() if {joint.parent.body, joint.child.body} & reached]:
        joint = waiting.pop(near[0])
        order.append(replace(joint, outward=joint.parent.body in reached))
        reached |= {joint.parent.body, joint.child.body}
    return tuple(order)
