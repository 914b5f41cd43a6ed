"""What the identified model gets wrong: causes, rivals, and what naming them gains."""

import math

import torch
from torch import Tensor

from torchid.diagnosis.diagnose import Alternative, Cause, Diagnosis
from torchid.outcome import Outcome
from torchid.report.blocks import Block, Items, Paragraph, Section, Table
from torchid.report.text import clean, number, percent, segment

STORY = {
    "time_offset": "The clocks of cameras and plates disagree",
    "plate_gain": "A plate reads too much or too little by one factor",
    "plate_offset": "A plate reads something when it bears nothing",
    "plate_drift": "A plate's zero drifts",
    "plate_pose": "A plate does not lie where the file has it",
    "plate_crosstalk": "Channels of a plate leak into each other",
    "plate_assignment": "Two plates are swapped",
    "gravity_tilt": "The cameras' vertical is not gravity's",
    "moving_ground": "The laboratory shakes",
    "body_mass": "The recorded mass is not the person's",
    "payload": "A segment carries more than its own mass",
    "wobbling_mass": "Part of a segment's mass lags behind its bone",
    "flywheel": "Something spins inside a segment",
    "external_force": "A constant force acts that no plate measures",
    "body_weight_support": "A harness carries part of the weight",
    "tether": "A spring pulls towards a fixed point",
    "drag": "A force works against motion",
}


def diagnosis_section(outcome: Outcome) -> Section | None:
    """None where no diagnosis was asked for."""
    found = outcome.diagnosis
    if found is None:
        return None
    blocks: list[Block] = []
    if found.causes:
        blocks.append(_causes(found))
        blocks.append(_rivals(found))
    blocks.append(Items(tuple(f"{STORY.get(n, n)}: {clean(why)}" for n, why in found.not_testable.items())))
    blocks.append(
        Paragraph(
            "The causes are named, not yet corrected: every other figure on this page is of the model without them."
        )
    )
    return Section("diagnosis", "What the model gets wrong", _finding(found), tuple(blocks))


def _finding(found: Diagnosis) -> str:
    if not found.causes:
        return "None of the effects that were tried is supported by the forces of the fit trials."
    before, after = found.baseline.force_rmse_N, found.extended.force_rmse_N
    said = "; ".join(f"{STORY.get(c.effect, c.effect)} ({_where(c.where)})" for c in found.causes)
    if not math.isfinite(before):
        return f"{said}. No held-out trial tells what that gains."
    return f"{said}. With that, the held-out force error goes from {number(before)} to {number(after)} N."


def _where(where: tuple[str, ...]) -> str:
    return ", ".join("whole session" if name == "session" else clean(segment(name)) for name in where)


def _causes(found: Diagnosis) -> Table:
    rows = tuple(
        (
            STORY.get(cause.effect, cause.effect),
            _where(cause.where),
            "; ".join(f"{key} {_valued(entry)}" for key, entry in cause.parameters.items()) or "yes",
            percent(cause.confidence),
            number(cause.gain["force_rmse_pct"]),
            number(cause.gain["heldout_log_likelihood"]),
        )
        for cause in found.causes
    )
    head = ("Cause", "Where", "Size", "Confidence", "Held-out force error less by, %", "Nats on held-out motion")
    return Table("Causes that the data support, with standard deviations", head, rows, text=3)


def _valued(entry: dict[str, Tensor]) -> str:
    value, sd = (torch.as_tensor(entry[k], dtype=torch.float64).reshape(-1) for k in ("value", "sd"))
    if len(value) > 6:
        return f"{len(value)} values, largest {_figure(float(value.abs().max()))}"
    return ", ".join(f"{_figure(float(v))} ± {_figure(float(s))}" for v, s in zip(value, sd, strict=True))


def _figure(value: float) -> str:
    return f"{value:.3g}".replace("-", "\N{MINUS SIGN}")


def _rivals(found: Diagnosis) -> Table:
    rows = []
    for cause in found.causes:
        rows.append((STORY.get(cause.effect, cause.effect), _listed(cause.indistinguishable), _others(cause)))
    head = ("Cause", "Cannot be told apart here from", "Less likely")
    return Table("Rivals", head, tuple(rows), text=3, wrap=True)


def _others(cause: Cause) -> str:
    twins = {(t.effect, t.where) for t in cause.indistinguishable}
    return _listed(tuple(a for a in cause.alternatives if (a.effect, a.where) not in twins))


def _listed(several: tuple[Alternative, ...]) -> str:
    return "; ".join(f"{a.effect} at {_where(a.where)} ({percent(a.confidence)})" for a in several) or "nothing"
