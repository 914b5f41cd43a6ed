"""A finished run held against published norms, figure by figure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from torchid.conventions import Inertial
from torchid.dynamics.rows import WrenchTrial, residual_rms
from torchid.errors import DataError
from torchid.inertia.certificate import InertiaStatus
from torchid.model.anthropometry import body_mass
from torchid.session.outcome import Criterion, Outcome, Quality, QualityLevel, graded
from torchid.session.standing import standing_weight
from torchid.session.tables import largest, rms
from torchid.session.unseen import UNSEEN, unseen_mass
from torchid.wording import clean, number, percent, plural, segment


@dataclass(frozen=True)
class Mass:
    """One statement of the subject's mass."""

    value: float
    """[kg]"""
    sd: float
    """Standard deviation [kg]."""

    def apart(self, other: "Mass") -> float:
        """Distance from another statement in standard deviations of both, with its sign."""
        return (self.value - other.value) / math.hypot(self.sd, other.sd)


@dataclass(frozen=True)
class Masses:
    """All statements there are; None where nobody made one."""

    identified: Mass | None
    recorded: Mass | None
    standing: Mass | None
    trials: tuple[str, ...] = ()
    """Static trials in which the subject stands on plates."""
    tables: Mass | None = None
    """What people of such a stature and age weigh, where neither a record nor standing tells the mass."""


def masses(outcome: Outcome) -> Masses:
    """The subject's mass as recorded, as static trials read it, and as it was identified; without the first two, as
    tables have it."""
    who, found = outcome.config.subject, outcome.identified
    recorded = standing = None
    if who.mass_kg:
        # The height bears on the mass only where none is recorded.
        recorded = Mass(*body_mass(1.0, who.mass_kg, who.mass_sd_kg))
    weight = standing_weight(outcome.followed.values(), outcome.session, outcome.config.subject.mass_kg)
    if weight is not None:
        standing = Mass(weight.mass, weight.sd)
    identified = None if found is None else Mass(float(found.fit.mass.sum()), float(found.fit.sd.total_mass))
    return Masses(
        identified, recorded, standing, () if weight is None else weight.trials,
        _of_tables(outcome) if recorded is None and standing is None else None,
    )  # fmt: skip


def _of_tables(outcome: Outcome) -> Mass | None:
    """What the prior has for the mass; a model from a file has none of its own person."""
    if outcome.config.model != "whole_body":
        return None
    mass, step = outcome.prior.mean[:, 0], len(Inertial)
    return Mass(float(mass.sum()), math.sqrt(float(outcome.prior.covariance[::step, ::step].sum())))


@dataclass(frozen=True)
class Judges:
    """Trials on which the model is judged."""

    names: tuple[str, ...]
    words: str
    """``held-out trials``, or what stands in for them."""
    heldout: bool


def judges(outcome: Outcome, stage: str = "geometry") -> Judges:
    """Held-out trials that ``stage`` is judged on; where there are none, the fit trials, and without these all."""
    for role, words in (("heldout", "held-out trials"), ("fit", "fit trials")):
        names = tuple(outcome.session.part(role, stage))
        if names:
            return Judges(names, words, role == "heldout")
    return Judges(tuple(outcome.session.trials), "trials", False)


OPENSIM = "OpenSim, checklist for evaluating a simulation (simtk.org)"
HICKS = "Hicks et al., J Biomech Eng 137:020905 (2015)"
OWN = "torchid, docs/reading.md"
MARKER_RMS_MM, MARKER_MAX_MM = 20.0, 40.0
"""Cited. Distance of markers from the model, RMS and largest (OpenSim's checklist for inverse kinematics)."""
FORCE_SHARE, MOMENT_SHARE = 0.05, 0.01
"""Cited. Residual force over the peak of the measured force, and residual moment over that peak times the height of
the centre of mass (Hicks et al., J Biomech Eng 137:020905 (2015))."""
FORCE_LIMIT, MOMENT_LIMIT = 0.2, 0.08
"""Calibrated. The largest shares on sound public recordings, a run at 5 m/s included: 20 % of the weight, and 5 % of
weight times height, which is 8 % of the norm's measure in walking."""
CENTRE_HEIGHT = 0.56
"""Cited. Height of a standing person's centre of mass over stature (Croskey et al., Am J Physiol 61:171 (1922))."""
STATURE_M = 1.7
"""Cited. Stature where none is recorded: mean of women and men (Gordon et al., ANSUR II (2014))."""
WORSE = 0.08
"""Derived. Growth of a held-out residual over the scaled template's: what is called worse of a single block
(``NeverWorseOptions.prior_blocks``)."""
FAR_SD = 3.0
"""Derived. Standard deviations that chance reaches in one of 370 comparisons."""
REMEDIES = {
    "force": "Run `torchid check` on the recordings, then see what is left under “Forces”",
    "moment": "Check zeros, corners and origins of plates with `torchid check`, then see what is left under “Forces”",
    "force_template": "Record more motion on the plates, or keep the masses of tables: `inertia: {enabled: false}`",
    "moment_template": "Record more motion on the plates, or keep the masses of tables: `inertia: {enabled: false}`",
    "markers": "See under “Skeleton and markers” which are farthest off: displaced, or on another segment",
    "marker_max": "See under “Skeleton and markers” which one: its label may be exchanged for some frames",
    "mass_standing": "Check the plates' zeros and gains: they disagree between standing and moving, "
    "or something was carried in one of them",
    "mass_tables": "Give `subject.mass_kg`, or height and age: nothing on record and no standing bears this mass out",
    "mass_recorded": "Weigh the subject again, in the clothes and shoes of the recordings, or check the plates' gains",
    "symmetry": "Record motion of both sides on the plates, such as squats and arm swings",
    "segment_mass": "Such a mass is an error of motion or plates more often than the person: compare with other trials",
    "unseen": "Put markers on the trunk and the arms where their inertia matters",
    "untested": "Hold out a trial on the plates: `role: heldout`",
    "converged": "Raise `geometry.iterations`",
    "heldout": "Record one trial more of the same motion, or give one `role: heldout`",
}
"""What to do where a figure is beyond its norm, by its name."""
ASYMMETRY = 0.15
"""A choice. Difference of left and right masses over their mean beyond which few people are."""
REFUSED = tuple(f"inertia.{status}" for status in InertiaStatus)
"""Codes of an inertial fit that was not accepted."""


def quality_of(outcome: Outcome, failure: DataError | None = None) -> Quality:
    """What a run is worth, by its held-out trials where there are some, with the figures that weigh most first.

    Args:
        failure: what kept the rest from being found, or why no body could give it.
    """
    found = [*_unseen(outcome), *_residuals(outcome), *_markers(outcome), *_masses(outcome)]
    found += [*_segments(outcome), *_unsure(outcome)]
    return Quality((*_failed(failure), *(replace(one, remedy=REMEDIES[one.name]) for one in found)))


def _failed(failure: DataError | None) -> list[Criterion]:
    if failure is None:
        return []
    level = (
        QualityLevel.UNUSABLE if failure.code.startswith("result.") or failure.code in REFUSED else QualityLevel.CARE
    )
    shown = f"{failure.message}: {failure.found}" if failure.found else failure.message
    return [Criterion(failure.code, level, math.nan, math.nan, shown, "", OWN, failure.remedy)]


def _unseen(outcome: Outcome) -> list[Criterion]:
    """Of a body most of which nobody saw moving."""
    share, names = unseen_mass(outcome.fit, outcome.prior)
    if outcome.identified is None or share <= UNSEEN:
        return []
    said = f"no marker shows how {percent(share)} of the mass moves ({', '.join(map(segment, names))})"
    return [Criterion("unseen", QualityLevel.CARE, share, UNSEEN, said, f"norm {percent(UNSEEN)}", OWN)]


def _residuals(outcome: Outcome) -> list[Criterion]:
    """Of the identified inertia, in the frames and through the filter that the template's are taken in."""
    judge = judges(outcome, "inertia")
    trials = [own for name in judge.names if (own := outcome.followed[name].wrench) is not None and own.used.any()]
    if outcome.identified is None:
        return []
    if not trials:
        said = f"none of the {judge.words} has forces that can be used, so the identified inertia is untested"
        return [Criterion("untested", QualityLevel.CARE, math.nan, math.nan, said, "", OWN)]
    force, moment = residual_rms(trials, outcome.phi)
    peak = max(float(own.wrench[own.used, :3].norm(dim=1).max()) for own in trials)
    lever = CENTRE_HEIGHT * (outcome.config.subject.height_m or STATURE_M)
    which = "held-out" if judge.heldout else "fit"
    shares = force / peak, moment / (peak * lever)
    found = [
        Criterion("force", graded(shares[0], FORCE_SHARE, FORCE_LIMIT), shares[0], FORCE_SHARE,
                  f"{which} force residual {percent(shares[0], _digits(shares[0]))} of peak",
                  f"norm {percent(FORCE_SHARE)}", HICKS),
        Criterion("moment", graded(shares[1], MOMENT_SHARE, MOMENT_LIMIT), shares[1], MOMENT_SHARE,
                  f"{which} moment residual {percent(shares[1], 1)} of peak force × height of the centre of mass",
                  f"norm {percent(MOMENT_SHARE)}", HICKS),
    ]  # fmt: skip
    return found + (_against_template(outcome, trials, (force, moment), found) if judge.heldout else [])


def _digits(share: float) -> int:
    return 0 if share >= 0.1 else 1


def _against_template(
    outcome: Outcome, trials: Sequence[WrenchTrial], found: tuple[float, float], beside: Sequence[Criterion]
) -> list[Criterion]:
    """Held-out residuals beyond those of the template: not to be used where they are beyond the norm too."""
    others = [(own.used, outcome.followed_scaled[own.name].wrench) for own in trials]
    scaled = residual_rms(
        [replace(one, used=used) for used, one in others if one is not None], outcome.prior_scaled.mean
    )
    criteria = []
    for after, before, own, word in zip(found, scaled, beside, ("force", "moment"), strict=True):
        growth = after / before - 1.0
        level = graded(growth, WORSE)
        if level is QualityLevel.CARE and own.level is not QualityLevel.GOOD:
            level = QualityLevel.UNUSABLE
        bound = f"norm {percent(WORSE)}{' worse' if growth < 0.0 else ''}"
        bound += "" if own.level is QualityLevel.GOOD else f"; {own.words}"
        said = f"held-out {word}s are predicted {_compared(growth)} a scaled model and masses of tables"
        criteria.append(Criterion(f"{word}_template", level, growth, WORSE, said, bound, OWN))
    return criteria


def _compared(growth: float) -> str:
    """``41 % worse than with``, of an error that grows by a share."""
    if abs(growth) < 0.005:
        return "as well as with"
    return f"{percent(abs(growth))} {'better' if growth < 0.0 else 'worse'} than with"


def _farthest(outcome: Outcome, names: Sequence[str]) -> tuple[str, str]:
    """The marker that is farthest from the model, and its trial."""
    error = {name: outcome.followed[name].tracked.error for name in names}
    trial = max(names, key=lambda name: largest(error[name]))
    far = [largest(column) for column in error[trial].unbind(1)]
    return clean(outcome.fit.attachment.labels[far.index(max(far))]), clean(trial)


def _markers(outcome: Outcome) -> list[Criterion]:
    judge = judges(outcome)
    errors = [outcome.followed[name].tracked.error for name in judge.names]
    typical, most = 1e3 * rms(*errors), 1e3 * largest(*errors)
    which = "held-out" if judge.heldout else "fit"
    label, trial = _farthest(outcome, judge.names)
    worst = f"{which} marker {label} {number(most, 0)} mm from the model in {trial}"
    return [
        Criterion("markers", graded(typical, MARKER_RMS_MM), typical, MARKER_RMS_MM,
                  f"{which} markers {number(typical)} mm RMS from the model", f"norm {number(MARKER_RMS_MM, 0)} mm",
                  OPENSIM),
        Criterion("marker_max", graded(most, MARKER_MAX_MM), most, MARKER_MAX_MM,
                  worst, f"norm {number(MARKER_MAX_MM, 0)} mm",
                  OPENSIM),
    ]  # fmt: skip


def _masses(outcome: Outcome) -> list[Criterion]:
    """The identified mass against what standing and the record say."""
    said = masses(outcome)
    if said.identified is None:
        return []
    others = (
        ("mass_standing", said.standing, f"standing in {', '.join(map(clean, said.trials))}"),
        ("mass_recorded", said.recorded, "on record"),
        ("mass_tables", said.tables, "by tables of stature and age"),
    )
    return [_mass(name, said.identified, other, words) for name, other, words in others if other is not None]


def _mass(name: str, found: Mass, other: Mass, words: str) -> Criterion:
    away = abs(found.apart(other))
    shown = f"mass {number(found.value)} kg identified, {number(other.value)} kg {words}, {number(away)} sd apart"
    return Criterion(name, graded(away, FAR_SD), away, FAR_SD, shown, f"norm {number(FAR_SD, 0)} sd", OWN)


def _segments(outcome: Outcome) -> list[Criterion]:
    """The least even pair of segments, and the segment whose mass lies farthest from the table."""
    if outcome.identified is None:
        return []
    fit, prior = outcome.identified.fit, outcome.prior
    found = []
    pairs = uneven(outcome)
    if pairs:
        part, left, right, share = pairs[0]
        said = f"{part} {number(left)} kg left and {number(right)} kg right, {percent(share)} apart"
        found.append(Criterion("symmetry", graded(share, ASYMMETRY), share, ASYMMETRY, said,
                               f"norm {percent(ASYMMETRY)}", OWN))  # fmt: skip
    away = (fit.mass - prior.mean[:, 0]) / prior.covariance.diagonal().sqrt().reshape(-1, 10)[:, 0]
    worst = int(away.abs().argmax())
    size = float(away[worst].abs())
    said = f"{segment(fit.names[worst])} {number(fit.mass[worst])} kg, table {number(prior.mean[worst, 0])} kg, "
    return [*found, Criterion("segment_mass", graded(size, FAR_SD), size, FAR_SD, f"{said}{number(size)} sd apart",
                              f"norm {number(FAR_SD, 0)} sd", OWN)]  # fmt: skip


def uneven(outcome: Outcome) -> list[tuple[str, float, float, float]]:
    """Segments whose sides differ beyond chance: name, left and right [kg], difference over mean; the worst first."""
    if outcome.identified is None:
        return []
    fit, found = outcome.identified.fit, []
    at = {name: k for k, name in enumerate(fit.names)}
    for name, k in at.items():
        other = at.get(f"{name[:-2]}_r") if name.endswith("_l") else None
        if other is None:
            continue
        pair = torch.tensor([10 * k, 10 * other])
        of = fit.covariance[pair][:, pair]
        sd = math.sqrt(max(float(of[0, 0] + of[1, 1] - 2.0 * of[0, 1]), 0.0))
        left, right = float(fit.mass[k]), float(fit.mass[other])
        if abs(left - right) > FAR_SD * sd:
            found.append((name[:-2].replace("_", " "), left, right, 2.0 * abs(left - right) / (left + right)))
    return sorted(found, key=lambda one: -one[3])


def _unsure(outcome: Outcome) -> list[Criterion]:
    """What keeps a run from being good whatever its figures say."""
    found = []
    solution, count = outcome.fit.solution, len(outcome.session.part("heldout", "geometry"))
    if solution is not None and not solution.converged:
        said = f"geometry stopped after {plural(solution.iterations, 'iteration')} before it converged"
        found.append(Criterion("converged", QualityLevel.CARE, math.nan, math.nan, said, "", OWN))
    if not count:
        said = "no trial was held out, so nothing tests the model on other motion"
        found.append(Criterion("heldout", QualityLevel.CARE, math.nan, math.nan, said, "", OWN))
    return found
