"""What the model gets wrong: causes in plain words, what naming them changes, and their rivals."""

import math

import torch
from torch import Tensor

from torchid.diagnosis.diagnose import select_effects
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.evidence.laboratory import lasts
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.verdict.records import Cause, Diagnosis, Refuted
from torchid.effects.catalogue import effect
from torchid.report.before_after import Sides, draw_curves, draw_spectrum, sides, telling_trial, trial_rows
from torchid.report.blocks import Block, Details, Figure, Items, Paragraph, Section, Table
from torchid.report.cause_sentences import called, name, noun, of_markers, place, surely, told
from torchid.report.decisions import why
from torchid.report.detectable_table import detectable_table, would_show
from torchid.report.marker_distances import draw_markers, marker_error
from torchid.report.rival_bars import rival_bars
from torchid.report.witness_table import witness_table
from torchid.session import Outcome
from torchid.session.tables import heldout_errors
from torchid.wording import clean, listing, number, percent, plural, scientific

SAME = 0.005
"""Part of an error below which its change is none."""
ERRORS = (("force_rmse_N", "force error", "N", 1), ("moment_rmse_Nm", "moment error", "N m", 2),
          ("marker_rmse_mm", "marker error", "mm", 2))  # fmt: skip


def diagnosis_section(outcome: Outcome) -> Section | None:
    """None where no diagnosis was asked for."""
    found = outcome.diagnosis
    if found is None:
        return None
    blocks: list[Block] = []
    if found.causes:
        blocks += _listed(found)
        blocks += witness_table(found.causes)
        blocks += _changes(outcome, found)
        blocks += rival_bars(found)
        blocks.append(Details("All parameters of the causes", (_parameters(found),)))
    blocks.append(Paragraph(_unexplained(found.unexplained, outcome.config.diagnosis.thresholds)))
    blocks += why(found.trace)
    if outcome.base is not None:
        blocks.append(Paragraph(EXTENDED))
    if found.not_testable:
        blocks.append(Paragraph("What these recordings cannot test:"))
        blocks.append(Items(tuple(f"{noun(n)}: {clean(why)}" for n, why in found.not_testable.items())))
    blocks += detectable_table(found.detectable)
    return Section("diagnosis", "What the model gets wrong", _finding(outcome, found), tuple(blocks))


def _listed(found: Diagnosis) -> list[Block]:
    """How sure each cause is, those that are only possible apart."""
    named = Items(tuple(f"{name(cause)}: {surely(cause)}" for cause in found.likely))
    possible = tuple(map(_would_be, found.possible))
    summary = f"Possible: {plural(len(possible), 'cause')}"
    apart = [Details(summary, (Paragraph(POSSIBLE), Items(possible)))] if possible else []
    return [*([named] if named.items else []), *apart]


def _would_be(cause: Cause) -> str:
    """What a cause would be, and how little sure that is."""
    what, sure = told(cause), surely(cause)
    return f"{name(cause)}: it would be that {what[0].lower()}{what[1:]} {sure[0].upper()}{sure[1:]}"


POSSIBLE = "Possible (at most 50 %, nothing is corrected): rivals share the odds, or a test contradicts it."
UNAPPLIED = "It is not corrected: the model that is fitted again with it predicts worse."
UNAPPLIED_SEVERAL = "These are not corrected: the model that is fitted again with them predicts worse."
UNLIKE = "This session is unlike the earlier ones of its laboratory ({}): it was judged without them."
ALIKE = "The laboratory's earlier sessions were asked, too."
EXTENDED = (
    "Every other figure of this page is of the extended model. The likely causes, but for those that are said not to "
    "be corrected, are taken out of the recordings, or, as a load, kept apart from the body. Then inertia is fitted "
    "again, and geometry where markers are concerned. Measured forces drawn elsewhere are the corrected ones. The "
    "values before stand under “base” in inertia.json and geometry.json, both predictions in the forces files."
)


def _finding(outcome: Outcome, found: Diagnosis) -> str:
    options, named = outcome.config.diagnosis, found.likely
    if named:
        first, last = ([told(cause) for cause in named if cause.applied is on] for on in (True, False))
        apart = [*last, UNAPPLIED if len(last) == 1 else UNAPPLIED_SEVERAL] if last else []
        return " ".join([*first, *_gains(outcome, found), *apart, *_refuted(found), *_earlier(found)])
    tried = len(select_effects(options.include, options.exclude))
    if found.causes:
        silent = f"No likely fault ({tried} kinds tested); possible ones are listed below: nothing was corrected."
        return " ".join([silent, *would_show(found.detectable), *_refuted(found), *_earlier(found)])
    silent = f"No fault found ({tried} kinds tested): nothing was corrected."
    near = _nearest(found, options.thresholds.naming.named_nats)
    return " ".join([silent, *would_show(found.detectable), *_refuted(found), *near, *_earlier(found)])


def _earlier(found: Diagnosis) -> list[str]:
    """What the laboratory's earlier sessions have to do with it."""
    if found.earlier is None:
        return []
    if found.earlier.unlike is not None:
        return [UNLIKE.format(called(found.earlier.unlike))]
    lasting = [cause for cause in found.likely if lasts(effect(cause.effect))]
    shared = [cause for cause in lasting if (cause.effect, cause.where) not in found.earlier.alone]
    said = "The laboratory's earlier sessions tell {}; this one alone would not."
    return [said.format(listing([called(one) for one in shared]))] if shared else [ALIKE]


def _refuted(found: Diagnosis) -> list[str]:
    """What was not believed."""
    said = "Fit trials suggest {}, but {}: not corrected."
    return [said.format(called(one), _against(one)) for one in found.refuted]


def _against(one: Refuted) -> str:
    """What held-out motion says."""
    return f"held-out motion is {_times(-one.heldout_log_likelihood)} likelier without it"


def _times(nats: float) -> str:
    """Of a likelihood ratio, as one reads it."""
    return f"{number(math.exp(nats), 0)} times" if nats < math.log(1e6) else "more than a million times"


def _nearest(found: Diagnosis, named_nats: float) -> list[str]:
    """Of a diagnosis that names nothing, what is likelier than nothing."""
    said = "The nearest is {} (odds {} : 1, required {} : 1)."
    bar = number(math.exp(named_nats), 0)
    return [
        said.format(called(near), number(math.exp(near.evidence_nats), 1), bar)
        for near in found.nearest[:1]
        if near.evidence_nats > 0.0
    ]


def _gains(outcome: Outcome, found: Diagnosis) -> list[str]:
    """What the extension gains on held-out trials, and in the trials to which a cause is confined."""
    if outcome.base is None:
        return []
    before, after = heldout_errors(outcome.base), heldout_errors(outcome)
    said = [gained(before, after, "held-out")]
    applied = [cause for cause in found.causes if cause.applied]
    confined = sorted({trial for cause in applied if not cause.everywhere for trial in cause.trials})
    marked = [cause for cause in applied if of_markers(cause) and not cause.everywhere]
    if marked:
        labels = tuple(dict.fromkeys(label for cause in marked for label in cause.where))
        trials = sorted({trial for cause in marked for trial in cause.trials})
        moved = {t: [marker_error(o, t, labels) for o in (outcome.base, outcome)] for t in trials}
        where = listing([f"{_between(a, b, 'mm', 2)} in {clean(t)}" for t, (a, b) in moved.items()], 4)
        said.append(f"The distance of {listing(list(labels))} from the model goes {where}.")
    elif confined:
        said.append(f"Causes that act in {listing(confined)} alone are judged by the residuals there, see the table.")
    return said


def gained(before: dict[str, float], after: dict[str, float], kind: str, what: str = "that") -> str:
    """Errors that change as ``what`` is corrected, in one sentence; where none does, the force's."""
    known = [e for e in ERRORS if math.isfinite(before[e[0]]) and math.isfinite(after[e[0]])]
    if not known:
        return f"No {kind} trial with forces tells what correcting {what} gains."
    moved = [e for e in known if abs(after[e[0]] - before[e[0]]) > SAME * before[e[0]]]
    if not moved:
        key, words, unit, digits = known[0]
        return f"With {what} corrected, the {kind} {words} stays at {number(after[key], digits)} {unit}."
    parts = []
    for key, words, unit, digits in moved:
        verb = "falls" if after[key] < before[key] else "rises"
        parts.append(f"the {kind} {words} {verb} {_between(before[key], after[key], unit, digits)}")
    return f"With {what} corrected, {listing(parts)}."


def _between(before: float, after: float, unit: str, digits: int) -> str:
    return f"from {number(before, digits)} to {number(after, digits)} {unit}"


def _changes(outcome: Outcome, found: Diagnosis) -> list[Block]:
    """Curves, bands and trials before and after."""
    trials = sides(outcome)
    if not trials:
        return []
    blocks: list[Block] = []
    if outcome.base is not None and outcome.base.fit is not outcome.fit:
        blocks.append(
            Figure(
                draw_markers(outcome),
                "Distance from the model of the marker that changes most, in held-out and in fit trials.",
            )
        )
    side = telling_trial(outcome, trials)
    if side is not None:
        blocks += _forces(outcome, trials, side)
    return [*blocks, _trial_table(outcome, found, trials)]


def _forces(outcome: Outcome, trials: dict[str, Sides], side: Sides) -> list[Block]:
    """Curves and bands of forces."""
    role = outcome.session.trials[side.name].role.replace("heldout", "held-out")
    unseen = [trials[n] for n in outcome.session.part("heldout", "inertia") if n in trials]
    judged = unseen if any(side is one for one in unseen) else [side]
    return [
        Figure(
            draw_curves(side),
            f"The {role} trial {clean(side.name)}, where the causes change the residual most, and the two "
            "components that they change most. Above, where plates bear all contact: measured, and predicted by the "
            "model without (base) and with them (extended); below: what is left.",
        ),
        Figure(
            draw_spectrum(judged),
            f"Residual by frequency, {'held-out trials' if judged is unseen else f'trial {clean(side.name)}'}; the "
            "squares of the bars add up to the square of the whole residual.",
        ),
    ]


def _trial_table(outcome: Outcome, found: Diagnosis, trials: dict[str, Sides]) -> Table:
    assert outcome.base is not None
    markers = outcome.base.fit is not outcome.fit
    named = tuple(dict.fromkeys(n for c in found.causes if c.applied and of_markers(c) for n in c.where))
    head = ["Trial", "Role"]
    kinds = ["Force [N]", "Moment [N\N{NO-BREAK SPACE}m]", *(["Markers [mm]"] if markers else [])]
    kinds += [f"{listing(list(named), 2)} [mm]"] if markers and named else []
    for kind in kinds:
        head += [f"{kind}, base", "extended"]
    caption = "Residuals of each trial before and after, RMS; moments about the pelvis' origin"
    return Table(caption, tuple(head), trial_rows(outcome, trials, markers, named), text=2)


def _unexplained(left: Adequacy, options: DiagnosisOptions) -> str:
    """What remains, in a sentence."""
    if not math.isfinite(left.share_of_residual):
        return f"Whether anything remains unexplained {clean(left.description, 400)}."
    if left.significant:
        said = clean(left.description, 400)
        return f"The residual exceeds the noise, and no known effect explains it: {said} (p {_p(left.p_value)})."
    least = f"at most {percent(left.share_of_residual)} of a band of the residual exceeds it"
    if left.p_value < options.adequacy.p_value:
        return f"The residual slightly exceeds the noise of plates and markers: {least} (p {_p(left.p_value)})."
    return f"The residual agrees with the noise of plates and markers: {least}, too little to matter."


def _p(value: float) -> str:
    return "< 0.001" if value < 1e-3 else f"= {scientific(value)}"


def _parameters(found: Diagnosis) -> Table:
    rows = tuple(
        (noun(cause.effect), place(cause), key, _valued(entry))
        for cause in found.causes
        for key, entry in (cause.parameters or {"present": {}}).items()
    )
    head = ("Cause", "Where", "Parameter, as in diagnosis.json", "Value ± standard deviation")
    return Table("Parameters of the causes", head, rows, text=4, wrap=True)


def _valued(entry: dict[str, Tensor]) -> str:
    if not entry:
        return "yes"
    value, sd = (torch.as_tensor(entry[k], dtype=torch.float64).reshape(-1) for k in ("value", "sd"))
    if len(value) > 6:
        return f"{len(value)} values, largest {_figure(float(value.abs().max()))}"
    return ", ".join(
        f"{_figure(float(v))} ± {_figure(float(s))}" for v, s in zip(value, sd.expand_as(value), strict=True)
    )


def _figure(value: float) -> str:
    return f"{value:.3g}".replace("-", "\N{MINUS SIGN}")
