"""Geometry and inertia of a session, fitted as its config asks."""

import logging
import time
from collections.abc import Callable, Iterable

import torch

from torchid.checks.recording import weight_problem
from torchid.config.sections import Inertia, Subject
from torchid.errors import DataError
from torchid.geometry.fit import ROUNDS, fit_geometry
from torchid.geometry.options import GeometryOptions
from torchid.geometry.result import GeometryFit
from torchid.inertia.identify import Identified, identify_inertia
from torchid.model.model import InertialPrior
from torchid.recording import Trial
from torchid.session import Outcome, Session
from torchid.session.motion_noise import motion_noise
from torchid.session.standing import standing_weight
from torchid.session.unseen import hold_unseen

STEPS = 10
"""Choice. Steps from which the pace of a solver is known."""
LONG_S = 300.0
"""Choice. A solver that may take longer than this says so once its pace is known [s]."""
EVERY_S = 60.0
"""Choice. Time after which a solver that takes long says again how far it has come [s]."""
NEARLY = 0.95
"""Choice. Share of a stage that its solver can reach: what comes after it is left."""

log = logging.getLogger(__name__)


class Pace:
    """Counts the steps of a solver that runs several times in a row, each time for at most so many steps."""

    def __init__(
        self, what: str, most: int, rounds: int, progress: Callable[[str, float], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        """Begin before the first step.

        Args:
            most: steps of a round, at most.
            rounds: how often the solver runs.
            progress: called with the stage and the share of it that is done.
            clock: a clock [s].
        """
        self._what, self._most, self._rounds, self._progress, self._clock = what, most, rounds, progress, clock
        self._begun_s = self._said_s = clock()
        self._round, self._last, self._steps, self._long = 0, 0, 0, False

    def __call__(self, step: int, cost: float) -> None:
        """Count a step.

        Args:
            step: of the round, counted from 1; a smaller one than the last begins another round.
            cost: after it.
        """
        self._round, self._steps = self._round + (step <= self._last), self._steps + 1
        self._last = step
        total, done = self._rounds * self._most, min(self._round, self._rounds - 1) * self._most + step
        self._progress(self._what, min(NEARLY, done / total))
        now = self._clock()
        left_s = (now - self._begun_s) / self._steps * max(total - done, 0)
        early = self._steps == STEPS and left_s > LONG_S
        self._long |= early
        if early or (self._long and now - self._said_s > EVERY_S):
            self._said_s = now
            log.warning(
                "%s: step %d of at most %d, cost %.6g; at most %.0f s more", self._what, done, total, cost, left_s
            )


OnStage = Callable[[str, float], None]
"""Callback of a run, called with the name of a stage and the share of it that is done, 0 to 1."""
REFUSED_FOR_FORCES = ("inertia.prior_conflict", "inertia.unexplained")
"""Refusals of the inertial fit that another weight than the body's explains."""


def fit_session(
    options: GeometryOptions, session: Session, free: bool, progress: OnStage, near: GeometryFit | None = None
) -> GeometryFit:
    """Geometry on the fit trials; not free, the template is scaled. ``near`` is a fit of nearly the same markers."""
    static = session.static
    trials = {name: trial.markers for name, trial in session.fit("geometry").items()}
    if not trials:
        trials = {n: t.markers for n, t in session.trials.items() if t.role == "static"}
    assignment, markers = session.assignment, None if static is None else static.markers
    most = options.iterations if options.solver == "arrow" else options.gradient_iterations
    return fit_geometry(
        assignment.model, assignment.attachment, trials, markers, options, free,
        Pace("geometry", most, ROUNDS, progress), near,
    )  # fmt: skip


def identify(inertia: Inertia, who: Subject, outcome: Outcome, progress: OnStage) -> Identified:
    """Inertia on the fit trials, with the total mass that standing on plates has told.

    Raises:
        DataError: the fit is not accepted.
    """
    progress("inertia", 0.0)
    names = outcome.session.fit("inertia")
    trials = [outcome.followed[n].wrench for n in names]
    mass, box = given_mass(inertia, who, outcome), com_boxes(outcome.prior) if inertia.com_boxes else None
    options, prior = hold_unseen(inertia, outcome.prior, outcome.fit)
    try:
        rows = [t for t in trials if t is not None]
        found = identify_inertia(rows, prior, options, mass, box, motion_noise(outcome))
    except DataError as error:
        fitted = outcome.session.fit("inertia").values()
        raise explained_by_weight(error, fitted, *_body_mass(who, outcome)) from error
    progress("inertia", 1.0)
    return found


def _body_mass(who: Subject, outcome: Outcome) -> tuple[float | None, str]:
    """Mass of the body [kg], None where nobody knows, and how it is known."""
    if who.mass_kg:
        return who.mass_kg, "on record"
    standing = standing_weight(outcome.followed.values(), outcome.session, who.mass_kg)
    return None if standing is None else standing.mass, "by standing"


def explained_by_weight(error: DataError, trials: Iterable[Trial], mass: float | None, known: str) -> DataError:
    """The error with what ``check`` says of the weight, where the plates of a trial carry another than the body's.

    Args:
        error: of the inertial fit.
        trials: that were fitted.
        mass: of the body [kg]; None where nobody knows.
        known: how that is known (``weight_problem``).
    """
    if error.code not in REFUSED_FOR_FORCES:
        return error
    each = filter(None, (weight_problem(trial, mass, known) for trial in trials))
    worst = max(each, key=lambda one: abs(one.size or 0.0), default=None)
    if worst is None:
        return error
    return DataError(
        error.code, f"{error.message}: {worst.evidence}", source=worst.source, found=error.found, remedy=worst.remedy()
    )


def given_mass(inertia: Inertia, who: Subject, outcome: Outcome) -> tuple[float, float] | None:
    """Total mass and its standard deviation [kg] that the inertial fit holds to, beside the prior; None without any."""
    if inertia.known_mass and who.mass_kg:
        return who.mass_kg, who.mass_sd_kg or 1e-3 * who.mass_kg
    weight = standing_weight(outcome.followed.values(), outcome.session, who.mass_kg)
    return None if weight is None else (weight.mass, weight.sd)


def com_boxes(prior: InertialPrior) -> torch.Tensor:
    """Three prior standard deviations about the template's centres of mass."""
    m, centre = prior.mean[:, :1], prior.mean[:, 1:4] / prior.mean[:, :1]
    sd = torch.diagonal(prior.covariance).sqrt().reshape(-1, 10)
    reach = 3.0 * sd[:, 1:4] / m
    return torch.stack([centre - reach, centre + reach], dim=1)
