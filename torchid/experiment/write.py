"""Result files of section 3 of the contracts: JSON tables, netCDF series, OpenSim storages, model files."""

import math
from typing import Any

import torch
import xarray
from torch import Tensor

from torchid.conventions import INERTIAL_NAMES
from torchid.dynamics import wrench_about
from torchid.errors import DataError
from torchid.experiment.outcome import Outcome
from torchid.experiment.stages import Followed, residual_rms
from torchid.files import safe_name, write_json, write_netcdf
from torchid.geometry.fit import GeometryFit
from torchid.io.storage import write_storage
from torchid.kinematics.chain import chain_poses
from torchid.model.osim import osim_coordinates, osim_names, write_osim
from torchid.model.urdf import write_urdf
from torchid.regressor.rows import predict
from torchid.results import OutputFolder


def write_outcome(outcome: Outcome, folder: OutputFolder, failure: DataError | None) -> None:
    """Write everything that is known; ``failure`` is why the rest is not."""
    write_json(folder.path("geometry.json"), geometry_table(outcome))
    if outcome.identified is not None:
        write_json(folder.path("inertia.json"), inertia_table(outcome))
    for name in outcome.session.trials:
        _write_trial(outcome, name, folder)
    tree, geometry = outcome.fit.model.tree, outcome.fit.geometry
    places = {
        label: (tree.names[int(body)], p.tolist())
        for label, body, p in zip(
            outcome.fit.attachment.labels, outcome.fit.attachment.body, outcome.fit.place, strict=True
        )
    }
    write_urdf(tree, geometry, outcome.phi, folder.path("model.urdf"), places)
    write_osim(tree, geometry, outcome.phi, folder.path("model.osim"), places)


def geometry_table(outcome: Outcome) -> dict[str, Any]:
    """Content of ``geometry.json``."""
    fit, named = outcome.fit, len(outcome.fit.prior.mean)
    sd = torch.zeros_like(fit.xi) if fit.uncertainty is None else fit.uncertainty.sd
    directions = () if fit.uncertainty is None else fit.uncertainty.undetermined
    return {
        "xi": {
            name: {"value": fit.xi[k], "sd": sd[k], "unit": unit, "prior": fit.prior.mean[k], "prior_sd": fit.prior.sd[k]}
            for k, (name, unit) in enumerate(zip(fit.prior.names, fit.prior.units, strict=True))
        },
        "segments": segment_lengths(fit),
        "markers": {
            label: {
                "segment": fit.model.tree.names[int(fit.attachment.body[k])],
                "landmark": fit.attachment.landmark[k],
                "p_BM_B": fit.place[k],
                "sd": sd[named + 3 * k : named + 3 * k + 3],
                "sigma_mm": 1e3 * fit.sigma[k],
            }
            for k, label in enumerate(fit.attachment.labels)
        },
        "undetermined": directions,
        "marker_rmse_mm": {name: marker_errors(outcome, name) for name in outcome.session.trials},
        "solver": fit.options.solver,
        "converged": None if fit.solution is None else fit.solution.converged,
        "iterations": None if fit.solution is None else fit.solution.iterations,
        "warnings": [{"code": n.code, "message": n.message, "source": n.source} for n in outcome.notes],
    }


def segment_lengths(fit: GeometryFit) -> dict[str, dict[str, float]]:
    """Distance from each body's origin to the joint of its (first) child, with its standard deviation [m]."""
    tree, found = fit.model.tree, {}
    named = len(fit.prior.mean)
    for k, body in enumerate(tree.bodies):
        children = [j for j, b in enumerate(tree.bodies) if b.parent == k]
        if not children or k == 0:
            continue
        p = fit.geometry.offset[children[0]]
        length = p.norm()
        row = (p / length) @ fit.prior.map[3 * children[0] : 3 * children[0] + 3]
        covariance = torch.zeros(named, named, dtype=p.dtype)
        if fit.uncertainty is not None:
            covariance = fit.uncertainty.covariance[:named, :named]
        found[body.name] = {"length_m": float(length), "sd": math.sqrt(max(0.0, float(row @ covariance @ row)))}
    return found


def marker_errors(outcome: Outcome, name: str) -> dict[str, Any]:
    """RMS distances of a trial's physical markers before filtering [mm]."""
    error, scaled = outcome.followed[name].tracked.error, outcome.followed_scaled[name].tracked.error
    mean_square = torch.nanmean(error.square(), dim=0)
    return {
        "role": outcome.session.trials[name].role,
        "identified": 1e3 * _rms(error),
        "scaled": 1e3 * _rms(scaled),
        "max": 1e3 * float(torch.nan_to_num(error).max()),
        "markers": dict(zip(outcome.fit.attachment.labels, (1e3 * mean_square.sqrt()).tolist(), strict=True)),
    }


def _rms(error: Tensor) -> float:
    known = error[torch.isfinite(error)]
    return float(known.square().mean().sqrt()) if len(known) else math.nan


def inertia_table(outcome: Outcome) -> dict[str, Any]:
    """Content of ``inertia.json``."""
    assert outcome.identified is not None
    identified = outcome.identified
    fit, prior = identified.fit, outcome.prior
    phi_sd = fit.sd.phi
    total = torch.zeros(10 * len(fit.names), dtype=fit.phi.dtype)
    total[::10] = 1.0
    return {
        "segments": {
            name: {
                "mass_kg": fit.mass[k],
                "com_m": fit.com[k],
                "inertia_kgm2": fit.inertia_com[k],
                "sd": {"mass_kg": phi_sd[k, 0], "com_m": fit.sd.com[k], "inertia_kgm2": fit.sd.inertia_com[k]},
                "progress": fit.progress.segment[k],
                "progress_mass": fit.progress.phi[k, 0],
                "progress_parameters": dict(zip(INERTIAL_NAMES, fit.progress.phi[k].tolist(), strict=True)),
                "prior": {"mass_kg": prior.mean[k, 0], "sd_kg": prior.covariance[10 * k, 10 * k].sqrt()},
            }
            for k, name in enumerate(fit.names)
        },
        "total_mass": {
            "value_kg": fit.mass.sum(),
            "sd_kg": (total @ fit.covariance @ total).sqrt(),
            "progress": fit.progress.total_mass,
            "recorded_kg": outcome.config.subject.mass_kg,
        },
        "rank": fit.rank,
        "base_parameters": None
        if fit.base is None
        else [
            {"name": name, "value": value, "sd": sd}
            for name, value, sd in zip(fit.base.names, fit.base.value.tolist(), fit.base.sd.tolist(), strict=True)
        ],
        "weights": {"omega_1": fit.omega_1, "omega_2": fit.omega_2, "rows": identified.rows},
        "cutoff_hz": outcome.cutoff_hz,
        "status": fit.status.value,
        "certificate": fit.certificate,
        "residuals": outcome.residuals,
        "trials": {name: _trial_residual(outcome, name) for name in outcome.session.trials},
    }


def _trial_residual(outcome: Outcome, name: str) -> dict[str, Any] | None:
    item = outcome.followed[name]
    if item.wrench is None or item.contact is None:
        return None
    force, moment = residual_rms([item.wrench], outcome.phi)
    return {
        "role": outcome.session.trials[name].role,
        "force_rmse_N": force,
        "moment_rmse_Nm": moment,
        "used": int(item.contact.used.sum()),
        "frames": len(item.contact.used),
        "beside_plates": item.contact.excluded,
    }


def _write_trial(outcome: Outcome, name: str, folder: OutputFolder) -> None:
    item, part = outcome.followed[name], safe_name(name)
    write_netcdf(folder.path(f"motion_{part}.nc"), motion_dataset(outcome, name))
    if item.wrench is not None:
        write_netcdf(folder.path(f"forces_{part}.nc"), forces_dataset(outcome, item))
    tree, time = outcome.fit.model.tree, item.motion.time.numpy()
    names = osim_names(tree)
    write_storage(
        folder.path(f"{part}_ik.mot"), names, time, osim_coordinates(item.motion.q).numpy(), title=f"{name} kinematics"
    )
    forces = tuple(f"{n}_{'force' if tree.dofs[k].unit == 'm' else 'moment'}" for k, n in enumerate(names))
    write_storage(folder.path(f"{part}_id.sto"), forces, time, outcome.torque[name].numpy(), title=f"{name} dynamics")


def motion_dataset(outcome: Outcome, name: str) -> xarray.Dataset:
    """Content of ``motion_<trial>.nc``: every frame and marker in the file's time."""
    item, fit, trial = outcome.followed[name], outcome.fit, outcome.session.trials[name]
    tree, labels = fit.model.tree, fit.attachment.labels
    by_dof = ("time", "dof")
    motion = item.motion
    return xarray.Dataset(
        {
            "q": (by_dof, motion.q.numpy()),
            "v": (by_dof, motion.v.numpy()),
            "a": (by_dof, motion.a.numpy()),
            "torque": (by_dof, outcome.torque[name].numpy()),
            "torque_scaled": (by_dof, _match_dofs(outcome, name)),
            "X_WB": (("time", "body", "row", "column"), chain_poses(tree, motion.q, fit.geometry).numpy()),
            "markers_measured": (("time", "marker", "axis"), trial.markers.select(labels).position.numpy()),
            "markers_modelled": (("time", "marker", "axis"), item.tracked.p_WM.numpy()),
            "observable": (("time",), item.tracked.observable.numpy()),
        },
        coords={
            "time": motion.time.numpy(), "dof": list(tree.dof_names), "body": list(tree.names),
            "marker": list(labels), "axis": list("xyz"),
        },
        attrs={
            "cutoff_hz": motion.smoother.cutoff_hz, "filter": motion.smoother.kind, "units": "SI, rad",
            "base": "q 0-2: p_WB [m]; q 3-5: rotation vector of R_WB [rad]; v, a 3-5: angular velocity and "
            "acceleration in W; torque 0-5: residual force and moment at the root's origin, in W",
        },
    )  # fmt: skip


def _match_dofs(outcome: Outcome, name: str):
    return outcome.torque_scaled[name].numpy()


def forces_dataset(outcome: Outcome, item: Followed) -> xarray.Dataset:
    """Content of ``forces_<trial>.nc``: wrenches on the subject about the world's origin, in W, all filtered alike."""
    trial = outcome.session.trials[item.name]
    assert item.wrench is not None and item.contact is not None and trial.forces is not None
    predicted = wrench_about(predict(item.wrench, outcome.phi), -item.motion.q[:, :3])
    smoother = item.motion.smoother
    finite = torch.isfinite(trial.forces.total).all(dim=1).to(torch.float64)
    plates = smoother(torch.nan_to_num(trial.forces.wrench), finite)
    rows = ("time", "component")
    return xarray.Dataset(
        {
            "measured": (rows, smoother(torch.nan_to_num(trial.forces.total), finite).numpy()),
            "predicted": (rows, predicted.numpy()),
            "extended": (rows, predicted.numpy()),
            "used": (("time",), item.contact.used.numpy()),
            "plate_wrench": (("time", "plate", "component"), plates.numpy()),
            "plate_foot": (("time", "plate"), item.contact.plate.numpy()),
        },
        coords={
            "time": item.motion.time.numpy(), "component": ["fx", "fy", "fz", "mx", "my", "mz"],
            "plate": [plate.name for plate in trial.forces.plates],
        },
        attrs={"cutoff_hz": smoother.cutoff_hz, "filter": smoother.kind, "feet": ", ".join(item.contact.feet)},
    )  # fmt: skip
