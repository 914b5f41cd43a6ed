"""All effects, by name. A new one is a file in this folder and a line in ``ENTRIES``."""

from importlib import import_module
from inspect import isabstract

from torchid.effects.effect import Effect
from torchid.errors import ConfigError

ENTRIES = (
    "timing:TimeOffset",
    "plates:PlateGain",
    "plate_zeros:PlateOffset",
    "plate_zeros:PlateDrift",
    "plates:PlatePose",
    "plates:PlateCrosstalk",
    "plate_assignment:PlateAssignment",
    "session:GravityTilt",
    "moving_ground:MovingGround",
    "body_mass:BodyMass",
    "masses:Payload",
    "masses:GraspedObject",
    "wobbling:WobblingMass",
    "flywheel:Flywheel",
    "contact:UnmeasuredContact",
    "forces:ExternalForce",
    "forces:BodyWeightSupport",
    "forces:Tether",
    "forces:Drag",
    "timing:BodyLag",
    "timing:FilterLag",
    "markers:MarkerShift",
    "marker_swap:MarkerSwap",
    "session:MarkerScale",
    "markers:SoftTissue",
    "skin_lag:SkinLag",
    "joint_centre:JointCentreShift",
    "missing_dof:MissingDof",
)
"""Module of this folder, and class. Columns of a diagnosis stand in this order."""


def make_effect(entry: str) -> Effect:
    """The effect of an entry."""
    module, _, name = entry.partition(":")
    kind = getattr(import_module(f"torchid.effects.{module}"), name)
    assert issubclass(kind, Effect) and not isabstract(kind), f"{entry} is no effect that can be made"
    return kind()


CATALOGUE: dict[str, Effect] = {one.name: one for one in map(make_effect, ENTRIES)}
BODILY = frozenset(name for name, one in CATALOGUE.items() if one.bodily)
"""Effects that every living body has some of."""


def effect(name: str) -> Effect:
    """The effect called ``name``.

    Raises:
        ConfigError: there is none.
    """
    if name not in CATALOGUE:
        raise ConfigError(
            "effect.unknown", "no such effect", place=name, remedy=f"Known are {', '.join(sorted(CATALOGUE))}"
        )
    return CATALOGUE[name]
