"""Numbers of a run as statistics programs and spreadsheets take them: tables ``results`` and ``cycles``."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch

from torchid.cycles.measures import STRIDE, unit_of
from torchid.effects.quantities import units_of
from torchid.session import Outcome
from torchid.session.joint_cycles import JointCycles
from torchid.storage.files import plain

AXES = "xyz"
MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Components of an inertia."""


class Scalar(NamedTuple):
    """One number."""

    group: str
    """quality, body, segment, length, geometry, trial, cause or stride."""
    item: str
    """Of what in the group: a criterion, a segment, a parameter, a trial, a cause with its place, a stride."""
    quantity: str
    value: float | None
    """None where it is not known."""
    sd: float | None
    """Standard deviation; None where none is known."""
    unit: str
    meaning: str
    """The quantity in words."""


def results_table(outcome: Outcome, tables: Mapping[str, Any], strides: JointCycles | None) -> pd.DataFrame:
    """Return every single number of a run, a line each, with its standard deviation, its unit and its meaning.

    Args:
        outcome: the run.
        tables: contents of its JSON files by their names; those that it does not have are left out.
        strides: of its trials; None where there are none.
    """
    found = [*scalars(outcome, plain(tables)), *(() if strides is None else stride_scalars(strides))]
    table = pd.DataFrame(found, columns=list(Scalar._fields))
    table.insert(0, "subject", outcome.config.subject.name)
    return table.astype({"value": float, "sd": float})


def scalars(outcome: Outcome, tables: Mapping[str, Any]) -> Iterator[Scalar]:
    """Every single number of a run, in the order in which its page tells them.

    Args:
        outcome: the run.
        tables: as of ``results_table``, made of what JSON holds.
    """
    geometry, body = tables["geometry.json"], tables.get("inertia.json", {})
    for one in () if outcome.quality is None else outcome.quality.criteria:
        yield _bare("quality", one.name, "figure", plain(one.value), "", f"{one.level.value}: {one.words}")
    yield from _body(body)
    for name, own in geometry["segments"].items():
        yield Scalar("length", name, "length", own["length_m"], own["sd"], "m", "from its joint to the next one")
    for name, own in geometry["xi"].items():
        yield Scalar("geometry", name, "value", own["value"], own["sd"], own["unit"], "parameter of the geometry")
    yield from _trials(geometry["marker_rmse_mm"], body.get("trials", {}))
    yield from _causes(tables.get("diagnosis.json", {}).get("causes", []))


def cycles_table(found: JointCycles) -> pd.DataFrame:
    """Return the courses of all strides, to seven digits: a line each for a joint at a percent of a stride.

    Args:
        found: the strides.
    """
    strides, points, joints = found.angle_deg.shape
    each = points * joints  # lines of a stride
    courses = {"angle_deg": found.angle_deg, "moment_Nm": found.moment_Nm, "power_W": found.power_W}
    return pd.DataFrame(
        {
            "trial": np.repeat([cycle.trial for cycle in found.cycles], each),
            "side": np.repeat([cycle.side for cycle in found.cycles], each),
            "start_s": np.repeat(found.start_s.numpy().round(4), each),
            "percent": np.tile(np.repeat(np.linspace(0, 100, points).round().astype(int), joints), strides),
            "joint": np.tile(list(found.joints), strides * points),
            **{name: values.reshape(-1).to(torch.float32).numpy() for name, values in courses.items()},
        }
    )


def stride_scalars(found: JointCycles) -> Iterator[Scalar]:
    """How every stride was walked.

    Args:
        found: the strides.
    """
    for cycle, start, values in zip(found.cycles, found.start_s.tolist(), found.values.tolist(), strict=True):
        for name, value in zip(STRIDE, plain(values), strict=True):
            item = f"{cycle.trial} {cycle.side} at {start:.2f} s"
            yield _bare("stride", item, name, value, unit_of(name), "from a strike to the next")


def _bare(group: str, item: str, quantity: str, value: float | None, unit: str, meaning: str) -> Scalar:
    return Scalar(group, item, quantity, value, None, unit, meaning)


def _body(table: dict[str, Any]) -> Iterator[Scalar]:
    """Masses, centres of mass and inertias."""
    if not table:
        return
    total = table["total_mass"]
    yield Scalar("body", "whole", "mass", total["value_kg"], total["sd_kg"], "kg", "identified mass of the subject")
    for name, own in table["segments"].items():
        sd = own["sd"]
        yield Scalar("segment", name, "mass", own["mass_kg"], sd["mass_kg"], "kg", "identified mass")
        for k, axis in enumerate(AXES):
            said = f"centre of mass from the segment's origin along its {axis} axis"
            yield Scalar("segment", name, f"com_{axis}", own["com_m"][k], sd["com_m"][k], "m", said)
        for pair in MOMENTS:
            i, j = map(AXES.index, pair)
            said = f"inertia {pair} about the centre of mass, in the segment's axes"
            value, deviation = (some["inertia_kgm2"][i][j] for some in (own, sd))
            yield Scalar("segment", name, f"inertia_{pair}", value, deviation, "kg m^2", said)
        yield _bare("segment", name, "prior_mass", own["prior"]["mass_kg"], "kg", "mass of the anthropometric table")
        yield _bare("segment", name, "progress", own["progress"], "", "share that the recordings determine, 0 to 1")


def _trials(markers: dict[str, Any], forces: dict[str, Any]) -> Iterator[Scalar]:
    """How far every trial is from the model."""
    for name, own in markers.items():
        yield _bare("trial", name, "marker_rms", own["identified"], "mm", "distance of markers from the model, RMS")
        yield _bare("trial", name, "marker_max", own["max"], "mm", "largest distance of a marker from the model")
        left = forces.get(name)
        if left is not None:
            yield _bare("trial", name, "force_rms", left["force_rmse_N"], "N", "residual force, RMS")
            yield _bare("trial", name, "moment_rms", left["moment_rmse_Nm"], "N m", "residual moment at the root, RMS")
            yield _bare("trial", name, "frames_used", left["used"], "", "frames whose forces were used")


def _causes(causes: list[dict[str, Any]]) -> Iterator[Scalar]:
    """What the diagnosis names, with its parameters."""
    for one in causes:
        when = dict.fromkeys(span["trial"] for span in one["when"] or ())
        item = " ".join((one["effect"], *one["where"], *(f"in {trial}" for trial in when)))
        said = f"{one['level']}, {'corrected' if one['applied'] else 'not corrected'}"
        yield _bare("cause", item, "confidence", one["confidence"], "", f"probability of it, or of a twin: {said}")
        for key, entry in one["parameters"].items():
            values, sds = (_flat(entry[k]) for k in ("value", "sd"))
            for k, (value, sd) in enumerate(zip(values, sds, strict=True)):
                name = f"{key}_{k}" if len(values) > 1 else key
                yield Scalar("cause", item, name, value, sd, units_of(key)[0], f"size: {said}")


def _flat(value: Any) -> list[float | None]:
    """The numbers of a value, row by row where it is a matrix."""
    return [number for one in value for number in _flat(one)] if isinstance(value, list) else [value]
