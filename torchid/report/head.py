"""Who was measured, what came out, and what a reader must know before believing it."""

from torchid.errors import DataError
from torchid.experiment.outcome import Outcome
from torchid.experiment.stages import residual_rms
from torchid.report.blocks import Block, Items, Paragraph, Section, Table
from torchid.report.facts import body_weight, force_rms, judges, marker_rms, used_frames, with_forces
from torchid.report.handling import grouped
from torchid.report.text import ABSENT, better, change, clean, number, percent, plural, spread

READING = ("axes.", "units.", "markers.", "trc.", "storage.", "mot.", "text.", "time.", "events.", "trial.frames", "model.")
"""Notes about files that were read as they should be; the section on data handling has them all."""
LARGE_MM = 80.0
"""A marker this far from the model was probably swapped or mislabelled [mm]."""


def head_section(outcome: Outcome, failure: DataError | None) -> Section:
    """The head of the page."""
    blocks: list[Block] = [_subject(outcome), Table(
        "How well the model predicts what it has not seen" if judges(outcome).heldout
        else "How well the model fits (no trial was held out: these figures are no test)",
        ("", "Scaled template, prior inertia", "Identified geometry, prior inertia", "Identified", "Change by the whole"),
        verdict_rows(outcome),
    )]  # fmt: skip
    warnings = tuple(warning_lines(outcome))
    if warnings:
        blocks += [Paragraph("Worth knowing before using these results:"), Items(warnings)]
    blocks.append(_trials(outcome))
    return Section("summary", "Summary", _finding(outcome, failure), tuple(blocks))


def _finding(outcome: Outcome, failure: DataError | None) -> str:
    judge = judges(outcome)
    identified, scaled = marker_rms(outcome, judge.names)
    said = (
        f"On the {judge.words} the identified model follows the markers to {number(identified)} mm RMS, "
        f"{better(scaled, identified)} the scaled template's {number(scaled)} mm"
    )
    if outcome.identified is None:
        why = "the inertial fit was not possible" if failure else "no inertia was identified"
        return f"{said}; {why}, so masses and moments below rest on anthropometric tables."
    if not with_forces(outcome, judge.names):
        return f"{said}; none of these trials has forces, so the identified inertia is untested."
    (force, moment), (force_0, moment_0) = (force_rms(outcome, judge.names, which) for which in (True, False))
    return (
        f"{said}; its residual force is {number(force)} N ({percent(force / body_weight(outcome), 1)} of body weight), "
        f"{better(force_0, force)} the {number(force_0)} N of tabulated inertia, and its residual moment "
        f"{number(moment)} N m, {better(moment_0, moment)} {number(moment_0)} N m."
    )


def verdict_rows(outcome: Outcome) -> tuple[tuple[str, ...], ...]:
    """Markers, force and moment on the judging trials: scaled, identified geometry, all identified, change."""
    judge, weight = judges(outcome), body_weight(outcome)
    identified, scaled = marker_rms(outcome, judge.names)
    rows = [("Markers, RMS [mm]", number(scaled), number(identified), number(identified), change(scaled, identified))]
    if with_forces(outcome, judge.names):
        trials = [outcome.followed_scaled[name].wrench for name in with_forces(outcome, judge.names)]
        start = residual_rms([t for t in trials if t is not None], outcome.prior_scaled.mean)
        middle = force_rms(outcome, judge.names, False)
        end = force_rms(outcome, judge.names, True) if outcome.identified is not None else (float("nan"),) * 2
        force = [f"{number(x[0])} ({percent(x[0] / weight, 1)})" if x[0] == x[0] else ABSENT for x in (start, middle, end)]
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
    return Table("", ("", ""), tuple(rows), text=2)


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


def warning_lines(outcome: Outcome) -> list[str]:
    """Notes that bear on the results, and what the numbers themselves give cause for."""
    lines = [
        f"{line.message}{f' ({line.where})' if line.where else ''}."
        for line in grouped(outcome)
        if not line.code.startswith(READING) or line.code in ("markers.assigned", "markers.unknown", "markers.held")
    ]
    return [line[0].upper() + line[1:] for line in lines] + _cautions(outcome)


def _cautions(outcome: Outcome) -> list[str]:
    judge, lines = judges(outcome), []
    if not judge.heldout:
        lines.append("No trial was held out: nothing here tests the model on motion that it has not seen.")
    if outcome.fit.solution is not None and not outcome.fit.solution.converged:
        lines.append("The geometric fit stopped at its limit of iterations before it converged.")
    far = [(name, 1e3 * float(item.tracked.error.nan_to_num(0.0).max())) for name, item in outcome.followed.items()]
    far = [(name, most) for name, most in far if most > LARGE_MM]
    if far:
        worst = max(far, key=lambda entry: entry[1])
        lines.append(
            f"In {plural(len(far), 'trial')} a marker is at some time more than {LARGE_MM:.0f} mm from the model, at most "
            f"{worst[1]:.0f} mm in {clean(worst[0])}: look for swapped or displaced markers."
        )
    if outcome.identified is not None and with_forces(outcome, judge.names):
        (force, _), (prior, _) = (force_rms(outcome, judge.names, which) for which in (True, False))
        if force > 1.02 * prior:
            lines.append(
                f"The identified inertia predicts the force of the {judge.words} worse than tabulated inertia "
                f"({number(force)} N against {number(prior)} N): see which trials under Forces."
            )
    return lines
