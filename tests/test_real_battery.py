"""What the battery on real recordings plants is what torchid's own effects undo; verdicts on it are judged fairly."""

import json
import sys
from argparse import Namespace
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from balance import in_balance
from torch import Tensor
from torch.testing import assert_close

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from batteries import real
from batteries.detectable import sized
from batteries.real_judge import differences, judged, tables
from batteries.remembered import remembered
from planted_faults.real_files import Recorded, cropped, frames_kept, read_recorded, write_session
from planted_faults.real_kinds import KINDS, UNPLANTED, Given, plant
from planted_faults.real_plates import plates_of, used_plates
from planted_faults.real_sessions import ASIDE, SESSIONS, RealSession, sessions
from planted_faults.real_sizes import SIZED, plant_sized
from planted_faults.real_truth import Answer, Inapplicable, Truth, truth_from
from small_session import SEED

from torchid.conventions import GRAVITY
from torchid.effects.catalogue import effect
from torchid.effects.marker_scene import Sight
from torchid.effects.place import SESSION, Interval, Place
from torchid.effects.scene import Reading
from torchid.errors import DataError
from torchid.io import read_trial
from torchid.kinematics.chain import chain_poses
from torchid.model.marker_set import load_marker_set
from torchid.recording import Trial
from torchid.simulate.options import SimulateOptions
from torchid.simulate.planting import numbered_frames
from torchid.simulate.session import SimulatedSession, simulate_session

SMALL = SimulateOptions(
    fit=("sway_steps", "squats"), heldout=("arms",), duration_s=2.5, marker_noise_mm=0.1, force_noise_n=0.0
)
OWN = RealSession("simulated", {"name": "simulated", "mass_kg": 70.0}, "simulated", ())
ON_PLATES = ("clock12", "clock20", "clock8", "gain", "all_gains", "offset", "crosstalk", "sideways", "shift15", "turn")


@cache
def simulated() -> SimulatedSession:
    """A static trial, steps, squats and a held-out trial, with little noise: without any, cameras seem to be stuck."""
    return in_balance(lambda seed: simulate_session(SMALL, seed), SEED)


@cache
def recorded() -> Recorded:
    """The same as a real session would be read."""
    trials = tuple(one.trial for one in simulated().trials)
    trials = tuple(replace(t, parameters={"file": f"{t.name}.c3d"}) for t in trials)
    matched = load_marker_set("simulated").match(trials[0].markers.labels)
    return Recorded(dict(OWN.subject), trials, {label: spec.segment for label, spec in matched.assigned.items()})


def planted(kind: str, seed: int = SEED, whole: Recorded | None = None) -> tuple[Recorded, Truth]:
    """The session with a fault of a kind, everything kept."""
    whole = recorded() if whole is None else whole
    return plant(kind, whole, OWN, [slice(0, len(t.markers.time)) for t in whole.trials], seed)


def without_corners(session: Recorded) -> Recorded:
    """The session as TRC and MOT hold it."""
    trials = []
    for trial in session.trials:
        assert trial.forces is not None
        plates = tuple(replace(plate, corners=None) for plate in trial.forces.plates)
        forces = replace(trial.forces, plates=plates)
        trials.append(replace(trial, forces=forces, parameters={"file": f"{trial.name}.trc"}))
    return replace(session, trials=tuple(trials))


def reading(trial: Trial, wrench: Tensor | None = None) -> Reading:
    """What torchid's effects read of a trial."""
    assert trial.forces is not None
    own = trial.forces.wrench if wrench is None else wrench
    return Reading(trial.name, trial.forces.time, own, numbered_frames(trial.forces.plates))


def sight(trial: Trial) -> Sight:
    """Markers where cameras see them, without a body."""
    found = object.__new__(Sight)
    scene = SimpleNamespace(trial=trial.name, time=trial.markers.time, rate=trial.markers.rate)
    found.__dict__.update(scene=scene, labels=trial.markers.labels, p=trial.markers.position.permute(1, 2, 0))
    return found


def slid(name: str, trial: Trial, place: Place, theta: Tensor) -> Tensor:
    """Marker positions with an effect of torchid's in them (frames, markers, 3)."""
    found, position = effect(name).slide(sight(trial), place, theta), trial.markers.position.clone()
    assert found is not None
    position[:, list(found.which)] += found.by.permute(2, 0, 1)
    return position


def inner(trial: Trial) -> slice:
    """Samples of the plates away from the ends, where a lag leaves none."""
    assert trial.forces is not None
    edge = round(0.05 * trial.forces.rate)
    return slice(edge, -edge)


@pytest.mark.parametrize("kind", ON_PLATES)
def test_faults_of_plates_are_those_of_torchids_effects(kind):
    """Planted by the effect of the truth's place and size, the right recording is the faulty one; undone, right again
    to second order in the size."""
    faulty, truth = planted(kind)
    (answer,) = truth.right
    own, values = effect(answer.effect), {k: torch.tensor(v).double() for k, v in answer.parameters.items()}
    values = {k: v.reshape(6, 6) if k == "matrix_plate" else v for k, v in values.items()}
    if answer.effect == "plate_pose":
        values = {"shift_m": torch.zeros(3).double(), "rotation_rad": torch.zeros(3).double()} | values
    if answer.effect == "plate_offset":
        values["moment_plate_Nm"] = torch.zeros(3).double()
    for k, right in enumerate(recorded().trials):
        wrong = faulty.trials[k]
        assert wrong.forces is not None and right.forces is not None
        names = [str(p.get(right.name)).replace("plate ", "plate_") for p in answer.plates]
        names = [f.name for f in reading(right).frames] if kind == "all_gains" else names
        place = Place(tuple(names)) if names else SESSION
        theta = own.internal(place, values)
        made = own.read(reading(wrong, right.forces.wrench), place, theta)
        part = inner(right)
        assert_close(wrong.forces.wrench[part], made.wrench[part], rtol=1e-6, atol=1e-3)
        back = own.undone(reading(wrong, torch.nan_to_num(wrong.forces.wrench)), place, theta).wrench[part]
        load = float(right.forces.wrench[..., :3].abs().max())
        error = float((back - right.forces.wrench[part]).abs().max()) / load
        assert error < (0.02 if kind.startswith("clock") else 0.012), (kind, right.name, error)
        assert not torch.equal(torch.nan_to_num(wrong.forces.wrench), right.forces.wrench) or names


def test_a_tilt_leans_what_stands_against_gravity():
    """The reading of quiet standing leans as roll and pitch of the truth say, whether the room leans or the plates."""
    seen = set()
    for seed in range(SEED, SEED + 12):
        faulty, truth = planted("tilt", seed)
        room = "room" in truth.told
        seen.add(room)
        (answer,) = truth.right
        roll, pitch = answer.parameters["roll_rad"][0], answer.parameters["pitch_rad"][0]
        up = torch.tensor([np.sin(pitch), -np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)])
        right, wrong = recorded().trials[0], faulty.trials[0]
        assert right.forces is not None and wrong.forces is not None
        lean = wrong.forces.total[:, :3].mean(0) - right.forces.total[:, :3].mean(0)
        weight = right.forces.total[:, 2].mean()
        assert_close(lean / weight, up - torch.tensor([0.0, 0.0, 1.0]).double(), rtol=0.0, atol=2e-3)
        corners = [one.forces.plates[0].corners for one in (right, wrong) if one.forces]
        assert room is not torch.equal(*corners) and room is not torch.equal(
            right.markers.position, wrong.markers.position
        )
    assert seen == {True, False}


def test_scale_filter_and_swaps_are_those_of_torchids_effects():
    """What cameras see with the effect, from the right recording, is what the faulty one holds."""
    (scaled, scale), (smooth, low), (swapped, swap) = (planted(kind) for kind in ("scale", "filter", "swap_part"))
    for k, trial in enumerate(recorded().trials):
        one = torch.tensor(scale.right[0].parameters["scale"]).double() - 1.0
        assert_close(scaled.trials[k].markers.position, slid("marker_scale", trial, SESSION, one))
        slowness = torch.tensor(low.right[0].parameters["cutoff_hz"]).double() ** -4
        edge = round(trial.markers.rate / 2.0)
        made = slid("filter_lag", trial, SESSION, slowness)
        # A bilinear low-pass and the exact power of a derivative part where motion is quick.
        assert_close(smooth.trials[k].markers.position[edge:-edge], made[edge:-edge], rtol=0.0, atol=2e-3)
    changed = [
        k for k, (a, b) in enumerate(zip(recorded().trials, swapped.trials, strict=True))
        if not torch.equal(a.markers.position, b.markers.position)
    ]  # fmt: skip
    (k,) = changed
    trial = recorded().trials[k]
    assert trial.role == "fit"
    moved = (trial.markers.position != swapped.trials[k].markers.position).any(2).any(1).nonzero()[:, 0]
    when = Interval(trial.name, float(trial.markers.time[moved[0]]), float(trial.markers.time[moved[-1]]))
    place = Place(swap.right[0].where, (when,))
    assert_close(swapped.trials[k].markers.position, slid("marker_swap", trial, place, torch.ones(1).double()))


@pytest.mark.parametrize("kind", ["marker", "marker_soft"])
def test_a_moved_marker_keeps_its_new_place_on_the_segment(kind):
    """In the axes of its body it is off by one vector of the truth's length, from one trial on; all else stays."""
    faulty, truth = planted(kind)
    (answer,) = truth.right
    label, size = answer.where[0], float(np.linalg.norm(answer.parameters["shift_seg_m"]))
    subject, found = simulated().subject, []
    column = recorded().trials[0].markers.labels.index(label)
    body = subject.model.tree.names.index(recorded().segments[label])
    for one, wrong in zip(simulated().trials, faulty.trials, strict=True):
        off = wrong.markers.position - one.trial.markers.position
        assert not bool(off[:, [k for k in range(off.shape[1]) if k != column]].any())
        if bool(off.any()):
            R_WB = chain_poses(subject.model.tree, one.truth.motion.q, subject.geometry)[:, body, :3, :3]
            found.append((R_WB.mT @ off[:, column, :, None])[..., 0])
        else:
            assert not found
    everywhere = torch.cat(found)
    assert_close(everywhere.norm(dim=1).mean(), torch.tensor(size).double(), rtol=1e-6, atol=0.0)
    assert float((everywhere - everywhere.mean(0)).norm(dim=1).max()) < 5e-4
    assert 0.015 <= size <= 0.025


def one_contact() -> tuple[Recorded, str]:
    """The session with squats in which one plate alone is loaded, for a second; and by which foot."""
    k = next(k for k in recorded().fitted if recorded().trials[k].name == "squats")
    trial = recorded().trials[k]
    assert trial.forces is not None
    plate = SEED % 2
    during = (trial.forces.time > 0.8) & (trial.forces.time < 1.8)
    wrench = torch.zeros_like(trial.forces.wrench)
    wrench[during, plate] = trial.forces.wrench[during, plate]
    trials = [replace(t, role="heldout") if t.role == "fit" else t for t in recorded().trials]
    trials[k] = replace(trial, forces=replace(trial.forces, wrench=wrench))
    return replace(recorded(), trials=tuple(trials)), ("foot_l", "foot_r")[plate]


def test_a_silent_plate_lacks_the_contact_of_the_foot_that_is_named():
    """The missing wrench is one plate's of one fit trial, has the truth's impulse, and pressed under that foot."""
    whole, foot = one_contact()
    faulty, truth = planted("silent", SEED, whole)
    (answer,) = truth.right
    lacks = []
    for right, wrong in zip(whole.trials, faulty.trials, strict=True):
        assert right.forces is not None and wrong.forces is not None
        gone = right.forces.wrench - wrong.forces.wrench
        if bool(gone.any()):
            lacks.append((right, gone, right.forces.rate))
    ((trial, gone, rate),) = lacks
    (plate,) = gone.any(2).any(0).nonzero()[:, 0].tolist()
    assert trial.role == "fit"
    impulse = gone[:, plate, :3].sum(0) / rate
    assert_close(impulse, torch.tensor(answer.parameters["impulse_Ns"]).double())
    assert answer.where == (foot,)


def test_a_wrong_record_errs_by_what_was_planted():
    """The effect's own parameter is what the person weighs beyond the record."""
    faulty, truth = planted("mass")
    values = {k: torch.tensor(v).double() for k, v in truth.right[0].parameters.items()}
    (excess,) = effect("body_mass").internal(SESSION, values).tolist()
    assert float(str(faulty.subject["mass_kg"])) == pytest.approx(70.0 - excess) and excess in (-5.0, 4.0)


@pytest.mark.parametrize("corners", [True, False])
def test_what_is_written_is_what_is_read(tmp_path, corners):
    """Markers and wrenches of every trial come back from the files, with any kind of fault in them."""
    rng = np.random.default_rng(SEED)
    whole = recorded() if corners else without_corners(recorded())
    kind = str(rng.choice([UNPLANTED, *KINDS]))
    print(kind)  # noqa: T201
    try:
        faulty, _ = planted(kind, SEED, whole)
    except Inapplicable:
        faulty = whole
    kept = [frames_kept(trial) for trial in faulty.trials]
    config = json.loads(write_session(faulty, OWN, tmp_path, kept).read_text())
    for entry, trial, frames in zip(config["trials"], faulty.trials, kept, strict=True):
        forces = tmp_path / entry["forces"] if "forces" in entry else None
        back = read_trial(entry["name"], tmp_path / entry["file"], forces, entry["role"])
        sent = cropped(trial, frames)
        assert back.forces is not None and sent.forces is not None
        assert back.markers.labels == sent.markers.labels
        assert_close(back.markers.time, sent.markers.time, rtol=0.0, atol=1e-6)
        assert_close(back.markers.position, sent.markers.position, rtol=0.0, atol=2e-6, equal_nan=True)
        known = sent.forces.wrench.isfinite()
        wrench = back.forces.wrench[: len(known)]
        assert_close(wrench[known], sent.forces.wrench[known], rtol=1e-5, atol=0.02)


def test_plates_are_known_again_whatever_their_numbers():
    """By name where files have corners; else where they are pressed, so that one out of place is another plate."""
    named = plates_of(recorded())
    assert [set(p.channels.values()) for p in named] == [{f"plate {k + 1}"} for k in range(len(named))]
    pressed = plates_of(without_corners(recorded()))
    assert all(len(set(p.channels.values())) == 1 for p in pressed)


def verdict(*causes: dict, **more: Any) -> dict:
    """What is kept of a run that named these."""
    held = {"heldout": {"force_rmse_N": 1.0, "marker_rmse_mm": 5.0}}
    plates = {"plate_1": {"channels": {"walk": "plate 1"}}, "plate_2": {"channels": {"walk": "plate 2"}}}
    said = {"causes": list(causes), "plates": plates, "baseline": held, "extended": held}
    label = {"label": "+ identified inertia", "role": "fit", "force_rmse_N": 20.0, "moment_rmse_Nm": 5.0}
    extended = {"label": "+ named causes", "role": "fit", "force_rmse_N": 30.0, "moment_rmse_Nm": 4.0}
    return {
        "case": "a", "session": "s", "way": "none", "kind": "gain", "seed": 1, "exit": 0, "message": "", "cpu_s": 1.0,
        "seconds": 1.0, "diagnosis": said, "residuals": [label, extended], **more,
    }  # fmt: skip


def cause(name: str, *where: str, confidence: float = 0.95, **parameters: Any) -> dict:
    """One cause of a verdict."""
    told = {key: {"value": value, "sd": sd} for key, (value, sd) in parameters.items()}
    return {"effect": name, "where": list(where), "confidence": confidence, "parameters": told, "indistinguishable": []}


def test_verdicts_are_judged_by_effect_place_and_size():
    """First, behind another, elsewhere, alike, known, none: each is told; twins count; sizes by a quarter or 2 sd."""
    channels = {"static": "plate 1", "walk": "plate 1"}
    right = Answer("plate_gain", (), {"gain": [1.04]}, (channels,))
    truth = Truth((right,), "+4 %", (Answer("body_mass", ("session",)),)).table()
    gain, other = cause("plate_gain", "plate_1", gain=(1.032, 0.001)), cause("tether", "head", confidence=0.92)
    skin, mass = cause("soft_tissue", "thigh_l"), cause("body_mass", "session")
    twin = mass | {"indistinguishable": [gain]}

    def told(*causes: dict, known: tuple = ()) -> dict:
        return judged(json.loads(json.dumps(verdict(*causes, truth=truth))), known, None)

    assert told(skin, gain)["result"] == "right" and told(other, gain)["result"] == "later"
    assert told(gain)["size"]["right"] and told(twin)["result"] == "right" and told(twin)["size"]["right"]
    assert not told(cause("plate_gain", "plate_1", gain=(1.02, 0.002)))["size"]["right"]
    assert told(cause("plate_gain", "plate_1", gain=(1.02, 0.012)))["size"]["right"]
    assert told(cause("plate_gain", "plate_2"))["result"] == "elsewhere" and told(mass)["result"] == "alike"
    assert told(skin)["result"] == "silent" and told(other)["result"] == "other"
    assert told(other, gain, known=(("tether", "*"),))["result"] == "right"
    assert [w["effect"] for w in told(other, gain)["wrong"]] == ["tether"] and not told(mass)["wrong"]
    row = told(gain)
    assert row["times"] == 1.5 and row["base"] == [20.0, 5.0] and row["published"] == [30.0, 4.0]
    before = json.loads(json.dumps(verdict(other, truth=Truth(()).table(), kind=UNPLANTED)))
    again = judged(json.loads(json.dumps(verdict(other, gain, truth=truth))), (), before)
    assert [n["new"] for n in again["named"]] == [False, True]
    refused = {k: v for k, v in verdict(truth=truth, exit=3).items() if k not in ("diagnosis", "residuals")}
    assert judged(refused, (), None)["result"] == "refused"
    lines = "\n".join(tables([told(gain), told(other, gain), judged(before, (), None), judged(refused, (), None)]))
    assert "gain" in lines and "tether" in lines and "worse" in lines and "exit 3" in lines
    changed = list(differences([told(gain)], [told(other, gain)]))
    assert len(changed) == 4 and changed[-1] == "1 cases in both, 1 differ; right 1 and 0"
    assert len(list(differences([told(gain)], [told(gain)]))) == 1


def test_rules_that_take_a_true_cause_out_are_listed():
    """Those that leave it out or refuse it, where nothing right is left; not those that act on others."""
    right = Answer("plate_gain", (), {"gain": [1.04]}, ({"walk": "plate 1"},))
    steps = [
        {"kind": kind, "effect": name, "where": [where], "rule": f"{kind} {name} {where}", "numbers": {}}
        for kind in ("enter", "leave", "refuse")
        for name in ("plate_gain", "tether") for where in ("plate_1", "plate_2")
    ]  # fmt: skip

    def row(*causes: dict) -> dict:
        kept = verdict(*causes, truth=Truth((right,), "+4 %").table())
        kept["diagnosis"] = kept["diagnosis"] | {"trace": steps}
        return judged(json.loads(json.dumps(kept)), (), None)

    lost = row(cause("tether", "head"))
    assert lost["lost"] == ["leave plate_gain plate_1", "refuse plate_gain plate_1"]
    found = row(cause("plate_gain", "plate_1", gain=(1.04, 0.01)))
    assert not found["lost"]
    lines = "\n".join(tables([lost, found]))
    assert "true causes that a rule took out: 1 of 2" in lines and "  a: leave plate_gain plate_1, refuse" in lines


def test_truths_pass_through_json():
    """What is kept of a truth is the truth."""
    for kind in KINDS:
        try:
            _, truth = planted(kind)
        except Inapplicable:
            continue
        assert truth_from(json.loads(json.dumps(truth.table()))) == truth


def test_sets_kept_aside_are_run_by_name_alone(data_dir):
    """Without ``--aside`` none of them is at hand, with it nothing else."""
    assert len(ASIDE) == 3 and set(ASIDE) <= {one.name for one in SESSIONS}
    assert not set(sessions(data_dir, False)) & set(ASIDE) and set(sessions(data_dir, True)) <= set(ASIDE)


def test_cases_do_not_hang_on_what_else_is_run():
    """A seed draws the same cases again, whichever sessions and kinds are asked for."""
    some = SESSIONS[:3]
    every = list(real.cases(some, (UNPLANTED, *KINDS), SEED))
    assert len({case.key for case in every}) == len(every)
    assert set(real.cases(some[1:2], ("gain",), SEED)) < set(every)
    assert {case.way for case in every if case.kind == UNPLANTED and case.session == "HC030A"} == {
        "none", "straight", "turn"
    }  # fmt: skip


def test_a_battery_of_an_hour_has_some_of_every_kind(data_dir):
    """By lot, a few sessions a kind, the same ones for a seed; every way of leaving a trial out as recorded."""
    some = sessions(data_dir, False)
    asked = Namespace(sessions=None, kinds=None, small=False, witnesses=False, each=2, cases=None, seed=SEED)
    found = real.planned(asked, some)
    assert found == real.planned(asked, some) and len({case.key for case in found}) == len(found)
    assert {kind: sum(case.kind == kind for case in found) for kind in KINDS} == dict.fromkeys(KINDS, 2)
    assert sum(case.kind == UNPLANTED for case in found) == sum(len(one.ways) for one in some.values())
    assert len(real.planned(Namespace(**vars(asked) | {"cases": 5}), some)) == 5


def test_a_battery_goes_on_where_it_was_stopped(tmp_path, monkeypatch, data_dir):
    """A refused run is kept with its exit code, is not run again, and is tabulated; real files carry the fault."""
    runs = []

    def refuse(config: Any) -> None:
        runs.append(config)
        raise DataError("inertia.few_frames", "too few frames", remedy="Record more")

    monkeypatch.setattr(real, "run_experiment", refuse)
    session = sessions(data_dir, False)["opensim_gait2354"]
    case = next(real.cases([session], ("gain",), SEED))
    kept = real.perform(case, session, data_dir, tmp_path)
    assert kept["exit"] == 3 and len(runs) == 1 and not any((tmp_path / "scratch").iterdir())
    (tmp_path / "verdicts.jsonl").write_text(json.dumps(kept) + "\n")
    assert "refused" in real.summary(tmp_path)
    (row,) = real.read_lines(tmp_path / "rows.jsonl")
    assert row["case"] == case.key and row["result"] == "refused"


def test_a_fault_of_the_stated_size_is_planted_where_it_is_stated() -> None:
    """On the plate that the verdict means, at the size and at half of it; neither on all plates nor without a size."""
    whole, session = recorded(), {"effect": "time_offset", "where": ["session"], "parameter": "lag_s", "why": ""}
    plate = used_plates(whole)[-1]
    gain = {"effect": "plate_gain", "where": ["plate_9"], "parameter": "gain", "size": 0.02}
    said = {"plates": {"plate_9": {"channels": plate.channels}}}
    said["detectable"] = [gain, gain | {"where": ["plate_9", "plate_1"], "size": 0.05}, session]
    verdict = {"session": "any", "way": "none", "diagnosis": said}
    found = [
        one.plant(whole, SESSIONS[0], [])[1].right[0] for one in sized(verdict, ("plate_gain", "time_offset"), SEED)
    ]
    assert [answer.plates for answer in found] == 2 * [(plate.channels,)]
    assert [abs(answer.parameters["gain"][0] - 1.0) for answer in found] == pytest.approx([0.02, 0.01])


@pytest.mark.parametrize(("name", "key"), SIZED)
def test_each_kind_is_planted_at_any_size(name: str, key: str) -> None:
    """Twice as much is another recording, and the answer is the effect whose size it is."""
    whole, own = recorded(), used_plates(recorded())[0].channels if name.startswith("plate") else None
    found = []
    for size in (0.01, 0.02):
        on = Given(whole, SESSIONS[0], [], np.random.default_rng(SEED))
        changed, truth = plant_sized(name, key, size, own, on)
        assert truth.right[0].effect == name and effect(name)
        loads = [trial.forces.wrench.nan_to_num() for trial in changed.trials if trial.forces is not None]
        found.append((sum(float(one.abs().sum()) for one in loads), changed.subject["mass_kg"]))
    assert found[0] != found[1]


def test_a_real_session_carries_what_was_planted(tmp_path, data_dir):
    """A plate's gain stands in the written files, and in no other plate."""
    session = sessions(data_dir, False)["HC031A"]
    case = next(real.cases([session], ("gain",), SEED))
    truth, config = real.planted(case, session, data_dir, tmp_path / "faulty")
    (gain,) = truth.right[0].parameters["gain"]
    right = read_recorded(session, case.way, data_dir)
    for trial in right.trials[1:]:
        back = read_trial(trial.name, config.parent / f"{trial.name}.c3d")
        sent = cropped(trial, frames_kept(trial))
        assert back.forces is not None and sent.forces is not None
        ratio = back.forces.wrench[..., 2].sum(0) / sent.forces.wrench[..., 2].sum(0)
        at = [plate.name for plate in sent.forces.plates].index(truth.right[0].plates[0][trial.name])
        assert_close(ratio[at], torch.tensor(gain).double(), rtol=1e-4, atol=0.0)
        assert_close(ratio[1 - at], torch.tensor(1.0).double(), rtol=1e-4, atol=0.0)
        assert float(back.forces.wrench.abs().max()) < 10.0 * GRAVITY * 27.7


def test_what_was_fitted_is_taken_up_for_the_same_and_nothing_else(tmp_path: Path) -> None:
    """Callbacks are no part of what is asked; another number is."""
    asked: list[Tensor] = []

    def doubled(given: Tensor, said: object = None) -> dict[str, Tensor]:
        asked.append(given)
        return {"twice": 2.0 * given}

    kept, one, other = remembered(doubled, tmp_path), torch.ones(3), torch.tensor([1.0, 1.0, 1.0 + 1e-6])
    for given, said in ((one, print), (one.clone(), repr), (other, print)):
        assert_close(kept(given, said)["twice"], 2.0 * given, rtol=0.0, atol=0.0)
    assert [given is one or given is other for given in asked] == [True, True]
