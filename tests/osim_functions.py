"""OpenSim's own values and derivatives of a function, in a process that has no other library of its kind loaded.

``python osim_functions.py`` reads ``{"kind", "x", "y", "at", "orders"}`` as JSON and writes a list for each order.
"""

import json
import subprocess
import sys
from typing import Any


def opensim_values(kind: str, x: list[float], y: list[float], at: list[float], orders: int) -> list[list[float]]:
    """Values, first derivatives and so on; beside Pinocchio, OpenSim does not know its own vectors of integers."""
    given = json.dumps({"kind": kind, "x": x, "y": y, "at": at, "orders": orders})
    done = subprocess.run([sys.executable, __file__], input=given, capture_output=True, text=True, check=True)  # noqa: S603
    return json.loads(done.stdout.strip().splitlines()[-1])


def _answer(kind: str, x: list[float], y: list[float], at: list[float], orders: int) -> list[list[float]]:
    import opensim  # noqa: PLC0415 - in the child alone

    function: Any = getattr(opensim, kind)()
    for pair in zip(x, y, strict=True):
        function.addPoint(*pair)
    points = [opensim.Vector(1, value) for value in at]
    found = [[function.calcValue(p) for p in points]]
    for order in range(1, orders):
        found.append([function.calcDerivative(opensim.StdVectorInt([0] * order), p) for p in points])
    return found


if __name__ == "__main__":
    print(json.dumps(_answer(**json.load(sys.stdin))))  # noqa: T201
