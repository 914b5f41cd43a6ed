"""Names of columns of forces as scripts write them: which plate, which quantity, which axis."""

import re
from dataclasses import dataclass

from torchid.errors import InputError

LETTERS = {"v": "force", "f": "force", "p": "point", "m": "moment", "t": "torque"}
"""What a letter before the axis means: ``vx``, ``px``, ``mx``."""
WORDS = {
    "torque": "torque", "moment": "moment", "grm": "moment", "cop": "point", "point": "point", "position": "point",
    "pos": "point", "pressure": "point", "force": "force", "grf": "force",
}  # fmt: skip
"""What a word of a name means, the first one found in this order: ``ground_force_1_px`` has its letter, and
``centre_of_pressure_of_force_x`` is a point."""
FILLER = frozenset(["ground", "reaction", "external", "centre", "center", "of", "free"])
"""Words that tell no plate from another."""
SIDES = {"right": "r", "left": "l"}
ENDING = re.compile(rf"(?P<side>[lr]?)(?P<kind>{'|'.join([*WORDS, *LETTERS])})(?P<axis>[xyz])|(?P<bare>[xyz])")
"""A token that holds the axis, with or without the quantity and a side before it."""
BREAKS = re.compile(r"[^A-Za-z0-9]+|(?<=[A-Za-z])(?=[0-9])|(?<=[0-9])(?=[A-Za-z])|(?<=[a-z])(?=[A-Z])")
JOINED = re.compile(r"(ground|force|torque|moment)", re.IGNORECASE)
"""Words that names join to others."""
OWN = re.compile(r"ground[_ .]?(force|torque|moment|reaction)", re.IGNORECASE)
"""No marker is named so."""


@dataclass(frozen=True)
class ForceColumn:
    """What the name of a column says."""

    plate: tuple[str, ...]
    """What remains of the name without quantity and axis, in lower case: what the columns of a plate share."""
    kind: str
    """force, point (centre of pressure), moment or torque; a torque beside a moment is the free one."""
    axis: str


def parse_column(name: str) -> ForceColumn | None:
    """Plate, quantity and axis of a column's name, None where it has no axis or no quantity.

    A name is cut into tokens at signs, digits and capitals. The last token that ends in an axis holds it, and the
    quantity where it is ``vx``, ``copx`` and the like; else a word or a single letter among the other tokens does
    (``FP1_moment_x``, ``f1_x``). Sides and numbers may stand anywhere.
    """
    tokens = [SIDES.get(token, token) for token in map(str.lower, BREAKS.split(JOINED.sub(r"_\1_", name))) if token]
    at = next((k for k in reversed(range(len(tokens))) if ENDING.fullmatch(tokens[k])), None)
    if at is None:
        return None
    found = ENDING.fullmatch(tokens[at])
    assert found
    rest = tokens[:at] + tokens[at + 1 :]
    kind, axis = found["kind"], found["axis"] or found["bare"]
    if not kind:
        kind = next((word for word in [*WORDS, *LETTERS] if word in rest), None)
    if kind is None:
        return None
    # With a word for the quantity, a single letter is the plate's own name.
    spent = {*WORDS, *FILLER} if kind in WORDS or found["kind"] else {*WORDS, *FILLER, kind}
    plate = ([found["side"]] if found["side"] else []) + [token for token in rest if token not in spent]
    return ForceColumn(tuple(plate), WORDS.get(kind) or LETTERS[kind], axis)


def force_columns(names: tuple[str, ...], source: str) -> dict[str, dict[str, dict[str, int]]]:
    """Columns of every plate with forces and centres of pressure: by the plate's name, the quantity and the axis.

    Forces (``force``) and centres of pressure (``point``) have all three axes; the free moment (``torque``) those that
    the file has. Columns of other things are ignored.

    Raises:
        InputError: ``mot.columns`` where a plate has forces without centres of pressure or with an axis missing, where
            two columns say the same, or where there is no plate at all.
    """
    found: dict[tuple[str, ...], dict[str, dict[str, list[int]]]] = {}
    for k, name in enumerate(names):
        column = parse_column(name)
        if column is not None:
            axes = found.setdefault(column.plate, {}).setdefault(column.kind, {})
            axes.setdefault(column.axis, []).append(k)
    plates = {}
    for key, kinds in found.items():
        if "force" not in kinds:
            continue
        if any(len(kinds.get(kind, {})) < 3 for kind in ("force", "point")):
            label = "_".join(key) or "the force"
            raise _refused(f"no complete columns of force (v) and centre of pressure (p) for {label}", names, source)
        kinds["torque"] = kinds.get("torque") or kinds.get("moment") or {}
        for kind in ("force", "point", "torque"):
            for axis, columns in kinds[kind].items():
                if len(columns) > 1:
                    same = tuple(names[k] for k in columns)
                    raise _refused(f"several columns hold {kind} {axis} of one plate", same, source)
        label = _plate_name(names[kinds["force"]["x"][0]], key)
        plates[label if label not in plates else names[kinds["force"]["x"][0]]] = {
            kind: {axis: columns[0] for axis, columns in kinds[kind].items()} for kind in ("force", "point", "torque")
        }
    if not plates:
        raise _refused("no complete columns of force (v) and centre of pressure (p)", names, source)
    return plates


def _plate_name(column: str, key: tuple[str, ...]) -> str:
    """The name of the column of force X up to its quantity, else what the plate's columns share."""
    return re.sub(r"[_ .]?[vf]?x$", "", column, flags=re.IGNORECASE) or "_".join(key) or "force"


def _refused(message: str, names: tuple[str, ...], source: str) -> InputError:
    return InputError(
        "mot.columns", message, source=source, place="column names", found=", ".join(names[:40]),
        remedy="Name them like ground_force_1_vx, ground_force_1_px, ground_force_1_mx (also y, z)",
    )  # fmt: skip


def refuse_forces(labels: list[str], source: str) -> None:
    """Refuse a marker file whose columns are ground reaction forces.

    They are where a label says ``ground_force`` or the like, or where the labels together hold force and centre of
    pressure of a plate on all three axes; a marker that is called PX, alone, is a marker.

    Raises:
        InputError: ``trc.forces``.
    """
    named = [label for label in labels if OWN.search(label)] or _force_table(labels)
    if named:
        raise InputError(
            "trc.forces", "these are forces, not markers", source=source, place="label line",
            found=", ".join(named[:12]), remedy="Name the file under forces: and give the marker file under file:",
        )  # fmt: skip


def _force_table(labels: list[str]) -> list[str]:
    """Labels that together make a table of forces."""
    columns = {label: parse_column(label) for label in labels}
    held: dict[tuple[str, ...], set[tuple[str, str]]] = {}
    for column in filter(None, columns.values()):
        held.setdefault(column.plate, set()).add((column.kind, column.axis))
    wanted = {(kind, axis) for kind in ("force", "point") for axis in "xyz"}
    full = {plate for plate, pairs in held.items() if wanted <= pairs}
    return [label for label, column in columns.items() if column and column.plate in full]
