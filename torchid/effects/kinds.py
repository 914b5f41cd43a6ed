"""Kinds of effects, by what they act on: each makes abstract what its effects must say."""

from abc import abstractmethod
from collections.abc import Mapping

from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect, MarkerEffect
from torchid.effects.marker_scene import Sight, Slid
from torchid.effects.place import Place
from torchid.effects.quantities import NamedEffect
from torchid.effects.scene import Reading, Scene
from torchid.effects.traits import Correction, Origin


class LoadEffect(Effect):
    """A wrench that the ground must supply besides what the motion of the modelled body needs."""

    @abstractmethod
    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        """Return the wrench about the origin of W that the ground must supply because of it [N, N m]."""


class AttachedLoad(LoadEffect):
    """The load of something that is on a segment: ``inertia.json`` lists it beside the segments."""


class RecordEffect(LoadEffect):
    """Something that was written down of the subject is wrong: a load, of what the body is beyond its record."""

    origin = Origin.RECORD
    correction = Correction.RECORD

    @abstractmethod
    def entries(self, finding: NamedEffect) -> Mapping[str, float]:
        """Return the values that the record should have instead, by the keys of ``subject`` in a config."""


class ReadingEffect(Effect):
    """A map from what plates bear to what they read."""

    correction = Correction.READING

    @abstractmethod
    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """Return the plates' reading of what they bear."""


class SlidingMarkers(MarkerEffect):
    """Markers that cameras see elsewhere than the bodies carry them."""

    @abstractmethod
    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        """Return the markers, and their displacement from where the bodies carry them [m]."""


class DisplacedBodies(MarkerEffect):
    """Bodies that are elsewhere than the model has them, with their markers."""

    @abstractmethod
    def move(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "bodies 6 frames"]:
        """Return the displacement of each body, in plan order: of its origin [m] and rotation [rad], in W."""
