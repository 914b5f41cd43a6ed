"""How the figures were made, in a paragraph each, with their sources."""

from torchid.evaluation.evaluation import Evaluation
from torchid.evaluation.ledger import Key, Ledger
from torchid.evaluation.torque_shares.draws import SAID
from torchid.report.blocks import Block, Items, Section
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


def method_section(found: Evaluation, ledger: Ledger) -> Section:
    """The chapter on method.

    Args:
        found: the evaluation.
        ledger: of its numbers.
    """
    levers = [ledger.show(Key("method", name, where="L5/S1"), 1, 100.0) for name in ("lever_low", "lever_high")]
    items = [
        "Human torque: inverse dynamics of the body and of the parts that it carries, minus the plates, minus the "
        f"device's generalised force. {BODIES[found.usual]}",
        f"Coordinates: {SIGNS[found.signs]}.",
        *(_test(ledger, one.condition, one.units.kind) for one in found.identified.comparisons),
        "p-values are adjusted by the step-down maximum over all measures (Westfall & Young 1993), and by the number "
        f"of conditions that are compared. Intervals are Welch's{_widened(found)}.",
        f"L5/S1: moment between pelvis and trunk in the pelvis' axes; compression of a single equivalent muscle "
        f"(Chaffin & Andersson) with a lever arm of {levers[0]} to {levers[1]} cm; limit of NIOSH "
        "(Waters et al. 1993).",
    ]
    blocks: tuple[Block, ...] = (Items(tuple(items)),)
    mass = "" if found.per_mass_kg is None else f"Torques are divided by {ledger.show(Key('method', 'mass'), 1)} kg. "
    return Section("method", "Method", f"{mass}Equations and limits: docs/evaluate.md of torchid.", blocks)


def _widened(found: Evaluation) -> str:
    """What intervals hold beside the scatter of trials."""
    if found.identified.rows.draws is None:
        return " between trials, of one body: none was drawn"
    return f", widened by what differs over bodies drawn, the same for all conditions; they differ in: {SAID}"


def _test(ledger: Ledger, condition: str, kind: str) -> str:
    count = [ledger.show(Key("test", name, condition), 0) for name in ("units_reference", "units")]
    least = ledger.show(Key("test", "least_p", condition), 4)
    what = "trials" if kind in ("trials", "none") else "blocks of cycles"
    return (
        f"{clean(condition)}: {count[0]} {what} of the reference against {count[1]} were exchanged; no p-value can be "
        f"below {least}."
    )
