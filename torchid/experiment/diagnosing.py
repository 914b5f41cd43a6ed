"""What the diagnosis sees of an experiment."""

from torchid.config import Config
from torchid.diagnosis.diagnose import Diagnosis, diagnose, wanted
from torchid.diagnosis.plates import recognise
from torchid.diagnosis.watched import Known, Watched, watch
from torchid.outcome import Outcome


def diagnose_outcome(config: Config, outcome: Outcome) -> Diagnosis | None:
    """Criticise the identified model on the fit trials and measure on the held-out ones; None without any forces.

    Raises:
        ConfigError: ``diagnosis.include`` or ``exclude`` names no effect.
    """
    effects, identified = wanted(config.diagnosis.include, config.diagnosis.exclude), outcome.identified
    plates, _ = recognise(_forces(outcome))
    watched, heldout = (list(watch_outcome(outcome, role).values()) for role in ("fit", "heldout"))
    if identified is None or not watched:
        return None
    return diagnose(
        watched, heldout, plates, effects, outcome.prior,
        identified.fit.omega_2, identified.whitening, config.diagnosis.max_effects, outcome.fit,
    )  # fmt: skip


def watch_outcome(outcome: Outcome, role: str) -> dict[str, Watched]:
    """Trials of a role with forces, as the diagnosis sees them."""
    forces = _forces(outcome)
    _, frames = recognise(forces)
    known = Known(outcome.prior.mean, outcome.phi, float(outcome.prior.mean[:, 0].sum()))
    found = {}
    for name in outcome.session.part(role, "inertia"):
        item = outcome.followed[name]
        if item.wrench is not None and item.contact is not None and any(True for _ in item.wrench.blocks()):
            seen = outcome.fit, outcome.session.trials[name].markers, item.tracked
            found[name] = watch(item.wrench, forces[name], item.contact.measured, frames[name], known, seen)
    return found


def _forces(outcome: Outcome) -> dict:
    """Fit trials first: held-out ones never say where a plate is that a fit trial knows."""
    trials = outcome.session.trials
    order = sorted(trials, key=lambda name: trials[name].role == "heldout")
    return {n: trials[n].forces for n in order if trials[n].forces is not None and trials[n].role != "static"}
