"""An OpenSim model with what was identified of it: inertia of its bodies, places of its joints and of its markers."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.model import Geometry
from torchid.model.opensim.binding import OsimBinding
from torchid.model.opensim.group_inertia import of_bodies
from torchid.model.opensim.model import Frame, OsimJoint, OsimModel
from torchid.model.opensim.rotations import inverse, moved


def identified_model(
    binding: OsimBinding,
    geometry: Geometry,
    phi: Float[Tensor, "groups 10"],
    places: Mapping[str, Float[Tensor, "3"]],
) -> OsimModel:
    """Return the file's model with another geometry, inertia and markers; ``write_back`` writes it.

    A joint's place moves the offset of its frame on the body nearer to ground; frames of welded bodies stay.

    Args:
        places: place p_TM_T of markers on the tree's bodies, by their names in the file [m]; others stay.
    """
    model = binding.model
    joints = tuple(_placed(binding, geometry, joint) for joint in model.joints)
    markers = []
    for marker in model.markers:
        if marker.name in places:
            X_BT = inverse(binding.X_TB[marker.frame.body])
            p_BM = moved(X_BT, places[marker.name].detach().cpu().double())
            marker = replace(marker, location=moved(inverse(marker.frame.X_BF), p_BM))
        markers.append(marker)
    inertias = of_bodies(binding, phi.detach().cpu().double())
    return replace(model, inertias=inertias, joints=joints, markers=tuple(markers))


def _placed(binding: OsimBinding, geometry: Geometry, joint: OsimJoint) -> OsimJoint:
    """The joint whose carrier's frame stands where the geometry has it."""
    if joint is binding.root:
        return joint
    at, group = joint.carrier, binding.group_of(joint.carried.body)
    if group == binding.group_of(at.body):
        return joint
    p_BF = moved(inverse(binding.X_TB[at.body]), geometry.offset[group].detach().cpu().double())
    new = _at(at, p_BF)
    return replace(joint, parent=new) if joint.outward else replace(joint, child=new)


def _at(frame: Frame, p_BF: Float[Tensor, "3"]) -> Frame:
    """The frame at another place on its body, its offset from the frame that it stands on moved; rounding aside."""
    if float((p_BF - frame.X_BF[:3, 3]).abs().max()) < torch.finfo(torch.float64).eps:
        return frame
    return replace(frame, translation=moved(inverse(frame.base), p_BF))
