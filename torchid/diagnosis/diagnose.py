"""The sequence of the diagnosis: search, eliminate, test on held-out motion, and assess what remains."""

from collections.abc import Sequence
from dataclasses import replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.adequacy import Adequacy, assess_adequacy
from torchid.diagnosis.evidence.earlier_sessions import unlike
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence, lasts
from torchid.diagnosis.evidence.model import Identification
from torchid.diagnosis.evidence.other_proof import NOTHING_TOLD, Told
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.search.elimination import AT_LAST, settle
from torchid.diagnosis.search.result import SearchResult, support
from torchid.diagnosis.search.stepwise import search
from torchid.diagnosis.testing.heldout import HeldOut
from torchid.diagnosis.testing.position_dependence import misfits, with_misfits
from torchid.diagnosis.testing.refutation import RULE, Upheld, uphold
from torchid.diagnosis.testing.vibration import with_vibration
from torchid.diagnosis.verdict.causes import after_forces, causes_of, nearest, untested
from torchid.diagnosis.verdict.confidence import bent_by_position, discounted
from torchid.diagnosis.verdict.records import Cause, Diagnosis, EarlierSessions, Refuted
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.effect import Effect
from torchid.model_free.panel import Panel
from torchid.observation.plate_registry import SessionPlate
from torchid.observation.trial import TrialObservation
from torchid.storage.snapshot import release


def select_effects(include: Sequence[str], exclude: Sequence[str]) -> tuple[Effect, ...]:
    """Return the effects to try.

    Args:
        include: their names; empty means the whole catalogue.
        exclude: names of those to leave out.

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
    known: Identification,
    limit: int,
    options: DiagnosisOptions = DiagnosisOptions(),
    panel: Panel | None = None,
    told: Told = NOTHING_TOLD,
    earlier: LaboratoryEvidence | None = None,
) -> Diagnosis:
    """Return the causes of what the identified model gets wrong, with what remains and the trace of all decisions.

    Args:
        observed: fit trials.
        heldout: trials that nothing was fitted on; they may refute a cause.
        plates: plates of the session.
        effects: effects to try.
        known: what the inertial fit knew and found.
        limit: number of causes at most of each kind (``still_open.kind_of``).
        options: every threshold that decides.
        panel: what model-free checks state; None: nothing.
        told: what other proof than forces says.
        earlier: what earlier sessions of the laboratory say; None: nothing. A session that is unlike them is judged
            without them.
    """
    found = search(observed, effects, known, limit, options, panel, told)
    release()  # the catalogue's memory
    beside = None
    if earlier is not None:
        beside = _beside_earlier(found, earlier)
        if beside.unlike is None:
            own = found.laboratory
            found = replace(search(observed, effects, known, limit, options, panel, told, earlier), laboratory=own)
            release()
    unseen = HeldOut(found, heldout)
    upheld = uphold(unseen, unseen.acting(), options.naming)
    found = settle(found.having(upheld.chosen, *upheld.trace), AT_LAST)
    found = found.having(sorted(found.chosen, key=lambda one: one.ordinary))
    return replace(_verdict(found, unseen, upheld, observed, plates), earlier=beside)


def _beside_earlier(alone: SearchResult, earlier: LaboratoryEvidence) -> EarlierSessions:
    """Return what a session says without its laboratory's earlier ones, and whether it is unlike them."""
    worst = None if alone.laboratory is None else unlike(alone.laboratory, earlier)
    if worst is not None and worst.nats < alone.options.naming.named_nats:
        worst = None
    return EarlierSessions(worst, tuple((one.effect.name, one.place.where) for one in alone.named if lasts(one.effect)))


def _verdict(
    found: SearchResult,
    unseen: HeldOut,
    upheld: Upheld,
    observed: Sequence[TrialObservation],
    plates: tuple[SessionPlate, ...],
) -> Diagnosis:
    """Return the diagnosis that the chosen effects amount to, of which those that are ordinary stand last."""
    limits, extended = found.options, unseen.fit(found.named)
    names = [w.rows.name for w in (*observed, *unseen.trials)]
    bent = misfits(found, observed)
    # Doubted for what is left where they were found; what is told to remain is what no name explains.
    searched = _remains(found, found.chosen, observed)
    causes, contradicted = discounted(found, observed, searched, causes_of(found, unseen, extended, names))
    causes, positions = bent_by_position(found, causes, bent)
    rest = _remains(found, found.named, observed)
    rest = with_misfits(with_vibration(rest, observed, limits.adequacy), found, bent)
    return Diagnosis(
        plates, unseen.fit(()).errors, extended.errors, _ordered(found, causes), rest,
        untested(observed, plates), nearest(found.rounds[-1], limits.confidence.rivals),
        _refuted(upheld), (*found.trace, *contradicted, *positions), found.detectable, found.laboratory,
    )  # fmt: skip


def _ordered(found: SearchResult, causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Return what a laboratory did to forces first, then what markers and bodies are like; the best supported come
    first."""
    strength = [support(found.model.statistics, found.chosen, one) for one in found.named]
    order = sorted(range(len(causes)), key=lambda k: (after_forces(causes[k]), -strength[k]))
    return tuple(causes[k] for k in order)


def _refuted(upheld: Upheld) -> tuple[Refuted, ...]:
    """Return the refuted causes."""
    return tuple(
        Refuted(one.effect.name, one.place.where, numbers["heldout_nats"], RULE, numbers)
        for one, numbers in upheld.refuted
    )


def _remains(found: SearchResult, chosen: Sequence[Candidate], observed: Sequence[TrialObservation]) -> Adequacy:
    """Return the adequacy of the model with some of the chosen effects."""
    left = residuals(observed, found.model, found.model.fit(chosen))
    return assess_adequacy(observed, left, found.options.adequacy)
