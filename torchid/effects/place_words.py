"""Places of effects in words."""

from torchid.effects.place import Angle
from torchid.effects.traits import Site
from torchid.wording import clean, listing, segment

FEW = 4
"""Wording. Segments that are listed by name at most."""


def place_words(site: Site, where: tuple[str, ...]) -> str:
    """Return a place as part of a sentence: segments and joints with their article, all else by name.

    Args:
        site: what the names are names of.
        where: names of segments, joints, plates, markers or trials, or ``("session",)``.
    """
    if where == ("session",):
        return "the whole session"
    if site is Site.PLATE and len(where) > 1:
        return "plates " + listing([name.rpartition("_")[2] for name in where])
    if site is Site.PLATE:
        return segment(*where)
    if site is Site.MARKER:
        return ("markers " if len(where) > 1 else "marker ") + listing(list(where))
    if site is Site.TRIAL:
        return "trial " + listing([clean(name) for name in where])
    if len(where) > FEW:
        return f"{len(where)} segments"
    return listing([f"the {segment(name)}" for name in where])


def motion_words(follows: Angle | None) -> str:
    """The coordinate that an effect follows, in words: ``knee_l_flexion`` as ``left knee flexion``."""
    if follows is None:
        return "a neighbouring joint"
    words = follows.dof.split("_")
    sides = [{"l": "left", "r": "right"}[w] for w in words if w in ("l", "r")]
    said = " ".join([*sides, *(w for w in words if w not in ("l", "r"))])
    return clean(said if follows.before is None else f"{said} (before {follows.before.rpartition('_')[2]})")
