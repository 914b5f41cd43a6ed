"""Whom a folder shows: name, mass, stature and sex, from recordings and from files beside them."""

import csv
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from statistics import median

from torchid.errors import TorchidError
from torchid.folder.survey import Surveyed, plain_name
from torchid.kinematics.chain import chain_poses
from torchid.model.marker_set import MarkerSet
from torchid.model.markup import read_xml
from torchid.model.model import Model
from torchid.model.whole_body import whole_body
from torchid.storage.documents import read_document

LARGEST = 1 << 20
"""Resolution. Bytes of the largest file in which facts about a person are looked for."""
ALIKE = 0.02
"""Choice. Part by which two sources may differ about a mass or a stature and still agree."""
UPRIGHT = ("c7", "jugular_notch", "acromion", "asis", "psis", "knee_lateral", "head_front", "head_back")
"""Landmarks whose heights tell the stature of one who stands."""
FEWEST = 3
"""Choice. Landmarks that tell a stature."""
TALLEST_M, HEAVIEST_KG = 3.0, 1000.0
"""Bounds of ``config.sections.Subject``: a larger stature is in cm or mm."""
ABOUT = re.compile(r"_?(subject|participant|session|metadata|demograph|person|info)\w*\.(json|ya?ml|enf|tsv|csv)", re.I)
"""Files that say whom recordings show: AddBiomechanics' ``_subject.json``, OpenCap's ``sessionMetadata.yaml``, Vicon's
``.enf``, BIDS' ``participants.tsv``."""
PERSON = re.compile(r".*\.(mp|vsk)", re.I)
"""Vicon's parameters of a subject."""
SCALING = re.compile(r".*scal\w*\.xml", re.I)
"""OpenSim's settings of scaling, which hold the subject's mass and stature."""
KEYS = {
    "mass_kg": re.compile(r"(subject|body)?_?(mass|weight)(_?kg)?"),
    "height_m": re.compile(r"(subject|body)?_?(height|stature)(_?(m|cm|mm))?"),
    "sex": re.compile(r"(biological)?_?(sex|gender)"),
}
"""What the facts are called, in small letters."""
SEXES = {"m": "male", "male": "male", "f": "female", "female": "female", "w": "female"}


@dataclass(frozen=True)
class Person:
    """What is known of a subject before any fit; None where it is not."""

    name: str | None = None
    mass_kg: float | None = None
    height_m: float | None = None
    sex: str | None = None

    @property
    def known(self) -> dict[str, str | float]:
        """What is known, by the name of its key in a config."""
        every = {one.name: getattr(self, one.name) for one in fields(self)}
        return {key: value for key, value in every.items() if value is not None}


@dataclass(frozen=True)
class PersonFacts:
    """A person, and where each fact comes from."""

    person: Person
    sources: Mapping[str, str]
    """By the name of the fact."""
    contradictions: tuple[str, ...] = ()


def told_of(folder: Path, found: Sequence[Surveyed], given: Person) -> PersonFacts:
    """Return what is known of the person of some recordings.

    Args:
        folder: in which files about the person are looked for.
        found: the recordings.
        given: what the user says, which goes first.
    """
    each = [(given, "as given"), *_stated(found), *_beside(folder, found)]
    facts: dict[str, str | float] = {}
    sources: dict[str, str] = {}
    against: list[str] = []
    for person, source in each:
        for key, value in person.known.items():
            if key not in facts:
                facts[key], sources[key] = value, source
            elif isinstance(value, float) and abs(value / float(facts[key]) - 1.0) > ALIKE:
                against.append(f"{key} is {facts[key]:g} ({sources[key]}) and {value:g} ({source})")
    return PersonFacts(Person(**facts), sources, tuple(dict.fromkeys(against)))  # pyright: ignore[reportArgumentType]


def _stated(found: Sequence[Surveyed]) -> Iterator[tuple[Person, str]]:
    """Return what the recordings themselves state."""
    for one in found:
        stated = _facts(one.stated)
        if stated.known:
            yield stated, one.file.name


def _beside(folder: Path, found: Sequence[Surveyed]) -> Iterator[tuple[Person, str]]:
    """Return what files say that lie beside the recordings, or above them: elsewhere they are about others."""
    above = {place for one in found for place in one.file.parents if place == folder or folder in place.parents}
    for place in sorted(above | {folder}):
        for file in sorted(one for one in place.iterdir() if one.is_file()):
            person = _person_in(file)
            if person.known:
                yield person, file.name


def _person_in(file: Path) -> Person:
    """Return what a file says of a person: nothing where it is no such file, or cannot be read."""
    try:
        if not any(kind.fullmatch(file.name) for kind in (ABOUT, PERSON, SCALING)) or file.stat().st_size > LARGEST:
            return Person()
        return _facts(dict(_pairs(file)))
    except (OSError, ValueError, TorchidError):
        return Person()


def _pairs(file: Path) -> Iterator[tuple[str, str]]:
    """Return the facts of a file as keys and values."""
    kind = file.suffix.lower()
    if kind == ".xml":
        tool = read_xml(file, "OpenSimDocument").find(".//ScaleTool")
        yield from () if tool is None else ((str(part.tag), part.text or "") for part in tool)
    elif kind == ".json":
        yield from _flat(json.loads(file.read_text("utf-8-sig")))
    elif kind in (".yaml", ".yml"):
        yield from _flat(read_document(file))
    elif kind in (".tsv", ".csv"):
        with file.open(encoding="utf-8-sig", newline="") as text:
            rows = list(csv.DictReader(text, delimiter="\t" if kind == ".tsv" else ","))
        yield from rows[0].items() if len(rows) == 1 else ()
    else:
        found = re.findall(r"^\s*\$?(\w+)\s*=\s*(.+?)\s*$", file.read_text("utf-8", "replace"), re.MULTILINE)
        yield from found


def _flat(content: object) -> Iterator[tuple[str, str]]:
    """Return keys and values of nested mappings."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from _flat(value) if isinstance(value, dict) else ((str(key), str(value)),)


def _facts(pairs: Mapping[str, str]) -> Person:
    """Return the facts among keys and values, in kilograms and metres."""
    found: dict[str, str] = {}
    for key, value in pairs.items():
        small = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", key).lower()
        found |= {name: value for name, pattern in KEYS.items() if pattern.fullmatch(small) and name not in found}
    mass, height = _number(found.get("mass_kg", "")), _number(found.get("height_m", ""))
    while height and height > TALLEST_M:  # cm, or mm
        height /= 10.0 if height > 100.0 * TALLEST_M else 100.0
    sex = SEXES.get(found.get("sex", "").strip().lower())
    return Person(None, mass if mass and 0.0 < mass < HEAVIEST_KG else None, height or None, sex)


def _number(text: str) -> float | None:
    match = re.match(r"\s*([-+]?\d+(\.\d+)?([eE][-+]?\d+)?)", text)
    return float(match[1]) if match else None


def stature_of(standing: Surveyed, markers: MarkerSet) -> float | None:
    """Return the stature that the heights of a standing person's markers tell [m], None without landmarks.

    Each landmark's height is compared with its height in the template; the median of the ratios is taken.

    Args:
        standing: who stands still.
        markers: where the markers are.
    """
    given = markers.match(standing.labels).assigned
    model = whole_body(None, None)
    template = _template_heights(model)
    ratios = [
        standing.heights[label] / template[spec.landmark] for label, spec in given.items() if spec.landmark in template
    ]
    return round(model.height * median(ratios), 3) if len(ratios) >= FEWEST else None


def _template_heights(model: Model) -> dict[str, float]:
    """Return heights of the upright landmarks of the template above its lowest landmark [m]."""
    tree, xi = model.tree, model.geometry.mean
    X_WB = chain_poses(tree, xi.new_zeros(1, len(tree.dofs)), model.geometry.geometry(xi))[0]
    height = {
        name: float((X_WB[tree.index(one.segment)] @ xi.new_tensor([*one.p_BM_B, 1.0]))[2])
        for name, one in model.landmarks.items()
    }
    floor = min(height.values())
    return {name: z - floor for name, z in height.items() if re.sub(r"_[lr]$", "", name) in UPRIGHT}


def people_in(found: Sequence[Surveyed], folder: Path) -> dict[str, list[Surveyed]]:
    """Return the recordings of each person, by name.

    Recordings show one person unless they state masses or statures that differ: the name of a subject is often that of
    a template. Those that state nothing belong to everybody.

    Args:
        found: the recordings.
        folder: that holds them all.
    """
    groups: list[tuple[Person, list[Surveyed]]] = []
    silent: list[Surveyed] = []
    for one in found:
        stated = _facts(one.stated)
        if not stated.known:
            silent.append(one)
            continue
        own = next((members for person, members in groups if _alike(person, stated)), None)
        if own is None:
            groups.append((stated, [one]))
        else:
            own.append(one)
    if len(groups) < 2:
        return {_name_of(found, folder): list(found)}
    shared = [Path(os.path.commonpath([one.file.parent for one in members])) for _, members in groups]
    return {_name_of(own, place): [*own, *silent] for (_, own), place in zip(groups, shared, strict=True)}


def _alike(one: Person, other: Person) -> bool:
    """Return whether two statements may be of one person."""
    pairs = ((one.mass_kg, other.mass_kg), (one.height_m, other.height_m))
    return all(a is None or b is None or abs(a / b - 1.0) <= ALIKE for a, b in pairs)


def _name_of(some: Sequence[Surveyed], folder: Path) -> str:
    """Return the name that recordings state; where they state none or several, that of their folder."""
    named = {one.stated["subject"] for one in some if one.stated.get("subject")}
    return plain_name(named.pop() if len(named) == 1 else folder.name)
