"""OpenSim's base residual beside ours, on the same frames of the same trials.

    scripts/tables opencap_subject4 && python scripts/opensim_residuals.py

Inverse kinematics and dynamics of OpenSim with the data set's hand-scaled model, its coordinates filtered at 6 Hz;
where the data set holds coordinates made with that model, these are used. Each plate loads the foot that our run found
on it. Writes out/opensim_residuals.json. Wants the extra ``test``.
"""

from collections import Counter
from pathlib import Path

import numpy as np
import opensim
import xarray
from harness.command import DATA, ROOT
from harness.opensim_tools import follow_markers
from harness.rows import write_json
from numpy.typing import NDArray

from torchid.config import load_config

FOLDER = DATA / "opencap_subject4"
MODEL = FOLDER / "Models" / "manually_scaled.osim"
OUT = ROOT / "out" / "opencap_subject4"
CUTOFF_HZ = 6.0
FEET = {"foot_r": "calcn_r", "foot_l": "calcn_l"}
FORCE = """<ExternalForce name="{name}"><applied_to_body>{body}</applied_to_body>
<force_expressed_in_body>ground</force_expressed_in_body><point_expressed_in_body>ground</point_expressed_in_body>
<force_identifier>{name}_v</force_identifier><point_identifier>{name}_p</point_identifier>
<torque_identifier>{name}_m</torque_identifier></ExternalForce>"""
LOADS = """<?xml version="1.0"?><OpenSimDocument Version="40000"><ExternalLoads name="plates">
<objects>{forces}</objects><datafile>{file}</datafile></ExternalLoads></OpenSimDocument>"""


def kinematics(name: str, markers: Path, folder: Path) -> Path:
    """Coordinates of the hand-scaled model: the data set's own, else by OpenSim's inverse kinematics."""
    given = FOLDER / "IK" / f"{name}_manual_scaling_ik.mot"
    if given.exists():
        return given
    found, data = folder / f"{name}_ik.mot", opensim.MarkerData(str(markers))
    span = data.getStartFrameTime(), data.getLastFrameTime()
    follow_markers(opensim.Model(str(MODEL)), markers, found, span)
    return found


def residual(name: str, coordinates: Path, loads: Path, folder: Path) -> tuple[NDArray, NDArray]:
    """Times, and force and moment that OpenSim's inverse dynamics leaves on the pelvis [N, N m]."""
    # The tool keeps no reference of its own: a temporary would be gone when it runs.
    model, tool, skipped = opensim.Model(str(MODEL)), opensim.InverseDynamicsTool(), opensim.ArrayStr()
    skipped.append("Muscles")
    table = opensim.TimeSeriesTable(str(coordinates))
    times = table.getIndependentColumn()
    tool.setModel(model)
    tool.setCoordinatesFileName(str(coordinates))
    tool.setLowpassCutoffFrequency(CUTOFF_HZ)
    tool.setExternalLoadsFileName(str(loads))
    tool.setStartTime(times[0])
    tool.setEndTime(times[-1])
    tool.setExcludedForces(skipped)
    tool.setResultsDir(str(folder))
    tool.setOutputGenForceFileName(f"{name}_id.sto")
    tool.run()
    found = opensim.TimeSeriesTable(str(folder / f"{name}_id.sto"))
    labels = list(found.getColumnLabels())
    wanted = [f"pelvis_t{a}_force" for a in "xyz"] + [f"pelvis_{a}_moment" for a in ("tilt", "list", "rotation")]
    values = found.getMatrix().to_numpy()[:, [labels.index(label) for label in wanted]]
    return np.array(found.getIndependentColumn()), values


def plate_loads(forces: xarray.Dataset, file: Path, folder: Path, name: str) -> Path:
    """OpenSim's description of which plate loads which foot."""
    feet, parts = forces.attrs["feet"].split(", "), []
    for k, plate in enumerate(forces.plate.values):
        (foot, _), *_ = Counter(x for x in forces.plate_foot.values[:, k].tolist() if x >= 0).most_common(1)
        parts.append(FORCE.format(name=plate, body=FEET[feet[foot]]))
    out = folder / f"{name}_loads.xml"
    out.write_text(LOADS.format(forces="".join(parts), file=file))
    return out


def about(wrench: NDArray, point: NDArray) -> NDArray:
    """A wrench about the world's origin, taken about ``point``."""
    return np.hstack([wrench[:, :3], wrench[:, 3:] - np.cross(point, wrench[:, :3])])


def rms(wrench: NDArray) -> tuple[float, float]:
    """Of the 3-vectors of force and of moment."""
    return tuple(float(np.sqrt(np.square(wrench[:, part]).sum(1).mean())) for part in (slice(3), slice(3, 6)))


def main() -> None:
    opensim.Logger.setLevelString("Error")
    config, rows = load_config(ROOT / "configs" / "opencap_subject4.yaml"), []
    folder = ROOT / "out" / "opensim"
    folder.mkdir(parents=True, exist_ok=True)
    print(f"{'trial':12s} {'role':8s} {'torchid N / N m':>16s} {'OpenSim N / N m':>16s}  ratios")
    for trial in config.trials:
        if trial.role == "static" or not trial.inertia:
            continue
        with xarray.open_dataset(OUT / f"forces_{trial.name}.nc") as forces:
            used = forces.used.values
            with xarray.open_dataset(OUT / f"motion_{trial.name}.nc") as motion:
                own = rms(about((forces.measured - forces.predicted).values, motion.q.values[:, :3])[used])
            loads = plate_loads(forces, Path(trial.forces or trial.file), folder, trial.name)
            coordinates = kinematics(trial.name, Path(trial.file), folder)
            times, wrench = residual(trial.name, coordinates, loads, folder)
            nearest = np.abs(times[:, None] - forces.time.values[used][None]).argmin(0)
        other = rms(wrench[nearest])
        rows.append({"trial": trial.name, "role": trial.role, "torchid": own, "opensim": other})
        pairs = [f"{a:.1f} / {b:.1f}" for a, b in (own, other)]
        ratios = "  ".join(f"{a / b:.2f}" for a, b in zip(own, other, strict=True))
        print(f"{trial.name:12s} {trial.role:8s} {pairs[0]:>16s} {pairs[1]:>16s}  {ratios}")
    write_json(ROOT / "out" / "opensim_residuals.json", rows)


if __name__ == "__main__":
    main()
