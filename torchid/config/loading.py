"""Reads a config file with overrides from the command line, and writes the resolved one."""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from torchid.config.explain import InvalidConfig, explain
from torchid.config.groups import GroupQuestion
from torchid.config.sections import Config
from torchid.config.study import Study
from torchid.errors import ConfigError
from torchid.io.files import container_of, file_on_disk
from torchid.io.pairing import is_recording
from torchid.storage.documents import Document, dump_document, parse_document, read_document

Kind = TypeVar("Kind", bound=BaseModel)

CORRECT_PATH = "Correct the path; relative ones start at the config's folder."


def load_config(path: str | Path, overrides: Sequence[str] = ()) -> Config:
    """The config in a YAML or JSON file.

    Args:
        path: the file; relative paths inside it start at its folder.
        overrides: ``key=value`` with a dotted key (``geometry.solver=adam``, ``trials.0.role=fit``) and a YAML value.

    Raises:
        ConfigError: the file is not plain YAML, or an override is malformed.
        InvalidConfig: keys or values at fault, all of them at once; so are recordings that do not exist.
    """
    path = Path(path)
    return _config(_document(path, overrides), path)


def config_of_text(text: str, path: str | Path) -> Config:
    """The config that a text is, before it is written.

    Args:
        text: YAML or JSON.
        path: where it would lie.

    Raises:
        ConfigError: as of ``load_config``.
        InvalidConfig: as of ``load_config``.
    """
    document = parse_document(text, str(path))
    assert isinstance(document, dict)
    return _config(document, Path(path))


def load_evaluation(path: str | Path, overrides: Sequence[str] = ()) -> Config | Study | GroupQuestion:
    """The config of one subject's evaluation, the study in a file that lists ``subjects``, or what is asked of the
    groups of a cohort.

    Args:
        path: the file; relative paths inside it start at its folder. Or the folder of a finished cohort.
        overrides: as of ``load_config``.

    Raises:
        ConfigError: as of ``load_config``.
        InvalidConfig: as of ``load_config``; so are configs of subjects that do not exist.
    """
    path = Path(path)
    if path.is_dir():
        asked: dict[str, Document] = {"cohort": str(path.resolve())}
        for override in overrides:
            _override(asked, override)
            key, _, text = override.partition("=")
            if key.strip() == "reference":
                asked["reference"] = text.strip().strip("'\"")  # a group may be called 001
        return _validated(asked, GroupQuestion, path)
    document = _document(path, overrides)
    if "subjects" not in document:
        return _config(document, path)
    study = _validated(document, Study, path)
    absent = [(k, one.config) for k, one in enumerate(study.subjects) if one.config and not os.path.isfile(one.config)]
    if absent:
        raise InvalidConfig([_missing(f"subjects.{k}.config", file, str(path)) for k, file in absent])
    return study


def _document(path: Path, overrides: Sequence[str]) -> dict[str, Document]:
    if is_recording(path):
        raise ConfigError(
            "config.recording", "a recording is no config", source=path,
            remedy=f"`torchid new {container_of(path) or path.parent}` makes one of all recordings there; one that is "
            f"written by hand names it under trials, as file: {path}",
        )  # fmt: skip
    document = read_document(path)
    if not isinstance(document, dict):
        raise ConfigError(
            "config.not_a_mapping", "a config is a list of `key: value` lines", source=path, remedy="See configs/."
        )
    for override in overrides:
        _override(document, override)
    return document


def _config(document: dict[str, Document], path: Path) -> Config:
    config = _validated(document, Config, path)
    missing = _missing_files(config, str(path))
    if missing:
        raise InvalidConfig(missing)
    return config


def _validated(document: dict[str, Document], kind: type[Kind], path: Path) -> Kind:
    # JSON mode: strict about numbers and truth values, yet a list is a tuple and a text a path.
    try:
        return kind.model_validate_json(json.dumps(document), context={"base": path.resolve().parent})
    except ValidationError as error:
        raise explain(error.errors(include_url=False), document, kind, str(path)) from error


def dump_config(config: Config) -> str:
    """The resolved config as YAML, defaults written out; ``load_config`` reads an equal one."""
    return dump_document(config.model_dump(mode="json"))


def _missing_files(config: Config, source: str) -> list[ConfigError]:
    named: dict[str, Path | str | None] = {key: getattr(config, key) for key in ("model", "markers", "laboratory")}
    named["subject.people"] = config.subject.people
    for k, trial in enumerate(config.trials):
        named |= {f"trials.{k}.{key}": getattr(trial, key) for key in ("file", "forces", "channels")}
    named |= {f"conditions.{name}.device": condition.device for name, condition in config.conditions.items()}
    absent = [
        (key, file) for key, file in named.items() if isinstance(file, Path) and not os.path.isfile(file_on_disk(file))
    ]
    return [_missing(key, file, source) for key, file in absent]


def _missing(key: str, file: Path, source: str) -> ConfigError:
    return ConfigError(
        "config.missing_file", "no such file", source=source, place=key, found=str(file), remedy=CORRECT_PATH
    )


def _override(document: dict[str, Document], override: str) -> None:
    """Set one dotted key in place; sections on the way are made where they are absent."""
    key, equals, text = override.partition("=")
    steps = key.strip().split(".")
    if not equals or not all(steps):
        raise _bad_override(override, "an override is written key=value", "For example geometry.solver=adam.")
    value = parse_document(text, source=f"override {key}")
    holder: Any = document
    for step in steps[:-1]:
        if isinstance(holder, dict):
            if holder.get(step) is None:
                holder[step] = {}
            holder = holder[step]
        else:
            holder = holder[_index(holder, step, override)]
    if isinstance(holder, dict):
        holder[steps[-1]] = value
    else:
        holder[_index(holder, steps[-1], override)] = value


def _index(holder: Document, step: str, override: str) -> int:
    if not isinstance(holder, list):
        raise _bad_override(override, f"nothing can stand below a single value at '{step}'", "Set that key.")
    if not (step.isascii() and step.isdigit() and len(step) < 10 and int(step) < len(holder)):
        raise _bad_override(override, f"'{step}' is no entry of this list", f"It has {len(holder)}, counted from 0.")
    return int(step)


def _bad_override(override: str, message: str, remedy: str) -> ConfigError:
    return ConfigError("config.override", message, source="command line", found=override[:80], remedy=remedy)
