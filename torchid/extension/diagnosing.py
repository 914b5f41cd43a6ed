"""What the diagnosis sees of an experiment."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from torch import Tensor

from torchid.diagnosis.candidates.marker_faults import MOVED
from torchid.diagnosis.candidates.missing_weight import EFFECT, MissingWeight, find_missing_weight, set_aside
from torchid.diagnosis.diagnose import diagnose, select_effects
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence
from torchid.diagnosis.evidence.model import Identification
from torchid.diagnosis.options import MissingWeightOptions
from torchid.diagnosis.verdict.causes import with_marker_faults, with_missing_weight
from torchid.diagnosis.verdict.records import Diagnosis
from torchid.dynamics.rows import WrenchTrial
from torchid.effects.catalogue import CATALOGUE
from torchid.extension.other_proofs import marker_faults, told
from torchid.model_free.panel import Panel
from torchid.model_free.watched import longest_stretch
from torchid.motion import Motion
from torchid.observation.trial import BodyEstimate, TrialObservation, observe_trial
from torchid.session import Outcome
from torchid.session.plates import plate_forces, session_plates
from torchid.storage.allocator import keeping_large
from torchid.storage.snapshot import in_memory

LONGEST_S = 40.0
"""Of a trial is searched at most: columns of the whole catalogue take 13 MB per second at 100 Hz."""
MOST = 12
"""Trials of each role that are searched: those with most used frames."""


@keeping_large()
def diagnose_outcome(
    outcome: Outcome,
    room: Callable[[Sequence[int]], Tensor] = in_memory,
    panel: Panel | None = None,
    earlier: LaboratoryEvidence | None = None,
    searching: bool = True,
) -> Diagnosis | None:
    """Criticise the identified model on the fit trials and measure on the held-out ones; None without any forces.

    Args:
        outcome: up to the inertia; its config says what to try and by which thresholds.
        room: makes zeros of a shape, where columns lie until they are looked at (``OutputFolder.room``); without it
            they lie in memory.
        panel: what model-free checks state; None: nothing.
        earlier: what earlier sessions of the laboratory say (``earlier_sessions``); None: nothing.
        searching: False names only what is known before any search.

    Raises:
        ConfigError: ``diagnosis.include`` or ``exclude`` names no effect.
    """
    wanted = outcome.config.diagnosis
    effects, identified = select_effects(wanted.include, wanted.exclude), outcome.identified
    options = wanted.thresholds
    if outcome.config.model != "whole_body" or outcome.config.subject.mass_kg is None:
        effects = tuple(one for one in effects if not one.on_record)  # a model's file has its masses from elsewhere
    plates, _ = session_plates(outcome.session)
    trials = {role: forceful(outcome, role) for role in ("fit", "heldout")}
    parts = {role: searched(some) for role, some in trials.items()}
    observed, heldout = (
        [replace(one, room=room) for one in observe_outcome(outcome, role, parts[role]).values()]
        for role in ("fit", "heldout")
    )
    if identified is None or not observed:
        return None
    missing = _missing_weight(outcome, observed, parts["fit"], options.missing_weight) if EFFECT in effects else []
    gone = [i for one in missing for i in one.aside]
    left = [w for w in (set_aside(w, gone) for w in observed) if any(True for _ in w.rows.blocks())]
    observed = left or observed
    known = Identification(outcome.prior, identified.fit.omega_2, identified.whitening, outcome.fit)
    sought = effects if searching else ()
    found = diagnose(
        observed, heldout, plates, sought, known, wanted.max_effects, options, panel, told(outcome), earlier
    )
    found = replace(found, not_testable=found.not_testable | _passed_over(trials["fit"], parts["fit"]))
    named = {cause.where for cause in found.likely if cause.effect == MOVED.name}
    faults = [one for one in marker_faults(outcome) if one.effect in effects]
    faults = [one for one in faults if one.effect is not MOVED or one.place.where not in named]
    return with_marker_faults(with_missing_weight(found, missing, options), faults)


def _missing_weight(
    outcome: Outcome, observed: Sequence[TrialObservation], parts: Mapping[str, slice], options: MissingWeightOptions
) -> list[MissingWeight]:
    found = []
    for w in observed:
        item, part, forces = (
            outcome.followed[w.rows.name],
            parts[w.rows.name],
            plate_forces(outcome.session)[w.rows.name],
        )
        assert item.contact is not None
        observable = item.tracked.observable[part]
        found.append(find_missing_weight(w, forces.samples(part), item.contact.frames(part), observable, options))
    return [one for one in found if one is not None]


def forceful(outcome: Outcome, role: str) -> dict[str, WrenchTrial]:
    """Rows of the trials of a role that have any."""
    rows = {name: outcome.followed[name].wrench for name in outcome.session.part(role, "inertia")}
    return {name: one for name, one in rows.items() if one is not None and any(True for _ in one.blocks())}


def searched(trials: Mapping[str, WrenchTrial]) -> dict[str, slice]:
    """The frames of each trial that are worth their memory: the stretch in which most are used."""
    kept = sorted(trials, key=lambda name: -int(trials[name].used.sum()))[:MOST]
    return {
        name: longest_stretch(rows.used, round(LONGEST_S * rows.rate)) for name, rows in trials.items() if name in kept
    }


def spans(outcome: Outcome) -> dict[str, slice]:
    """The frames of each trial in which parameters of causes were found: what was searched, all where nothing was."""
    parts = [searched(forceful(outcome, role)) for role in ("fit", "heldout")]
    whole = {name: slice(0, len(item.motion.time)) for name, item in outcome.followed.items()}
    return whole | parts[0] | parts[1]


def _passed_over(trials: Mapping[str, WrenchTrial], parts: Mapping[str, slice]) -> dict[str, str]:
    """What comes and goes is not found where nobody looks."""
    said = [f"{name} was not searched" for name in trials if name not in parts]
    for name, part in parts.items():
        time = trials[name].motion.time
        if part.stop - part.start < len(time):
            said.append(f"of {name} only {float(time[part.start]):.1f} to {float(time[part.stop - 1]):.1f} s")
    return {name: "; ".join(said) for name, one in CATALOGUE.items() if one.intermittent} if said else {}


def observe_outcome(
    outcome: Outcome, role: str, parts: Mapping[str, slice] | None = None
) -> dict[str, TrialObservation]:
    """Trials of a role with forces, as the diagnosis sees them; given parts, these alone."""
    observer, found = Observer(outcome), {}
    for name in forceful(outcome, role):
        part = slice(None) if parts is None else parts.get(name)
        if part is not None and outcome.followed[name].contact is not None:
            found[name] = observer(name, part)
    return found


class Observer:
    """What the diagnosis sees of parts of an experiment's trials."""

    def __init__(self, outcome: Outcome) -> None:
        """Recognise the plates of the session.

        Args:
            outcome: up to the inertia.
        """
        self.outcome, self._forces = outcome, plate_forces(outcome.session)
        _, self._frames = session_plates(outcome.session)

    def __call__(self, name: str, part: slice, ends: Motion | None = None) -> TrialObservation:
        """One part of a trial whose forces and contacts are known.

        Args:
            name: of the trial.
            part: frames to look at.
            ends: as ``observe_trial``.
        """
        outcome, item = self.outcome, self.outcome.followed[name]
        assert item.wrench is not None and item.contact is not None
        known = BodyEstimate(outcome.prior.mean, outcome.phi, float(outcome.prior.mean[:, 0].sum()))
        seen = outcome.fit, outcome.session.trials[name].markers.frames(part), item.tracked.frames(part)
        return observe_trial(
            item.wrench.frames(part), self._forces[name].samples(part), item.contact.measured[part],
            self._frames[name], known, seen, outcome.config.diagnosis.thresholds.observation, ends,
        )  # fmt: skip
