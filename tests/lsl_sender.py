"""A sender in a process of its own, to be killed: every marker stays at its own place, (letter, letter, letter).

python lsl_sender.py LABELS RATE_HZ, one letter for each marker; says so when its streams are open.
"""

import sys
import time

import pylsl

from torchid.live.sources.outlets import describe_markers, describe_plates
from torchid.recording import Plate


def main() -> None:
    """Send until killed."""
    labels, rate_hz = tuple(sys.argv[1]), float(sys.argv[2])
    plates = (Plate("left"), Plate("right"))
    outlets = {
        pylsl.StreamOutlet(describe_markers(labels, rate_hz, "mortal", "mortal markers")):
            [float(ord(label)) for label in labels for _ in range(3)],
        pylsl.StreamOutlet(describe_plates(plates, rate_hz, "mortal", "mortal plates")): [1.0] * 12,
    }  # fmt: skip
    print("open", flush=True)  # noqa: T201
    while True:
        for outlet, sample in outlets.items():
            outlet.push_sample(sample, pylsl.local_clock())
        time.sleep(1.0 / rate_hz)


if __name__ == "__main__":
    main()
