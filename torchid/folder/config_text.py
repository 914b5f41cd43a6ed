"""The config that a proposal becomes: YAML that says why each line stands there."""

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

from torchid.errors import InputError
from torchid.folder.proposal import Proposal
from torchid.folder.roles import Use
from torchid.io.b3d_header import read_b3d_model
from torchid.io.files import container_of
from torchid.model.marker_set import MarkerSpec
from torchid.model.recognition import Recognised
from torchid.wording import clean, listing

PLAIN = re.compile(r"[A-Za-z][\w./-]*")
"""Text that YAML reads as text without quotes."""
LONG = 500
"""Resolution. Letters of a reason."""
RESERVED = ("true", "false", "null", "none", "nan", "inf", "yes", "no", "on", "off")
"""Words that some YAML reads as something else."""


def config_text(proposal: Proposal, beside: Path, marker_map: str = "") -> str:
    """Return the config as text.

    Args:
        proposal: the session.
        beside: the folder in which the config will lie; recordings below it are named by relative paths.
        marker_map: name of the file there that holds ``marker_map_text``; empty: a built-in set is named.
    """
    parts = (
        _head(proposal), _markers(proposal.markers, marker_map), _model(proposal, beside), _trials(proposal, beside),
        _tail(proposal),
    )  # fmt: skip
    return "\n".join(line for part in parts for line in part) + "\n"


def marker_map_text(markers: Recognised) -> str:
    """Return a marker set as text: every label with its segment and landmark, and what told them.

    Args:
        markers: what was recognised.
    """
    lines = [f"# {clean(markers.said)}. Every line is LABEL: SEGMENT, or with a landmark."]
    ways = (
        (f"By the set {markers.name}:", markers.listed),
        ("By their words:", markers.worded),
        ("By where they stand and how they move, each to at least 90 %:", markers.placed),
    )
    for said, some in ways:
        lines += [f"# {said}"] * bool(some)
        lines += [f"{json.dumps(label, ensure_ascii=False)}: {_spec(one)}" for label, one in some.items()]
    lines += ["# Not told; write a segment behind those whose place you know:"] * bool(markers.unknown)
    lines += [f"# {json.dumps(clean(label), ensure_ascii=False)}:" for label in markers.unknown]
    return "\n".join(lines) + "\n"


def _spec(one: MarkerSpec) -> str:
    return one.segment if one.landmark is None else f"{{segment: {one.segment}, landmark: {one.landmark}}}"


def _head(proposal: Proposal) -> Iterator[str]:
    yield f"# Made by `torchid new` from {clean(proposal.folder.name)}; every line may be changed (docs/config.md)."
    yield from (f"# In doubt: {clean(doubt, LONG)}." for doubt in proposal.doubts)
    told = proposal.told
    facts = {"name": proposal.name} | told.person.known
    yield f"subject: {{{', '.join(f'{key}: {_scalar(value)}' for key, value in facts.items())}}}"
    where = [f"{key}: {source}" for key, source in told.sources.items()]
    if where:
        yield f"# {clean('; '.join(where), LONG)}"


def _markers(markers: Recognised, marker_map: str) -> Iterator[str]:
    yield f"markers: {_scalar(marker_map) if marker_map else markers.name}  # {clean(markers.said)}"
    if markers.unknown:
        named = clean(listing(markers.unknown, 12))
        yield f"# Not told: {named}. Each joins the segment that it surely moves with, or is left out."
        if marker_map:
            yield "unlisted: assign  # leave_out: they take no part"


def _model(proposal: Proposal, beside: Path) -> Iterator[str]:
    """Return what to write for the OpenSim model that the first file of several trials holds, where one does."""
    for file in dict.fromkeys(container_of(use.of.file) for use in proposal.uses):
        try:
            if file is not None and read_b3d_model(file):
                yield f"# In place of the built-in body, the OpenSim model in the file: model: {_path(file, beside)}"
                yield "# and markers: model (docs/opensim.md)."
                return
        except InputError:
            continue


def _trials(proposal: Proposal, beside: Path) -> Iterator[str]:
    yield "trials:"
    for use in proposal.uses:
        entry = f"{{{', '.join(_entry(use, beside))}}}"
        if use.role:
            yield f"  - {entry}  # {clean(use.why, LONG)}"
        else:
            yield f"  # left out: {clean(use.why, LONG)}"
            yield f"  # - {entry}"


def _entry(use: Use, beside: Path) -> Iterator[str]:
    yield f"name: {_scalar(use.of.name)}"
    if use.role:
        yield f"role: {use.role}"
    if not use.inertia:
        yield "inertia: false"
    if use.mend:
        yield use.mend
    yield f"file: {_path(use.of.file, beside)}"
    if use.of.forces is not None:
        yield f"forces: {_path(use.of.forces, beside)}"


def _tail(proposal: Proposal) -> Iterator[str]:
    if not any(use.role and use.serves_inertia for use in proposal.uses):
        yield "inertia: {enabled: false}  # no forces: geometry and motion alone"
    yield f"out: {_scalar(f'out/{proposal.name}')}"


def _path(file: Path, beside: Path) -> str:
    """Return a path as a config means it: below the config from there, else the whole.

    Raises:
        InputError: ``folder.path`` where a config would take a part of it for a variable.
    """
    if "${" in str(file):
        raise InputError(
            "folder.path", "a config takes ${...} in a path for a variable", source=str(file),
            remedy="Rename the folder or the file",
        )  # fmt: skip
    below = os.path.relpath(file, beside.resolve())
    # What begins with ~ would be a user's home.
    return _scalar(str(file) if below.startswith(("..", "~")) else below)


def _scalar(value: str | float) -> str:
    """Return a value as YAML has it; text in quotes where it could be read as anything else."""
    if isinstance(value, float | int):
        return f"{value:.6g}"
    plain = PLAIN.fullmatch(value) and value.lower() not in RESERVED
    return value if plain else json.dumps(value).replace("\x7f", "\\x7f")
