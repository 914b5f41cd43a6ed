"""All effects, by name."""

from torchid.effects.effect import Effect
from torchid.effects.forces import BodyWeightSupport, Drag, ExternalForce, Tether, UnmeasuredContact
from torchid.effects.joints import JointCentreShift, MissingDof
from torchid.effects.markers import MarkerScale, MarkerShift, MarkerSwap, SkinLag, SoftTissue
from torchid.effects.masses import BodyMass, Flywheel, GraspedObject, Payload, WobblingMass
from torchid.effects.plates import PlateAssignment, PlateCrosstalk, PlateDrift, PlateGain, PlateOffset, PlatePose
from torchid.effects.session import FilterLag, GravityTilt, MovingGround, TimeOffset
from torchid.errors import ConfigError

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        TimeOffset(), PlateGain(), PlateOffset(), PlateDrift(), PlatePose(), PlateCrosstalk(), PlateAssignment(),
        GravityTilt(), MovingGround(), BodyMass(), Payload(), GraspedObject(), WobblingMass(), Flywheel(),
        UnmeasuredContact(), ExternalForce(), BodyWeightSupport(), Tether(), Drag(), FilterLag(), MarkerShift(),
        MarkerSwap(), MarkerScale(), SoftTissue(), SkinLag(), JointCentreShift(), MissingDof(),
    )
}  # fmt: skip
BODILY = frozenset(name for name, effect in CATALOGUE.items() if effect.bodily)
"""What every living body has some of."""


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
