"""An effect that a session hides by lot, and whether a diagnosis found it.

Sizes are those that a laboratory meets; one lot in ``len(LOTS)`` hides nothing.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.random import Generator

from torchid.effects.catalogue import effect
from torchid.effects.flywheel import Flywheel
from torchid.effects.forces import Drag
from torchid.effects.markers import MarkerShift
from torchid.effects.masses import Payload
from torchid.effects.place import Interval
from torchid.effects.plates import PlateGain, PlatePose
from torchid.effects.session import GravityTilt
from torchid.effects.timing import TimeOffset
from torchid.simulate.options import PlantedOptions, SimulateOptions

Lot = Callable[[Generator, SimulateOptions], tuple[PlantedOptions, ...]]
LABELS = ("LTHI", "RTHI", "LTIB", "RTIB", "LUPA", "RUPA", "RBAK")
"""Markers that are knocked."""


def draw_hidden(seed: int, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    """The effect that ``seed`` hides in a session, or none."""
    rng = np.random.default_rng((seed, 17))
    return LOTS[rng.integers(len(LOTS))](rng, options)


def _nothing(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    return ()


def _clock(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    return (PlantedOptions(TimeOffset.name, parameters={"lag_s": _signed(rng, 0.012, 0.02)}),)


def _gain(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    return (PlantedOptions(PlateGain.name, _plate(rng), parameters={"gain": 1.0 + _signed(rng, 0.02, 0.05)}),)


def _pose(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    shift = [*_flat(rng, 0.01, 0.02), 0.0]
    turn = [0.0, 0.0, _signed(rng, 0.005, 0.02)]
    return (PlantedOptions(PlatePose.name, _plate(rng), parameters={"shift_m": shift, "rotation_rad": turn}),)


def _load(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    point = [_signed(rng, 0.05, 0.15), 0.0, float(rng.uniform(0.1, 0.3))]
    values = {"mass_kg": float(rng.uniform(3.0, 6.0)), "point_seg_m": point}
    return (PlantedOptions(Payload.name, ("thorax",), parameters=values),)


def _tilt(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    roll, pitch = _flat(rng, math.radians(0.5), math.radians(1.0))
    return (PlantedOptions(GravityTilt.name, parameters={"roll_rad": roll, "pitch_rad": pitch}),)


def _drag(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    values: dict[str, float | list] = {"coefficient_Ns_m": float(rng.uniform(25.0, 50.0))}
    return (PlantedOptions(Drag.name, (str(rng.choice(["thorax", "pelvis"])),), parameters=values),)


def _knocked(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    when = (Interval(str(rng.choice(options.fit)), 0.0, options.duration_s),)
    shift = _direction(rng, 3) * rng.uniform(0.01, 0.02)
    return (PlantedOptions(MarkerShift.name, (str(rng.choice(LABELS)),), when, {"shift_seg_m": shift.tolist()}),)


def _spin(rng: Generator, options: SimulateOptions) -> tuple[PlantedOptions, ...]:
    momentum = _direction(rng, 3) * rng.uniform(2.0, 5.0)
    return (PlantedOptions(Flywheel.name, ("thorax",), parameters={"momentum_seg_Nms": momentum.tolist()}),)


LOTS: tuple[Lot, ...] = (_nothing, _clock, _gain, _pose, _load, _tilt, _drag, _knocked, _spin)


def _signed(rng: Generator, least: float, most: float) -> float:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(least, most))


def _flat(rng: Generator, least: float, most: float) -> list[float]:
    return (_direction(rng, 2) * rng.uniform(least, most)).tolist()


def _direction(rng: Generator, size: int) -> np.ndarray:
    v = rng.standard_normal(size)
    return v / np.linalg.norm(v)


def _plate(rng: Generator) -> tuple[str]:
    return (f"plate_{rng.integers(1, 3)}",)


def judge(truth: Sequence[Mapping[str, Any]], causes: Sequence[Mapping[str, Any]]) -> tuple[bool, list[str]]:
    """Whether the first named cause, or one that it says it cannot be told from, is what was hidden; and the sizes.

    What every living body has some of, such as skin that moves, is no answer to what was hidden, unless it says that it
    cannot be told from it: it is there besides.

    Args:
        truth: of ``truth/subject.json``, ``options.effects``.
        causes: of ``diagnosis.json``, those that are believed.
    """
    hidden = truth[0] if truth else None
    causes = [cause for cause in causes if not effect(cause["effect"]).bodily or _says(hidden, cause)]
    if not truth or not causes:
        return not truth and not causes, []
    planted, right = truth[0], _says(hidden, causes[0])
    named = next((cause for cause in causes if _same(planted, cause)), None)
    return right, [] if named is None else _sizes(planted["parameters"], named["parameters"])


def _says(planted: Mapping[str, Any] | None, cause: Mapping[str, Any]) -> bool:
    return planted is not None and any(_same(planted, one) for one in (cause, *cause["indistinguishable"]))


def _same(planted: Mapping[str, Any], named: Mapping[str, Any]) -> bool:
    return planted["effect"] == named["effect"] and set(planted["where"]) == set(named["where"])


def _sizes(true: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """Each parameter as found, with its standard deviation, beside the truth."""
    return [
        f"{key}: {_listed(found[key]['value'])} ± {_listed(found[key]['sd'])}, in truth {_listed(true[key])}"
        for key in true
        if key in found
    ]


def _listed(value: Any) -> str:
    flat = np.asarray(value, dtype=float).ravel()
    return f"{flat[0]:.4g}" if len(flat) == 1 else f"({', '.join(f'{x:.3g}' for x in flat)})"
