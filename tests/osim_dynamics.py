"""OpenSim's own inverse dynamics of a model file, in a process that has no other library of its kind loaded.

``python osim_dynamics.py`` reads ``{"path", "names", "q", "v", "a"}`` as JSON, values by frame and coordinate, and
writes the generalised forces of every frame in the order of the names. Coordinates are free: no coupler and no lock
holds any, as in OpenSim's tool.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path


def opensim_forces(path: Path, names: Sequence[str], *states: list[list[float]]) -> list[list[float]]:
    """Generalised forces of every frame; beside Pinocchio, OpenSim does not know its own vectors."""
    given = json.dumps({"path": str(path), "names": list(names), **dict(zip("qva", states, strict=True))})
    done = subprocess.run([sys.executable, __file__], input=given, capture_output=True, text=True, check=True)  # noqa: S603
    return json.loads(done.stdout.strip().splitlines()[-1])


def _answer(
    path: str, names: list[str], q: list[list[float]], v: list[list[float]], a: list[list[float]]
) -> list[list[float]]:
    import opensim  # noqa: PLC0415 - in the child alone

    opensim.Logger.setLevelString("Off")
    model = opensim.Model(path)
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(name) for name in names]
    for one in coordinates:
        one.setLocked(state, False)
        one.setClamped(state, False)
    for k in range(model.getForceSet().getSize()):
        model.getForceSet().get(k).setAppliesForce(state, False)
    order = _order(model, state, coordinates)
    found = []
    for frame in range(len(q)):
        for one, value, speed in zip(coordinates, q[frame], v[frame], strict=True):
            one.setValue(state, value, False)
            one.setSpeedValue(state, speed)
        model.realizeDynamics(state)
        udot = opensim.Vector(len(names), 0.0)
        for k, value in enumerate(a[frame]):
            udot.set(order[k], value)
        forces = opensim.InverseDynamicsSolver(model).solve(state, udot)
        found.append([forces.get(order[k]) for k in range(len(names))])
    return found


def _order(model, state, coordinates) -> list[int]:
    """Where each coordinate's speed stands in the state's."""
    order = []
    for one in coordinates:
        for other in coordinates:
            other.setSpeedValue(state, 0.0)
        one.setSpeedValue(state, 1.0)
        speeds = state.getU()
        order.append(next(k for k in range(speeds.size()) if speeds.get(k) == 1.0))
    return order


if __name__ == "__main__":
    print(json.dumps(_answer(**json.load(sys.stdin))))  # noqa: T201
