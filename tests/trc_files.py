"""Markers written as TRC."""

from pathlib import Path

import numpy as np

from torchid.conventions import y_up_to_z_up
from torchid.recording import Markers
from torchid.storage.files import write_text


def write_trc(path: str | Path, markers: Markers, y_up: bool = True) -> None:
    """Write markers as TRC in m, with Y up as OpenSim expects or in W; gaps are blank cells. Whole or not at all."""
    position = markers.position
    for _ in range(3 if y_up else 0):
        # The rotation by +90 degrees about X taken three times is its inverse.
        position = y_up_to_z_up(position)
    values = position.detach().cpu().numpy()
    count, rate = len(markers.labels), markers.rate if len(markers.time) > 1 else 0.0
    keys = ("DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate", "OrigDataStartFrame")
    facts = (f"{rate:.10g}", f"{rate:.10g}", len(values), count, "m", f"{rate:.10g}", 1, len(values))
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "\t".join((*keys, "OrigNumFrames")),
        "\t".join(str(fact) for fact in facts),
        "Frame#\tTime\t" + "\t\t\t".join(markers.labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{k + 1}" for k in range(count) for axis in "XYZ"),
        "",
    ]
    rows = (
        "\t".join([str(k + 1), f"{float(t):.10g}", *("" if np.isnan(x) else f"{x:.9g}" for x in frame.ravel())])
        for k, (t, frame) in enumerate(zip(markers.time, values, strict=True))
    )
    write_text(path, "\n".join([*head, *rows]) + "\n")
