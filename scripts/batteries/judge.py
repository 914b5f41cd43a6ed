"""What a diagnosis is worth against the truth.

    PYTHONPATH=.:scripts python -m batteries.judge scripts/batteries/battery.json

prints the tables of the sessions that a file keeps, one line each.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mujoco_laboratory.sizes import SIZES

from batteries.power import half_sizes, reliability
from torchid.effects.catalogue import BODILY

WITHIN, SIGMAS, VAGUE = 0.15, 2.0, 0.25
"""A parameter is right within this part of it or so many stated standard deviations, unless those exceed a quarter."""
UNNAMED = {"gain": "gain", "scale": "scale"}
SURE = 0.9
WORTH, PART = 10.0, 0.8
"""Nats of held-out density that matter, and the part of what can be had that must be."""
COLUMNS = ("kind", "level", "names", "seed", "engine", "where", "named", "wrong", "found", "first", "sizes",
           "unexplained", "nearest", "gain", "gained", "failed")  # fmt: skip
"""What is kept of a session: ``where`` of each hidden effect; which of ``named`` are ``wrong``, by number; of ``sizes``
whether each is right; of ``nearest`` the best score in nats; trailing nulls are left out."""


def judged(truth: Sequence[dict], said: dict) -> dict:
    """Named causes against planted effects."""
    causes = said["causes"]
    hits = [next((c for c in causes if matches(planted, c)), None) for planted in truth]
    first = [k for k, c in enumerate(causes) if any(matches(planted, c) for planted in truth)]
    wrong = [c for c in causes if not any(matches(planted, c) for planted in truth)]
    return {
        "truth": [{"effect": t["effect"], "where": t["where"], "parameters": t["parameters"]} for t in truth],
        "named": [[c["effect"], c["where"], round(c["confidence"], 3)] for c in causes],
        "found": [hit is not None for hit in hits],
        "first": bool(first) and first[0] == 0,
        "sizes": [None if hit is None else sized(t, hit) for t, hit in zip(truth, hits, strict=True)],
        "wrong": [[c["effect"], c["where"], round(c["confidence"], 3)] for c in wrong],
        "unexplained": said.get("unexplained", {}).get("significant"),
        "heldout": [said["baseline"]["heldout"]["force_rmse_N"], said["extended"]["heldout"]["force_rmse_N"]],
        "nearest": [[n["effect"], n["where"], round(n["evidence_nats"], 2)] for n in said["nearest"]],
        "refuted": [[r["effect"], r["where"], _rounded(r["heldout_log_likelihood"])] for r in said["refuted"]],
        "gain": [c["gain"]["heldout_log_likelihood"] for c in causes],
        "told": f"{'+'.join(t['effect'] + '@' + ','.join(t['where']) for t in truth) or 'nothing'} -> "
        + ("; ".join(f"{c['effect']}@{','.join(c['where'])}" for c in causes) or "nothing"),
    }


def _rounded(nats: float | None) -> float | None:
    """A log likelihood to hundredths; None where no held-out trial could tell it."""
    return None if nats is None else round(nats, 2)


def matches(planted: dict, cause: dict) -> bool:
    """The cause itself, or one of which it says that it cannot be told apart."""
    options = [cause, *cause["indistinguishable"]]
    return any(_same(planted, o) for o in options)


def _same(planted: dict, one: dict) -> bool:
    return one["effect"] == planted["effect"] and set(one["where"]) == set(planted["where"])


def sized(planted: dict, cause: dict) -> dict | None:
    """Main parameters: value, stated sd, truth, and whether that is right, of the cause or the twin that is the planted
    one; None where no size of it is told."""
    options = [cause, *(twin for twin in cause["indistinguishable"] if twin.get("parameters"))]
    cause = next((o for o in options if _same(planted, o)), cause)
    if cause["effect"] != planted["effect"]:
        return None
    found = {}
    if planted["effect"] == "gravity_tilt":
        entry, true = cause["parameters"], planted["parameters"]
        both = (
            [x[key] for key in ("roll_rad", "pitch_rad")] for x in (_part(entry, "value"), _part(entry, "sd"), true)
        )
        found["tilt_rad"] = _right("tilt_rad", *both)
    for key in SIZES[planted["effect"]]:
        key = {"excess_kg": "mass_kg"}.get(key, key)
        if key in cause["parameters"] and key in planted["parameters"]:
            entry = cause["parameters"][key]
            found[key] = _right(key, entry["value"], entry["sd"], _ordered(key, planted, cause))
    return found


def _ordered(key: str, planted: dict, cause: dict) -> object:
    """The true value, its parts in the order in which the cause has segments or markers."""
    true = planted["parameters"][key]
    if not isinstance(true, dict):
        return true
    nothing = np.zeros_like(next(iter(true.values())))
    return [true.get(name, nothing) for name in cause["markers"] or cause["where"]]


def _part(parameters: dict, name: str) -> dict:
    return {key: entry[name] for key, entry in parameters.items()}


def _right(key: str, value: object, sd: object, true: object) -> dict:
    """Vectors by their length and the error's; factors by their distance from one."""
    one = 1.0 if key in ("gain", "scale") else 0.0
    v, s, t = (np.asarray(x, dtype=float).ravel() for x in (value, sd, true))
    size, miss, spread = np.linalg.norm(t - one), np.linalg.norm(v - t), np.linalg.norm(s)
    vague = bool(spread > VAGUE * np.linalg.norm(v - one))
    right = bool(miss < max(WITHIN * size, SIGMAS * spread)) and not vague
    return {"value": v.tolist(), "sd": s.tolist(), "true": t.tolist(), "right": right}


def tables(rows: Sequence[dict]) -> dict:
    """Figures over all sessions, and a text of them."""
    good = [r for r in rows if "failed" not in r]
    lines, figures = [], {}
    for level in sorted({r["level"] for r in good if r["kind"] == "single"}):
        lines.append(f"\n{level:22s} sessions found first sizes  wrong names")
        own = [r for r in good if r["kind"] == "single" and r["level"] == level]
        for name in SIZES:
            some = [r for r in own if list(r["names"]) == [name]]
            if some:
                lines.append(_line(name, some))
        lines.append(_line("all", own))
        figures[level] = {"sessions": len(own), "first": _share(own, "first"), "sizes": _sizes(own)}
    stiff = [r for r in good if r["kind"] != "skin"]
    for part in (_silent(good), _several(good), _living(good), _calibrated(stiff), _gained(stiff)):
        figures |= part[0]
        lines += part[1]
    lines.append(f"failed: {len(rows) - len(good)}")
    return {"figures": figures, "text": "\n".join(lines)}


def _silent(rows: Sequence[dict]) -> tuple[dict, list[str]]:
    """Sessions that hide nothing."""
    nulls = [r for r in rows if r["kind"] == "null"]
    best = max((score for r in nulls for _, _, score in r.get("nearest", ())), default=None)
    found = {
        "sessions": len(nulls), "named": sum(bool(r["named"]) for r in nulls),
        "laboratory": sum(_laboratory(r["named"]) for r in nulls),
        "flagged": sum(bool(r["unexplained"]) for r in nulls), "best_nats": best,
    }  # fmt: skip
    said = (
        "\nnothing hidden: {sessions} sessions, {named} with a cause named, {laboratory} beside bodies', "
        "{flagged} flagged; best score of what was not named: {best_nats} nats"
    )
    return {"null": found}, [said.format(**found)]


def _several(rows: Sequence[dict]) -> tuple[dict, list[str]]:
    """Two effects, or what no catalogue has, level by level."""
    found: dict[str, dict] = {"double": {}, "foreign": {}}
    lines = []
    for level in sorted({r["level"] for r in rows if r["kind"] in found}):
        doubles, foreign = ([r for r in rows if r["kind"] == kind and r["level"] == level] for kind in found)
        both = {"sessions": len(doubles), "both": sum(all(r["found"]) for r in doubles),
                "one": sum(any(r["found"]) for r in doubles)}  # fmt: skip
        unknown = {"sessions": len(foreign), "flagged": sum(bool(r["unexplained"]) for r in foreign),
                   "fooled": sum(_fooled(r) for r in foreign)}  # fmt: skip
        found["double"][level], found["foreign"][level] = both, unknown
        text = "two hidden, {}: {sessions} sessions, both named in {both}, at least one in {one}"
        lines.append(text.format(level, **both))
        text = "outside the catalogue, {}: {sessions} sessions, {flagged} flagged, {fooled} wrongly named without one"
        lines.append(text.format(level, **unknown))
    return found, lines


def _living(rows: Sequence[dict]) -> tuple[dict, list[str]]:
    """Sessions in which skin slides: bodies' own effects are there, and right to be named."""
    skin = [r for r in rows if r["kind"] == "skin"]
    bare, hidden = ([r for r in skin if bool(r["names"]) == any_] for any_ in (False, True))
    found = {
        "sessions": len(bare), "laboratory": sum(_laboratory(r["named"]) for r in bare),
        "hidden": len(hidden), "first": sum(r["first"] for r in hidden),
        "false": sum(_laboratory(r["wrong"]) for r in hidden), "flagged": sum(bool(r["unexplained"]) for r in skin),
    }  # fmt: skip
    said = (
        "living skin: {sessions} sessions that hide nothing, a cause beside bodies' named in {laboratory}; of {hidden} "
        "with an error of the laboratory {first} named it first, {false} a false one too; {flagged} of all flagged"
    )
    return {"skin": found}, [said.format(**found)]


def _laboratory(named: Sequence[list]) -> bool:
    return any(e not in BODILY for e, *_ in named)


def _calibrated(rows: Sequence[dict]) -> tuple[dict, list[str]]:
    bins, power = reliability(rows), half_sizes(rows)
    lines = [f"confidence {a:.2f}-{b:.2f}: {n} verdicts, {right} right" for a, b, n, right in bins if n]
    for name, own in power.items():
        low, high = own["interval"]
        text = f"half of {name} found from {own['half']:.3g} ({low:.3g} to {high:.3g}) {own['parameter']}"
        lines.append(f"{text}, ideal {own['ideal']:.3g}; {own['sessions']} sessions")
    return {"calibration": bins, "power": power}, lines


def _gained(rows: Sequence[dict]) -> tuple[dict, list[str]]:
    known = [r["gained"] for r in rows if r.get("gained") and r["gained"][1] >= WORTH]
    found = {"sessions": len(known), "reached": sum(some >= PART * whole for some, whole in known)}
    said = "gain: of {sessions} sessions with {worth:.0f} nats to gain on held-out motion, {reached} gained {part:.0%}"
    return {"gain": found}, [said.format(**found, worth=WORTH, part=PART)]


def _line(name: str, rows: Sequence[dict]) -> str:
    wrong = [e for r in rows for e, *_ in r["wrong"]]
    found = sum(all(r["found"]) for r in rows)
    right, all_ = _sizes(rows)
    first = round(_share(rows, "first") * len(rows))
    return f"{name:22s} {len(rows):8d} {found:5d} {first:5d} {right:3d}/{all_:<3d} {', '.join(sorted(set(wrong)))}"


def _share(rows: Sequence[dict], key: str) -> float:
    return sum(bool(r[key]) for r in rows) / max(len(rows), 1)


def _sizes(rows: Sequence[dict]) -> tuple[int, int]:
    entries = [entry for r in rows for one in r["sizes"] if one for entry in one.values()]
    return sum(e["right"] for e in entries), len(entries)


def _fooled(row: dict) -> bool:
    return not row["unexplained"] and any(confidence > SURE for _, _, confidence in row["named"])


def kept(row: dict) -> list:
    """A session's row in the order of ``COLUMNS``, without what no table and no calibration needs."""
    if "failed" in row:
        short = {"failed": row["failed"]}
    else:
        short = {
            "where": [one["where"] for one in row["truth"]],
            "wrong": [row["named"].index(one) for one in row["wrong"]],
            "found": [int(one) for one in row["found"]],
            "first": int(row["first"]),
            "sizes": [one and {key: int(entry["right"]) for key, entry in one.items()} for one in row["sizes"]],
            "unexplained": int(bool(row["unexplained"])),
            "nearest": max((score for *_, score in row["nearest"]), default=None),
            "gain": [None if nats is None else round(nats, 1) for nats in row["gain"]],
            "gained": row.get("gained") and [round(nats, 2) for nats in row["gained"]],
        }
    values = [(row | short).get(column) for column in COLUMNS]
    while values[-1] is None:
        values.pop()
    return values


def restored(values: Sequence) -> dict:
    """A kept row as ``tables`` reads it."""
    row = dict(zip(COLUMNS, values, strict=False))
    if row.get("failed"):
        return row
    sizes = [one and {key: {"right": bool(right)} for key, right in one.items()} for one in row["sizes"]]
    nearest = [] if row.get("nearest") is None else [["", [], row["nearest"]]]
    return row | {"wrong": [row["named"][k] for k in row["wrong"]], "sizes": sizes, "nearest": nearest}


def document(rows: Sequence[dict], date: str, first: int) -> str:
    """JSON of the tables and of every session's kept row; those of one effect and level stand in one line."""
    table, lines = tables([restored(kept(row)) for row in rows]), {}
    for row in rows:
        own = lines.setdefault((row["kind"], row["level"], *row["names"][:1]), [])
        own.append(json.dumps(kept(row), separators=(",", ":")))
    head = {"date": date, "first_seed": first, "tables": table["text"].splitlines()}
    columns, figures = json.dumps(COLUMNS), json.dumps(table["figures"])
    text = ",\n".join(",".join(own) for own in lines.values())
    return (
        f'{json.dumps(head, indent=1)[:-2]},\n "columns": {columns},\n "figures": {figures},\n "rows": [\n{text}\n]}}\n'
    )


if __name__ == "__main__":
    stored = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    print(tables([restored(values) for values in stored["rows"]])["text"])
