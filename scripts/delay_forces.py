"""A session whose plates are late: forces of a config's trials on another clock, to see whether that is found.

    python scripts/delay_forces.py configs/hamner2013_subject04.yaml 0.010 out/late
    torchid run out/late/config.yaml

Takes forces from OpenSim's motion files; markers are read where they are.
"""

from pathlib import Path

import yaml
from harness.command import Command

from torchid.config import load_config


def delayed(text: str, lag_s: float) -> str:
    """A motion file whose times, the first column behind the line of labels, are later by a lag."""
    lines = text.splitlines()
    labels = next((k for k, line in enumerate(lines) if line.split()[:1] == ["time"]), None)
    if labels is None:
        raise SystemExit("no line of labels that begins with `time`: give a config whose forces are .mot files")
    rows = [line.split(None, 1) for line in lines[labels + 1 :] if line.strip()]
    return "\n".join([*lines[: labels + 1], *(f"{float(time) + lag_s:.6f}\t{rest}" for time, rest in rows)]) + "\n"


def main() -> None:
    """Write motion files and a config beside them."""
    arguments = Command(__doc__, ("config", "lag_s", "out"), config=Path, lag_s=float, out=Path).asked()
    arguments.out.mkdir(parents=True, exist_ok=True)
    content = yaml.safe_load(arguments.config.read_text())
    for entry, trial in zip(content["trials"], load_config(arguments.config).trials, strict=True):
        if trial.forces is not None:
            entry["forces"] = f"{trial.name}.mot"
            (arguments.out / entry["forces"]).write_text(delayed(trial.forces.read_text(), arguments.lag_s))
    content["out"] = "out"
    (arguments.out / "config.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    print(arguments.out / "config.yaml")


if __name__ == "__main__":
    main()
