"""OpenSim's residual reduction (RRA) beside the motion that obeys its forces: same body, same plates, same frames.

    scripts/module test benchmarks.consistent configs/opencap_subject4.yaml && scripts/module test opensim_rra

Both start from the same coordinates and body, those that the run has written. RRA tracks all coordinates alike, with
actuators at the pelvis that cost by what ``--pelvis`` says: the weaker they are, the less is left, and the more the
motion changes. Its own changes of masses and of the trunk's centre are left out. Residuals are those of its actuators;
distances of markers are of all that were seen, with OpenSim's kinematics for every motion. Writes out/opensim_rra.json.
Wants the extra ``test``; each trial takes some seconds.
"""

import os
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median

import numpy as np
import opensim
import xarray
from harness.command import ROOT, Command
from harness.rows import write_json
from numpy.typing import NDArray

WEIGHT = 10.0
"""Choice. Of every coordinate's acceleration: with 1, markers go 16 mm off in the first walk."""
GAINS = 100.0, 20.0
"""Choice. Of position and rate: those of OpenSim's examples."""
STRONG = 300.0
"""Choice. Torque that an actuator of a joint has at unit control [N m]: no joint wants for it."""


def read_storage(path: Path) -> tuple[list[str], NDArray, bool]:
    """Labels, rows, and whether angles are in degrees; rows of equal time are kept, which OpenSim's reader refuses."""
    lines = path.read_text().splitlines()
    head = lines.index("endheader")
    rows = np.array([[float(x) for x in line.split("\t")] for line in lines[head + 2 :]])
    return lines[head + 1].split("\t"), rows, any(line == "inDegrees=yes" for line in lines[:head])


class Body:
    """A run's model and trials in OpenSim."""

    def __init__(self, out: Path) -> None:
        self.out, self.model = out, opensim.Model(str(out / "model.osim"))
        self.state = self.model.initSystem()
        every = self.model.getCoordinateSet()
        self.coordinates = [every.get(k) for k in range(every.getSize())]
        self.slides, self.turns = (
            [c.getName() for c in self.coordinates[:6] if c.getMotionType() == k] for k in (2, 1)
        )

    def span(self, name: str) -> tuple[float, float]:
        """First and last time at which all loads of a trial are known [s]."""
        found = ET.parse(self.out / f"{name}_id_setup.xml").find(".//time_range")  # noqa: S314 - torchid's own
        assert found is not None and found.text is not None
        first, last = map(float, found.text.split())
        return first, last

    def reduce(self, name: str, folder: Path, pelvis: tuple[float, float]) -> float:
        """Run RRA on a trial; seconds that it took."""
        forces, tasks = opensim.ForceSet(), opensim.CMC_TaskSet()
        for one in self.coordinates:
            label = one.getName()
            free = label in (*self.slides, *self.turns)
            actuator, task = opensim.CoordinateActuator(label), opensim.CMC_Joint(label)
            actuator.setName(f"left_{label}" if free else label)
            actuator.setOptimalForce(pelvis[label in self.turns] if free else STRONG)
            actuator.setMinControl(-100.0)
            actuator.setMaxControl(100.0)
            task.setName(label)
            task.setActive(True, False, False)
            task.setWeight(WEIGHT, WEIGHT, WEIGHT)
            task.setKP(GAINS[0], 1.0, 1.0)
            task.setKV(GAINS[1], 1.0, 1.0)
            forces.cloneAndAppend(actuator)
            tasks.cloneAndAppend(task)
        files = {key: str(folder / f"{key}.xml") for key in ("forces", "tasks", "setup")}
        forces.printToXML(files["forces"])
        tasks.printToXML(files["tasks"])
        tool, actuators = opensim.RRATool(), opensim.ArrayStr()
        actuators.append(files["forces"])
        tool.setName(name)
        tool.setModelFilename(str(self.out / "model.osim"))
        tool.setForceSetFiles(actuators)
        tool.setReplaceForceSet(True)
        first, last = self.span(name)
        tool.setStartTime(first)
        tool.setFinalTime(last)
        tool.setResultsDir(str(folder))
        tool.setDesiredKinematicsFileName(str(self.out / f"{name}_ik.mot"))
        tool.setLowpassCutoffFrequency(-1.0)
        tool.setTaskSetFileName(files["tasks"])
        tool.setExternalLoadsFileName(str(self.out / f"{name}_external_loads.xml"))
        tool.setAdjustCOMToReduceResiduals(False)
        tool.setOutputModelFileName(str(folder / "adjusted.osim"))
        tool.printToXML(files["setup"])
        begin = time.process_time()
        with silent():
            opensim.RRATool(files["setup"]).run()
        return time.process_time() - begin

    def markers_mm(self, name: str, path: Path, span: tuple[float, float]) -> float:
        """Distance of the markers seen from where coordinates of a file put them, root mean square."""
        labels, rows, degrees = read_storage(path)
        columns, square = [labels.index(one.getName()) for one in self.coordinates], []
        markers = self.model.getMarkerSet()
        own = {markers.get(k).getName(): markers.get(k) for k in range(markers.getSize())}
        with xarray.open_dataset(self.out / f"motion_{name}.nc") as motion:
            seen, times, wanted = motion.markers_measured.values, motion.time.values, list(motion.marker.values)
        for t, measured in zip(times, seen, strict=True):
            if not span[0] <= t <= span[1]:
                continue
            for one, k in zip(self.coordinates, columns, strict=True):
                value, turns = float(np.interp(t, rows[:, 0], rows[:, k])), one.getMotionType() == 1
                one.setValue(self.state, np.radians(value) if degrees and turns else value, False)
            self.model.realizePosition(self.state)
            for label, place in zip(wanted, measured, strict=True):
                if np.isfinite(place).all() and label in own:
                    x, y, z = (own[label].getLocationInGround(self.state).get(i) for i in range(3))
                    square.append(np.square(np.array([x, -z, y]) - place).sum())
        return 1e3 * float(np.sqrt(np.mean(square)))


@contextmanager
def silent() -> Iterator[None]:
    """What a library prints by itself goes nowhere."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


def left(path: Path, body: Body) -> tuple[float, float]:
    """Force [N] and moment [N m] of the pelvis' actuators, root mean squares of the three-vectors."""
    labels, rows, _ = read_storage(path)
    each = (rows[:, [labels.index(f"left_{name}") for name in names]] for names in (body.slides, body.turns))
    force, moment = (float(np.sqrt(np.square(x).sum(1).mean())) for x in each)
    return force, moment


def main() -> None:
    """Print a line for each trial that has both, and the medians."""
    opensim.Logger.setLevelString("Error")
    asked = Command(
        __doc__, run=(ROOT / "out" / "consistent" / "opencap_subject4", "folder of a run with motion.consistent"),
        pelvis=({"nargs": 2, "type": float, "default": (5.0, 2.0)}, "N and N m at unit control of actuators there"),
        trials=({"nargs": "*", "default": ()}, "only these"),
    ).asked()  # fmt: skip
    body, rows = Body(asked.run.resolve()), []
    for file in sorted(asked.run.glob("*_consistent.mot")):
        name = file.name.removesuffix("_consistent.mot")
        if asked.trials and name not in asked.trials or not (asked.run / f"{name}_id_setup.xml").exists():
            continue
        folder, span = asked.run.resolve() / "rra" / name, body.span(name)
        folder.mkdir(parents=True, exist_ok=True)
        seconds = body.reduce(name, folder, tuple(asked.pelvis))
        found = folder / f"{name}_Kinematics_q.sto"
        remains = left(folder / f"{name}_Actuation_force.sto", body)
        row = {"trial": name, "seconds": seconds, "rra": (*remains, body.markers_mm(name, found, span))}
        with xarray.open_dataset(asked.run / f"motion_{name}.nc") as motion:
            inside = (motion.time >= span[0]) & (motion.time <= span[1])
            for key, end in (("markers", ""), ("obeying", "_consistent")):
                torque = motion[f"torque{end}"].values[inside.values][:, :6]
                parts = (np.sqrt(np.nanmean(np.square(torque[:, k : k + 3]).sum(1))) for k in (0, 3))
                path = asked.run / (f"{name}_consistent.mot" if end else f"{name}_ik.mot")
                row[key] = (*map(float, parts), body.markers_mm(name, path, span))
        rows.append(row)
        parts = ["{:5.1f} N {:4.1f} N m {:4.1f} mm".format(*row[key]) for key in ("markers", "obeying", "rra")]
        print(f"{name:14}" + "   ".join(parts) + f"   RRA {seconds:.0f} s", flush=True)
    for key in ("markers", "obeying", "rra") if rows else ():
        figures = map(median, zip(*(row[key] for row in rows), strict=True))
        print(f"median {key:10}" + "{:5.1f} N {:4.1f} N m {:4.1f} mm".format(*figures))
    write_json(ROOT / "out" / "opensim_rra.json", rows)


if __name__ == "__main__":
    main()
