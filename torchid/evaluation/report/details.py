"""What stands behind the first page of one subject: values, devices, corrections, contacts, cycles and gaps."""

import math
from collections.abc import Sequence

from torchid.devices import SheetFinding
from torchid.evaluation.cycle_measures.cycles import APART
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.gaps import contradicted
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.numbers import cycle_names
from torchid.evaluation.report.sentences import gap_lines, interval
from torchid.evaluation.report.words import digits_of, labelled, where_words
from torchid.report.blocks import Block, Details, Items, Paragraph, Section, Table
from torchid.report.cause_sentences import chance
from torchid.wording import clean, segment


def values_section(found: Evaluation, ledger: Ledger) -> Section:
    """Means of all conditions with both bodies."""
    tables: list[Block] = []
    for name in found.config.conditions:
        rows = []
        for column in found.layout.columns:
            key = Key("measure", "value", name, column.where, column.measure)
            if not math.isfinite(ledger.value(key)):
                continue
            digits = digits_of(column.measure, found.per_mass)
            rows.append((
                labelled(column, found.per_mass), ledger.show(key, digits), interval(ledger, key, digits),
                ledger.show(key._replace(statistic="cycles"), 0),
                ledger.show(key._replace(body="template"), digits),
            ))  # fmt: skip
        head = ("Measure", "Mean", "Interval", "Cycles", found.usual.capitalize())
        tables.append(Table(clean(name), head, tuple(rows)))
    said = "Means over trials; torques, powers and works are the human's share."
    return Section("values", "Values of every condition", said, tuple(tables))


def device_section(found: Evaluation, ledger: Ledger) -> Section | None:
    """What the devices do; None where none was worn."""
    blocks: list[Block] = []
    for condition, worn in found.worn.items():
        if worn.device is None:
            continue
        rows = []
        for name in found.layout.names:
            peak = Key("device", "peak", condition, name, "torque_Nm")
            load = Key("device", "load_taken", condition, name, "cumulative_load_Nms")
            rows.append((where_words(name), ledger.show(peak, 1), ledger.show(load, 2)))
        per = "/kg" if found.per_mass else ""
        head = ("Coordinate", f"Device's peak torque [N m{per}]", f"Load taken [N m s{per}]")
        blocks.append(Table(f"{clean(condition)}: {clean(worn.device.name)}", head, tuple(rows)))
        blocks += [*_parameters(ledger, condition, worn.parameters), *_sheet(ledger, worn.findings)]
        blocks += [Paragraph(ledger.say("device", clean(source, 300))) for source in worn.device.sources]
    if not blocks:
        return None
    said = "Load taken is the cumulative load of human and device together minus the human's, per cycle."
    return Section("device", "What the device does", said, tuple(blocks))


def _parameters(ledger: Ledger, condition: str, parameters: dict[str, dict]) -> list[Block]:
    rows = []
    for name, one in parameters.items():
        if "value" in one and ".com_" not in name:
            rows.append(
                (name, *(ledger.show(Key("device", part, condition, item=name), 3) for part in ("value", "sd")))
            )
    return [Table("Found of what its sheet leaves open", ("Parameter", "Value", "sd"), tuple(rows))] if rows else []


def _sheet(ledger: Ledger, findings: Sequence[SheetFinding]) -> list[Block]:
    """What the recordings say against the device's sheet, and what they cannot say of it."""
    said = []
    for one in findings:
        kind = one.kind.replace("_", " ")
        if one.found is None:
            said.append(f"{kind} of {one.where}: cannot be tested, {one.why}.")
        elif one.wrong:
            said.append(f"{kind} of {one.where}: {contradicted(one)}.")
    lines = tuple(ledger.say("device", clean(text, 400)) for text in said)
    return [Paragraph("The sheet against the recordings:"), Items(lines)] if lines else []


def reach_section(found: Evaluation, ledger: Ledger) -> Section:
    """Cycles, contacts, and everything that cannot be said."""
    blocks = (
        Items(gap_lines(ledger, found.gaps)),
        *_corrections(found, ledger),
        _contacts(found, ledger),
        *_apart(found, ledger),
        _cycles(found, ledger),
    )
    return Section("reach", "What cannot be said, and what it rests on",
                   "Nothing was left out for how it looks.", blocks)  # fmt: skip


def _corrections(found: Evaluation, ledger: Ledger) -> list[Block]:
    """Faults that the diagnosis took out of body and recordings before anything was compared."""
    if not found.corrections:
        return []
    said = "Corrections that the diagnosis made to the body and to the trials without a device:"
    lines = (f"{one.what} Probability {chance(one.confidence)}." for one in found.corrections)
    return [Paragraph(said), Items(tuple(ledger.say("correction", clean(text, 600)) for text in lines))]


def _contacts(found: Evaluation, ledger: Ledger) -> Block:
    rows = []
    for one in found.contacts:
        shares = [ledger.show(Key("contact", n, one.condition, item=one.foot), 0, 100.0)
                  for n in ("measured", "shared", "beside")]  # fmt: skip
        rows.append((clean(one.condition), segment(one.foot), *shares))
    head = ("Condition", "Foot", "On its own plate [%]", "On a shared plate [%]", "Beside the plates [%]")
    return Table("Where the forces of the feet come from, parts of their contact", head, tuple(rows), text=2)


def _apart(found: Evaluation, ledger: Ledger) -> list[Block]:
    score = ledger.show(Key("method", "apart"), 1)
    names = [name for name, z in zip(cycle_names(found), found.apart.tolist(), strict=True) if z > APART]
    if not names:
        return []
    said = f"Cycles that stand apart from the others of their condition (modified z above {score}), and are in all "
    return [Paragraph(f"{said}figures: {', '.join(clean(name) for name in names)}.")]


def _cycles(found: Evaluation, ledger: Ledger) -> Block:
    rows = []
    for k, name in enumerate(cycle_names(found)):
        key = Key("cycle", "", found.conditions[k], item=name)
        ends = [ledger.show(key._replace(statistic=end), 2) for end in ("t0", "t1")]
        score = ledger.show(key._replace(statistic="score"), 1)
        rows.append((clean(name), clean(found.conditions[k]), *ends, score))
    head = ("Cycle", "Condition", "From [s]", "To [s]", "Apart (z)")
    return Details("All cycles", (Table("", head, tuple(rows), text=2),))
