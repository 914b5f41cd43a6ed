"""What the source itself shows: calls that run foreign code, errors without a remedy, codes that no test names."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from harness.command import ROOT

ERRORS = ("InputError", "ConfigError", "DataError", "TorchidError", "fault", "_marked")
CODE = re.compile(r"[a-z0-9_]+\.[a-z0-9_]+")
RUNS_CODE = ("eval", "exec", "pickle.load", "pickle.loads", "dill.load", "joblib.load", "yaml.load", "yaml.unsafe_load",
             "os.system", "os.popen", "marshal.loads")  # fmt: skip


def calls(folder: Path) -> Iterator[tuple[Path, ast.Call, str]]:
    """Every call below a folder, with the dotted name of what is called."""
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                yield path, node, ast.unparse(node.func)


def unsafe(folder: Path) -> list[str]:
    """Calls that may run what a file holds: unpickling, evaluating, shells, torch.load of more than weights."""
    found = []
    for path, call, name in calls(folder):
        words = {word.arg: ast.unparse(word.value) for word in call.keywords}
        pickled = words.get("allow_pickle") == "True" or name == "torch.load" and words.get("weights_only") != "True"
        if name in RUNS_CODE or pickled or words.get("shell") == "True":
            found.append(f"{path.name}:{call.lineno} {name}")
    return found


def without_remedy(folder: Path) -> tuple[list[str], int]:
    """Places where an error is made without a remedy, and the number of all places."""
    found, count = [], 0
    for path, call, name in calls(folder):
        if name.split(".")[-1] not in ERRORS or not call.args or not isinstance(call.args[-1], ast.expr):
            continue
        count += 1
        if "remedy" not in {word.arg for word in call.keywords} and len(call.args) < 5:
            found.append(f"{path.name}:{call.lineno}")
    return found, count


def unnamed_codes() -> tuple[list[str], int]:
    """Codes of errors and notes that no test names, and the number of all codes."""
    codes = set()
    for _, call, name in calls(ROOT / "torchid"):
        first = call.args[0] if call.args else None
        if name.split(".")[-1] in (*ERRORS, "Note") and isinstance(first, ast.Constant | ast.Attribute):
            codes |= {value for value in [getattr(first, "value", None)] if isinstance(value, str)}
        codes |= {
            a.value for a in call.args[:3] if name == "fault" and isinstance(a, ast.Constant) and _is_code(a.value)
        }
    codes = {code for code in codes if _is_code(code)}
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").glob("*.py")).replace("\\.", ".")
    return sorted(code for code in codes if code not in tests), len(codes)


def _is_code(text: object) -> bool:
    return isinstance(text, str) and bool(CODE.fullmatch(text))
