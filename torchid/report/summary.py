"""Who was measured, what came out, and what a reader must know before believing it."""

import math

from torchid.diagnosis.verdict.records import Diagnosis
from torchid.errors import DataError
from torchid.report.blocks import Block, Items, Paragraph, Section, Table
from torchid.report.cause_sentences import likely, told
from torchid.report.data_handling import grouped
from torchid.report.effect_words import called
from torchid.report.facts import Wrenches, body_weight, force_rms, improved, judges, marker_rms, some, used_frames
from torchid.session import Outcome
from torchid.session.tables import largest
from torchid.wording import ABSENT, better, change, clean, listing, number, percent, plural, segment, spread

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
LARGE_MM = 80.0
"""A marker this far from the model was probably swapped or mislabelled [mm]."""


def head_section(outcome: Outcome, forces: dict[str, Wrenches], failure: DataError | None) -> Section:
    """The head of the page."""
    tested = some(forces, judges(outcome, "inertia").names)
    blocks: list[Block] = [_subject(outcome), Table(
        "How well the model predicts what it has not seen" if judges(outcome).heldout
        else "How well the model fits (no trial was held out: these figures are no test)",
        ("", "Scaled template, tabulated inertia", "Identified geometry, tabulated inertia", "Identified", "Change"),
        verdict_rows(outcome, tested),
    )]  # fmt: skip
    blocks = [*([] if failure else _named(outcome.diagnosis)), *blocks]
    warnings = tuple(warning_lines(outcome, tested))
    if warnings:
        blocks += [Paragraph("Worth knowing before using these results:"), Items(warnings)]
    blocks.append(_trials(outcome))
    return Section("summary", "Summary", _finding(outcome, tested, failure), tuple(blocks))


def _named(found: Diagnosis | None) -> list[Block]:
    """What the diagnosis says, in a sentence or two; its section has the rest."""
    if found is None:
        return []
    sure = found.likely
    more, possible = max(len(sure) - 1, 0), len(found.possible)
    if sure:
        twins = " or ".join(map(called, sure[0].indistinguishable))
        apart = f"; it may as well be {twins}, which the recordings do not tell apart" if twins else ""
        said = [told(sure[0]), f"That is {likely(sure[0])}{apart}."]
    elif found.causes or found.refuted:
        said = ["Nothing that the catalogue knows is shown to be wrong with the recordings."]
    else:
        said = ["Nothing that the catalogue knows was found wrong with the recordings."]
    others = [plural(count, f"{kind} cause") for count, kind in ((more, "more"), (possible, "possible")) if count]
    if others:
        said.append(f"{listing(others)} and all rivals: see “What the model gets wrong”.")
    if found.unexplained.significant:
        said.append("More remains in the forces than noise makes, and no named cause explains it.")
    return [Paragraph(" ".join(said))]


def _finding(outcome: Outcome, tested: dict[str, Wrenches], failure: DataError | None) -> str:
    if failure is not None and failure.code.startswith("result."):
        return f"No body could give this result, so do not use it: {failure.message} ({failure.found})."
    judge = judges(outcome)
    identified, scaled = marker_rms(outcome, judge.names)
    said = (
        f"On the {judge.words} the identified model follows the markers to {number(identified)} mm RMS, "
        f"{better(scaled, identified)} the scaled template's {number(scaled)} mm"
    )
    if outcome.identified is None:
        why = "the inertial fit was not possible" if failure else "no inertia was identified"
        return f"{said}; {why}, so masses and moments below rest on anthropometric tables."
    if not tested:
        return f"{said}; none of these trials has forces, so the identified inertia is untested."
    (force, moment), (force_0, moment_0) = (force_rms(tested, which) for which in ("identified", "prior"))
    return (
        f"{said}; its residual force is {number(force)} N ({percent(force / body_weight(outcome), 1)} of body weight), "
        f"{better(force_0, force)} the {number(force_0)} N of tabulated inertia, and its residual moment "
        f"{number(moment)} N m, {better(moment_0, moment)} {number(moment_0)} N m."
    )


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
    recorded = spread(who.mass_kg, who.mass_sd_kg) if who.mass_sd_kg else number(who.mass_kg)
    rows = [
        ("Subject", clean(who.name)),
        ("Mass", f"{recorded} kg recorded" if who.mass_kg else "not recorded"),
        ("Height, sex", f"{f'{number(who.height_m, 2)} m' if who.height_m else 'not recorded'}, {who.sex}"),
        ("Model", f"{clean(str(outcome.config.model))}: {len(fit.model.tree.bodies)} segments, "
                  f"{len(fit.model.tree.dofs)} coordinates, {len(fit.attachment.labels)} markers"),
    ]  # fmt: skip
    if outcome.identified is not None:
        found = outcome.identified.fit
        text = f"{spread(found.mass.sum(), found.sd.total_mass, 2)} kg"
        if who.mass_kg:
            text += f" ({change(who.mass_kg, float(found.mass.sum()))} against the recorded mass)"
        rows.insert(2, ("Mass found", text))
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
    if outcome.identified is not None and tested:
        (force, _), (prior, _) = (force_rms(tested, which) for which in ("identified", "prior"))
        if force > 1.02 * prior:
            lines.append(
                f"The identified inertia predicts the force of the {judge.words} worse than tabulated inertia "
                f"({number(force)} N against {number(prior)} N): worse in {listing(improved(tested)[1])}, better in "
                f"{listing(improved(tested)[0])}."
            )
    return lines


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
