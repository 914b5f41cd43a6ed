"""Whether a result is one that a body could give, and if not, the likeliest reasons."""

import torch

from torchid.conventions import GRAVITY
from torchid.dynamics.rows import residual_rms
from torchid.errors import DataError
from torchid.session import Outcome
from torchid.session.judging import STATURE_M, masses
from torchid.session.standing import carried
from torchid.wording import clean

MARKER_M = 0.05
"""Calibrated. Root mean square distance of a trial's markers from the model beyond which they are not that body's: 6 to
25 mm on public recordings, skin and clothes included."""
FORCE_SHARE = 0.4
"""Calibrated. Residual force of the fit trials as a share of the weight: 0.03 to 0.2 there, a run at 5 m/s included."""
MOMENT_SHARE = 0.12
"""Calibrated. Residual moment as a share of weight times height: 0.01 to 0.05 there; a plate turned by 180 degrees
gives 0.2."""
MASS_RATIO = 0.6, 1.6
"""Derived. Total mass over the recorded one: a wrong record is a matter of kilograms, twice the mass is a wrong unit or
gain."""
STANDING_RATIO = 0.75, 1.33
"""A choice. Total mass over what the same plates read in standing, where unit and gain cancel: a quarter of the weight
is a load of 18 kg on 70 kg that came or went between the trials. One plate of two that reads half does the same."""


def impossible(outcome: Outcome) -> DataError | None:
    """Why a result cannot be that of a body, None where it can be."""
    return _markers(outcome) or _mass(outcome) or _standing(outcome) or _residuals(outcome)


def _markers(outcome: Outcome) -> DataError | None:
    wrong = {}
    for name, item in outcome.followed.items():
        error = item.tracked.error[torch.isfinite(item.tracked.error)]
        if len(error) and float(error.square().mean().sqrt()) > MARKER_M:
            wrong[name] = float(error.square().mean().sqrt())
    if not wrong:
        return None
    return DataError(
        "result.markers",
        "the markers are too far from the model for any pose of the body",
        place=f"trials {', '.join(wrong)}",
        found=f"{1e3 * max(wrong.values()):.0f} mm RMS, limit {1e3 * MARKER_M:.0f} mm",
        remedy="Most likely labels are exchanged or belong to another marker set (markers:), then another unit "
        "(units:), then a trial of somebody else; look at the trial's markers in the report",
    )


def _mass(outcome: Outcome) -> DataError | None:
    recorded = outcome.config.subject.mass_kg
    if outcome.identified is None or not recorded:
        return None
    found = float(outcome.phi[:, 0].sum())
    if MASS_RATIO[0] < found / recorded < MASS_RATIO[1]:
        return None
    return DataError(
        "result.mass",
        "mass from the plates contradicts the recorded mass",
        found=f"{found:.1f} kg identified, {recorded:.1f} kg recorded",
        remedy="Most likely a plate has another gain or unit, then a part of the contact is on no plate, then "
        "subject.mass_kg is another's; run `torchid check` on the config",
    )


def _standing(outcome: Outcome) -> DataError | None:
    """The same plates weigh the subject in standing: what contradicts it is in the other trials, or in that one."""
    said = masses(outcome)
    if said.identified is None or said.standing is None:
        return None
    found, standing = said.identified.value, said.standing.value
    if STANDING_RATIO[0] < found / standing < STANDING_RATIO[1]:
        return None
    moving = {name: carried(outcome.followed[name].wrench, outcome.phi) for name in outcome.session.fit("inertia")}
    each = ", ".join(f"{mass:.1f} kg in {clean(name)}" for name, mass in moving.items() if mass is not None)
    return DataError(
        "result.standing",
        "mass in motion contradicts the mass in standing",
        place=f"trials {', '.join(map(clean, said.trials))} against {', '.join(map(clean, moving))}",
        found=f"{found:.1f} kg identified, {standing:.1f} kg standing; the plates bear {each}",
        remedy="Most likely a load or a pull acts in one of the trials only, then a plate's gain or zero changed "
        "between them, then the subject does not stand on the plates with the whole weight; run `torchid check` on "
        "the config, and set inertia: false for a trial that is not to count",
    )


def _residuals(outcome: Outcome) -> DataError | None:
    trials = [outcome.followed[name].wrench for name in outcome.session.fit("inertia")]
    if outcome.identified is None or not any(trials):
        return None
    force, moment = residual_rms([t for t in trials if t is not None], outcome.phi)
    weight = GRAVITY * (outcome.config.subject.mass_kg or float(outcome.phi[:, 0].sum()))
    height = outcome.config.subject.height_m or STATURE_M
    if not (force > FORCE_SHARE * weight or moment > MOMENT_SHARE * weight * height):
        return None
    return DataError(
        "result.residuals",
        "the motion and the plates are not those of one body",
        found=f"{force:.0f} N ({force / weight:.0%} of the weight, limit {FORCE_SHARE:.0%}) and {moment:.0f} N m "
        f"(limit {MOMENT_SHARE * weight * height:.0f} N m) remain in the fit trials",
        remedy="Most likely the forces are those of another trial or late, then a plate lies elsewhere than the file "
        "says, then a contact is on no plate; run `torchid check` on the config",
    )
