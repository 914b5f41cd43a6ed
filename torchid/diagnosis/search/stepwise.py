"""Stepwise search: scan the catalogue, add the best, estimate the noise again, until nothing more is supported.

Each round asks every candidate beside the effects already chosen, inertia and geometry integrated out. An effect that
is not linear in its parameters is linearised where it was found, one that comes and goes gets its interval refined.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.columns.assemble import make_design
from torchid.diagnosis.columns.design import narrower, only
from torchid.diagnosis.columns.relinearise import relinearised
from torchid.diagnosis.columns.statement_rows import with_statements
from torchid.diagnosis.evidence.adequacy import assess_adequacy
from torchid.diagnosis.evidence.earlier_sessions import with_earlier
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence, laboratory_evidence, lasting
from torchid.diagnosis.evidence.model import Identification, LinearModel, make_model, spectra_of
from torchid.diagnosis.evidence.noise import Noise
from torchid.diagnosis.evidence.noise_estimation import estimate_noise
from torchid.diagnosis.evidence.other_proof import NOTHING_TOLD, Told
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.evidence.skin_prior import with_slides
from torchid.diagnosis.options import DiagnosisOptions, NamingOptions
from torchid.diagnosis.search.believed import believed
from torchid.diagnosis.search.elimination import SUPPORTED, settle
from torchid.diagnosis.search.interval_refinement import refine_interval
from torchid.diagnosis.search.result import SearchResult, reduced, twins_of
from torchid.diagnosis.search.rivals import Rival, Round
from torchid.diagnosis.search.scan import scan_all
from torchid.diagnosis.search.sensitivity import sizes_shown
from torchid.diagnosis.search.still_open import closed_by, open_candidates
from torchid.diagnosis.trace import StepKind, Trace, TraceStep, step
from torchid.effects.effect import Effect
from torchid.model_free.panel import Panel
from torchid.observation.trial import TrialObservation
from torchid.storage.snapshot import release

log = logging.getLogger(__name__)
NEWTON = 2
"""Resolution. Number of steps by which effects that are not linear in their parameters are found: a third moves no
value by a tenth of its standard deviation."""


@dataclass(frozen=True)
class _State:
    """The state of a search between two rounds."""

    model: LinearModel
    limit: int
    options: DiagnosisOptions
    told: Told
    """Places that other proof than forces bears out."""
    chosen: tuple[Candidate, ...] = ()
    rounds: tuple[Round, ...] = ()
    trace: Trace = ()
    silent: dict[tuple[str, int], float] = field(default_factory=dict)
    """Energy that effects would explain at places where the noise that they leave did not support them [nat].

    Places are told by identity, which rounds keep alive.
    """


def search(
    observed: Sequence[TrialObservation],
    effects: Sequence[Effect],
    known: Identification,
    limit: int,
    options: DiagnosisOptions = DiagnosisOptions(),
    panel: Panel | None = None,
    told: Told = NOTHING_TOLD,
    earlier: LaboratoryEvidence | None = None,
) -> SearchResult:
    """Return the effects that fit trials support, with everything that later tests ask about.

    Args:
        observed: fit trials.
        effects: effects to try.
        known: what the inertial fit knew and found.
        limit: number of effects at most of each kind (``kind_of``).
        options: thresholds.
        panel: what model-free checks state; None: nothing.
        told: what other proof than forces says.
        earlier: what earlier sessions of the laboratory say; None: nothing.
    """
    log.info("scanning %d effects in %d trials", len(effects), len(observed))
    state = _State(_begin(observed, effects, known, options.naming, panel, earlier), limit, options, told)
    while True:
        scan, model, looked, silent = _scan(observed, state)
        trace = (*state.trace, *_decisions(scan, looked))
        state = replace(state, rounds=(*state.rounds, scan), trace=trace, silent=silent)
        if (best := scan.named) is None:
            break
        log.info("%s at %s gains %.1f nats", best.candidate.effect.name, best.candidate.place.where, best.score)
        one = replace(best.candidate, ordinary=scan.ordinary)
        added = replace(state, model=model, chosen=(*state.chosen, one))
        added = _add(observed, added, again=looked is not best.candidate)
        state = _narrow(added)
        del model, added  # gigabytes that the next round does without
    shown = sizes_shown(model, state.chosen, _open(state), options.naming)
    shared = _of_laboratory(model, state.chosen)
    found = reduced(state.model, state.chosen, state.rounds, options, state.trace)
    return believed(settle(replace(found, detectable=shown, laboratory=shared), SUPPORTED), observed, limit)


def _of_laboratory(model: LinearModel, chosen: Sequence[Candidate]) -> LaboratoryEvidence | None:
    """Return what is said of lasting faults of instruments, beside the others that the model has."""
    asked = [one for one in model.design.candidates if lasting(one)]
    if not asked:
        return None
    others = [one for one in chosen if not (lasting(one) or one.effect.shifts_time)]
    small, own = model.restrict([*others, *asked])
    return laboratory_evidence(small.statistics, own[: len(others)], own[len(others) :])


def _begin(
    observed: Sequence[TrialObservation],
    effects: Sequence[Effect],
    known: Identification,
    naming: NamingOptions,
    panel: Panel | None,
    earlier: LaboratoryEvidence | None,
) -> LinearModel:
    """Return the model of the whole catalogue, under the noise that the model without any of it leaves."""
    design = make_design(observed, effects, known.geometry, naming)
    design = with_earlier(with_statements(design, panel, [one.rows.name for one in observed]), earlier)
    release()  # pieces of all sizes, which the search has no use for
    model = with_slides(make_model(observed, design, known))
    return _under_own_noise(model, ())


def _under_own_noise(model: LinearModel, chosen: Sequence[Candidate]) -> LinearModel:
    """Return the model under the noise that it leaves with the chosen effects."""
    small, own = model.restrict(chosen)
    return model.with_noise(estimate_noise(small, own))


def _scan(
    observed: Sequence[TrialObservation], state: _State
) -> tuple[Round, LinearModel, Candidate | None, dict[tuple[str, int], float]]:
    """Return a round, the model that it was held under, the candidate whose noise that is, and what was found
    silent."""
    naming, some = state.options.naming, _open(state)
    scanned = scan_all(state.model.statistics, some, state.chosen, naming, state.told)
    log.info("scanned %d candidates", len(some))
    look, silent = _look_closer(observed, state, scanned.rivals)
    if look is None:
        return scanned.round, state.model, None, silent
    model, looked = look
    del scanned
    state.model.forget()  # statistics under a noise that is no longer asked about
    return scan_all(model.statistics, some, state.chosen, naming, state.told).round, model, looked, silent


def _look_closer(
    observed: Sequence[TrialObservation], state: _State, rivals: Sequence[Rival]
) -> tuple[tuple[LinearModel, Candidate] | None, dict[tuple[str, int], float]]:
    """Return the model under the noise of the likeliest candidate, with that, and what was found silent.

    Effects that are not yet named are in the noise that was estimated without them, and hide themselves. Where the
    residual is more than noise, likely ones compete under the noise that each would leave.
    """
    naming, model = state.options.naming, state.model
    left = residuals(observed, model, model.fit(state.chosen))
    rest = assess_adequacy(observed, left, state.options.adequacy)
    looks, silent = [], dict(state.silent)
    for one in _likely(rivals, naming) if rest.significant else ():
        key = one.candidate.effect.name, id(one.candidate.place)
        if one.explained > naming.look_again_growth * silent.get(key, 0.0):
            look = _look(model, one, state.chosen, naming)
            if look is None:
                silent[key] = one.explained
            else:
                looks.append((*look, one.candidate))
    if not looks:
        return None, silent
    _, noise, candidate = max(looks, key=lambda look: look[0])
    return (model.with_noise(noise), candidate), silent


def _look(
    model: LinearModel, rival: Rival, chosen: Sequence[Candidate], naming: NamingOptions
) -> tuple[float, Noise] | None:
    """Return the log evidence with one more effect under the noise that it leaves, and that noise; None without
    support."""
    small, own = model.restrict([*chosen, rival.candidate])
    noise = estimate_noise(small, own)
    statistics, base = marginalise_per_trial(small.with_noise(noise).statistics, own[:-1])
    posterior = fit(statistics, base)
    gain = float(gains(statistics, posterior, own[-1:])[0]) + math.log(rival.candidate.odds) - rival.ordinary
    return None if gain < naming.named_nats else (posterior.log_evidence + gain + statistics.constant, noise)


def _likely(rivals: Sequence[Rival], naming: NamingOptions) -> list[Rival]:
    """Return the effects that would explain most, each at the place that does."""
    best: dict[str, Rival] = {}
    for one in rivals:
        name = one.candidate.effect.name
        if name not in best or one.explained > best[name].explained:
            best[name] = one
    order = sorted(best.values(), key=lambda one: -one.explained)[: naming.look_closer_most]
    return [one for one in order if one.explained > naming.look_closer_part * order[0].explained]


def _decisions(scan: Round, looked: Candidate | None) -> list[TraceStep]:
    """Return the step of what a round named; if it named nothing, those of what came near, with the reason of
    refusal."""
    least = scan.options.named_nats
    if (best := scan.named) is not None:
        rule = "evidence" if looked is None else "evidence_under_its_own_noise"
        numbers = {
            "evidence_nats": best.evidence,
            "crossed_nats": best.crossed,
            "effect_nats": scan.family(best),
            "apparent_nats": scan.appearance,
        }
        if scan.ordinary:
            return [step(StepKind.REFUSE, best.candidate, "ordinary", **numbers, least_nats=least)]
        return [step(StepKind.ENTER, best.candidate, rule, **numbers, least_nats=least)]
    refused: dict[str, TraceStep] = {}
    for one in scan.rivals:
        if one.evidence + math.log(one.candidate.odds) >= least and one.candidate.effect.name not in refused:
            numbers = {"evidence_nats": one.evidence, "crossed_nats": one.crossed, "background_nats": one.ordinary,
                       "effect_nats": scan.family(one), "least_nats": least}  # fmt: skip
            refused[one.candidate.effect.name] = step(StepKind.REFUSE, one.candidate, _refusal(one), **numbers)
    return list(refused.values())


def _refusal(one: Rival) -> str:
    """Return the rule by which a place with evidence is refused: trials disagree, all places have some, or search costs
    more."""
    if one.score < one.evidence - one.ordinary:
        return "trials_disagree"
    return "ordinary" if one.ordinary > 0.0 else "search_price"


def _add(observed: Sequence[TrialObservation], state: _State, again: bool) -> _State:
    """Return the state with the last effect as it is best, under the noise that all chosen ones leave, estimated again
    unless the model has it."""
    model, chosen, effect = state.model, state.chosen, state.chosen[-1].effect
    if effect.shifts_time or effect.nonlinear:
        model = _relinearise(observed, model, chosen)
    elif effect.intermittent and not effect.moves_markers:
        refined, last = refine_interval(observed, _under_own_noise(model, chosen), chosen)
        model, chosen = refined.with_noise(model.noise), (*chosen[:-1], last)
    elif not again:
        return state
    return replace(state, model=_under_own_noise(model, chosen), chosen=chosen)


def _relinearise(observed: Sequence[TrialObservation], model: LinearModel, chosen: Sequence[Candidate]) -> LinearModel:
    """Return the model with effects that are not linear in their parameters linearised where they are."""
    model.forget()  # statistics of columns that are taken anew
    design, noise, n = model.design, model.noise, model.design.inertia
    theta = [model.prior.mean.clone() for _ in model.rows]
    for newton in range(NEWTON):
        if newton:
            # All columns at once: those of the chosen effects alone would have to be taken again behind this.
            design = relinearised(observed, design, [x[n:] for x in theta])
        small, own, which = only(design, chosen)
        less = LinearModel(spectra_of(observed, small), model.prior.for_design(small), small, noise)
        noise = estimate_noise(less, own)
        posterior = less.with_noise(noise).fit(own)
        for k, x in enumerate(theta):
            x[which] = less.prior.theta(posterior.z(len(less.prior.mean), k))
    design = relinearised(observed, design, [x[n:] for x in theta])
    release()
    return LinearModel(spectra_of(observed, design), model.prior, design, noise)


def _narrow(state: _State) -> _State:
    """Return the state without columns of kinds of which as many are named as may be, but for those asked about
    later."""
    design, chosen = state.model.design, state.chosen
    some = [*chosen, *_open(state)]
    some += [c for c in twins_of(design, chosen, state.rounds, state.options) if c not in some]
    some += [c for one in chosen for c in closed_by(design, chosen, one) if c not in some]
    if narrower(design, some)[0].width == design.width:
        return state
    model, own = state.model.restrict(some)
    return replace(state, model=model, chosen=own[: len(chosen)])


def _open(state: _State) -> list[Candidate]:
    """Return the candidates that may still be named."""
    return open_candidates(state.model.design, state.chosen, state.limit)
