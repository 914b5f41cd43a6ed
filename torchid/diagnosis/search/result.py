"""The result of a search: chosen effects, the scans that named them, and what may stand for them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.columns.design import Design
from torchid.diagnosis.evidence.detectable import Detectable
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import Posterior, fit
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.search.rivals import Round, named_in, same, shares, twins
from torchid.diagnosis.trace import Trace, TraceStep


@dataclass(frozen=True)
class SearchResult:
    """Effects that a model has, the scans that named them, and what may stand for them."""

    model: LinearModel
    """Model with the columns of chosen effects and of what cannot be told from them."""
    chosen: tuple[Candidate, ...]
    """Effects in the model."""
    rounds: tuple[Round, ...]
    """Scans of the catalogue, in order; the last one named nothing."""
    posterior: Posterior
    """Posterior of the model with the chosen effects."""
    options: DiagnosisOptions = DiagnosisOptions()
    """Thresholds of the diagnosis."""
    twins: tuple[Candidate, ...] = ()
    """Candidates that cannot be told from chosen effects."""
    trace: Trace = ()
    """Every decision so far."""
    detectable: tuple[Detectable, ...] = ()
    """Smallest sizes that would have been named beside the chosen effects."""
    laboratory: LaboratoryEvidence | None = None
    """Evidence of the session on its laboratory's instruments."""

    @property
    def named(self) -> list[Candidate]:
        """Chosen effects that are more than sessions without them seem to have of them."""
        return [one for one in self.chosen if not one.ordinary]

    def having(self, chosen: Sequence[Candidate], *steps: TraceStep) -> "SearchResult":
        """Return the result with other effects chosen, fitted again.

        Args:
            chosen: the effects.
            steps: decisions that led to them.
        """
        return replace(self, chosen=tuple(chosen), posterior=self.model.fit(chosen), trace=(*self.trace, *steps))


def reduced(
    model: LinearModel, chosen: Sequence[Candidate], rounds: Sequence[Round], options: DiagnosisOptions, trace: Trace
) -> SearchResult:
    """Return the result of a search without columns of what nobody chose and nobody asks about later.

    Args:
        model: model of all candidates.
        chosen: effects in it.
        rounds: scans, in order.
        options: thresholds.
        trace: decisions so far.
    """
    design = model.design
    alike = list(twins_of(design, chosen, rounds, options))
    some = list({id(c): c for c in (*chosen, *alike)}.values())
    small, cut = model.restrict(some)
    own = {id(old): new for old, new in zip(some, cut, strict=True)}
    kept = tuple(own[id(c)] for c in chosen)
    alike = tuple(own[id(c)] for c in alike)
    return SearchResult(small, kept, tuple(rounds), small.fit(kept), options, alike, trace)


def twins_of(
    design: Design, chosen: Sequence[Candidate], rounds: Sequence[Round], options: DiagnosisOptions
) -> Iterator[Candidate]:
    """Yield candidates that cannot be told from chosen effects by the scan; intervals are not searched again.

    Args:
        design: design of all candidates.
        chosen: effects in the model.
        rounds: scans, in order.
        options: thresholds.
    """
    for one in chosen:
        others = twins(shares(named_in(rounds, one), one)[1], options.confidence.twins)
        for twin in (share.rival.candidate for share in others):
            if not twin.effect.intermittent:
                yield from (c for c in design.candidates if same(twin, c))


def without(chosen: Sequence[Candidate], one: Candidate) -> list[Candidate]:
    """Return the chosen effects but for one.

    Args:
        chosen: effects.
        one: the very object to leave out.
    """
    return [c for c in chosen if c is not one]


def support(statistics: Statistics, chosen: Sequence[Candidate], one: Candidate) -> float:
    """Return the log evidence of one of the chosen effects over the others alone [nat].

    Args:
        statistics: statistics of all trials.
        chosen: effects of the model.
        one: the effect in question.
    """
    less, rest = marginalise_per_trial(statistics, without(chosen, one))
    return float(gains(less, fit(less, rest), [one])[0])
