"""Streams a trial over Lab Streaming Layer at its own pace, as a laboratory would, for `torchid live --source lsl`.

    python scripts/send_lsl.py configs/hamner2013_subject04.yaml --trial walk1
    python scripts/send_lsl.py walk.trc --forces walk.mot --up y --speed 2 --loop

It waits until somebody listens. Everybody on the network can listen (docs/live.md says how to confine it).
"""

import time
from argparse import Namespace
from pathlib import Path

from harness.command import Among, Command

from torchid.config import load_config
from torchid.io import ReadOptions, read_trial
from torchid.live.sources.outlets import Outlets, play
from torchid.recording import Trial
from torchid.session.opening import read_recording, setup_of

CONFIGS = (".yaml", ".yml", ".json")


def main(arguments: list[str] | None = None) -> None:
    """Send until the trial ends, or with --loop until Ctrl-C."""
    given = Command(
        __doc__, ("file",), file=(Path, "a config, a C3D or a TRC"), trial=(str, "of the config"),
        forces=(Path, "MOT beside a TRC or C3D"), name=("torchid", "of the streams"), speed=1.0, loop=False,
        up=(Among(("y", "z")), "vertical axis, where the file leaves it open"),
    ).asked(arguments)  # fmt: skip
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


def read(given: Namespace) -> Trial:
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
