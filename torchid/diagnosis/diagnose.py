"""From a search to a verdict: what is kept of it, how sure, and what it gains on motion that was not used."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import takewhile

from torch import Tensor

from torchid.diagnosis.design import Candidate
from torchid.diagnosis.doubtful import PLAIN, relevant, stands_out, without_opposed
from torchid.diagnosis.evidence import fit
from torchid.diagnosis.field import misfits, with_misfits
from torchid.diagnosis.found import Search, estimate, instead, internal, pruned, support, without
from torchid.diagnosis.heldout import HeldOut, Judged
from torchid.diagnosis.plates import SessionPlate
from torchid.diagnosis.residual import residuals
from torchid.diagnosis.rivals import Round, Share, named_in, same, shares, twins
from torchid.diagnosis.scan import scan_all
from torchid.diagnosis.search import search
from torchid.diagnosis.unexplained import P_VALUE, Structure, structure
from torchid.diagnosis.verdict import RIVALS, Alternative, Cause, Diagnosis, Near, Refuted, Twin
from torchid.diagnosis.vibration import with_vibration
from torchid.diagnosis.watched import Watched
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.effect import Effect
from torchid.effects.session import SESSION
from torchid.geometry.fitted import GeometryFit
from torchid.model.model import InertialPrior
from torchid.regressor.whitening import Whitening

ALONE = 0.5
"""Times the confidence of what forces of a single short trial tell."""
BENT = 0.5
"""Times the confidence of a named force that a field beside it contradicts."""


def wanted(include: Sequence[str], exclude: Sequence[str]) -> tuple[Effect, ...]:
    """The effects to try.

    Raises:
        ConfigError: one of the names is no effect.
    """
    out = {effect(name).name for name in exclude}
    return tuple(effect(name) for name in (include or CATALOGUE) if name not in out)


def diagnose(
    watched: Sequence[Watched],
    heldout: Sequence[Watched],
    plates: tuple[SessionPlate, ...],
    effects: Sequence[Effect],
    inertia: InertialPrior,
    omega: float,
    whitening: Whitening,
    limit: int,
    geometry: GeometryFit | None = None,
) -> Diagnosis:
    """Scan fit trials, then measure on held-out ones.

    Args:
        watched: fit trials.
        heldout: trials that nothing was fitted on; they may refute a cause, or the place of one.
        plates: of the session.
        effects: to try.
        inertia: prior of the inertial parameters.
        omega: weight of that prior in the inertial fit.
        whitening: of the inertial fit.
        limit: causes at most of each kind, see ``search``.
        geometry: with which the trials were followed.
    """
    found = search(watched, effects, inertia, omega, whitening, limit, geometry)
    if _remains(found, watched, heldout).significant:
        found = weighed_again(found, pruned(relevant(without_opposed(found), watched)))
    unseen = HeldOut(found, watched, heldout)
    chosen, refuted = unseen.upheld(unseen.acting())
    found = pruned(replace(found, chosen=chosen, fitted=fit(found.sums, chosen)), last=True)
    rest = _remains(found, watched, heldout)
    extended = unseen.judged(found.chosen)
    names = [w.rows.name for w in (*watched, *heldout)]
    bent = [] if rest.alone else misfits(found, watched)
    causes = _trusted(found, watched, rest, _causes(found, unseen, extended, names))
    for one in bent:
        causes[one.index] = replace(causes[one.index].scaled(BENT), doubted=True)
    strength = [support(found.sums, found.chosen, one) for one in found.chosen]
    order = sorted(range(len(causes)), key=lambda k: (after_forces(causes[k]), -strength[k]))
    rest = with_misfits(with_vibration(rest, watched), found, bent)
    idle, near = _idle(watched, plates), _nearest(found.rounds[-1])
    kept = {id(one) for one in found.chosen}
    instead = {id(first): other.place.where for first, other in found.stand_ins if id(other) in kept}
    against = tuple(Refuted(one.effect.name, one.place.where, says, instead.get(id(one))) for one, says in refuted)
    return Diagnosis(
        plates, unseen.judged(()).errors, extended.errors, tuple(causes[k] for k in order), rest, idle, near, against
    )


def weighed_again(before: Search, after: Search) -> Search:
    """With a wrong record or a common gain, if forces that were dropped have stood for it.

    A runner written down 6 kg too light was 25 nats, until forces at an arm and the thorax, which explained more and
    took nothing away from the residual, pulled at him by as much.
    """
    left = [c for c in after.scales if c not in after.chosen]
    if len(after.chosen) == len(before.chosen) or not left:
        return after
    scan = scan_all(after.sums, left, after.chosen).round
    if scan.named is None:
        return after
    chosen = (*after.chosen, scan.named.candidate)
    rounds = (*after.rounds[:-1], scan, after.rounds[-1])
    return replace(after, chosen=chosen, fitted=fit(after.sums, chosen), rounds=rounds)


def after_forces(cause: Cause) -> bool:
    """What a laboratory did to forces is read first, and what markers and bodies are like after it."""
    return effect(cause.effect).kinematic or effect(cause.effect).bodily


def trust(rest: Structure) -> float:
    """Times the confidence of what forces told a model that leaves such a residual."""
    if rest.alone:
        return ALONE
    return 1.0 - 0.5 * rest.share_of_residual if rest.p_value < P_VALUE else 1.0


def _remains(found: Search, watched: Sequence[Watched], heldout: Sequence[Watched]) -> Structure:
    return structure(watched, residuals(watched, found.design, found.prior, found.fitted), len(heldout))


def _trusted(found: Search, watched: Sequence[Watched], rest: Structure, causes: Iterable[Cause]) -> list[Cause]:
    """A model that the data contradict is sure of nothing that the contradicted forces told: what bodies do and cameras
    see is none of that.

    So is one that nothing can check. Too little of it to be flagged leaves in doubt what is small beside it: at a share
    of 0.31, a harness of 9 N that nobody wore had stayed at 1.00.
    """
    if not (rest.p_value < P_VALUE or rest.alone):
        return list(causes)
    sure = [
        one.effect.kinematic and one.effect.bodily if rest.significant
        else visible(one) if rest.alone
        else one.effect.kinematic or one.effect.timed or stands_out(found, watched, k) > PLAIN
        for k, one in enumerate(found.chosen)
    ]  # fmt: skip
    both = zip(causes, sure, strict=True)
    return [c if plain else replace(c.scaled(trust(rest)), doubted=True) for c, plain in both]


def visible(one: Candidate) -> bool:
    """Markers alone tell it: where all of them do it, only forces disagree, and in one short trial nothing agrees."""
    return one.effect.kinematic and not one.effect.overall and one.place != SESSION


def _nearest(scan: Round) -> tuple[Near, ...]:
    """Of the last scan, which named nothing."""
    best = sorted(scan.families.items(), key=lambda both: -both[1])[:RIVALS]
    first = {name: next(r.candidate for r in scan.rivals if r.candidate.effect.name == name) for name, _ in best}
    return tuple(Near(name, first[name].place.where, score) for name, score in best)


def _causes(found: Search, unseen: HeldOut, extended: Judged, names: Sequence[str]) -> Iterator[Cause]:
    """The chosen effects, each with what it gains on top of the others."""
    for k, one in enumerate(found.chosen):
        gain = extended.over(unseen.judged(without(found.chosen, one)))
        yield cause_of(found, k, found.rounds, gain, names)


def cause_of(found: Search, k: int, rounds: Sequence[Round], gain: dict[str, float], names: Sequence[str]) -> Cause:
    """The k-th of the chosen effects, against the rivals of the round that named it."""
    one = found.chosen[k]
    scan = _upheld(found, rounds, one)
    own, others = shares(scan, one)
    alike = tuple(_twin(found, k, share) for share in twins(others))
    listed = tuple(Alternative(*_named(share), share.weight) for share in others if share.weight > 1e-3)[:RIVALS]
    confidence = min(1.0, own.weight + sum(twin.confidence for twin in alike))
    acting = tuple(names[j] for j in sorted(one.trials))
    return Cause(
        one.effect.name, one.place.where, one.place.when, _told(estimate(found, k)), confidence, listed, alike, gain,
        one.place, internal(found, k).view(len(one.blocks), -1), acting, one.trials == found.sums.all,
    )  # fmt: skip


def _twin(found: Search, k: int, share: Share) -> Twin:
    """With its size in place of the k-th chosen effect."""
    own = next((c for c in found.twins if same(share.rival.candidate, c) and c not in found.chosen), None)
    if own is None:
        return Twin(*_named(share), share.weight)
    return Twin(*_named(share), share.weight, own.place, _told(instead(found, k, own)))


def _named(share: Share) -> tuple[str, tuple[str, ...]]:
    return share.rival.candidate.effect.name, share.rival.candidate.place.where


def _told(values: dict[str, tuple[Tensor, Tensor]]) -> dict[str, dict[str, Tensor]]:
    return {key: {"value": value, "sd": sd} for key, (value, sd) in values.items()}


def _upheld(found: Search, rounds: Sequence[Round], one: Candidate) -> Round:
    """The round that named a cause; where it stands for another place, without those that were refused before it."""
    first = next((first for first, other in found.stand_ins if other is one), None)
    if first is None:
        return named_in(rounds, one)
    tried = [first, *(other for own, other in found.stand_ins if own is first)]
    refused = [(c.effect.name, c.place.where) for c in takewhile(lambda c: c is not one, tried)]
    scan = named_in(rounds, first)
    left = (r for r in scan.compared if (r.candidate.effect.name, r.candidate.place.where) not in refused)
    return replace(scan, compared=tuple(left))


def _idle(watched: Sequence[Watched], plates: Sequence[SessionPlate]) -> dict[str, str]:
    borne = {
        f.name for w in watched for k, f in enumerate(w.view.reading.frames) if bool(w.view.reading.wrench[:, k].any())
    }
    silent = [plate.frame.name for plate in plates if plate.frame.name not in borne]
    out = {}
    if silent:
        out["plate_gain"] = f"not of {', '.join(silent)}: nobody steps there in a fit trial"
    return out
