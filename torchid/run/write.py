"""Result files of section 3 of the contracts: JSON tables, netCDF series, OpenSim storages, model files."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import xarray
from jaxtyping import Float
from torch import Tensor

from torchid.contact.sharing.records import WrenchSource
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import predict
from torchid.errors import DataError
from torchid.extension.open_geometry import right_subject
from torchid.geometry.tracking import modelled
from torchid.io.storage import write_storage
from torchid.kinematics.recursion import body_transforms
from torchid.model.model import Model
from torchid.model.opensim.model import CoordinateKind
from torchid.model.opensim.writing_back import identified_model, write_back
from torchid.model.osim import osim_coordinates, osim_forces, osim_names, write_osim
from torchid.model.urdf import write_urdf
from torchid.motion import Motion
from torchid.recording import Plate
from torchid.run.bids import bids_names, write_bids_about, write_bids_trial
from torchid.run.opensim_setup import SUFFIXES, ToolFiles, write_tool_files
from torchid.run.scalars import cycles_table, results_table
from torchid.session import Followed, Outcome
from torchid.session.joint_cycles import joint_cycles
from torchid.session.laboratory import NAME as LABORATORY
from torchid.session.laboratory import SessionEvidence, laboratory_dataset, laboratory_plate
from torchid.session.person import NAME as PERSON
from torchid.session.person import person_dataset, person_evidence
from torchid.session.tables import diagnosis_table, geometry_table, inertia_table
from torchid.storage.files import safe_name, write_json
from torchid.storage.netcdf import write_netcdf
from torchid.storage.results import OutputFolder
from torchid.storage.snapshot import release
from torchid.storage.table_forms import Form
from torchid.storage.tables import write_table

PIECE = 8192
"""Frames of a motion file that are put together at a time."""
TABLES = (
    "geometry.json", "inertia.json", "diagnosis.json", "model.urdf", "model.osim", "report.html", "provenance.json",
    LABORATORY, PERSON,
)  # fmt: skip
COMPONENTS = ("fx", "fy", "fz", "mx", "my", "mz")
"""Names of a wrench's components in files."""
_SOURCES = ", ".join(f"{one.value} {one.name.lower()}" for one in WrenchSource)
SERIES = ("motion_{}.nc", "forces_{}.nc", "{}_ik.mot", "{}_id.sto")
"""Names of a trial's files beside those for OpenSim's tool (``opensim_setup.SUFFIXES``)."""
CONSISTENT = ("{}_consistent.mot", "{}_consistent_id.sto")
"""Names of a trial's files for OpenSim that hold the motion that obeys its forces."""
COURSES = ("q", "v", "a", "torque")
"""Courses of a motion in files."""


def result_names(
    trials: Iterable[str], forms: Iterable[Form] = (), subject: str | None = None, consistent: bool = False
) -> list[str]:
    """Every file that a run may write, but for its config.

    Args:
        trials: their names.
        forms: of its tables, beside CSV.
        subject: whom its data set of Motion-BIDS shows; None where it writes none.
        consistent: True where it writes the motion that obeys its forces.
    """
    trials, own = list(trials), CONSISTENT if consistent else ()
    tables = [f"{name}.{form}" for form in ("csv", *forms) for name in ("results", "cycles")]
    series = [name.format(safe_name(trial)) for trial in trials for name in (*SERIES, *SUFFIXES, *own)]
    return [*TABLES, *tables, *series, *([] if subject is None else bids_names(subject, trials))]


def write_outcome(outcome: Outcome, folder: OutputFolder, failure: DataError | None) -> None:
    """Write everything that is known; ``failure`` is why the rest is not."""
    tables = {"geometry.json": geometry_table(outcome)}
    if outcome.identified is not None:
        tables["inertia.json"] = inertia_table(outcome)
    if outcome.diagnosis is not None:
        tables["diagnosis.json"] = diagnosis_table(outcome)
    for name, table in tables.items():
        write_json(folder.path(name), table)
    strides = joint_cycles(outcome)
    found = outcome.diagnosis
    if found is not None and found.laboratory is not None:
        kept = SessionEvidence(found.laboratory, tuple(map(laboratory_plate, found.plates)))
        write_netcdf(folder.path(LABORATORY), [laboratory_dataset(kept)])
    if (person := person_evidence(outcome, right_subject(outcome))) is not None:
        write_netcdf(folder.path(PERSON), [person_dataset(person)])
    forms = outcome.config.tables
    write_table(results_table(outcome, tables, strides), "results", forms, folder.path)
    if strides is not None:
        write_table(cycles_table(strides), "cycles", forms, folder.path)
    if outcome.config.bids:
        write_bids_about(outcome.config.subject, folder.path)
    for name in outcome.session.trials:
        _write_trial(outcome, name, folder)
        release()
    tree, geometry = outcome.fit.model.tree, outcome.fit.geometry
    write_urdf(tree.uncoupled, geometry, outcome.phi, folder.path("model.urdf"), outcome.fit.places)
    if outcome.fit.model.osim is None:
        write_osim(tree, geometry, outcome.phi, folder.path("model.osim"), outcome.fit.places)
    else:
        named = zip(outcome.fit.attachment.landmark, outcome.fit.place, strict=True)
        own = {name: place for name, place in named if name is not None}
        write_back(identified_model(outcome.fit.model.osim, geometry, outcome.phi, own), folder.path("model.osim"))


def _write_trial(outcome: Outcome, name: str, folder: OutputFolder) -> None:
    item = outcome.followed[name]
    motion, forces, kinematics, dynamics = (folder.path(file.format(safe_name(name))) for file in SERIES)
    pieces = [slice(k, k + PIECE) for k in range(0, len(item.motion.time), PIECE)]
    write_netcdf(motion, (_piece(outcome, name, piece) for piece in pieces))
    if item.wrench is not None:
        write_netcdf(forces, [forces_dataset(outcome, item)])
    _write_storages(outcome.fit.model, name, item.motion, outcome.torque[name], (kinematics, dynamics))
    if (own := outcome.consistent.get(name)) is not None:
        both = [folder.path(file.format(safe_name(name))) for file in CONSISTENT]
        _write_storages(outcome.fit.model, f"{name} consistent", own.motion, own.torque, both)
    under = outcome.under.get(name)
    if under is not None and under.contacts:
        grf, loads, setup = (folder.path(file.format(safe_name(name))) for file in SUFFIXES)
        write_tool_files(under, item.motion.time, ToolFiles(grf, loads, setup, kinematics))
    if outcome.config.bids:
        write_bids_trial(outcome, name, pieces, folder.path)


def _write_storages(
    model: Model, title: str, motion: Motion, torque: Float[Tensor, "frames dofs"], paths: Sequence[Path]
) -> None:
    """Write coordinates and generalised forces for OpenSim.

    Args:
        paths: of the two files.
    """
    for path, table, kind in zip(
        paths, opensim_tables(model, motion.q, torque), ("kinematics", "dynamics"), strict=True
    ):
        values = torch.stack(list(table.values()), dim=1).numpy()
        write_storage(path, tuple(table), motion.time.numpy(), values, title=f"{title} {kind}")


def opensim_tables(
    model: Model, q: Float[Tensor, "frames dofs"], torque: Float[Tensor, "frames dofs"]
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Columns of ``_ik.mot`` and ``_id.sto``, for the model that is written beside them.

    Where the model came from an OpenSim file, they are that file's coordinates, all of them, and the generalised forces
    of those that are free.

    Args:
        q: coordinates [m, rad].
        torque: generalised forces [N, N m].
    """
    tree, binding = model.tree, model.osim
    if binding is None:
        names = osim_names(tree)
        columns = [f"{n}_{'force' if tree.dofs[k].unit == 'm' else 'moment'}" for k, n in enumerate(names)]
        table = dict(zip(names, osim_coordinates(q).unbind(1), strict=True))
        return table, dict(zip(columns, osim_forces(q, torque).unbind(1), strict=True))
    values = binding.from_tree(tree.dof_names, q)
    kind = {
        one.name: "moment" if one.motion is CoordinateKind.ROTATIONAL else "force" for one in binding.model.coordinates
    }
    found = binding.forces(tree.dof_names, values, torque)
    table = dict(zip(binding.model.coordinate_names, values.unbind(1), strict=True))
    return table, {f"{name}_{kind[name]}": value for name, value in found.items()}


def _piece(outcome: Outcome, name: str, part: slice) -> xarray.Dataset:
    release()
    return motion_dataset(outcome, name, part)


def motion_dataset(outcome: Outcome, name: str, part: slice = slice(None)) -> xarray.Dataset:
    """Content of ``motion_<trial>.nc``: every marker in the file's time, every frame (or ``part`` of them)."""
    fit, motion = outcome.fit, outcome.followed[name].motion
    tracked, trial = outcome.followed[name].tracked, outcome.session.trials[name]
    tree, labels = fit.model.tree, fit.attachment.labels
    scaled, by_body = outcome.followed_scaled[name], ("time", "body", "row", "column")
    by_dof, by_marker = ("time", "dof"), ("time", "marker", "axis")
    return xarray.Dataset(
        {
            "q": (by_dof, motion.q[part].numpy()),
            "v": (by_dof, motion.v[part].numpy()),
            "a": (by_dof, motion.a[part].numpy()),
            "torque": (by_dof, outcome.torque[name][part].numpy()),
            "torque_scaled": (by_dof, outcome.torque_scaled[name][part].numpy()),
            "X_WB": (by_body, body_transforms(tree, motion.q[part], fit.geometry).numpy()),
            "X_WB_scaled": (by_body, body_transforms(tree, scaled.motion.q[part], outcome.scaled.geometry).numpy()),
            "markers_measured": (by_marker, trial.markers.frames(part).select(labels).position.numpy()),
            "markers_modelled": (by_marker, modelled(fit, tracked.q[part]).numpy()),
            "observable": (("time",), tracked.observable[part].numpy()),
            **_under(outcome, name, part),
            **{key: (by_dof, x[part].numpy()) for key, x in _consistent(outcome, name)},
            **({"torque_sd": (by_dof, outcome.torque_sd[name][part].numpy())} if name in outcome.torque_sd else {}),
        },
        coords={
            "time": motion.time[part].numpy(), "dof": list(tree.dof_names), "body": list(tree.names),
            "marker": list(labels), "axis": list("xyz"), **_contacts(outcome, name),
        },
        attrs={
            "trial": name, "cutoff_hz": motion.smoother.cutoff_hz, "filter": motion.smoother.kind, "units": "SI, rad",
            "parents": [body.parent for body in tree.bodies],
            "base": "q 0-2: p_WB [m]; q 3-5: rotation vector of R_WB [rad]; v, a 3-5: angular velocity and "
            "acceleration in W; q_consistent_sd 3-5: of a turn in W; torque 0-5: residual force and moment at the "
            "root's origin, in W",
        },
    )  # fmt: skip


def _consistent(outcome: Outcome, name: str) -> Iterator[tuple[str, Tensor]]:
    """Courses of the motion that obeys its forces, and their standard deviations, with their names in files."""
    found = outcome.consistent.get(name)
    if found is not None:
        whole = (found.motion.q, found.motion.v, found.motion.a, found.torque)
        yield from zip((f"{course}_consistent" for course in COURSES), whole, strict=True)
        yield from zip((f"{course}_consistent_sd" for course in COURSES), found.sd or (), strict=False)


def _under(outcome: Outcome, name: str, part: slice) -> dict[str, tuple]:
    """Wrench under every contact about the world's origin, its standard deviation, and its ``WrenchSource``."""
    found, by_contact = outcome.under.get(name), ("time", "contact", "component")
    if found is None:
        return {}
    return {
        "contact_wrench": (by_contact, found.wrench[part].numpy()),
        "contact_wrench_sd": (by_contact, found.sd[part].numpy()),
        "contact_source": (("time", "contact"), found.source[part].numpy(), {"meaning": _SOURCES}),
    }


def _contacts(outcome: Outcome, name: str) -> dict[str, Any]:
    found = outcome.under.get(name)
    if found is None:
        return {}
    bodies = (("contact",), list(found.body))
    return {"contact": list(found.contacts), "contact_body": bodies, "component": list(COMPONENTS)}


def forces_dataset(outcome: Outcome, item: Followed) -> xarray.Dataset:
    """Content of ``forces_<trial>.nc``: wrenches on the subject about the world's origin, in W, all filtered alike."""
    trial = outcome.session.trials[item.name]
    assert item.wrench is not None and item.contact is not None and trial.forces is not None
    predicted = wrench_about(predict(item.wrench, outcome.phi), -item.motion.q[:, :3])
    extended = predicted + outcome.added.get(item.name, torch.zeros_like(predicted))
    if outcome.base is not None:
        before = outcome.base.followed[item.name]
        assert before.wrench is not None
        predicted = wrench_about(predict(before.wrench, outcome.base.phi), -before.motion.q[:, :3])
    smoother = item.motion.smoother
    finite = torch.isfinite(trial.forces.total).all(dim=1).to(torch.float64)
    plates = smoother(torch.nan_to_num(trial.forces.wrench), finite)
    rows = ("time", "component")
    return xarray.Dataset(
        {
            "measured": (rows, smoother(torch.nan_to_num(trial.forces.total), finite).numpy()),
            "predicted": (rows, predicted.numpy()),
            "extended": (rows, extended.numpy()),
            "used": (("time",), item.contact.used.numpy()),
            "plate_wrench": (("time", "plate", "component"), plates.numpy()),
            "plate_foot": (("time", "plate"), item.contact.plate.numpy()),
            "plate_corners": (("plate", "corner", "axis"), _corners(trial.forces.plates)),
        },
        coords={
            "time": item.motion.time.numpy(), "component": list(COMPONENTS),
            "plate": [plate.name for plate in trial.forces.plates],
        },
        attrs={"cutoff_hz": smoother.cutoff_hz, "filter": smoother.kind, "feet": ", ".join(item.contact.bodies)},
    )  # fmt: skip


def _corners(plates: Sequence[Plate]) -> np.ndarray:
    """Corners of plates in W, NaN where nobody told them [m]."""
    unknown = torch.full((4, 3), torch.nan, dtype=torch.float64)
    corners = [unknown if plate.corners is None else plate.corners for plate in plates]
    return torch.stack(corners).numpy() if corners else np.zeros((0, 4, 3))
