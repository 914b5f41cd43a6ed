"""What the diagnosis sees of an experiment."""

from torchid.config import Config
from torchid.diagnosis.candidates import Watched, watch
from torchid.diagnosis.diagnose import Diagnosis, diagnose, wanted
from torchid.diagnosis.plates import recognise
from torchid.outcome import Outcome


def diagnose_outcome(config: Config, outcome: Outcome) -> Diagnosis | None:
    """Criticise the identified model on the fit trials and measure on the held-out ones; None without any forces.

    Raises:
        ConfigError: ``diagnosis.include`` or ``exclude`` names no effect.
    """
    effects, identified = wanted(config.diagnosis.include, config.diagnosis.exclude), outcome.identified
    forces = {n: t.forces for n, t in outcome.session.trials.items() if t.forces is not None and t.role != "static"}
    plates, frames = recognise(forces)

    def seen(role: str) -> list[Watched]:
        found = []
        for name in outcome.session.part(role, "inertia"):
            item = outcome.followed[name]
            if item.wrench is not None and item.contact is not None and any(True for _ in item.wrench.blocks()):
                known = item.contact.measured, frames[name], outcome.phi, float(outcome.prior.mean[:, 0].sum())
                found.append(watch(item.wrench, forces[name], *known))
        return found

    watched = seen("fit")
    if identified is None or not watched:
        return None
    return diagnose(
        watched, seen("heldout"), plates, effects, outcome.prior,
        identified.fit.omega_2, identified.whitening, config.diagnosis.max_effects,
    )  # fmt: skip
