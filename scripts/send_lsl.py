"""Streams a trial over Lab Streaming Layer at its own pace, as a laboratory would, for `torchid live --source lsl`.

    python scripts/send_lsl.py configs/hamner2013_subject04.yaml --trial walk1
    python scripts/send_lsl.py walk.trc --forces walk.mot --up y --speed 2 --loop

It waits until somebody listens. Everybody on the network can listen (docs/live.md says how to confine it).
"""

import argparse
import time
from pathlib import Path

from torchid.config import load_config
from torchid.io import ReadOptions, read_trial
from torchid.live.sources.outlets import Outlets, play
from torchid.recording import Trial
from torchid.session.opening import read_recording, setup_of

CONFIGS = (".yaml", ".yml", ".json")


def main(arguments: list[str] | None = None) -> None:
    """Send until the trial ends, or with --loop until Ctrl-C."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="a config, a C3D or a TRC")
    parser.add_argument("--trial", help="of the config")
    parser.add_argument("--forces", type=Path, help="MOT beside a TRC or C3D")
    parser.add_argument("--up", choices=("y", "z"), help="vertical axis, where the file leaves it open")
    parser.add_argument("--name", default="torchid", help="of the streams")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--loop", action="store_true")
    given = parser.parse_args(arguments)
    trial = read(given)
    outlets = Outlets(trial, given.name)
    print(f"{len(trial.markers.time)} frames of {trial.name} as {given.name}; waiting for a listener", flush=True)
    try:
        while not outlets.listened():
            time.sleep(0.05)
        play(trial, outlets, given.speed, given.loop)
        time.sleep(1.0)  # the last samples are still under way when an outlet is closed at once
    except KeyboardInterrupt:
        print("stopped")


def read(given: argparse.Namespace) -> Trial:
    """The trial that is to be sent."""
    if given.file.suffix.lower() not in CONFIGS:
        return read_trial(given.file.stem, given.file, given.forces, options=ReadOptions(up=given.up))
    config = load_config(given.file)
    names = {file.name: file for file in config.trials}
    if given.trial not in names:
        raise SystemExit(f"give --trial, one of {', '.join(names)}")
    return read_recording(names[given.trial], setup_of(config))


if __name__ == "__main__":
    main()
