"""Which bodies of an OpenSim file are the person's, and by which joint they hang in the laboratory.

What stands or moves on ground by itself (a treadmill, a platform, a wall) is in the file beside the person. A person is
carried by ground, or goes about on such a body.
"""

import math
from dataclasses import dataclass

from torchid.conventions import ROOT_MARKERS
from torchid.model.opensim.model import GROUND, OsimJoint, OsimModel

LEAST_FREEDOMS, LEAST_SLIDES = 3, 2
"""Choice. Free coordinates of a joint, and slides that one of them moves and nothing else, from which on the body that
it carries goes about by itself: a pelvis that is planar has both, joints of bones seldom two slides that are free."""


@dataclass(frozen=True)
class Root:
    """How a person hangs in the laboratory."""

    row: int
    """Index of the joint among those of the model."""
    bodies: frozenset[int]
    """Bodies of the person; the others stay in the file as they are."""


def root_of(model: OsimModel) -> Root:
    """Return the joint that carries the person.

    Bodies on ground are the beginnings of trees, and so is a body that goes about on others that carry too few markers
    to be a person's. The person is the tree with most markers; of trees with as many, the one with most bodies.
    """
    tree: dict[int, int] = {}
    borne: dict[int, float] = {GROUND: 0.0}
    """Markers on a body and all that carry it; infinite from where something goes about."""
    for row, joint in enumerate(model.joints):
        carrier, body = joint.carrier.body, joint.carried.body
        about = _goes_about(joint, model)
        tree[body] = row if carrier == GROUND or about and borne[carrier] < ROOT_MARKERS else tree[carrier]
        own = math.inf if about else sum(marker.frame.body == body for marker in model.markers)
        borne[body] = borne[carrier] + own
    members = {row: frozenset(body for body in tree if tree[body] == row) for row in tree.values()}
    weight = {row: (sum(m.frame.body in bodies for m in model.markers), len(bodies)) for row, bodies in members.items()}
    chosen = max(members, key=lambda row: (weight[row], -row))
    return Root(chosen, members[chosen])


def _goes_about(joint: OsimJoint, model: OsimModel) -> bool:
    following = {coupler.dependent for coupler in model.couplers}
    free = {row for row in joint.rows if not model.coordinates[row].locked} - following
    used = [row for axis in (*joint.turns, *joint.slides) for row in axis.rows]
    moved = [slide for slide in joint.slides if len(slide.rows) == 1 and free & set(slide.rows)]
    moved = [slide for slide in moved if used.count(slide.rows[0]) == 1]
    return len(free) >= LEAST_FREEDOMS and len(moved) >= LEAST_SLIDES
