"""Motion that obeys its forces, replayed forward by OpenSim from the files of a run alone.

    scripts/module test benchmarks.consistent configs/opencap_subject4.yaml && scripts/module test opensim_forward
    scripts/module test opensim_forward --runs out/consistent/*

``model.osim`` starts in the state of ``<trial>_consistent.mot``, is driven by the generalised forces of
``<trial>_consistent_id.sto`` (those left at the pelvis among them) and the ground forces of
``<trial>_external_loads.xml``, and is integrated for 0.3 s from several instants of each trial. Prints how far pelvis
and worst other body are from the motion then, in the median of the instants. Writes out/opensim_forward.json. Wants the
extra ``test``.
"""

from collections.abc import Iterator
from pathlib import Path
from statistics import median

import numpy as np
import opensim
from harness.command import ROOT, Command
from harness.rows import write_json
from numpy.typing import NDArray
from opensim_rra import Body, read_storage, silent
from scipy.interpolate import BSpline, make_interp_spline

SECONDS = 0.3
"""Goal. Time that is integrated [s]."""
INSTANTS = 4
"""Choice. Instants of a trial from which it is integrated, at most."""
BESIDE_S = 0.05
"""Resolution. How far beyond the time that is integrated forces are known [s]."""
ACCURACY = 1e-7
"""Resolution. Of OpenSim's integrator; with a hundredth of it the pelvis of a walk ends 0.004 deg and 0.01 mm
elsewhere."""
LIMIT = 1e6
"""Resolution. Largest control [N, N m]: no limit."""


class Replay:
    """A trial as OpenSim integrates it."""

    def __init__(self, out: Path, name: str) -> None:
        self.body, self.name = Body(out), name
        self.names = [one.getName() for one in self.body.coordinates]
        self.time, self.q = self._columns(out / f"{name}_consistent.mot", "")
        _, self.force = self._columns(out / f"{name}_consistent_id.sto", "_force")
        self.spline: BSpline = make_interp_spline(self.time, self.q, k=5)

    def _columns(self, path: Path, end: str) -> tuple[NDArray, NDArray]:
        """Times and a column for each coordinate [rad, m, N, N m]."""
        labels, rows, degrees = read_storage(path)
        found = []
        for one in self.body.coordinates:
            turns, own = one.getMotionType() == 1, one.getName()
            column = rows[:, labels.index(own if not end else f"{own}_{'moment' if turns else 'force'}")]
            found.append(np.radians(column) if degrees and turns and not end else column)
        return rows[:, 0], np.stack(found, 1)

    def starts(self) -> list[float]:
        """Instants from which on all is known for long enough [s]."""
        first, last = self.body.span(self.name)
        known = np.isfinite(self.force).all(1) & (self.time >= first) & (self.time <= last)
        rate = 1.0 / np.diff(self.time).mean()
        length, beside = round((SECONDS + 2.0 * BESIDE_S) * rate) + 1, round(BESIDE_S * rate)
        whole = np.convolve(known, np.ones(length), "valid") > length - 0.5 if len(known) >= length else np.zeros(0)
        some = self.time[np.flatnonzero(whole) + beside]
        return some[:: max(1, -(-len(some) // INSTANTS))].tolist()

    def drift(self, start: float) -> tuple[float, float, float, float]:
        """Turn [deg] and way [mm] from the motion at the end, of the pelvis and the largest of the other bodies."""
        model = opensim.Model(str(self.body.out / "model.osim"))
        part = np.abs(self.time - start - 0.5 * SECONDS) <= 0.5 * SECONDS + 2.0 * BESIDE_S
        controller = opensim.PrescribedController()
        for name, column in zip(self.names, self.force[part].T, strict=True):
            actuator, course = opensim.CoordinateActuator(name), opensim.SimmSpline()
            actuator.setName(f"drive_{name}")
            actuator.setOptimalForce(1.0)
            actuator.setMinControl(-LIMIT)
            actuator.setMaxControl(LIMIT)
            for t, value in zip(self.time[part].tolist(), np.nan_to_num(column).tolist(), strict=True):
                course.addPoint(t, value)
            model.addForce(actuator)
            controller.addActuator(actuator)
            controller.prescribeControlForActuator(actuator.getName(), course)
        model.addController(controller)
        model.addModelComponent(opensim.ExternalLoads(str(self.body.out / f"{self.name}_external_loads.xml"), True))
        state = model.initSystem()
        self._pose(model, state, start)
        manager = opensim.Manager(model)
        manager.setIntegratorAccuracy(ACCURACY)
        state.setTime(start)
        manager.initialize(state)
        ended = _places(model, manager.integrate(start + SECONDS))
        self._pose(model, state, start + SECONDS)
        off = [_apart(one, other) for one, other in zip(ended, _places(model, state), strict=True)]
        turns, ways = zip(*off[1:], strict=True)
        return *off[0], max(turns), max(ways)

    def _pose(self, model: opensim.Model, state: opensim.State, t: float) -> None:
        every = model.getCoordinateSet()
        for name, value, rate in zip(self.names, self.spline(t), self.spline(t, 1), strict=True):
            every.get(name).setValue(state, float(value), False)
            every.get(name).setSpeedValue(state, float(rate))


def _places(model: opensim.Model, state: opensim.State) -> list[tuple[NDArray, NDArray]]:
    """Rotation and origin of every body, the pelvis first."""
    model.realizePosition(state)
    found = []
    for k in range(model.getBodySet().getSize()):
        X = model.getBodySet().get(k).getTransformInGround(state)
        R, p = X.R().asMat33(), X.p()
        found.append((np.array([[R.get(i, j) for j in range(3)] for i in range(3)]),
                      np.array([p.get(i) for i in range(3)])))  # fmt: skip
    return found


def _apart(one: tuple[NDArray, NDArray], other: tuple[NDArray, NDArray]) -> tuple[float, float]:
    turn = np.arccos(np.clip((np.trace(one[0].T @ other[0]) - 1.0) / 2.0, -1.0, 1.0))
    return float(np.degrees(turn)), 1e3 * float(np.linalg.norm(one[1] - other[1]))


def rows(out: Path) -> Iterator[dict]:
    """A row for each trial of a run that is known for long enough."""
    for file in sorted(out.glob("*_consistent.mot")):
        name = file.name.removesuffix("_consistent.mot")
        if not (out / f"{name}_external_loads.xml").is_file():
            continue
        replay = Replay(out, name)
        with silent():
            found = [replay.drift(start) for start in replay.starts()]
        if found:
            yield {"run": out.name, "trial": name, "drift": [median(column) for column in zip(*found, strict=True)]}


def main() -> None:
    """Print a line for each trial, and the medians."""
    opensim.Logger.setLevelString("Error")
    asked = Command(
        __doc__,
        runs=({"nargs": "+", "type": Path, "default": [ROOT / "out" / "consistent" / "opencap_subject4"]},
              "folders of runs with motion.consistent"),
    ).asked()  # fmt: skip
    every = []
    for out in asked.runs:
        for row in rows(out.resolve()):
            every.append(row)
            said = "pelvis {:.1f} deg {:.0f} mm, worst body {:.1f} deg {:.0f} mm".format(*row["drift"])
            print(f"{row['run'][:24]:25}{row['trial'][:16]:17}{said}", flush=True)
    if every:
        figures = [median(column) for column in zip(*(row["drift"] for row in every), strict=True)]
        print("median: pelvis {:.1f} deg {:.0f} mm, worst body {:.1f} deg {:.0f} mm".format(*figures))
    write_json(ROOT / "out" / "opensim_forward.json", every)


if __name__ == "__main__":
    main()
