"""Skin that slides under every marker with every joint near it, as in every living recording."""

import mujoco
import numpy as np

from mujoco_laboratory.body import JOINTS, Person

Entry = dict
PARTS = {
    "thigh": 1.0, "shank": 0.6, "foot": 0.2, "pelvis": 0.5, "abdomen": 0.6, "thorax": 0.5, "head": 0.1,
    "upper_arm": 0.7, "forearm": 0.5, "hand": 0.2,
}  # fmt: skip
"""Of what skin does on a thigh (Leardini, Chiari, Della Croce & Cappozzo, Gait & Posture 21 (2005))."""


def skin(person: Person, model: mujoco.MjModel, size_m: float, rng: np.random.Generator) -> list[Entry]:
    """Shifts of all markers by the angles of the joints at both ends of their segments.

    Args:
        person: whose.
        model: of the person.
        size_m: root mean square of a thigh marker's shift where one of the angles is 90 degrees [m].
        rng: of the patterns.
    """
    found = []
    for name in person.segments:
        labels = [label for label, marker in person.markers.items() if marker.segment == name]
        for joint in _near(person, name):
            for angle in (model.joint(k).name for k in range(model.njnt)):
                if angle.startswith(f"{joint}_"):
                    size = size_m * PARTS[_stem(name)] / np.sqrt(3.0)
                    shifts = {label: (size * rng.normal(size=3)).tolist() for label in labels}
                    parameters = {"shift_90_m": shifts, "joint": angle}
                    found.append({"effect": "soft_tissue", "where": [name], "when": None, "parameters": parameters})
    return found


def _near(person: Person, name: str) -> list[str]:
    carried = [child for child, segment in person.segments.items() if segment.parent == name]
    return [JOINTS[_stem(part)] + _side(part) for part in (name, *carried) if _stem(part) in JOINTS]


def _stem(name: str) -> str:
    return name[:-2] if _side(name) else name


def _side(name: str) -> str:
    return name[-2:] if name.endswith(("_l", "_r")) else ""
