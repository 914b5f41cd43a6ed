"""Turns what pydantic found into errors that name the key, what was found and the nearest thing that exists."""

import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from difflib import get_close_matches
from typing import Any, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from torchid.errors import ConfigError, OptionError

Place = tuple[str | int, ...]
Section = type
"""A pydantic model, or a dataclass of options."""
MOST = 20
"""Problems that are explained; what else is wrong is counted."""

_CODES = {
    "extra_forbidden": "config.unknown_key",
    "unexpected_keyword_argument": "config.unknown_key",
    "missing": "config.missing_key",
    "literal_error": "config.unknown_value",
    "json_invalid": "config.invalid_text",
    "path": "config.path",
    "unset_variable": "config.unset_variable",
    "unknown_name": "config.unknown_value",
    "duplicate_trial": "config.duplicate_trial",
    "no_trials": "config.no_trials",
    "no_mass": "config.no_mass",
    "unknown_condition": "config.unknown_condition",
    "no_reference": "config.no_reference",
    "empty_condition": "config.empty_condition",
    "unknown_trial": "config.unknown_trial",
}


_WORDINGS = {
    "bool_type": "must be true or false",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "string_type": "must be text",
    "tuple_type": "must be a list",
    "dict_type": "must be a mapping {key: value}",
    "model_type": "must be a mapping {key: value}",
    "dataclass_type": "must be a mapping {key: value}",
}


_REMEDIES = {
    "path": "Write a path, in quotes where it has : or # in it.",
    "unset_variable": "Set it, or write the path out.",
    "duplicate_trial": "Give every trial a name of its own.",
    "no_trials": "List recordings under trials:, or describe a person under simulate:.",
    "no_mass": "Give subject.mass_kg, or leave inertia.known_mass out.",
    "unknown_condition": "List it under conditions:, or correct the trial's condition:.",
    "no_reference": "Write reference: true in exactly one of the conditions.",
    "empty_condition": "Give trials this condition:, or leave the condition out.",
    "unknown_trial": "Name one of the trials:, or correct the contact's when:.",
}
"""What to do about a refused value, where no other value is near."""


class InvalidConfig(ConfigError):
    """All that is wrong with a config at once; code, place and remedy are those of the first problem."""

    def __init__(self, problems: Sequence[ConfigError]) -> None:
        self.problems = tuple(problems)
        first = self.problems[0]
        super().__init__(
            first.code,
            first.message,
            source=first.source,
            place=first.place,
            found=first.found,
            remedy=first.remedy,
        )

    def __str__(self) -> str:
        return "\n".join(str(problem) for problem in self.problems)


def explain(details: list[ErrorDetails], document: Any, model: type[BaseModel], source: str) -> InvalidConfig:
    """One error per key at fault.

    Args:
        details: ``ValidationError.errors()``.
        document: the data that was refused.
        model: the model that refused it.
        source: where the data come from.
    """
    grouped: dict[Place, list[ErrorDetails]] = {}
    for detail in details:
        grouped.setdefault(_place(detail, document), []).append(detail)
    # A union reports every member; the one that went deepest is what the user meant.
    above = {place[:k] for place in grouped for k in range(len(place))}
    deepest = [place for place in grouped if place not in above]
    problems = [_explain_one(place, grouped[place], document, model, source) for place in deepest[:MOST]]
    if len(deepest) > MOST:
        message, remedy = f"{len(deepest) - MOST} more problems are not listed", "Correct those above first."
        problems.append(ConfigError("config.more_problems", message, source=source, remedy=remedy))
    return InvalidConfig(problems)


def dotted(place: Place) -> str:
    """``("trials", 0, "role")`` as ``trials.0.role``."""
    return ".".join(map(str, place))


def _place(detail: ErrorDetails, document: Any) -> Place:
    """The key path without the union members that pydantic mixes into its location."""
    place: list[str | int] = []
    for step in detail["loc"]:
        if isinstance(document, dict) and step in document:
            document = document[step]
        elif isinstance(document, list) and isinstance(step, int) and step < len(document):
            document = document[step]
        elif not (detail["type"] == "missing" and step == detail["loc"][-1]):
            continue
        place.append(step)
    return tuple(place)


def _explain_one(
    place: Place, details: list[ErrorDetails], document: Any, model: type[BaseModel], source: str
) -> ConfigError:
    kind, refused = details[0]["type"], details[0].get("ctx", {}).get("error")
    found, remedy = "", ""
    if isinstance(refused, OptionError):
        place = (*place, refused.place)
        return ConfigError(
            refused.code, refused.message, source=source, place=dotted(place), found=refused.found,
            remedy=refused.remedy,
        )  # fmt: skip
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        message, remedy = "unknown key", _nearest_key(place, document, model)
    elif kind == "missing":
        message, remedy = "this key is required", f"Add {place[-1]}: and its value."
    else:
        message = " or ".join(dict.fromkeys(_wording(detail) for detail in details))
        value = _value(document, place)
        found = repr(value)[:80] if place and not isinstance(value, dict | list) else ""
        remedy = _did_you_mean(str(value), _literals(details)) or _REMEDIES.get(kind, "Correct this value.")
        remedy = f"Write it in brackets: [{value}]." if kind == "tuple_type" and found else remedy
    code = _CODES.get(kind, "config.invalid_value")
    return ConfigError(code, message, source=source, place=dotted(place), found=found, remedy=remedy)


def _wording(detail: ErrorDetails) -> str:
    return _WORDINGS.get(detail["type"], detail["msg"].replace("Input should be", "must be"))


def _literals(details: list[ErrorDetails]) -> list[str]:
    """The words that an enumeration accepts, from pydantic's ``'a', 'b' or 'c'``, or a validator's list."""
    context = [detail.get("ctx", {}) for detail in details]
    text = " ".join(str(entry.get("expected", entry.get("known", ""))) for entry in context)
    return [word.strip("',") for word in text.split()]


def _did_you_mean(word: str, known: Sequence[str]) -> str:
    nearest = get_close_matches(word.lower(), known, n=1, cutoff=0.5)
    return f"Did you mean '{nearest[0]}'?" if nearest else ""


def _nearest_key(place: Place, document: Any, model: type[BaseModel]) -> str:
    """The nearest key of the same section, else a section that has this very key, else the keys there are."""
    section = _section(place[:-1], document, model)
    key = str(place[-1])
    fields = list(_fields(section)) if section else []
    taken = set(_value(document, place[:-1]) or ())
    free = [name for name in fields if name not in taken]
    hint = _did_you_mean(key, free or fields)
    if hint:
        return hint
    elsewhere = [name for name, other in _sections(model) if key in _fields(other)]
    if elsewhere:
        return "It belongs to " + " or ".join(elsewhere) + "."
    return f"Known here: {', '.join(fields)}."


def _section(place: Place, document: Any, model: type[BaseModel]) -> Section | None:
    current, keyed = model, False
    for step in place:
        if isinstance(step, int):
            continue
        fields = _fields(current) if current else {}
        if keyed and step not in fields:  # a name that the user gives, of a mapping to sections
            keyed = False
            continue
        current = next(_inside(fields[step]), None) if step in fields else None
        keyed = get_origin(fields.get(step)) is dict
    return current


def _sections(model: type[BaseModel]) -> Iterator[tuple[str, Section]]:
    for name, annotation in _fields(model).items():
        for nested in _inside(annotation):
            yield name, nested


def _fields(section: Section) -> Mapping[str, Any]:
    """Keys of a section and the types of their values."""
    if issubclass(section, BaseModel):
        return {name: field.annotation for name, field in section.model_fields.items()}
    hints = get_type_hints(section)
    return {name: hints[name] for name in section.__dataclass_fields__}


def _inside(annotation: Any) -> Iterator[Section]:
    """Sections inside an annotation such as ``tuple[Trial, ...]`` or ``SimulateOptions | None``."""
    if isinstance(annotation, type) and get_origin(annotation) is None:
        if issubclass(annotation, BaseModel) or is_dataclass(annotation):
            yield annotation
    elif get_origin(annotation) in (Union, types.UnionType, tuple, list, dict):
        for part in get_args(annotation):
            yield from _inside(part)


def _value(document: Any, place: Place) -> Any:
    for step in place:
        document = document[step]
    return document
