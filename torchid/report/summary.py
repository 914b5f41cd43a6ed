"""Who was measured, what came out, and what a reader must know before believing it."""

import math

from torchid.errors import DataError
from torchid.report.blocks import Block, Glance, Items, Paragraph, Section, Table
from torchid.report.data_handling import grouped
from torchid.report.facts import Wrenches, body_weight, force_rms, improved, judges, marker_rms, some, used_frames
from torchid.report.glance import glance
from torchid.report.picture import person_picture
from torchid.session import Outcome
from torchid.session.judging import quality_of
from torchid.session.outcome import ORDER, Quality
from torchid.session.tables import largest
from torchid.wording import ABSENT, change, clean, listing, number, percent, plural, segment

READING = (
    "axes.",
    "units.",
    "markers.",
    "trc.",
    "storage.",
    "mot.",
    "text.",
    "time.",
    "events.",
    "trial.frames",
    "model.",
)
"""Notes about files that were read as they should be; the section on data handling has them all."""
FAR_SD = 3.0
"""An identified mass this many prior standard deviations from the table is pointed out."""
FEWEST_ROWS = 10
"""Derived. Equations beyond the quantities that they determine below which the noise is known to no better than 24 %
(1 / sqrt(2 x 9)), and chi-square says nothing."""
CONFLICT = 1e-3
"""Derived. Chance of a chi-square that is pointed out."""
LARGE_MM = 80.0
"""A marker this far from the model was probably swapped or mislabelled [mm]."""


def head_section(outcome: Outcome, forces: dict[str, Wrenches], failure: DataError | None) -> Section:
    """The head of the page: the verdict, what it rests on, and what to know before using the results."""
    tested = some(forces, judges(outcome, "inertia").names)
    quality = quality_of(outcome, failure)
    blocks: list[Block] = [
        Glance(*person_picture(outcome), glance(outcome, quality)),
        criteria_table(quality),
        _subject(outcome),
        Table(
            "Residuals on held-out trials" if judges(outcome).heldout
            else "Residuals on the trials of the fit (no trial was held out: these figures are no test)",
            ("", "Scaled template, tabulated inertia", "Identified geometry, tabulated inertia", "Identified",
             "Change against the scaled template"),
            verdict_rows(outcome, tested),
        ),
    ]  # fmt: skip
    warnings = tuple(warning_lines(outcome, tested))
    if warnings:
        blocks += [Paragraph("Worth knowing before using these results:"), Items(warnings)]
    blocks.append(_trials(outcome))
    line = quality.line[0].upper() + quality.line[1:]
    return Section("summary", "Summary", f"{line}.", tuple(blocks), quality.level.name.lower())


def criteria_table(quality: Quality) -> Table:
    """Every figure beside its norm, those that decide first."""
    order = sorted(quality.criteria, key=lambda one: -ORDER.index(one.level))
    rows = tuple((one.shown[0].upper() + one.shown[1:], one.bound or ABSENT, one.level.value, one.source)
                 for one in order)  # fmt: skip
    return Table("What the verdict rests on", ("Figure", "Norm", "Verdict", "Source of the norm"), rows, 4, wrap=True)


def verdict_rows(outcome: Outcome, tested: dict[str, Wrenches]) -> tuple[tuple[str, ...], ...]:
    """Markers, force and moment on the judging trials: scaled, identified geometry, all identified, change."""
    judge, weight = judges(outcome), body_weight(outcome)
    identified, scaled = marker_rms(outcome, judge.names)
    rows: list[tuple[str, ...]] = [
        ("Markers, RMS [mm]", number(scaled), number(identified), number(identified), change(scaled, identified))
    ]
    if tested:
        start, middle, end = (force_rms(tested, which) for which in ("scaled", "prior", "identified"))
        if outcome.identified is None:
            end = (math.nan, math.nan)
        force = [
            f"{number(x[0])} ({percent(x[0] / weight, 1)})" if x[0] == x[0] else ABSENT for x in (start, middle, end)
        ]
        rows.append(("Force, RMS [N] (of body weight)", *force, change(start[0], end[0])))
        moments = [number(x[1]) for x in (start, middle, end)]
        rows.append(("Moment about the pelvis, RMS [N m]", *moments, change(start[1], end[1])))
    return tuple(rows)


def _subject(outcome: Outcome) -> Table:
    who, fit = outcome.config.subject, outcome.fit
    rows = [
        ("Subject", clean(who.name)),
        ("Height, sex, age", f"{f'{number(who.height_m, 2)} m' if who.height_m else 'not recorded'}, {who.sex}, "
                             f"{f'{who.age_years:g} years' if who.age_years else 'not recorded'}"),
        ("Model", f"{clean(str(outcome.config.model))}: {len(fit.model.tree.bodies)} segments, "
                  f"{len(fit.model.tree.dofs)} coordinates, {len(fit.attachment.labels)} markers"),
    ]  # fmt: skip
    if outcome.config.inertia.enabled:
        names = list(outcome.session.fit("inertia"))
        used, frames = used_frames(outcome, names)
        rows.append(("Frames for inertia", f"{used} of {frames} in {plural(len(names), 'fit trial')}"))
    return Table("", ("", ""), tuple(rows), text=2, wrap=True)


def _trials(outcome: Outcome) -> Table:
    rows = []
    for name, trial in outcome.session.trials.items():
        item, file = outcome.followed[name], outcome.session.files.get(name)
        uses = [use for use in ("geometry", "inertia") if trial.role == "fit" and file and getattr(file, use)]
        contact = item.contact
        rows.append((
            clean(name), trial.role.replace("heldout", "held out"), ", ".join(uses) or ABSENT,
            number(float(trial.markers.time[-1] - trial.markers.time[0]), 2), number(trial.markers.rate, 0),
            str(len(trial.markers.time)),
            ABSENT if contact is None else str(int(contact.used.sum())),
            ABSENT if trial.forces is None else str(len(trial.forces.plates)),
        ))  # fmt: skip
    head = ("Trial", "Role", "Fitted to it", "Duration [s]", "Rate [Hz]", "Frames", "Frames with forces used", "Plates")
    return Table("Trials", head, tuple(rows), text=3)


def warning_lines(outcome: Outcome, tested: dict[str, Wrenches]) -> list[str]:
    """Notes that bear on the results, and what the numbers themselves give cause for."""
    lines = [
        f"{line.message}{f' ({line.where})' if line.where else ''}."
        for line in grouped(outcome)
        if not line.code.startswith(READING) or line.code in ("markers.assigned", "markers.unknown", "markers.held")
    ]
    return [line[0].upper() + line[1:] for line in lines] + _cautions(outcome, tested)


def _cautions(outcome: Outcome, tested: dict[str, Wrenches]) -> list[str]:
    judge, lines = judges(outcome), []
    if not judge.heldout:
        lines.append("No trial was held out: nothing here tests the model on motion that it has not seen.")
    if outcome.fit.solution is not None and not outcome.fit.solution.converged:
        lines.append("The geometric fit stopped at its limit of iterations before it converged.")
    far = [(name, 1e3 * largest(item.tracked.error)) for name, item in outcome.followed.items()]
    far = [(name, most) for name, most in far if most > LARGE_MM]
    if far:
        worst = max(far, key=lambda entry: entry[1])
        lines.append(
            f"In {plural(len(far), 'trial')} a marker is at some time more than {LARGE_MM:.0f} mm from the model, "
            f"at most {worst[1]:.0f} mm in {clean(worst[0])}: look for swapped or displaced markers."
        )
    odd = odd_masses(outcome)
    if odd:
        lines.append(
            f"Masses more than {FAR_SD:.0f} prior standard deviations from the table, more likely errors of motion or "
            f"plates than the person: {listing(odd)}."
        )
    worse = improved(tested)[1] if outcome.identified is not None else []
    if worse:
        lines.append(
            f"Force residual higher than the scaled template's in {len(worse)} of {plural(len(tested), 'trial')}: "
            f"{listing(worse)}."
        )
    spare = _spare_rows(outcome)
    if spare:
        lines.append(spare)
    return lines


def _spare_rows(outcome: Outcome) -> str:
    """What the scatter of the rows says of the stated standard deviations; empty where they agree."""
    if outcome.identified is None:
        return ""
    fit, conflict = outcome.identified.fit, outcome.identified.fit.certificate.conflict
    left = outcome.identified.rows - fit.rank
    if left < FEWEST_ROWS:
        return (
            f"Standard deviations of masses cannot be tested: the forces give {outcome.identified.rows} independent "
            f"equations for {fit.rank} quantities. Record more motion on the plates."
        )
    factor = math.sqrt(conflict.chi_square / max(conflict.dof, 1))
    if conflict.p_value < CONFLICT and factor > 1.0:
        return (
            f"Data and tables differ {number(factor)} times as much as the deviations of both say where geometry is "
            f"taken for known (chi-square {number(conflict.chi_square, 0)} at {conflict.dof} degrees of freedom): the "
            "stated deviations may be too small."
        )
    return ""


def odd_masses(outcome: Outcome) -> list[str]:
    """Segments whose identified mass lies far from the table, with both masses, the farthest first."""
    if outcome.identified is None:
        return []
    fit, prior = outcome.identified.fit, outcome.prior
    sd = prior.covariance.diagonal().sqrt().reshape(-1, 10)[:, 0]
    away = ((fit.mass - prior.mean[:, 0]) / sd).abs()
    return [
        f"{segment(fit.names[k])} ({number(fit.mass[k], 2)} kg, table {number(prior.mean[k, 0], 2)} kg)"
        for k in away.argsort(descending=True).tolist()
        if float(away[k]) > FAR_SD
    ]
