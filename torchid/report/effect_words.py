"""What effects are called in a sentence."""

from torchid.diagnosis.verdict.records import Alternative, Cause, Near, Refuted
from torchid.report.text import clean, listing, segment

NOUN = {
    "time_offset": "a clock that is off",
    "filter_lag": "markers that were low-passed",
    "plate_gain": "a wrong gain",
    "plate_offset": "a wrong zero",
    "plate_drift": "a drifting zero",
    "plate_pose": "a wrong place",
    "plate_crosstalk": "channels that leak",
    "plate_assignment": "swapped cables",
    "gravity_tilt": "a tilted vertical",
    "moving_ground": "ground that shakes",
    "body_mass": "a wrong body mass",
    "payload": "a load",
    "grasped_object": "an object in the hand",
    "wobbling_mass": "a wobbling mass",
    "flywheel": "something that spins",
    "unmeasured_contact": "a contact that no plate sees",
    "external_force": "a constant force",
    "body_weight_support": "a harness",
    "tether": "a spring",
    "drag": "a drag",
    "marker_shift": "a displaced marker",
    "marker_swap": "exchanged markers",
    "marker_scale": "a wrong scale of the cameras",
    "soft_tissue": "sliding skin",
    "skin_lag": "lagging skin",
    "joint_centre_shift": "a gliding joint centre",
    "missing_dof": "an unmodelled motion",
}
LINK = dict.fromkeys(("plate_gain", "plate_offset", "plate_drift", "plate_pose", "plate_crosstalk"), "of") | {
    "plate_assignment": "of", "soft_tissue": "of", "skin_lag": "of", "wobbling_mass": "of",
    "joint_centre_shift": "of", "missing_dof": "of", "flywheel": "inside", "body_weight_support": "at",
    "unmeasured_contact": "of", "grasped_object": "of",
}  # fmt: skip
"""Between what it is and where; ``on`` elsewhere."""
FEW = 4
"""Segments that are listed."""
LABELLED = frozenset({"marker_shift", "marker_swap"})
"""Effects whose places are marker labels."""


def called(one: Cause | Alternative | Near | Refuted) -> str:
    """An effect and where it sits, as part of a sentence."""
    noun = NOUN.get(one.effect, one.effect.replace("_", " "))
    if one.effect in LABELLED:
        return f"{noun} {listing(list(one.where))}"
    return noun if one.where == ("session",) else f"{noun} {LINK.get(one.effect, 'on')} {place(one)}"


def place(one: Cause | Alternative | Near | Refuted) -> str:
    """Where an effect sits: segments and joints with their article, plates, trials and markers by name."""
    if one.where == ("session",):
        return "the whole session"
    if one.effect.startswith("plate_"):
        return (
            "plates " + listing([n.rpartition("_")[2] for n in one.where])
            if len(one.where) > 1
            else segment(*one.where)
        )
    if one.effect in LABELLED:
        return ("markers " if len(one.where) > 1 else "marker ") + listing(list(one.where))
    if one.effect in ("time_offset", "filter_lag"):
        return "trial " + listing([clean(name) for name in one.where])
    if len(one.where) > FEW:
        return f"{len(one.where)} segments"
    return listing([f"the {segment(name)}" for name in one.where])
