"""OpenSim's own inverse dynamics of a model file, in a process that has no other library of its kind loaded.

``python osim_dynamics.py`` reads ``{"path", "names", "q", "v", "a"}`` as JSON, a question a line, values by frame and
coordinate, and writes the generalised forces of every frame in the order of the names. Coordinates are free: no coupler
and no lock holds any, as in OpenSim's tool. One process answers all questions, for OpenSim takes half a second to load.
"""

import atexit
import functools
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ANSWER = "answer: "
"""How lines begin that answer."""


def opensim_forces(path: Path, names: Sequence[str], *states: list[list[float]]) -> list[list[float]]:
    """Generalised forces of every frame; beside Pinocchio, OpenSim does not know its own vectors."""
    return _answered({"path": str(path), "names": list(names), **dict(zip("qva", states, strict=True))})


def opensim_consistency(
    path: Path, names: Sequence[str], body: str, q: list[list[float]], v: list[list[float]]
) -> tuple[list[float], list[float]]:
    """Acceleration of a body (angular, linear, in ground) without accelerations of coordinates: by differences of
    OpenSim's velocities along the motion, and as OpenSim has it."""
    first, second = _answered({"path": str(path), "names": list(names), "q": q, "v": v, "body": body})
    return first, second


def _answered(question: dict[str, Any]) -> Any:
    child = _child()
    assert child.stdin is not None and child.stdout is not None
    child.stdin.write(json.dumps(question) + "\n")
    child.stdin.flush()
    for line in child.stdout:  # OpenSim says things of its own in between
        if line.startswith(ANSWER):
            return json.loads(line.removeprefix(ANSWER))
    raise RuntimeError(f"OpenSim ended with {child.wait()}; what it said is above")


@functools.cache
def _child() -> subprocess.Popen[str]:
    child = subprocess.Popen([sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)  # noqa: S603

    def end() -> None:
        child.communicate()

    atexit.register(end)
    return child


def _consistency(
    path: str, names: list[str], q: list[list[float]], v: list[list[float]], body: str
) -> tuple[list[float], list[float]]:
    import opensim  # noqa: PLC0415 - in the child alone

    model, state, coordinates = _opened(opensim, path, names)
    part, matter, step = model.getBodySet().get(body), model.getMatterSubsystem(), 1e-5

    def six(pair: Any) -> list[float]:
        return [pair.get(k).get(i) for k in range(2) for i in range(3)]

    def velocity(ahead: float) -> list[float]:
        for one, value, speed in zip(coordinates, q[0], v[0], strict=True):
            one.setValue(state, value + ahead * speed, False)
            one.setSpeedValue(state, speed)
        model.realizeVelocity(state)
        return six(part.getVelocityInGround(state))

    difference = [(b - a) / (2 * step) for a, b in zip(velocity(-step), velocity(step), strict=True)]
    velocity(0.0)
    model.realizeDynamics(state)
    found = opensim.VectorOfSpatialVec()
    matter.calcBodyAccelerationFromUDot(state, opensim.Vector(len(names), 0.0), found)
    return difference, six(found.get(part.getMobilizedBodyIndex()))


def _opened(opensim: Any, path: str, names: list[str]) -> tuple[Any, Any, list]:
    """Model, state and coordinates in the order of the names, nothing locked or clamped."""
    opensim.Logger.setLevelString("Off")
    model = opensim.Model(path)
    state = model.initSystem()
    coordinates = [model.getCoordinateSet().get(name) for name in names]
    for one in coordinates:
        one.setLocked(state, False)
        one.setClamped(state, False)
    return model, state, coordinates


def _answer(
    path: str, names: list[str], q: list[list[float]], v: list[list[float]], a: list[list[float]]
) -> list[list[float]]:
    import opensim  # noqa: PLC0415 - in the child alone

    model, state, coordinates = _opened(opensim, path, names)
    for k in range(model.getForceSet().getSize()):
        model.getForceSet().get(k).setAppliesForce(state, False)
    order = _order(state, coordinates)
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


def _order(state: Any, coordinates: list) -> list[int]:
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
    for text in sys.stdin:
        asked = json.loads(text)
        print(ANSWER + json.dumps(_consistency(**asked) if "body" in asked else _answer(**asked)), flush=True)  # noqa: T201
