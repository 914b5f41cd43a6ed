"""What a recording, and files beside it, say of the person whom it shows."""

import csv
import json
import logging
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path

from torchid.errors import TorchidError
from torchid.folder.survey import Surveyed
from torchid.io.files import bids_places
from torchid.model.markup import read_xml
from torchid.storage.documents import read_document

LARGEST = 1 << 20
"""Resolution. Bytes of the largest file in which facts about a person are looked for."""
TALLEST_M, SMALLEST_M, HEAVIEST_KG, OLDEST_YEARS = 3.0, 0.3, 1000.0, 120.0
"""Bounds of ``config.sections.Subject``: a larger stature is in cm or mm, other values are nobody's."""
ABOUT = re.compile(
    r"(.*\.)?_?(subject|participant|session|metadata|demograph|person|patient|info)\w*\.(json|ya?ml|enf)", re.I
)
"""Files that say whom recordings show: AddBiomechanics' ``_subject.json``, OpenCap's ``sessionMetadata.yaml``, Vicon's
``.enf``."""
PARTICIPANTS = re.compile(r"participants?\.(tsv|csv)", re.I)
"""Tables with a row for each person, as of BIDS."""
PARAMETERS = re.compile(r".*\.mp", re.I)
"""Vicon's parameters of a subject."""
SCALING = re.compile(r".*scal\w*\.xml", re.I)
"""OpenSim's settings of scaling, which hold the subject's mass and stature. The age there serves nothing, and is often
that of an example."""
KEYS = {
    "mass_kg": re.compile(r"(subject|body)?_?(mass|weight)(_?kg)?"),
    "height_m": re.compile(r"(subject|body)?_?(height|stature)(_?(m|cm|mm))?"),
    "sex": re.compile(r"(biological)?_?(sex|gender)(_?mf)?"),
    "age_years": re.compile(r"(subject)?_?age(_?(y|yrs?|years?))?"),
}
"""What the facts are called, in small letters. ``body_age`` is what scales make of fat and water."""
UNITS = {"mass_kg": r"kg", "height_m": r"m|cm|mm", "age_years": r"y|yrs?|years?"}
"""Units in which people write them. A number in another unit is none: 18 m is no age of 18 years."""
SEXES = {"m": "male", "male": "male", "f": "female", "female": "female", "w": "female"}
NUMBER = r"\s*(\d+(?:[.,]\d+)?(?:[eE][-+]?\d{1,2})?)\s*"
"""A number as people write it."""
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Person:
    """What is known of a subject before any fit; None where it is not."""

    name: str | None = None
    mass_kg: float | None = None
    height_m: float | None = None
    sex: str | None = None
    age_years: float | None = None

    @property
    def known(self) -> dict[str, str | float]:
        """What is known, by the name of its key in a config."""
        every = {one.name: getattr(self, one.name) for one in fields(self)}
        return {key: value for key, value in every.items() if value is not None}


def statements_of(one: Surveyed, folder: Path) -> list[tuple[Person, str]]:
    """Return what a recording itself, and files beside it or above it, say of its person, the nearest first.

    Args:
        one: the recording.
        folder: above which nothing is looked for, but for the data set of BIDS in which it lies.
    """
    stated = _person_of(dict(one.stated))
    found = [(stated, one.file.name)] if stated.known else []
    root = bids_places(folder)[-1]
    for place in (one.file.parent, *one.file.parent.parents):
        if place != root and root not in place.parents:
            break
        found += [(person, os.path.relpath(file, folder)) for file, person in _in_folder(place, _names(one, root))]
    return found


def _names(one: Surveyed, folder: Path) -> frozenset[str]:
    """Return the names under which a table of participants may have the person of a recording."""
    return frozenset({one.stated.get("subject", ""), folder.name, *one.file.relative_to(folder).parent.parts} - {""})


def _in_folder(place: Path, names: frozenset[str]) -> list[tuple[Path, Person]]:
    """Return what the files of a folder say of a person."""
    try:
        files = sorted(file for file in place.iterdir() if file.is_file())
    except OSError:
        return []
    return [(file, person) for file in files if (person := _person_in(file, names)).known]


def _person_in(file: Path, names: frozenset[str]) -> Person:
    """Return what a file says of a person: nothing where it is no such file, or cannot be read."""
    kinds = (ABOUT, PARTICIPANTS, PARAMETERS, SCALING)
    try:
        if not any(kind.fullmatch(file.name) for kind in kinds) or file.stat().st_size > LARGEST:
            return Person()
        people = [_person_of(pairs) for pairs in _mappings(file, names)]
    except (OSError, ValueError, csv.Error, RecursionError, TorchidError) as error:
        log.warning("%s says nothing of a person: %s", file, error)
        return Person()
    if PARTICIPANTS.fullmatch(file.name):
        return next((one for one in people if one.known), Person())
    # A height alone may be a camera's, or a picture's.
    return next((one for one in people if one.mass_kg or one.sex), Person())


def _mappings(file: Path, names: frozenset[str]) -> Iterator[dict[str, str]]:
    """Return the mappings of keys to values in a file."""
    kind = file.suffix.lower()
    if kind == ".xml":
        tool = read_xml(file, "OpenSimDocument").find(".//ScaleTool")
        yield {} if tool is None else {str(part.tag): part.text or "" for part in tool if part.tag != "age"}
    elif kind == ".json":
        yield from _nested(json.loads(file.read_text("utf-8-sig")))
    elif kind in (".yaml", ".yml"):
        yield from _nested(read_document(file))
    elif kind in (".tsv", ".csv"):
        text = file.read_text("utf-8-sig")
        mark = "\t" if kind == ".tsv" else ";" if ";" in text.partition("\n")[0] else ","
        rows = list(csv.DictReader(text.splitlines(), delimiter=mark))
        own = rows if len(rows) == 1 else [row for row in rows if names & {str(value) for value in row.values()}]
        yield from ({str(key): str(value) for key, value in row.items()} for row in own)
    else:
        yield dict(re.findall(r"^\s*\$?(\w+)\s*=\s*(.+?)\s*$", file.read_text("utf-8", "replace"), re.MULTILINE))


def _nested(content: object) -> Iterator[dict[str, str]]:
    """Return a mapping's own values, then those of mappings in it."""
    if isinstance(content, dict):
        yield {str(key): str(value) for key, value in content.items() if not isinstance(value, dict | list)}
        for value in content.values():
            yield from _nested(value)


def _person_of(pairs: Mapping[str, object]) -> Person:
    """Return the facts among keys and values, in kilograms, metres and years; what is nobody's is none."""
    found: dict[str, str] = {}
    for key, value in pairs.items():
        small = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", str(key)).lower()
        found |= {name: str(value) for name, word in KEYS.items() if word.fullmatch(small) and name not in found}
    mass, height, age = (_number(found.get(key, ""), unit) for key, unit in UNITS.items())
    if height and height > TALLEST_M:  # cm, or mm
        height /= 1000.0 if height > 100.0 * TALLEST_M else 100.0
    sex = SEXES.get(found.get("sex", "").strip().lower())
    return Person(
        None,
        mass if mass and 0.0 < mass < HEAVIEST_KG else None,
        height if height and SMALLEST_M < height < TALLEST_M else None,
        sex,
        age if age and 0.0 < age < OLDEST_YEARS else None,
    )


def _number(text: str, unit: str) -> float | None:
    match = re.fullmatch(rf"{NUMBER}({unit})?\s*", text)
    return float(match[1].replace(",", ".")) if match else None
