"""Paths as a config means them: variables expanded, relative ones from the config's folder."""

import os
import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import PlainValidator
from pydantic_core import PydanticCustomError

PROJECT_DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
"""Where ``${TORCHID_DATA}`` points unless the environment says otherwise: ``shared/data`` beside the project."""


def resolve_path(text: object, info: Any) -> Path:
    """The absolute path that a config means: ``${VAR}`` and ``~`` expanded, relative ones from the folder in ``info``.

    ``info`` is pydantic's ValidationInfo, a protocol that beartype cannot check.
    """
    text = str(text) if isinstance(text, Path) else text
    if not isinstance(text, str) or not text.strip():
        raise PydanticCustomError("path", "must be a path")
    if "\0" in text:
        raise PydanticCustomError("path", "a path cannot hold a NUL character")
    expanded = re.sub(r"\$\{([^}]*)\}", lambda match: _variable(match[1]), text)
    base = Path((info.context or {}).get("base", "."))
    try:
        return Path(os.path.abspath(base / Path(expanded).expanduser()))
    except RuntimeError as error:
        raise PydanticCustomError("path", "no such user's home") from error


def _variable(name: str) -> str:
    value = os.environ.get(name)
    if value is None and name == "TORCHID_DATA" and PROJECT_DATA.is_dir():
        return str(PROJECT_DATA)
    if value is None:
        raise PydanticCustomError("unset_variable", "the environment variable {name} is not set", {"name": name})
    return value


UserPath = Annotated[Path, PlainValidator(resolve_path)]
