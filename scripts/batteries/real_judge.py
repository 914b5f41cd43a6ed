"""What a diagnosis of a real recording is worth against what was planted, and tables of it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from planted_faults.real_kinds import KINDS, UNPLANTED
from planted_faults.real_truth import ANYWHERE, Answer, Truth, truth_from

from torchid.diagnosis.trace import StepKind
from torchid.effects.catalogue import BODILY

PART, SIGMAS = 0.25, 2.0
"""The contract: a size is right within this part of it, or within so many of its stated standard deviations."""
SURE, LIKELY = 0.9, 0.5
"""The contract: confidences above which a wrong name counts, of faults that a witness sees and of the others."""
WORSE, MUCH_WORSE = 1.02, 2.0
"""Choice. Times the base model's error from which the published one counts as worse: rounding and other frames move
it by less."""
RESULTS = ("right", "later", "alike", "elsewhere", "other", "silent", "refused", "crashed")
"""Right effect and place first; behind another laboratory cause; what does the same, unstated; at another place; only
other causes named; none named; exit 2 or 3; exit 1."""
ONE = ("gain", "scale")
"""Parameters whose size is their distance from one."""
LENGTHS = ("shift_seg_m",)
"""Parameters in axes that the model chooses: only lengths can be compared."""


def judged(kept: Mapping[str, Any], known: Sequence[Sequence[str]], unplanted: Mapping[str, Any] | None) -> dict:
    """A row of one run.

    Args:
        kept: of a run: truth, exit code, residuals, diagnosis.
        known: effect and place of what is wrong with the session as recorded.
        unplanted: the same of the session as recorded, run the same way; None where there is none.
    """
    # A run that ends well without a verdict, where too little is on plates, names nothing.
    nothing = None if kept["exit"] else {"causes": [], "plates": {}}
    said, truth = kept.get("diagnosis", nothing), truth_from(kept["truth"])
    row = {key: kept[key] for key in ("case", "session", "way", "kind", "seed", "exit", "message", "cpu_s", "seconds")}
    row |= {"told": truth.told, "scored": kept["kind"] in KINDS and KINDS[kept["kind"]].scored}
    row |= _errors(kept)
    if said is None:
        return row | {"result": "crashed" if kept["exit"] == 1 else "refused", "named": [], "wrong": []}
    plates = said["plates"]
    causes = [c for c in said["causes"] if c["effect"] not in BODILY or _right(c, truth, plates)]
    before = [] if unplanted is None or not unplanted.get("diagnosis") else unplanted["diagnosis"]["causes"]
    named = [_named(cause, truth, known, before, plates) for cause in causes]
    counted = [(cause, one) for cause, one in zip(causes, named, strict=True) if one["is"] != "known"]
    return row | {
        "named": named,
        "bodily": [c["effect"] for c in said["causes"] if c["effect"] in BODILY],
        "wrong": [one for one in named if one["is"] in ("wrong", "elsewhere")],
        "result": _result([one["is"] for _, one in counted]) if truth.right else ("none" if not counted else "named"),
        "lost": [] if any(one["is"] == "right" for one in named) else _lost(said, truth),
        "size": next((_size(c, truth, plates) for c, one in counted if one["is"] == "right"), None),
        "unexplained": said.get("unexplained", {}).get("significant"),
    }


def _named(
    cause: Mapping[str, Any], truth: Truth, known: Sequence[Sequence[str]], before: Sequence[Mapping], plates: Mapping
) -> dict[str, Any]:
    """A cause in short: what, where, how sure, and whether it is right, alike, known, elsewhere or wrong."""
    if _right(cause, truth, plates):
        verdict = "right"
    elif any(e == cause["effect"] and (p == ANYWHERE or p in cause["where"]) for e, p in known):
        verdict = "known"
    elif any(_is(answer, cause, plates) for answer in truth.alike):
        verdict = "alike"
    else:
        verdict = "elsewhere" if any(answer.effect == cause["effect"] for answer in truth.right) else "wrong"
    new = not any(b["effect"] == cause["effect"] and set(b["where"]) == set(cause["where"]) for b in before)
    return {"effect": cause["effect"], "where": cause["where"], "confidence": round(cause["confidence"], 3),
            "is": verdict, "new": new}  # fmt: skip


def _right(cause: Mapping[str, Any], truth: Truth, plates: Mapping[str, Any]) -> bool:
    said = [cause, *cause["indistinguishable"]]
    return any(_is(answer, one, plates) for answer in truth.right for one in said)


def _lost(said: Mapping[str, Any], truth: Truth) -> list[str]:
    """Rules that took a right cause out, or let none in, in the order in which they did."""
    own = [one for one in said.get("trace", ()) if any(_is(answer, one, said["plates"]) for answer in truth.right)]
    return [one["rule"] for one in own if one["kind"] in (StepKind.LEAVE, StepKind.REFUSE)]


def _is(answer: Answer, cause: Mapping[str, Any], plates: Mapping[str, Any]) -> bool:
    return answer.effect == cause["effect"] and answer.is_at(cause["where"], plates)


def _result(verdicts: Sequence[str]) -> str:
    if not verdicts:
        return "silent"
    if "right" in verdicts:
        return "right" if verdicts[0] == "right" else "later"
    return next((v for v in ("alike", "elsewhere") if v in verdicts), "other")


def _size(cause: Mapping[str, Any], truth: Truth, plates: Mapping[str, Any]) -> dict[str, Any] | None:
    """Found and true size, and whether that is right; None where none is told."""
    for answer in truth.right:
        for one in (cause, *cause["indistinguishable"]):
            parameters = one.get("parameters") or {}
            if _is(answer, one, plates) and answer.parameters and set(answer.parameters) <= set(parameters):
                return _sized(answer.parameters, parameters)
    return None


def _sized(true: Mapping[str, list[float]], found: Mapping[str, Any]) -> dict[str, Any]:
    """Vectors by the length of what they are off, against the length of what was planted."""
    t = np.concatenate([np.ravel(true[key]) for key in true])
    v, s = (np.concatenate([np.ravel(np.asarray(found[key][what], float)) for key in true]) for what in ("value", "sd"))
    if "recorded_kg" in true:
        # A wrong record errs by what it is off; what it says is known.
        t, v, s = (x[:1] - (0.0 if x is s else true["recorded_kg"][0]) for x in (t, v, s))
    one = 1.0 if any(key in ONE for key in true) else 0.0
    size = float(np.linalg.norm(t - one))
    if any(key in LENGTHS for key in true):
        off = float(abs(np.linalg.norm(v) - size))
    else:
        off = float(np.linalg.norm(v - t))
    spread = float(np.linalg.norm(s))
    right = off <= max(PART * size, SIGMAS * spread)
    return {"true": size, "found": float(np.linalg.norm(v - one)), "off": off, "sd": spread, "right": bool(right)}


def _errors(kept: Mapping[str, Any]) -> dict[str, Any]:
    """Errors of the base model and of the published one: force [N] and moment [N m], held out where a trial is; and
    how many times worse the published one is."""
    rows = kept.get("residuals") or []
    role = "heldout" if any(row["role"] == "heldout" for row in rows) else "fit"
    own = {row["label"]: [row["force_rmse_N"], row["moment_rmse_Nm"]] for row in rows if row["role"] == role}
    base = own.get("+ identified inertia")
    if base is None or None in base:
        return {"base": None, "published": None, "times": None}
    published = own.get("+ named causes", base)
    times = max(b / a for a, b in zip(base, published, strict=True) if a > 0.0)
    found: dict[str, Any] = {"base": base, "published": published, "role": role, "times": round(times, 4)}
    said = kept.get("diagnosis")
    markers = [] if said is None else [said[k]["heldout"]["marker_rmse_mm"] for k in ("baseline", "extended")]
    if role == "heldout" and all(markers):
        found |= {"markers_mm": markers, "times": round(max(times, markers[1] / markers[0]), 4)}
    return found


def tables(rows: Sequence[dict]) -> Iterator[str]:
    """Lines of the tables of all rows."""
    planted = [r for r in rows if r["kind"] != UNPLANTED]
    yield f"{'kind':14s} {'cases':>5s} " + " ".join(f"{name:>9s}" for name in RESULTS) + f" {'sizes':>7s}  wrong names"
    for scored, title in ((True, "a witness sees it"), (False, "the rest")):
        own = [r for r in planted if r["scored"] is scored]
        for kind in KINDS:
            some = [r for r in own if r["kind"] == kind]
            if some:
                yield _line(kind, some)
        if own:
            yield _line(title, own)
            yield from _goals(own, scored)
    yield from _taken_out(planted)
    yield ""
    yield from _by_session(rows)
    yield ""
    yield from _confidence(planted)
    for row in rows:
        if row["result"] in ("refused", "crashed"):
            yield f"{row['result']}, exit {row['exit']}: {row['case']} [{row['told']}] {row['message'][:160]}"
    yield from _unplanted([r for r in rows if r["kind"] == UNPLANTED])
    for title, some in (("unplanted", [r for r in rows if r["kind"] == UNPLANTED]), ("planted", planted)):
        if any(r["times"] is not None for r in some):
            yield _worse(title, some)
    cpu = [r["cpu_s"] for r in rows]
    if cpu:
        each = f"{np.mean(cpu):.0f} s each, at most {max(cpu):.0f} s"
        yield f"cost: {len(cpu)} runs, {sum(cpu) / 60:.1f} min of CPU, {each}"


def differences(rows: Sequence[dict], others: Sequence[dict]) -> Iterator[str]:
    """Cases that two batteries share and judge differently: result, causes and worst error of each."""
    before = {row["case"]: row for row in rows}
    shared = [(before[row["case"]], row) for row in others if row["case"] in before]
    changed = [(a, b) for a, b in shared if (a["result"], _short(a)) != (b["result"], _short(b))]
    for a, b in changed:
        yield f"{a['case']} [{a['told']}]"
        yield from (f"    {row['result']}: {_short(row)}; {row['times']} times the base" for row in (a, b))
    right = [sum(row["result"] == "right" for row in side) for side in zip(*shared, strict=True)]
    yield f"{len(shared)} cases in both, {len(changed)} differ; right {' and '.join(map(str, right))}"


def _short(row: dict) -> str:
    told = [f"{n['effect']} ({', '.join(n['where'])}) {n['confidence']:.2f}" for n in row["named"]]
    return "; ".join(told) or row["message"][:60] or "nothing"


def _line(name: str, rows: Sequence[dict]) -> str:
    counts = [sum(r["result"] == result for r in rows) for result in RESULTS]
    sizes = [r["size"]["right"] for r in rows if r.get("size")]
    wrong = sorted({w["effect"] for r in rows for w in r["wrong"] if w["new"]})
    told = " ".join(f"{n or '':>9}" for n in counts)
    return f"{name:14.14s} {len(rows):5d} {told} {sum(sizes):3d}/{len(sizes):<3d}  {', '.join(wrong)}".rstrip()


def _goals(rows: Sequence[dict], scored: bool) -> Iterator[str]:
    """The figures that the contract asks for."""
    kinds = {r["kind"] for r in rows}
    share = {k: np.mean([r["result"] == "right" for r in rows if r["kind"] == k]) for k in kinds}
    bound = SURE if scored else LIKELY
    wrong = [any(w["confidence"] > bound for w in r["wrong"]) for r in rows]
    fresh = [any(w["confidence"] > bound and w["new"] for w in r["wrong"]) for r in rows]
    sizes = [r["size"]["right"] for r in rows if r.get("size")]
    yield (
        f"  right effect and place first {np.mean([r['result'] == 'right' for r in rows]):.0%}, worst kind "
        f"{min(share.values()):.0%} ({min(share, key=lambda k: share[k])}); sizes right "
        f"{np.mean(sizes) if sizes else float('nan'):.0%}; a wrong laboratory cause above {bound:g} in "
        f"{np.mean(wrong):.0%}, in {np.mean(fresh):.0%} one that the session as recorded does not have"
    )


def _taken_out(rows: Sequence[dict]) -> Iterator[str]:
    """Right causes that entered or nearly did, and that a rule took out."""
    lost = [row for row in rows if row.get("lost")]
    if rows:
        yield f"true causes that a rule took out: {len(lost)} of {len(rows)}"
    yield from (f"  {row['case']}: {', '.join(dict.fromkeys(row['lost']))}" for row in lost)


def _by_session(rows: Sequence[dict]) -> Iterator[str]:
    yield f"{'session':28s} {'cases':>5s} {'right':>6s}  published / base error, median and most"
    for session in dict.fromkeys(r["session"] for r in rows):
        own = [r for r in rows if r["session"] == session]
        planted = [r for r in own if r["kind"] != UNPLANTED and r["scored"]]
        times = [r["times"] for r in own if r["times"] is not None]
        said = f"{np.median(times):.2f}, {max(times):.2f}" if times else ""
        yield f"{session:28s} {len(own):5d} {sum(r['result'] == 'right' for r in planted):3d}/{len(planted):<3d} {said}"


def _confidence(rows: Sequence[dict]) -> Iterator[str]:
    """How often laboratory causes are right, by stated confidence; those of the session as recorded are left out."""
    every = [n for r in rows for n in r["named"] if n["is"] != "known" and n["effect"] not in BODILY]
    for low, high in ((0.0, 0.5), (0.5, 0.9), (0.9, 1.01)):
        own = [n for n in every if low <= n["confidence"] < high]
        right = sum(n["is"] == "right" for n in own)
        if own:
            said = f"{len(own)} causes, {right} right ({right / len(own):.0%})"
            alike = sum(n["is"] == "alike" for n in own)
            yield f"confidence {low:.1f}-{min(high, 1.0):.1f}: {said}, {alike} that do the same"


def _unplanted(rows: Sequence[dict]) -> Iterator[str]:
    if not rows:
        return
    named = [r for r in rows if r["result"] == "named"]
    strange = [[n for n in r["named"] if n["is"] != "known"] for r in named]
    likely = sum(any(n["confidence"] > LIKELY for n in some) for some in strange)
    said = f"likely in {likely}, no more than possible in {len(named) - likely}"
    yield f"unplanted: {len(rows)} runs, a laboratory cause that is not known {said}"
    for r, some in zip(named, strange, strict=True):
        causes = [f"{n['effect']} ({', '.join(n['where'])}) {n['confidence']:.2f}" for n in some]
        yield f"  {r['case']}: {'; '.join(causes)}"


def _worse(title: str, rows: Sequence[dict]) -> str:
    own = [r for r in rows if r["times"] is not None]
    worse = [sum(r["times"] > bound for r in own) for bound in (WORSE, MUCH_WORSE)]
    most = max((r["times"] for r in own), default=float("nan"))
    return (
        f"published against base, {title}: worse (over {WORSE:g} times) in {worse[0]} of {len(own)}, over "
        f"{MUCH_WORSE:g} times in {worse[1]}, at most {most:.2f} times; no result in {len(rows) - len(own)}"
    )
