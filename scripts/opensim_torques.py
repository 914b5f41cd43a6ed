"""Torques on the coordinates of two laboratories' OpenSim models, beside those that OpenSim wrote for the same motion.

    PYTHONPATH=.:scripts python scripts/opensim_torques.py

Beside the reference stand the torques that OpenSim's InverseDynamicsTool gives today for the same files, where it is
installed. What is left between it and torchid is OpenSim's own: where several turns of a joint follow functions, as
in the knees of Rajagopal's model, its accelerations are not the rates of its velocities (tests/test_osim_run.py).

Coordinates are the data sets' own, filtered and differentiated as OpenSim's InverseDynamicsTool does it: padded by half
their length, a Butterworth filter of third order forwards and backwards, a natural quintic spline through the result;
plates act on the feet that the set-up file names, straight between their samples. Writes out/opensim_torques.json.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import scipy.interpolate
import scipy.signal
import torch
from harness.opensim_forces import as_free, osim_inverse_dynamics
from lxml import etree
from numpy.typing import NDArray

from torchid.config.sections import PROJECT_DATA
from torchid.io.storage import Storage, read_storage, write_storage
from torchid.model.opensim.model import OsimModel
from torchid.model.opensim.posing import coupled
from torchid.model.opensim.reading import read_osim

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("TORCHID_DATA", PROJECT_DATA))
Series = NDArray[np.float64]
ALLOWED = 2.0
"""Goal of the comparison: RMS deviation in percent of the reference's range."""


@dataclass(frozen=True)
class Case:
    """A motion, the loads on it, the model, and OpenSim's torques."""

    name: str
    model: str
    coordinates: str
    loads: str
    reference: str
    cutoff_hz: float
    """Of OpenSim's filter."""
    centres: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Centres of mass that the model had when the reference was made [m]."""


RAJAGOPAL, GAIT = "opensim_rajagopal_walk", "opensim_subject01_gait2354"
TORSO = (-0.0323916, 0.34551037, 0.0)
"""Centre of the torso in ``subject01_simbody_scaled.osim``, before OpenSim's residual reduction moved it [m]."""
_GAIT = (
    f"{GAIT}/reference/opensim-models_subject01_simbody_adjusted.osim",
    f"{GAIT}/reference/opensim-models_subject01_walk1_ik.mot",
    f"{GAIT}/subject01_walk1_grf.xml",
    f"{GAIT}/reference/opensim-models_inverse_dynamics.sto",
    6.0,
)
CASES = (
    Case(
        "rajagopal_walk",
        f"{RAJAGOPAL}/subject_walk_scaled.osim",
        f"{RAJAGOPAL}/reference/coordinates.sto",
        f"{RAJAGOPAL}/grf_walk.xml",
        f"{RAJAGOPAL}/reference/id_walk.sto",
        6.0,
    ),
    Case("gait2354", *_GAIT),
    Case("gait2354, torso as before residual reduction", *_GAIT, {"torso": TORSO}),
)
TOOL = """
import opensim
opensim.Logger.setLevelString("Off")
model, tool, skipped = opensim.Model({model!r}), opensim.InverseDynamicsTool(), opensim.ArrayStr()
skipped.append("Muscles")
skipped.append("ALL")
for name, centre in {centres!r}.items():
    model.getBodySet().get(name).setMassCenter(opensim.Vec3(*centre))
tool.setModel(model)
tool.setCoordinatesFileName({coordinates!r})
tool.setLowpassCutoffFrequency({cutoff_hz!r})
tool.setExternalLoadsFileName({loads!r})
tool.setStartTime({start!r})
tool.setEndTime({end!r})
tool.setExcludedForces(skipped)
tool.setResultsDir({folder!r})
tool.setOutputGenForceFileName("id.sto")
tool.run()
"""
"""OpenSim's tool in a process of its own."""


def states(model: OsimModel, source: Storage, cutoff_hz: float | None) -> tuple[Series, tuple[torch.Tensor, ...]]:
    """Times of the file, and all coordinates of the model with rates and accelerations there; None filters nothing."""
    time, columns = np.asarray(source.time), [column.removesuffix("/value").split("/")[-1] for column in source.columns]
    kinds = {one.name: one.unit for one in model.coordinates}
    found = [model.defaults.expand(len(time), -1).clone() * (order == 0) for order in range(3)]
    for k, name in enumerate(columns):
        if name not in model.coordinate_names:
            continue
        scale = np.pi / 180.0 if source.in_degrees and kinds[name] == "rad" else 1.0
        for out, values in zip(
            found, derivatives(time, scale * np.asarray(source.values)[:, k], cutoff_hz), strict=True
        ):
            out[:, model.coordinate_names.index(name)] = torch.tensor(values)
    return time, following(model, *found)


def following(model: OsimModel, q: torch.Tensor, v: torch.Tensor, a: torch.Tensor) -> tuple[torch.Tensor, ...]:
    """The same state with coordinates that follow others where these have them."""

    def rate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return torch.func.jvp(lambda x: coupled(model, x), (q,), (v,))[1]

    return coupled(model, q), *torch.func.jvp(rate, (q, v), (v, a))


def derivatives(time: Series, values: Series, cutoff_hz: float | None) -> list[Series]:
    """Values, rates and accelerations of one coordinate; the spline goes on through what the filter was padded by."""
    inside, knots = slice(None), time
    if cutoff_hz is not None:
        inside = slice(len(time) // 2, len(time) // 2 + len(time))
        knots, values = padded(time), filtered(padded(values), cutoff_hz, (len(time) - 1) / (time[-1] - time[0]))
    ends = [(3, 0.0), (4, 0.0)]
    spline = scipy.interpolate.make_interp_spline(knots, values, k=5, bc_type=(ends, ends))
    return [spline(knots[inside], order) for order in range(3)]


def padded(values: Series) -> Series:
    """A course with half its length at either end, turned over there (OpenSim, Signal::Pad)."""
    pad = len(values) // 2
    return np.concatenate([2 * values[0] - values[pad:0:-1], values, 2 * values[-1] - values[-2 : -pad - 2 : -1]])


def filtered(values: Series, cutoff_hz: float, rate_hz: float) -> Series:
    """Butterworth of third order, forwards and backwards, from rest at its start (OpenSim, Signal::LowpassIIR)."""
    b, a = scipy.signal.butter(3, cutoff_hz, fs=rate_hz)
    start = scipy.signal.lfilter_zi(b, a)
    for _ in range(2):
        values = scipy.signal.lfilter(b, a, values, zi=start * values[0])[0][::-1]
    return values


def external(setup: Path, time: Series) -> dict[str, torch.Tensor]:
    """Wrench on each body about ground's origin, in its axes."""
    root = etree.parse(str(setup)).getroot()
    data, found = read_storage(setup.parent / root.findtext(".//datafile").strip()), dict[str, torch.Tensor]()
    for force in root.iter("ExternalForce"):
        word = {tag: (force.findtext(tag) or "").strip() for tag in ("applied_to_body", *IDENTIFIERS)}
        f, p, m = (at_times(data, word[tag], time) for tag in IDENTIFIERS)
        found[word["applied_to_body"]] = torch.tensor(np.hstack([f, m + np.cross(p, f)]))
    return found


IDENTIFIERS = ("force_identifier", "point_identifier", "torque_identifier")


def at_times(data: Storage, name: str, time: Series) -> Series:
    """Three columns, straight between samples."""
    columns = [data.columns.index(f"{name}{axis}") for axis in "xyz"]
    return np.stack([np.interp(time, data.time, np.asarray(data.values)[:, k]) for k in columns], axis=1)


def compared(case: Case, again: bool = True) -> dict[str, dict[str, float]]:
    """Of each coordinate the reference's range, and deviations from the reference and, where OpenSim is asked again,
    from its tool in percent of it."""
    model = with_centres(read_osim(DATA / case.model)[0], case.centres)
    source = read_storage(DATA / case.coordinates)
    time, (q, v, a) = states(model, source, case.cutoff_hz)
    ours = osim_inverse_dynamics(as_free(model), q, v, a, external(DATA / case.loads, time))
    reference, found = read_storage(DATA / case.reference), {}
    todays = tool(case, model, time, states(model, source, None)[1][0]) if again else None
    for k, column in enumerate(reference.columns):
        name, theirs = column.rsplit("_", 1)[0], np.asarray(reference.values)[:, k]
        own = np.interp(reference.time, time, ours[name].numpy())
        span = float(np.ptp(theirs))
        found[name] = {"range": span} | percent("reference", own - theirs, span)
        if todays is not None:
            at = list(todays.columns).index(column)
            new = np.interp(reference.time, todays.time, np.asarray(todays.values)[:, at])
            found[name] |= percent("tool", own - new, span) | percent("tool_from_reference", new - theirs, span)
    return found


def percent(name: str, error: Series, span: float) -> dict[str, float]:
    """RMS and largest deviation in percent."""
    rms, most = float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())
    return {f"{name}_rms_pct": 100.0 * rms / span, f"{name}_max_pct": 100.0 * most / span}


def with_centres(model: OsimModel, centres: Mapping[str, tuple[float, float, float]]) -> OsimModel:
    """The model with other centres of mass."""
    centre = model.stated.centre.clone()
    for name, place in centres.items():
        centre[model.bodies.index(name)] = centre.new_tensor(place)
    return replace(model, stated=replace(model.stated, centre=centre))


def tool(case: Case, model: OsimModel, time: Series, q: torch.Tensor) -> Storage | None:
    """What OpenSim's tool gives today; None without OpenSim."""
    if find_spec("opensim") is None:
        return None
    with TemporaryDirectory() as folder:
        coordinates = Path(folder) / "coordinates.mot"
        write_storage(coordinates, model.coordinate_names, time, q.numpy(), title="coordinates")
        script = TOOL.format(
            model=str(DATA / case.model), centres=case.centres, coordinates=str(coordinates), cutoff_hz=case.cutoff_hz,
            loads=str(DATA / case.loads), start=float(time[0]), end=float(time[-1]), folder=folder,
        )  # fmt: skip
        subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)  # noqa: S603
        return read_storage(Path(folder) / "id.sto")


def main() -> None:
    """Print the table and write it."""
    rows = {}
    for case in CASES:
        rows[case.name] = {"case": asdict(case), "coordinates": compared(case)}
        print(f"\n{case.name}, filter {case.cutoff_hz:g} Hz; RMS and largest deviation in % of the reference's range")
        print(f"{'coordinate':20s} {'range':>8s} {'reference':>18s} {'tool today':>18s} {'tool - reference':>18s}")
        for name, one in rows[case.name]["coordinates"].items():
            pairs = [
                f"{one.get(f'{key}_rms_pct', np.nan):9.4f} {one.get(f'{key}_max_pct', np.nan):8.3f}"
                for key in ("reference", "tool", "tool_from_reference")
            ]
            flag = "" if one["reference_rms_pct"] <= ALLOWED else "  beyond the goal"
            print(f"{name:20s} {one['range']:8.2f} {' '.join(pairs)}{flag}")
    (ROOT / "out").mkdir(exist_ok=True)
    (ROOT / "out" / "opensim_torques.json").write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
