"""Peak memory and time of ``torchid run`` on a session with one long trial: `scripts/hour --minutes 60 --against 10`.

With ``--diagnosis`` each length is run with the diagnosis as well, with ``--diagnosis alone`` only so. A simulated
minute is played forwards and backwards until the trial is long enough. Reversed in time, a motion needs the same
forces, so the recording stays one that a person could have made; it turns where the subject is slowest.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from harness.command import Command

from torchid.effects.place import Interval
from torchid.io.c3d_header import C3dHeader, read_header
from torchid.io.c3d_layout import C3dLayout, resolve_layout
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.session import simulate_session

TURN_S = 5.0
"""Within this time of its ends the piece is cut where the markers are slowest."""
SATURATED = b"\xff\xff"
"""A count of frames that 16 bits cannot hold: readers take it from the size of the file."""
HIDDEN = (
    PlantedOptions("payload", ("forearm_r",), None, {"mass_kg": 1.5, "point_seg_m": [0.0, 0.0, -0.1]}),
    PlantedOptions("marker_shift", ("LTHI",), (Interval("squats", 0.0, 1e5),), {"shift_seg_m": [0.02, -0.02, 0.02]}),
)
"""A load and a knocked marker, which act backwards as they do forwards: the model is extended in both ways."""
WITH = {"beside": (False, True), "alone": (True,)}
"""Runs without and with the diagnosis that are asked for."""


def main() -> None:
    """Make the session, run it, and print what it cost."""
    args = Command(
        __doc__, minutes=60.0, against=(float, "a shorter length too [min], to tell the slope"), threads=1,
        trial=("squats", "the trial that is made long: squats, arms, sway_steps, ..."),
        folder=(Path, "keep recordings and results here"),
        diagnosis=({"nargs": "?", "const": "beside", "choices": tuple(WITH)}, "with it and the extended model too"),
    ).asked()  # fmt: skip
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.folder or Path(temporary)
        config = make_session(folder)
        lengths = [x for x in (args.against, args.minutes) if x]
        for diagnosis in WITH.get(args.diagnosis, (False,)):
            rows = [measure(config, args.trial, minutes, args.threads, diagnosis) for minutes in lengths]
            if len(rows) > 1:
                slope = (rows[1]["peak_MiB"] - rows[0]["peak_MiB"]) * 1024.0 / (rows[1]["frames"] - rows[0]["frames"])
                print(f"slope {slope:.2f} KiB/frame")


def make_session(folder: Path) -> Path:
    """A static, four fit and two held-out trials, with skin motion, gaps and ``HIDDEN``; path of their config."""
    options = SimulateOptions(duration_s=30.0, skin_motion_mm=3.0, gap_fraction=0.01, effects=HIDDEN)
    config = simulate_session(options, 1, folder).config
    assert config is not None
    return config


def measure(config: Path, trial: str, minutes: float, threads: int, diagnosis: bool) -> dict:
    """Run the config with ``trial`` made ``minutes`` long."""
    long = config.with_name(f"{trial}_{minutes:g}min.c3d")
    frames = lengthen(config.with_name(f"{trial}.c3d"), long, minutes)
    listed = config.read_text().replace(f"file: {trial}.c3d", f"file: {long.name}")
    own = config.with_name(f"config_{minutes:g}min.yaml")
    own.write_text(listed)
    out = config.with_name(f"out_{minutes:g}min_{'with' if diagnosis else 'without'}").resolve()
    found = run_child(own, out, threads, diagnosis) | {"minutes": minutes, "frames": frames}
    stages = json.loads((out / "provenance.json").read_text())["stages"]
    said = "with" if diagnosis else "without"
    print(f"{minutes:g} min, {frames} frames, a file of {long.stat().st_size / 2**20:.0f} MiB, {said} diagnosis")
    print(f"  peak {found['peak_MiB']:.0f} MiB, wall {found['wall_s']:.0f} s, CPU {found['cpu_s']:.0f} s")
    print("  " + ", ".join(f"{name} {stage['seconds']:.1f} s" for name, stage in stages.items()))
    return found


def lengthen(short: Path, long: Path, minutes: float) -> int:
    """Write ``short`` as often as needed, every second time backwards; returns the number of frames."""
    data = short.read_bytes()
    header = read_header(data, short)
    layout = resolve_layout(header, data)
    frames = np.frombuffer(data, "<f4", layout.frames * layout.values, layout.offset).reshape(-1, layout.values)
    first, last = turning_points(frames, layout)
    piece = frames[first:last]
    wanted = round(minutes * 60.0 * layout.rate)
    with long.open("wb") as file:
        file.write(without_count(data[: layout.offset], header))
        for k in range(0, wanted, len(piece)):
            part = reverse(piece, layout) if (k // len(piece)) % 2 else piece
            file.write(part[: wanted - k].tobytes())
    return wanted


def turning_points(frames: np.ndarray, layout: C3dLayout) -> tuple[int, int]:
    """First and last frame of the piece: where the markers are slowest near either end."""
    points = frames[:, : 4 * layout.points].reshape(len(frames), layout.points, 4)[..., :3]
    shifted = np.median(np.linalg.norm(points[5:] - points[:-5], axis=2), axis=1)
    near = min(round(TURN_S * layout.rate), len(shifted) // 3)
    return int(shifted[:near].argmin()) + 2, len(frames) - near + int(shifted[-near:].argmin()) - 2


def reverse(piece: np.ndarray, layout: C3dLayout) -> np.ndarray:
    """The piece backwards, the analog samples within each frame too."""
    turned = piece[::-1].copy()
    analogs = turned[:, 4 * layout.points :].reshape(len(piece), layout.ratio, layout.channels)
    turned[:, 4 * layout.points :] = analogs[:, ::-1].reshape(len(piece), -1)
    return turned


def without_count(head: bytes, header: C3dHeader) -> bytes:
    """Header and parameters with saturated counts of frames."""
    kept = bytearray(head)
    kept[header.start + 8 : header.start + 10] = SATURATED
    stated = header.find("POINT", "FRAMES")
    assert stated is not None and stated.kind == 2
    at = bytes(kept).index(b"FRAMES", header.start + 512) + len("FRAMES") + 2 + 2 + len(stated.dims)
    assert bytes(kept[at : at + 2]) == stated.raw
    kept[at : at + 2] = SATURATED
    return bytes(kept)


def run_child(config: Path, out: Path, threads: int, diagnosis: bool) -> dict[str, float]:
    """``torchid run`` as a process of its own: peak resident memory [MiB], wall and CPU time [s]."""
    asked = [f"out={out}", f"threads={threads}", f"diagnosis.enabled={str(diagnosis).lower()}"]
    line = [sys.executable, "-m", "torchid.cli", "run", str(config), *asked]
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    start, peak = time.perf_counter(), 0.0
    child = subprocess.Popen(line, env=environment)  # noqa: S603
    while True:
        peak = max(peak, high_water(child.pid))
        done, status, usage = os.wait4(child.pid, os.WNOHANG)
        if done:
            break
        time.sleep(0.05)
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"torchid run ended with {os.waitstatus_to_exitcode(status)}")
    wall, cpu = time.perf_counter() - start, usage.ru_utime + usage.ru_stime
    return {"peak_MiB": peak, "wall_s": wall, "cpu_s": cpu}


def high_water(pid: int) -> float:
    """Peak resident memory so far [MiB]. ``ru_maxrss`` would count this process, from which the child was forked."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    lines = [line for line in status.splitlines() if line.startswith("VmHWM")]
    return float(lines[0].split()[1]) / 1024.0 if lines else 0.0


if __name__ == "__main__":
    main()
