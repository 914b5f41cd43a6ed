"""Whether a result is one that a body could give, and if not, the likeliest reasons."""

import torch

from torchid.conventions import GRAVITY
from torchid.dynamics.rows import residual_rms
from torchid.errors import DataError
from torchid.session import Outcome

MARKER_M = 0.05
"""Root mean square distance of a trial's markers from the model beyond which they are not that body's: 6 to 25 mm on
public recordings, skin and clothes included."""
FORCE_SHARE = 0.4
"""Residual force of the fit trials as a share of the weight: 0.03 to 0.2 there, a run at 5 m/s included."""
MOMENT_SHARE = 0.12
"""Residual moment as a share of weight times height: 0.01 to 0.05 there; a plate turned by 180 degrees gives 0.2."""
MASS_RATIO = 0.6, 1.6
"""Total mass over the recorded one: a wrong record is a matter of kilograms, twice the mass is a wrong unit or gain."""
STATURE_M = 1.7
"""Where no height is on record."""


def impossible(outcome: Outcome) -> DataError | None:
    """Why a result cannot be that of a body, None where it can be."""
    return _markers(outcome) or _mass(outcome) or _residuals(outcome)


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
        "no pose of the body brings it to these markers",
        place=f"trials {', '.join(wrong)}",
        found=f"markers {1e3 * max(wrong.values()):.0f} mm from the model (root mean square)",
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
        found=f"{found:.1f} kg, {recorded:.1f} kg on record",
        remedy="Most likely a plate has another gain or unit, then a part of the contact is on no plate, then "
        "subject.mass_kg is another's; run `torchid check` on the config",
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
        found=f"{force:.0f} N ({force / weight:.0%} of the weight) and {moment:.0f} N m remain in the fit trials",
        remedy="Most likely the forces are those of another trial or late, then a plate lies elsewhere than the file "
        "says, then a contact is on no plate; run `torchid check` on the config",
    )
