"""Marker sets: which segment a label rides on, which bony landmark it sits on, and which labels are no markers.

A set is YAML (or JSON) with one entry per label, ``label: segment`` or ``label: {segment: ..., landmark: ...}``, and up
to three keys beside them: ``aliases`` (label: other spellings), ``computed`` (patterns with ``*``, ``?``, ``[..]`` of
points that another program wrote, left out unless the set lists them), ``extends`` (a set whose entries come first).
"""

import difflib
import fnmatch
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import Inertial
from torchid.errors import ConfigError
from torchid.io.labels import AUGMENTED, loose
from torchid.model.landmarks import LANDMARKS
from torchid.model.model import Landmark, Model
from torchid.model.skeleton import SEGMENTS
from torchid.storage.documents import read_document

FOLDER = Path(__file__).parent / "marker_sets"
RESERVED = ("aliases", "computed", "extends")
ALIASES = "write them as aliases: {LASI: [LASIS, left asis]}"
FREE_SD = 0.10
"""Scatter of a marker without landmark about its segment's centre of mass, fraction of stature: wider than any segment
is thick and half as long as a thigh, so that it guides the first iteration and nothing else."""


@dataclass(frozen=True)
class MarkerSpec:
    """Where a marker belongs."""

    segment: str
    landmark: str | None = None


@dataclass(frozen=True)
class Match:
    """Labels of a file sorted by a marker set."""

    assigned: dict[str, MarkerSpec]
    """In the order of the file."""
    computed: tuple[str, ...]
    """Points of another program."""
    unknown: tuple[str, ...]
    """Neither: to be assigned by motion, or dropped."""


@dataclass(frozen=True)
class MarkerSet:
    """Labels of a laboratory and what they stand for."""

    name: str
    specs: dict[str, MarkerSpec]
    aliases: dict[str, tuple[str, ...]] = field(default_factory=dict)
    computed: tuple[str, ...] = ()

    def match(self, labels: Iterable[str]) -> Match:
        """Assign labels: as spelt, else without case, spaces, dots, dashes and underscores, else by alias.

        What remains is compared with the patterns of computed points. A prefix ``Subject:`` is ignored.
        """
        plain = {loose(label): spec for label, spec in self.specs.items()}
        other = {loose(alias): self.specs[label] for label, names in self.aliases.items() for alias in names}
        assigned: dict[str, MarkerSpec] = {}
        computed, unknown = [], []
        for label in labels:
            bare = label.rsplit(":", 1)[-1]
            spec = self.specs.get(bare) or plain.get(loose(bare)) or other.get(loose(bare))
            if spec is not None:
                assigned[label] = spec
            elif any(fnmatch.fnmatchcase(bare, pattern) for pattern in self.computed):
                computed.append(label)
            else:
                unknown.append(label)
        return Match(assigned, tuple(computed), tuple(unknown))

    @property
    def wanted(self) -> frozenset[str]:
        """Labels that are markers whatever they are called (``ReadOptions.wanted``).

        Not those of markers that OpenCap estimated: they are other spellings, which give way to the marker itself.
        """
        others = {name for names in self.aliases.values() for name in names if not name.endswith(AUGMENTED)}
        return frozenset(self.specs) | others


def marker_sets() -> tuple[str, ...]:
    """Names of the built-in sets."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def load_marker_set(
    name_or_path: str | Path, segments: tuple[str, ...] = SEGMENTS, landmarks: tuple[str, ...] = LANDMARKS
) -> MarkerSet:
    """Read a built-in set by name or a set from a YAML file.

    Args:
        segments: bodies of the model; the default is the whole body's.
        landmarks: landmarks that the model places.

    Raises:
        ConfigError: no such set, or an entry names an unknown segment, landmark or label; the nearest is named. So is
            a file that is absent or not plain YAML (``torchid.storage.documents``).
    """
    path = Path(name_or_path)
    if path.suffix.lower() not in (".yaml", ".yml", ".json"):
        known = marker_sets()
        if str(name_or_path) not in known:
            raise ConfigError(
                "markers.unknown_set", "no such marker set", source=str(name_or_path),
                remedy=_suggest(str(name_or_path), known, "built-in sets") + "; or give the path of a YAML file",
            )  # fmt: skip
        return _built_in(FOLDER / f"{name_or_path}.yaml", segments, landmarks)
    return _parse(_read(path), path, segments, landmarks)


@cache
def _built_in(path: Path, segments: tuple[str, ...], landmarks: tuple[str, ...]) -> MarkerSet:
    """One of torchid's own sets, read once: to recognise labels asks for all of them, recording after recording."""
    return _parse(_read(path), path, segments, landmarks)


def _read(path: Path) -> dict[str, object]:
    content = read_document(path)
    if not isinstance(content, dict):
        raise ConfigError(
            "markers.not_a_mapping", "a marker set is label: segment, line by line", source=path,
            remedy="Write one `label: segment` a line.",
        )  # fmt: skip
    return content


def _parse(
    content: Mapping[str, object], path: Path, segments: tuple[str, ...], landmarks: tuple[str, ...]
) -> MarkerSet:
    parent = content.get("extends")
    if parent is not None and (not isinstance(parent, str) or parent not in marker_sets() or parent == path.stem):
        raise ConfigError(
            "markers.extends", "extends names a built-in set", source=path, place="extends", found=repr(parent)[:80],
            remedy=_suggest(str(parent), marker_sets(), "built-in sets"),
        )  # fmt: skip
    base = load_marker_set(parent, segments, landmarks) if isinstance(parent, str) else MarkerSet("", {})
    own = {k: _spec(k, v, path, segments, landmarks) for k, v in content.items() if k not in RESERVED}
    specs = base.specs | own
    _check_spelling(specs, path)
    aliases = base.aliases | _aliases(_given(content, "aliases", {}), specs, path)
    computed = _given(content, "computed", [])
    if not isinstance(computed, list) or not all(isinstance(pattern, str) for pattern in computed):
        raise ConfigError(
            "markers.computed", "computed is a list of patterns", source=path, place="computed",
            found=repr(computed)[:80], remedy='write it as computed: ["*JC", "PEL?"]',
        )  # fmt: skip
    return MarkerSet(path.stem, specs, aliases, base.computed + tuple(computed))


def _given(content: Mapping[str, object], key: str, empty: object) -> object:
    """What stands under a key; ``empty`` where the key is absent or nothing is written after it."""
    return empty if content.get(key) is None else content[key]


def _spec(label: str, value: object, path: Path, segments: tuple[str, ...], landmarks: tuple[str, ...]) -> MarkerSpec:
    entry = {"segment": value} if isinstance(value, str) else value
    if not isinstance(entry, dict) or not {"segment"} <= set(entry) <= {"segment", "landmark"}:
        raise ConfigError(
            "markers.entry", "an entry is a segment, or {segment: ..., landmark: ...}", source=path, place=label,
            found=repr(value)[:80], remedy="write it as LASI: pelvis, or LASI: {segment: pelvis, landmark: asis_l}",
        )  # fmt: skip
    for key, known in (("segment", segments), ("landmark", landmarks)):
        if key in entry and entry[key] not in known:
            raise ConfigError(
                f"markers.{key}", f"unknown {key}", source=path, place=label, found=repr(entry[key])[:80],
                remedy=_suggest(str(entry[key]), known, f"{key}s"),
            )  # fmt: skip
    return MarkerSpec(entry["segment"], entry.get("landmark"))


def _check_spelling(specs: Mapping[str, MarkerSpec], path: Path) -> None:
    """Labels that differ only in case or punctuation must mean the same place."""
    seen: dict[str, str] = {}
    for label, spec in specs.items():
        twin = seen.setdefault(loose(label), label)
        if specs[twin] != spec:
            raise ConfigError(
                "markers.ambiguous", "two labels differ only in case or punctuation and sit in different places",
                source=path, place=f"{twin}, {label}", remedy="rename one in the recording and here",
            )  # fmt: skip


def _aliases(value: object, specs: Mapping[str, MarkerSpec], path: Path) -> dict[str, tuple[str, ...]]:
    if not isinstance(value, dict):
        raise ConfigError(
            "markers.aliases", "aliases are label: [other, ...]", source=path, place="aliases",
            found=repr(value)[:80], remedy=ALIASES,
        )  # fmt: skip
    found: dict[str, tuple[str, ...]] = {}
    for label, names in value.items():
        if label not in specs:
            raise ConfigError(
                "markers.alias", "alias of a label that the set lacks", source=path, place=f"aliases.{label}",
                remedy=_suggest(str(label), tuple(specs), "labels"),
            )  # fmt: skip
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            place = f"aliases.{label}"
            raise ConfigError("markers.alias", "not a list of labels", source=path, place=place, remedy=ALIASES)
        found[label] = tuple(names)
    return found


def _suggest(word: str, known: tuple[str, ...], what: str) -> str:
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    return f"did you mean {near[0]}?" if near else f"{what}: {', '.join(known)}"


def marker_prior(
    model: Model, specs: Iterable[MarkerSpec]
) -> tuple[Float[Tensor, "markers 3"], Float[Tensor, "markers 3"]]:
    """Mean and scatter of p_BM_B [m] of markers: on their landmark, else about their segment's centre of mass.

    Raises:
        ConfigError: a segment or landmark is not in the model, or the landmark lies on another segment.
    """
    mean, sd = [], []
    for spec in specs:
        if spec.segment not in model.tree.names:
            raise ConfigError(
                "markers.segment", "the model has no such segment", place=spec.segment,
                remedy=_suggest(spec.segment, model.tree.names, "segments"),
            )  # fmt: skip
        if spec.landmark is None:
            row = model.inertia.mean[model.tree.index(spec.segment)]
            mean.append(row[[Inertial.MCX, Inertial.MCY, Inertial.MCZ]] / row[Inertial.M])
            sd.append(row.new_full((3,), FREE_SD * model.height))
        else:
            landmark = _landmark(model, spec)
            mean.append(model.inertia.mean.new_tensor(landmark.p_BM_B))
            sd.append(model.inertia.mean.new_tensor(landmark.sd))
    if not mean:
        return model.inertia.mean.new_zeros(0, 3), model.inertia.mean.new_ones(0, 3)
    return torch.stack(mean), torch.stack(sd)


def _landmark(model: Model, spec: MarkerSpec) -> Landmark:
    landmark = model.landmarks.get(spec.landmark or "")
    if landmark is not None and landmark.segment == spec.segment:
        return landmark
    place, remedy = "", _suggest(str(spec.landmark), tuple(model.landmarks), "landmarks")
    if landmark is not None:
        own = [name for name, one in model.landmarks.items() if one.segment == spec.segment]
        place = f"; it lies on {landmark.segment}"
        remedy = f"write segment: {landmark.segment}, or a landmark of {spec.segment} ({', '.join(own) or 'none'})"
    raise ConfigError(
        "markers.landmark", "no such landmark on this segment", place=spec.segment, found=f"{spec.landmark}{place}",
        remedy=remedy,
    )  # fmt: skip
