"""Words of effects: their names in a sentence, their places, and advice on what to record to be sure of them."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, final

from torchid.effects.place_words import place_words
from torchid.effects.quantities import NamedEffect
from torchid.effects.traits import Site
from torchid.wording import listing


class Described:
    """The words of an effect; nuisances, which are never named, have none."""

    site: ClassVar[Site] = Site.SESSION
    """Kind of things that the names of its places name."""
    noun: ClassVar[str]
    """Name in a sentence, with its article."""
    link: ClassVar[str] = "on"
    """Preposition between the noun and the place."""
    advice: ClassVar[str]
    """Recording in which it shows for itself."""
    apart: ClassVar[Mapping[str, str]] = MappingProxyType({})
    """Recordings that tell it from another effect, by the other's name, or by its own from itself at another place.
    Each pair stands at one of the two."""

    @final
    def located(self, where: tuple[str, ...]) -> str:
        """Return a place in words, as part of a sentence."""
        return place_words(self.site, where)

    @final
    def called(self, where: tuple[str, ...]) -> str:
        """Return the effect with its place, as part of a sentence."""
        if self.site is Site.MARKER:
            return f"{self.noun} {listing(list(where))}"
        return self.noun if where == ("session",) else f"{self.noun} {self.link} {self.located(where)}"

    def sentence(self, finding: NamedEffect) -> str:
        """Return a sentence on what was found, where and how large, without a capital and without a full stop."""
        return self.called(finding.where)
