"""From a search to a verdict: what is kept of it, how sure, and what it gains on motion that was not used."""

from collections.abc import Sequence
from dataclasses import replace

from torchid.diagnosis.evidence.adequacy import Adequacy, assess_adequacy
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.search.elimination import (
    drop_opposed,
    drop_unsupported,
    drop_without_residual_gain,
    restore_record,
)
from torchid.diagnosis.search.result import SearchResult, support
from torchid.diagnosis.search.stepwise import search
from torchid.diagnosis.testing.heldout import HeldOut
from torchid.diagnosis.testing.position_dependence import misfits, with_misfits
from torchid.diagnosis.testing.vibration import with_vibration
from torchid.diagnosis.verdict.causes import after_forces, causes_of, nearest, untested_plates
from torchid.diagnosis.verdict.confidence import BENT, with_trust
from torchid.diagnosis.verdict.records import Diagnosis, Refuted
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.effect import Effect
from torchid.geometry.result import GeometryFit
from torchid.model.model import InertialPrior
from torchid.observation.plate_registry import SessionPlate
from torchid.observation.trial import TrialObservation
from torchid.regressor.whitening import Whitening


def select_effects(include: Sequence[str], exclude: Sequence[str]) -> tuple[Effect, ...]:
    """The effects to try.

    Raises:
        ConfigError: one of the names is no effect.
    """
    out = {effect(name).name for name in exclude}
    return tuple(effect(name) for name in (include or CATALOGUE) if name not in out)


def diagnose(
    observed: Sequence[TrialObservation],
    heldout: Sequence[TrialObservation],
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
    found = search(observed, effects, inertia, omega, whitening, limit, geometry)
    if _remains(found, observed, heldout).significant:
        found = restore_record(found, drop_unsupported(drop_without_residual_gain(drop_opposed(found), observed)))
    unseen = HeldOut(found, observed, heldout)
    chosen, refuted = unseen.upheld(unseen.acting())
    found = drop_unsupported(replace(found, chosen=chosen, posterior=fit(found.statistics, chosen)), last=True)
    rest = _remains(found, observed, heldout)
    extended = unseen.judged(found.chosen)
    names = [w.rows.name for w in (*observed, *heldout)]
    bent = [] if rest.alone else misfits(found, observed)
    causes = with_trust(found, observed, rest, causes_of(found, unseen, extended, names))
    for one in bent:
        causes[one.index] = replace(causes[one.index].scaled(BENT), doubted=True)
    strength = [support(found.statistics, found.chosen, one) for one in found.chosen]
    order = sorted(range(len(causes)), key=lambda k: (after_forces(causes[k]), -strength[k]))
    rest = with_misfits(with_vibration(rest, observed), found, bent)
    unloaded, near = untested_plates(observed, plates), nearest(found.rounds[-1])
    kept = {id(one) for one in found.chosen}
    instead = {id(first): other.place.where for first, other in found.alternative_places if id(other) in kept}
    against = tuple(Refuted(one.effect.name, one.place.where, says, instead.get(id(one))) for one, says in refuted)
    return Diagnosis(
        plates,
        unseen.judged(()).errors,
        extended.errors,
        tuple(causes[k] for k in order),
        rest,
        unloaded,
        near,
        against,
    )


def _remains(
    found: SearchResult, observed: Sequence[TrialObservation], heldout: Sequence[TrialObservation]
) -> Adequacy:
    return assess_adequacy(observed, residuals(observed, found.design, found.prior, found.posterior), len(heldout))
