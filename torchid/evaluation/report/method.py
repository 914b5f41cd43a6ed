"""How the figures were made, in a few sentences each, with their sources."""

from collections.abc import Sequence

from torchid.evaluation.compared import Compared
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.statistics.comparing import Comparison
from torchid.report.blocks import Items, Section
from torchid.wording import clean

SIGNS = {
    "torchid": "flexion, adduction, internal rotation, dorsiflexion and inversion are positive (signs of ISB)",
    "isb": "names and signs of ISB: flexion, adduction, internal rotation, dorsiflexion and inversion are positive",
    "opensim": "names and signs of OpenSim (Rajagopal et al. 2016): lumbar extension is positive",
    "file_torchid": "names and signs of the model's own file",
    "file_opensim": "names and signs of the model's own file",
    "file_isb": "names and signs of ISB where the file's coordinate turns about the same axis, else the file's own",
}
"""By ``Evaluation.signs``."""
BODIES = {
    "scaled template": "The scaled template has tabulated inertia and lengths scaled to the markers.",
    "model as shipped": "The model as shipped has the joints and the inertia of its file, and the same markers placed "
    "on it anew.",
}
"""What is held beside the identified body, by ``Evaluation.usual``."""
ADJUSTED = (
    "p-values are adjusted by the step-down maximum over all measures and all courses (Westfall & Young 1993), and by "
    "the number of conditions that are compared."
)
HUMAN = (
    "Human torque: inverse dynamics of the identified body and of the parts that it carries, minus the plates, minus "
    "the device's generalised force."
)


def method_section(found: Compared, ledger: Ledger, intervals: str, more: Sequence[str] = ()) -> Section:
    """The chapter on method.

    Args:
        intervals: what they hold.
        more: items behind those that one subject and a study have alike.
    """
    paired = any(one.units.paired for one in found.comparisons)
    effect = (
        "Effect size: Hedges' g of paired differences, their mean over their standard deviation; interval of the "
        "non-central t distribution (Cumming & Finch 2001)."
        if paired else "Effect size: Hedges' g, the difference over the pooled standard deviation between units."
    )  # fmt: skip
    items = [
        f"{HUMAN}{' Every subject was evaluated alone, and is one unit here.' if paired else ''}",
        *(BODIES[one] for one in found.usual.split(" or ")),
        f"Coordinates: {SIGNS[found.signs]}.",
        *(_test(ledger, one) for one in found.comparisons),
        *([ADJUSTED] if any(one.testable for one in found.comparisons) else []),
        intervals, effect, *more,
    ]  # fmt: skip
    mass = Key("method", "mass")
    said = f"Torques are divided by {ledger.show(mass, 1)} kg. " if ledger.has(mass) else ""
    return Section(
        "method", "Method", f"{said}Equations and limits: docs/evaluate.md of torchid.", (Items(tuple(items)),)
    )


def _test(ledger: Ledger, one: Comparison) -> str:
    first, second = (ledger.show(Key("test", name, one.condition), 0) for name in ("units_reference", "units"))
    least = ledger.show(Key("test", "least_p", one.condition), 4)
    what = "blocks of cycles" if one.units.kind == "blocks" else one.units.kind
    done = (f"signs of {second} subjects' differences were flipped (Nichols & Holmes 2002)" if one.units.paired
            else f"{first} {what} of the reference against {second} were exchanged")  # fmt: skip
    return f"{clean(one.condition)}: {done}; no p-value can be below {least}."
