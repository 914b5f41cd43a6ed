"""Ten faults planted in a copy of the project, each of which a test must catch.

    PYTHONPATH=scripts python -m batteries.breakages
    PYTHONPATH=scripts python -m batteries.breakages --project ../before

A fault is one changed line where a whole run ends otherwise. Tests are run fault by fault until the first fails;
``--project`` takes another checkout, such as the one before its tests were shortened. Exits with 1 if a fault stays
unseen.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
COPIED = ("torchid", "tests", "scripts", "configs", "docs", "pyproject.toml", "README.md", "CONTRIBUTING.md")


@dataclass(frozen=True)
class Fault:
    """A line that is changed, and the files of tests, as far as they exist, that should see it."""

    what: str
    file: str
    line: str
    changed: str
    tests: tuple[str, ...]
    words: str = ""
    """Words by which pytest finds the tests in them, empty for all."""


ELIMINATION = "diagnosis/search/elimination.py"
DIAGNOSIS = ("test_diagnosis.py", "test_diagnosis_markers.py")
MARKERS = "stays_knocked"
FAULTS = (
    Fault("negative loads stay", ELIMINATION, "(theta < 0.0).all() or", "(theta < 0.0).all() and",
          ("test_doubtful.py",)),
    Fault("superfluous causes stay", ELIMINATION, "if nats < least:", "if nats < -1e9:", ("test_doubtful.py",)),
    Fault("skin is never learned", "diagnosis/evidence/skin_prior.py", "part = min(1.0, TOGETHER * size",
          "part = max(1.0, TOGETHER * size", ("test_skin.py",)),
    Fault("swapped names stay", "extension/swapped_markers.py", "position[inside, pair[::-1]]",
          "position[inside, pair]", ("test_relabelled.py",)),
    Fault("a swap bends the geometry for good", "extension/swapped_markers.py",
          "lambda: fit_session(config.geometry, session, True, progress)", "lambda: base.fit", ("test_relabelled.py",)),
    Fault("gaps are never bridged", "geometry/tracking.py", "if bridge and not bool(", "if False and not bool(",
          ("test_geometry_fit.py",), "gap"),
    Fault("held-out motion refutes nothing", "diagnosis/testing/refutation.py", "margin[worst] > -options.refuted_nats",
          "margin[worst] > -1e9", ("test_heldout.py", "test_diagnosis.py"), "held_out or refute"),
    Fault("flesh runs ahead of the bone", "effects/skin_lag.py", "-soft[which]", "soft[which]",
          ("test_effects.py",), "flesh"),
    Fault("no field is put beside a force", "diagnosis/testing/position_dependence.py", "if not bent:", "if True:",
          ("test_field.py",)),
    Fault("corrected markers stay as they were", "extension/correction.py", "-= off[:, k]", "-= 0.0 * off[:, k]",
          DIAGNOSIS, MARKERS),
)  # fmt: skip


def caught(fault: Fault, project: Path) -> str:
    """Return the test that fails because of a fault, empty if none does.

    Args:
        fault: the fault.
        project: checkout that is copied.

    Raises:
        ValueError: the line is not there, once.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for item in COPIED:
            (shutil.copytree if (project / item).is_dir() else shutil.copy)(project / item, folder / item)
        path = folder / "torchid" / fault.file
        text = path.read_text(encoding="utf-8")
        if text.count(fault.line) != 1:
            raise ValueError(f"{fault.what}: {fault.file} has {text.count(fault.line)} times {fault.line!r}, not once")
        path.write_text(text.replace(fault.line, fault.changed), encoding="utf-8")
        files = [f"tests/{one}" for one in fault.tests if (folder / "tests" / one).exists()]
        words = [sys.executable, "-m", "pytest", "-xq", "-p", "no:cacheprovider", "-k", fault.words,
                 "-o", "addopts=--strict-markers", *files]  # fmt: skip
        said = subprocess.run(words, cwd=folder, text=True, capture_output=True, check=False, env=_environment())  # noqa: S603
        if said.returncode not in (0, 1):
            raise ValueError(f"{fault.what}: pytest ended with {said.returncode}\n{said.stdout}{said.stderr}")
        failed = [line for line in said.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
        return failed[0].split(" - ")[0] if failed else ""


def _environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def main() -> None:
    """Print what catches each fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--project", type=Path, default=PROJECT, help="checkout with its tests")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    arguments = parser.parse_args()
    unseen = 0
    with ThreadPoolExecutor(arguments.workers) as pool:
        for fault, said in zip(FAULTS, pool.map(lambda one: caught(one, arguments.project), FAULTS), strict=True):
            unseen += not said
            print(f"{fault.what}: {said or 'NOT SEEN'}", flush=True)
    print(f"{len(FAULTS) - unseen} of {len(FAULTS)} faults caught")
    sys.exit(bool(unseen))


if __name__ == "__main__":
    main()
