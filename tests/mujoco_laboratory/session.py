"""A whole synthetic session: C3D files, ``markers.yaml``, ``config.yaml`` and, apart from them, ``truth/``.

What is hidden and by how much stands in ``truth/truth.json`` only.
"""

import json
import zlib
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import yaml

from mujoco_laboratory.body import Person, draw_person
from mujoco_laboratory.hidden_body import Entry, extra, gliding, gravity, moving
from mujoco_laboratory.hidden_forces import Scene, load
from mujoco_laboratory.hidden_readings import clock_of, displaced, lag, misread, processed, true_plates
from mujoco_laboratory.intent import Script, make_script
from mujoco_laboratory.laboratory import (
    Plate,
    Recording,
    lay_plates,
    resample,
    share_load,
    stand_on,
    to_plate,
    with_gaps,
    with_noise,
    write_c3d,
)
from mujoco_laboratory.motion import Balanced, balance
from mujoco_laboratory.physics import RATE, mjcf
from mujoco_laboratory.sizes import FIT, HELDOUT, SIZES
from mujoco_laboratory.skin import skin

TRIALS = (("static", "static"), *((name, "fit") for name in FIT), *((name, "heldout") for name in HELDOUT))
"""Name, which is its kind, and role."""
STATIC_S, DURATION_S, MARGIN_S = 3.0, 10.0, 1.0
"""Of a trial, and before and after it, where nobody records [s]."""
ATTEMPTS = 12
LONG_STEPS = 2
"""Attempts with steps that reach the plates in front."""
LIMITS = {"ankle_flexion": (-60.0, 49.0), "ankle_inversion": (-40.0, 50.0), "knee_flexion": (0.0, 140.0),
          "hip_abduction": (-35.0, 60.0), "hip_rotation": (-55.0, 55.0)}  # fmt: skip
"""Of the legs [deg]."""
SCALE_ERROR = 0.3
"""Of the recorded mass [kg]."""


class Undone(RuntimeError):
    """No motion that was drawn is one that the person can do."""


@dataclass(frozen=True)
class World:
    """What all trials of a session share."""

    seed: int
    person: Person
    plates: tuple[Plate, ...]
    model: mujoco.MjModel
    effects: list[Entry]
    skin: list[Entry]
    """What every body does: hidden, but no secret."""


def simulate(out: Path, seed: int, effects: list[Entry], skin_m: float = 0.0) -> Path:
    """Write a session in which effects are hidden; returns its config.

    Args:
        out: folder, made where it does not exist.
        seed: of the person, the motions, the laboratory and its noise.
        effects: dicts with ``effect``, ``where``, ``when`` and ``parameters``, as ``draw_effect`` makes them.
        skin_m: how far skin slides under a thigh's markers [m], see ``skin``.

    Raises:
        KeyError: an effect that does not exist.
        RuntimeError: the person cannot do a motion.
    """
    unknown = [e["effect"] for e in effects if e["effect"] not in SIZES]
    if unknown:
        raise KeyError(f"no such effect: {', '.join(unknown)}; known are {', '.join(SIZES)}")
    rng = np.random.default_rng(seed)
    person = draw_person(rng)
    plates = lay_plates(rng)
    recorded = round(person.mass + SCALE_ERROR * float(np.clip(rng.normal(), -2, 2)) - _excess(effects), 1)
    model = mujoco.MjModel.from_xml_string(mjcf(person, extra(person, effects)))
    slides = skin(person, model, skin_m, np.random.default_rng((seed, 11))) if skin_m else []
    world = World(seed, person, plates, model, effects, slides)
    (out / "truth").mkdir(parents=True, exist_ok=True)
    facts = {name: _trial(world, k, out) for k, (name, _) in enumerate(TRIALS)}
    _write_truth(world, recorded, facts, out)
    return _write_config(world, recorded, out)


def _excess(effects: list[Entry]) -> float:
    """By how much the record is below the true mass because of ``body_mass`` [kg]."""
    own = [e["parameters"] for e in effects if e["effect"] == "body_mass"]
    return sum(p["excess_kg"] if "excess_kg" in p else p["mass_kg"] - p["recorded_kg"] for p in own)


def _trial(world: World, number: int, out: Path) -> dict:
    """Simulate and write one trial; returns facts for the truth."""
    name = TRIALS[number][0]
    key = (world.seed, zlib.crc32(name.encode()))
    duration = STATIC_S if name == "static" else DURATION_S
    script, moved = _possible(world, number, duration, key)
    rng = np.random.default_rng((*key, 2))
    recording, clean = _record(world, name, script, moved, rng, key)
    write_c3d(out / f"{name}.c3d", recording, world.plates)
    inside = _inside(script.time, duration)
    np.savez_compressed(out / "truth" / f"{name}.npz", time=script.time[inside], q=moved.q[inside],
                        wrench=moved.wrench[inside], markers=clean)  # fmt: skip
    return {"pressure_miss_mm": 1e3 * moved.miss, "momentum_miss_of_weight": moved.moved.miss}


def _possible(world: World, number: int, duration: float, key: tuple[int, int]) -> tuple[Script, Balanced]:
    """Draw motions until the person can do one, which raises ``Undone`` where there is none."""
    time = np.arange(-round(MARGIN_S * RATE), round((duration + MARGIN_S) * RATE)) / RATE
    pull = gravity(world.effects, time, number, world.seed)
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng((*key, 1, attempt))
        short = attempt >= LONG_STEPS
        script = make_script(rng, world.person, TRIALS[number][0], time, duration, short)
        script = moving(script, world.effects, key)
        try:
            moved = balance(
                world.model, script, pull, gliding(world.model, world.effects),
                lambda m: load(Scene(TRIALS[number][0], world.person, m, key), world.effects),
            )  # fmt: skip
        except RuntimeError as problem:
            found = str(problem)
            continue
        found = _beyond(world.model, moved.q)
        if not found:
            return script, moved
    raise Undone(f"{TRIALS[number][0]} with seed {world.seed} cannot be done: {found}")


def _beyond(model: mujoco.MjModel, q: np.ndarray) -> str:
    """Joints of the legs that leave their limits."""
    found = []
    for turn, (low, high) in LIMITS.items():
        joint, _, axis = turn.partition("_")
        for side in ("l", "r"):
            angle = np.degrees(q[:, model.joint(f"{joint}_{side}_{axis}").qposadr[0]])
            if angle.min() < low or angle.max() > high:
                found.append(f"{joint}_{side}_{axis} {angle.min():.0f} to {angle.max():.0f} deg")
    return ", ".join(found)


def _inside(time: np.ndarray, duration: float) -> slice:
    first = int(np.argmin(np.abs(time)))
    return slice(first, first + round(duration * RATE))


def _record(
    world: World, name: str, script: Script, moved: Balanced, rng: np.random.Generator, key: tuple[int, int]
) -> tuple[Recording, np.ndarray]:
    """What is measured, and where the markers are (frames, markers, 3) without noise or gaps."""
    inside = _inside(script.time, script.time[-1] - MARGIN_S + 1.0 / RATE)
    labels = tuple(world.model.site(k).name for k in range(world.model.nsite))
    scene = Scene(name, world.person, moved.moved, key)

    def angle(joint: str) -> np.ndarray:
        return moved.q[:, world.model.joint(joint).qposadr[0]]

    clean = displaced([*world.effects, *world.skin], scene, labels, moved.moved.markers, angle)[inside]
    clock = clock_of(len(clean))
    own = _plates(world, name, script, moved, clock, rng)
    recording = with_noise(rng, Recording(labels, clean, clock, own))
    seen = with_gaps(rng, processed(world.effects, name, labels, recording.markers))
    return Recording(labels, seen, clock, recording.own), clean


def _plates(
    world: World, name: str, script: Script, moved: Balanced, clock: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """What the plates read (samples, plates, 6) without noise."""
    onto = stand_on(share_load(script, moved.wrench), script)
    fine = resample(script.time, onto, clock - lag(world.effects, name))
    true = true_plates(world.effects, world.plates)
    own = np.stack([to_plate(plate, fine[:, k]) for k, plate in enumerate(true)], 1)
    return misread(world.effects, clock, own, world.person.mass)


def _write_config(world: World, recorded: float, out: Path) -> Path:
    person = world.person
    markers = {label: {"segment": m.segment, "landmark": m.landmark} if m.landmark else m.segment
               for label, m in person.markers.items()}  # fmt: skip
    (out / "markers.yaml").write_text(yaml.safe_dump(markers, sort_keys=False))
    config = {
        "subject": {"name": f"M{world.seed:02d}", "mass_kg": recorded, "mass_sd_kg": SCALE_ERROR,
                    "height_m": round(person.height, 3), "sex": person.sex},
        "model": "whole_body",
        "markers": "markers.yaml",
        "trials": [{"name": name, "file": f"{name}.c3d", "role": role} for name, role in TRIALS],
        "diagnosis": {"enabled": True},
        "out": "out",
        "seed": world.seed,
    }  # fmt: skip
    path = out / "config.yaml"
    path.write_text(yaml.safe_dump(config, sort_keys=False))
    return path


def _write_truth(world: World, recorded: float, facts: dict, out: Path) -> None:
    person = world.person
    truth = {
        "seed": world.seed,
        "effects": [_told(e, person.mass, recorded) for e in world.effects],
        "sex": person.sex, "height_m": person.height, "mass_kg": person.mass, "recorded_kg": recorded,
        "segments": {n: {"parent": s.parent, "centre_m": s.centre.tolist(), "mass_kg": s.mass, "com_m": s.com.tolist(),
                         "inertia_kgm2": s.inertia.tolist()} for n, s in person.segments.items()},
        "axes": {joint: axis.tolist() for joint, axis in person.axes.items()},
        "markers": {label: {"segment": m.segment, "p_BM_B": m.place.tolist()} for label, m in person.markers.items()},
        "plates": {f"plate_{k + 1}": p.corners().tolist() for k, p in enumerate(world.plates)},
        "trials": facts,
    }  # fmt: skip
    (out / "truth" / "truth.json").write_text(json.dumps(truth, indent=1))


def _told(entry: Entry, mass: float, recorded: float) -> Entry:
    """The effect by the catalogue's keys."""
    if entry["effect"] != "body_mass":
        return entry
    return entry | {"parameters": entry["parameters"] | {"mass_kg": mass, "recorded_kg": recorded}}
