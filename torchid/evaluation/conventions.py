"""Names and signs of coordinates as readers of other programs know them.

torchid's coordinates follow ISB in sign (Wu et al. 2002, J Biomech 35:543; 2005, 38:981; see ``model.skeleton``):
flexion, adduction, internal rotation, dorsiflexion and inversion are positive on both sides. ``isb`` keeps the signs
and writes joint, motion, side. ``opensim`` has the names and signs of Rajagopal et al. 2016 (IEEE Trans Biomed Eng
63:2068), where the lumbar joint's first coordinate is an extension. Coordinates without an entry keep their names.
"""

from collections.abc import Mapping

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
        wanted: coordinates; one without its side stands for both.
        dofs: of the model.
    """
    found, missing = [], []
    for name in wanted:
        own = [dof for dof in dofs if dof == name or _sideless(dof) == name]
        found += [dof for dof in own if dof not in found]
        missing += [] if own else [name]
    return tuple(found), tuple(missing)


def _sideless(dof: str) -> str:
    return "_".join(part for part in dof.split("_") if part not in SIDED)
