"""Names and signs of coordinates as readers of other programs know them.

torchid's coordinates follow ISB in sign (Wu et al. 2002, J Biomech 35:543; 2005, 38:981; see ``model.skeleton``):
flexion, adduction, internal rotation, dorsiflexion and inversion are positive on both sides. ``isb`` keeps the signs
and writes joint, motion, side. ``opensim`` has the names and signs of Rajagopal et al. 2016 (IEEE Trans Biomed Eng
63:2068), where the lumbar joint's first coordinate is an extension. Coordinates without an entry keep their names.

Coordinates of a model file keep the file's names and signs; with ``isb`` those that have a counterpart take ISB's, the
sign found from how each turns its body in the neutral pose: files do not agree on it (a knee's flexion is positive in
Rajagopal's model and negative in gait2354's).
"""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.equations_of_motion import dynamic_state
from torchid.model.model import Geometry, Model
from torchid.model.tree import Tree
from torchid.model.whole_body import whole_body

OPENSIM: Mapping[str, tuple[str, float]] = {
    "hip_{}_flexion": ("hip_flexion_{}", 1.0),
    "hip_{}_adduction": ("hip_adduction_{}", 1.0),
    "hip_{}_rotation": ("hip_rotation_{}", 1.0),
    "knee_{}_flexion": ("knee_angle_{}", 1.0),
    "ankle_{}_flexion": ("ankle_angle_{}", 1.0),
    "ankle_{}_inversion": ("subtalar_angle_{}", 1.0),
    "shoulder_{}_flexion": ("arm_flex_{}", 1.0),
    "shoulder_{}_adduction": ("arm_add_{}", 1.0),
    "shoulder_{}_rotation": ("arm_rot_{}", 1.0),
    "elbow_{}_flexion": ("elbow_flex_{}", 1.0),
    "elbow_{}_pronation": ("pro_sup_{}", 1.0),
    "wrist_{}_flexion": ("wrist_flex_{}", 1.0),
    "wrist_{}_deviation": ("wrist_dev_{}", 1.0),
    "lower_spine_flexion": ("lumbar_extension", -1.0),
    "lower_spine_bending": ("lumbar_bending", 1.0),
    "lower_spine_rotation": ("lumbar_rotation", 1.0),
}
"""Name and sign in OpenSim by our name; {} is the side."""
SIDED = ("l", "r")
ALONG = 0.7
"""Choice. Cosine between a file's axis and the built-in model's from which on they turn about one axis: 45 degrees,
where another anatomical axis would be as near."""
_OURS = {name: ours for ours, (name, _) in OPENSIM.items()}


class Spelling(NamedTuple):
    """How a coordinate is called in files and report."""

    name: str
    sign: float


def spellings(model: Model, convention: str, filed: bool) -> dict[str, Spelling]:
    """Name and sign of every coordinate of a model.

    Args:
        model: whose coordinates are meant.
        convention: torchid, isb or opensim; of a file the first and the last are the file's own.
        filed: whether the model is from a file.
    """
    names = model.tree.dof_names[6:]
    if not filed:
        return {dof: Spelling(*spelt(dof, convention)) for dof in names}
    own = {dof: Spelling(dof, 1.0) for dof in names}
    return own | _as_isb(model) if convention == "isb" else own


def _as_isb(model: Model) -> dict[str, Spelling]:
    """Coordinates of a file that have a counterpart in the built-in model, and turn about the same axis."""
    usual = whole_body(None, None)
    known, turned = (turning(one.tree, one.geometry.geometry(one.geometry.mean)) for one in (usual, model))
    found = {}
    for dof in model.tree.dof_names[6:]:
        ours = counterpart(dof)
        if ours in known:
            along = float(torch.nn.functional.cosine_similarity(known[ours], turned[dof], dim=0))
            if abs(along) > ALONG:
                found[dof] = Spelling(spelt(ours, "isb")[0], 1.0 if along > 0.0 else -1.0)
    return found


def turning(tree: Tree, geometry: Geometry) -> dict[str, Float[Tensor, " 3"]]:
    """Direction in which each coordinate turns the body that it turns most, against its parent, in the neutral pose.

    Args:
        tree: of a model whose bodies' axes are parallel then.
    """
    count = len(tree.dofs)
    rest = geometry.offset.new_tensor([dof.rest for dof in tree.dofs])
    q = rest[:, None].expand(-1, count).contiguous()
    state = dynamic_state(tree, geometry, q, torch.eye(count).to(q), torch.zeros_like(q))
    w = state.motion.w[[state.plan.position[k] for k in range(len(tree.bodies))]]
    own = torch.stack([w[k] - w[body.parent] if k else w[k] for k, body in enumerate(tree.bodies)])
    most = own.norm(dim=1).argmax(0)
    return {dof.name: own[int(most[k]), :, k] for k, dof in enumerate(tree.dofs)}


def counterpart(dof: str) -> str:
    """The built-in model's name of a coordinate that OpenSim's models call otherwise; its own where none is known."""
    stem, _, side = dof.rpartition("_")
    if side in SIDED and f"{stem}_{{}}" in _OURS:
        return _OURS[f"{stem}_{{}}"].format(side)
    return _OURS.get(dof, dof)


def spelt(dof: str, convention: str) -> tuple[str, float]:
    """Name and sign of a coordinate in a convention.

    Args:
        dof: torchid's name, such as ``hip_l_flexion``.
        convention: torchid, isb or opensim.
    """
    side = side_of(dof)
    stem = dof.replace(f"_{side}_", "_{}_", 1) if side else dof
    if convention == "opensim" and stem in OPENSIM:
        name, sign = OPENSIM[stem]
        return name.format(side), sign
    if convention == "isb" and side:
        return f"{dof.replace(f'_{side}_', '_', 1)}_{side}", 1.0
    return dof, 1.0


def side_of(dof: str) -> str:
    """Side of a coordinate, l or r; empty for one of the trunk.

    Args:
        dof: torchid's name, or another model's that ends with its side.
    """
    parts = dof.split("_")
    return next((part for part in parts if part in SIDED), "")


def chosen(wanted: tuple[str, ...], dofs: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Coordinates of a model that a config means, and what it means that the model does not have.

    Args:
        wanted: coordinates; one without its side stands for both, and the built-in model's name for the counterpart
            that a file has.
    """
    found, missing = [], []
    for name in wanted:
        own = [dof for dof in dofs if name in (dof, _sideless(dof))]
        own = own or [dof for dof in dofs if name in (counterpart(dof), _sideless(counterpart(dof)))]
        found += [dof for dof in own if dof not in found]
        missing += [] if own else [name]
    return tuple(found), tuple(missing)


def _sideless(dof: str) -> str:
    return "_".join(part for part in dof.split("_") if part not in SIDED)
