"""What an evaluation cannot say, and why: read before believing that there is no difference."""

from collections.abc import Iterator

import torch

from torchid.conventions import GRAVITY
from torchid.cycles.measures import MEASURES
from torchid.devices import SheetFinding
from torchid.dynamics.rows import predict
from torchid.evaluation.compared import Gap
from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.torque_shares.draws import SAID
from torchid.evaluation.torque_shares.wearing import Worn, carried
from torchid.wording import listing, plural

WEIGHED_KG = 0.5
"""Choice. Mass that plates may bear beyond body and device: plates of one laboratory differ by 0.4 % of a person's
weight (``session.standing.PLATE_GAIN``), 0.3 kg."""


def find_gaps(found: Evaluation) -> tuple[Gap, ...]:
    """Everything that is not determinable.

    Args:
        found: the evaluation, without its gaps.
    """
    return (
        *_sheets(found),
        *_coordinates(found),
        *_tests(found),
        *_torques(found),
        *_device(found),
        *_body(found),
        *_back(found),
    )


def contradicted(finding: SheetFinding) -> str:
    """What sheet and recordings say of one thing, in words.

    Args:
        finding: with what was found.
    """
    sheet, own = (x if isinstance(x, str) else f"{x:.4g}" for x in (finding.sheet, finding.found))
    doubt = f" (sd {finding.sd:.2g})" if finding.sd > 0.0 else ""
    rivals = f", or else {finding.why}" if finding.kind == "carried_elsewhere" and finding.why else ""
    return f"the sheet says {sheet}, the recordings {own}{doubt}{rivals}"


def _sheets(found: Evaluation) -> Iterator[Gap]:
    """Faults of devices: what their sheets say, and recordings contradict."""
    for condition, worn in found.worn.items():
        for finding in worn.findings:
            if finding.wrong and finding.kind == "unexplained":
                yield Gap(
                    f"{finding.found:.0%} of what {finding.where} of the device of {condition} does",
                    f"its law, with numbers fitted anew, leaves so much of what its sensor read: {finding.why}. Its "
                    "share is what the sensor read all the same",
                )
            elif finding.wrong:
                yield Gap(
                    f"{finding.kind.replace('_', ' ')}: {finding.where} of the device of {condition}",
                    f"{contradicted(finding)}. {_used(finding, worn)}",
                )


def _used(finding: SheetFinding, worn: Worn) -> str:
    """What shares are computed with in spite of a finding, and what a user can do about it."""
    if finding.kind == "carried_elsewhere":
        return (
            f"Shares are computed with the part on {finding.sheet}; if it was worn elsewhere, write that segment and "
            "the centre of mass in its axes into the sheet (`unknown` finds no place), and evaluate again"
        )
    if finding.kind == "strap_slides":
        return (
            "Its share is what its sensor read, along the line that the sheet says. If the strap slid, give that trial "
            "a condition with a sheet of its own; if markers were knocked, leave the trial out"
        )
    if any(finding.where.startswith(f"{name}.") for name in worn.read):
        return (
            "Its share is what its sensor read, and the number is used in frames without a reading alone: correct it, "
            "or write `unknown`"
        )
    return (
        "Shares are computed with the sheet's number, as closely as its standard deviation holds it; `unknown` in its "
        "place has it identified from the recordings alone"
    )


def _coordinates(found: Evaluation) -> Iterator[Gap]:
    for name in found.layout.missing:
        yield Gap(name, "the model has no such coordinate")


def _tests(found: Evaluation) -> Iterator[Gap]:
    for one in found.comparisons:
        yield from untested(one)
        if one.testable and one.units.granted:
            yield Gap(f"what trials of {one.condition} against {one.reference} have in common", one.units.granted)


def untested(one: Comparison) -> Iterator[Gap]:
    """A comparison in which no finding is possible, and what it needs."""
    if not one.testable:
        yield Gap(f"whether {one.condition} against {one.reference} differs", one.needed.said)


def _torques(found: Evaluation) -> Iterator[Gap]:
    """Coordinates whose torque is not known in some cycles of a condition."""
    sample, layout = found.identified.sample, found.layout
    torque = [
        k for k, column in enumerate(sample.columns) if column.measure in MEASURES and column.measure != "range_deg"
    ]
    for condition in found.config.conditions:
        lost: dict[tuple[int, int], list[str]] = {}
        for name, side in zip(layout.names, layout.sides, strict=True):
            own = [k for k, c in enumerate(found.cycles) if found.conditions[k] == condition
                   and (not side or not c.side or side == c.side)]  # fmt: skip
            columns = [k for k in torque if sample.columns[k].where == name][:1]
            if columns:
                unknown = int(torch.isnan(sample.values[own][:, columns]).all(1).sum())
                lost.setdefault((unknown, len(own)), []).append(name)
        for (unknown, every), names in lost.items():
            if not every:
                yield Gap(f"{listing(names)} in {condition}", "no cycle of that foot was found")
            elif unknown:
                yield Gap(
                    f"torque of {listing(names)} in {unknown} of {plural(every, 'cycle')} of {condition}",
                    "the force of a contact that they answer for is not known throughout: a foot stood beside the "
                    "plates, or on one that does not tell" + _declared(found),
                )


def _declared(found: Evaluation) -> str:
    """Contacts of the config that no plate may have measured either."""
    others = found.config.contact.others
    return f"; or no plate measured {listing(list(others))}" if others else ""


def _device(found: Evaluation) -> Iterator[Gap]:
    for condition, worn in found.worn.items():
        lacking = unweighed(found, condition)
        if worn.device is not None and abs(lacking) > WEIGHED_KG:
            yield Gap(
                f"what the device of {condition} weighs, and with it its share",
                f"plates bear {lacking:+.1f} kg beyond body and device on average: its masses are not the sheet's or "
                "were identified wrongly, or something else was carried or held",
            )
        for element in worn.left_out:
            yield Gap(
                f"what {element} of the device of {condition} does",
                "a number of it is unknown, and no sensor tells something in every trial and reads in all of its "
                "frames: its share is counted as the human's",
            )
        for name, parameter in worn.parameters.items():
            if "why" in parameter:
                yield Gap(f"{name} of the device of {condition}", str(parameter["why"]))


def unweighed(found: Evaluation, condition: str) -> float:
    """Mean vertical force of a condition's plates beyond what body and device need, as a mass [kg]; 0: no plates."""
    tree, phi, worn = found.outcome.fit.model.tree, found.outcome.phi, found.worn[condition]
    rows = [t.followed.wrench for t in found.trials if t.condition == condition]
    left = [(r.wrench - predict(r, carried(worn, tree, phi)))[r.used, 2] for r in rows if r is not None]
    return float(torch.cat(left).mean()) / GRAVITY if left and sum(map(len, left)) else 0.0


def _body(found: Evaluation) -> Iterator[Gap]:
    if not found.config.evaluate.draws:
        yield Gap(
            "bands from the body", "no draws were asked for: intervals hold what trials scatter, and nothing else"
        )
    elif found.identified.rows.draws is None:
        yield Gap("bands from the body", "no inertia was identified, so its uncertainty is unknown")
    else:
        yield Gap("errors that are in no band", f"bands draw {SAID}; what else is wrong with the model is not in them")
    if found.outcome.base is not None and any(condition.device for condition in found.config.conditions.values()):
        yield Gap(
            "faults of the recordings with a device",
            "what the diagnosis has named was taken out of the trials that the body was identified on, not of these",
        )


def _back(found: Evaluation) -> Iterator[Gap]:
    if not found.layout.back:
        yield Gap("L5/S1", "the model has no joint of three turns between pelvis and trunk")
    else:
        yield Gap(
            "loads in the hands that the config does not declare, and a device's own pull along the spine, at L5/S1",
            "moment and compression follow from the motion of trunk, head and arms, from the forces of declared "
            "contacts and from the device's torque alone",
        )
