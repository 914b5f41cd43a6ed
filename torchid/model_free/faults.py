"""Faults of a laboratory that witnesses name by themselves, each against all others that could say the same."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import scipy.stats
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.model_free.panel import Panel


@dataclass(frozen=True)
class Suspect:
    """An effect at a place, with what it would have witnesses say."""

    effect: Effect
    place: Place
    signature: Float[Tensor, "some params"]
    """Change of the statements by a unit of each internal parameter."""
    odds: float
    """Odds before any data that it is there."""

    @property
    def scale(self) -> Float[Tensor, " params"]:
        """Standard deviations of its parameters before any data."""
        return self.signature.new_tensor(self.effect.scale(self.place))

    @property
    def covariance(self) -> Float[Tensor, "some some"]:
        """Covariance that it gives the statements."""
        scaled = self.signature * self.scale
        return scaled @ scaled.T


@dataclass(frozen=True)
class Scored:
    """A suspect with its log odds against no further fault."""

    suspect: Suspect
    nats: float
    """Log odds [nat]."""
    probability: float
    """That it is the further fault."""


@dataclass(frozen=True)
class Size:
    """Parameters of a fault, all faults together."""

    mean: Float[Tensor, " params"]
    covariance: Float[Tensor, "params params"]


@dataclass(frozen=True)
class SuspectedFault:
    """A fault that witnesses name."""

    suspect: Suspect
    size: Size
    scan: tuple[Scored, ...]
    """The search that named it, the best first."""

    @property
    def of_measuring(self) -> bool:
        """True if it is an error of measuring; one that lifts is not, and a body model must tell where it is."""
        return self.suspect.effect.witnessed


def alike(scan: Sequence[Scored], least_nats: float) -> tuple[Scored, ...]:
    """Return the rivals of a search that cannot be told from its best.

    Args:
        scan: the search, the best first.
        least_nats: log odds within which two cannot be told apart.
    """
    return tuple(one for one in scan[1:] if one.nats > scan[0].nats - least_nats)


def probability(scan: Sequence[Scored], least_nats: float) -> float:
    """Return the probability that the best of a search is there, or what cannot be told from it; 0 without any.

    Args:
        scan: the search, the best first.
        least_nats: log odds within which two cannot be told apart.
    """
    return min(1.0, math.fsum(one.probability for one in (*scan[:1], *alike(scan, least_nats))))


def suspects_of(panel: Panel, effects: Sequence[Effect]) -> tuple[Suspect, ...]:
    """Return what witnesses can be asked about: what would change what they say.

    These are errors of measuring, and what they would take for one: a harness that lifts.

    Args:
        panel: the statements.
        effects: effects to try.
    """
    found, views = [], [one.view for one in panel.trials]
    for effect in (one for one in effects if one.witnessed or one.lifts):
        places = effect.places(views)
        total = sum(place.odds for place in places)
        for place in places:
            signature = panel.signature(effect, place)
            if bool(signature.any()):
                found.append(Suspect(effect, place, signature, panel.options.odds * place.odds / total))
    return tuple(found)


def name_faults(panel: Panel, suspects: Sequence[Suspect]) -> tuple[SuspectedFault, ...]:
    """Return the faults that the statements need, in the order in which they are found.

    Args:
        panel: the statements.
        suspects: what could be there.
    """
    chosen: list[Suspect] = []
    scans: list[tuple[Scored, ...]] = []
    while len(chosen) < panel.options.most:
        found = scan(panel, chosen, suspects)
        if not probability(found, panel.options.alike_nats) >= panel.options.named_probability:
            break
        chosen.append(found[0].suspect)
        scans.append(found)
    return _sized(panel, chosen, scans)


def without(
    panel: Panel, faults: Sequence[SuspectedFault], places: Collection[tuple[str, tuple[str, ...]]]
) -> tuple[SuspectedFault, ...]:
    """Return the faults but for some, with what sizes the others have without them.

    Args:
        panel: the statements.
        faults: all that are named.
        places: effect and place of those to leave out, by their names.
    """
    kept = [one for one in faults if (one.suspect.effect.name, one.suspect.place.where) not in places]
    return _sized(panel, [one.suspect for one in kept], [one.scan for one in kept])


def _sized(panel: Panel, chosen: Sequence[Suspect], scans: Sequence[tuple[Scored, ...]]) -> tuple[SuspectedFault, ...]:
    both = zip(chosen, sizes(panel, chosen), scans, strict=True)
    return tuple(SuspectedFault(one, size, found) for one, size, found in both)


def left_by(panel: Panel, faults: Sequence[SuspectedFault]) -> float:
    """Return the chance of what the statements say beyond faults of any size, by their chi-square.

    Errors that no fault describes, such as exchanged cables, are explained by several large ones that nearly cancel,
    and leave much.

    Args:
        panel: the statements.
        faults: what is named.
    """
    more = _covariance([one.suspect for one in faults])
    off = torch.linalg.solve(panel.likeliest(more) + more, panel.value)
    return float(scipy.stats.chi2.sf(float(panel.value @ off), len(panel.value)))


def outdone(panel: Panel, faults: Sequence[SuspectedFault], effects: Sequence[Effect]) -> float:
    """Return by how much the likeliest effect that is there or not, and has no size, describes the statements better
    than faults of any size [nat]; minus infinity where there is none to try.

    Plates that have moved can stand for exchanged cables, but have to be given their sizes for it.

    Args:
        panel: the statements.
        faults: what is named.
        effects: effects to try.
    """
    views = [one.view for one in panel.trials]
    whole, nats = panel.value.new_ones(1), [-math.inf]
    for effect in (one for one in effects if one.all_or_nothing):
        places = effect.places(views)
        total = sum(place.odds for place in places)
        for place in places:
            undone = panel.change([one.without(effect, place, whole) for one in panel.trials])
            nats.append(panel.log_density(-undone) + math.log(panel.options.odds * place.odds / total))
    suspects = [one.suspect for one in faults]
    return max(nats) - panel.log_density(more=_covariance(suspects)) - sum(math.log(one.odds) for one in suspects)


def scan(panel: Panel, chosen: Sequence[Suspect], suspects: Sequence[Suspect]) -> tuple[Scored, ...]:
    """Return every further suspect with what it would gain beside the chosen ones, the best first.

    Args:
        panel: the statements.
        chosen: faults that are named.
        suspects: what could be there.
    """
    others = (one for one in suspects if not any(one is other for other in chosen))
    base, some = _covariance(chosen), [one for one in others if _possible(panel, chosen, one)]
    before = panel.log_density(more=base)
    gains = [panel.log_density(more=base + one.covariance) - before + math.log(one.odds) for one in some]
    weights = torch.softmax(panel.value.new_tensor([0.0, *gains]), 0)[1:].tolist()
    scored = [Scored(*both) for both in zip(some, gains, weights, strict=True)]
    return tuple(sorted(scored, key=lambda one: -one.nats))


def _possible(panel: Panel, chosen: Sequence[Suspect], one: Suspect) -> bool:
    """Return whether a suspect that can only push one way would push that way."""
    ways = one.effect.positives(one.place)
    return not ways or bool((sizes(panel, [*chosen, one])[-1].mean[:ways] > 0.0).all())


def sizes(panel: Panel, chosen: Sequence[Suspect]) -> list[Size]:
    """Return mean and covariance of each fault's internal parameters, all faults together.

    Args:
        panel: the statements.
        chosen: the faults.
    """
    more, found = _covariance(chosen), []
    whole = panel.likeliest(more) + more
    for one in chosen:
        prior = one.scale.square().diag()
        gain = torch.linalg.solve(whole, one.signature @ prior).T
        found.append(Size(gain @ panel.value, prior - gain @ one.signature @ prior))
    return found


def instead(panel: Panel, faults: Sequence[SuspectedFault], k: int, other: Suspect) -> Size:
    """Return the size of a suspect in the place of the k-th fault.

    Args:
        panel: the statements.
        faults: all that are named.
        k: index of the one that gives way.
        other: the suspect.
    """
    chosen = [one.suspect for one in faults]
    return sizes(panel, [*chosen[:k], other, *chosen[k + 1 :]])[k]


def _covariance(chosen: Sequence[Suspect]) -> Float[Tensor, "some some"] | float:
    """Return the covariance that faults of unknown sizes give the statements."""
    return sum((one.covariance for one in chosen), start=0.0)
