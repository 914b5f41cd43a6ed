"""Speed beside other programs (``scripts/bench``), and errors against the truth; what hides it lies with the tests."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
