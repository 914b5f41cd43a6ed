"""Sessions in which effects are hidden, and how torchid fares; the laboratory in MuJoCo lies with the tests."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))
