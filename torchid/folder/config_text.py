"""The config that a proposal becomes: YAML that says why each line stands there."""

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

from torchid.folder.proposal import Proposal
from torchid.folder.roles import Use
from torchid.wording import clean, listing

PLAIN = re.compile(r"[A-Za-z][\w./-]*")
"""Text that YAML reads as text without quotes."""
RESERVED = ("true", "false", "null", "none", "nan", "inf", "yes", "no", "on", "off")
"""Words that some YAML reads as something else."""


def config_text(proposal: Proposal, beside: Path) -> str:
    """Return the config as text.

    Args:
        proposal: the session.
        beside: the folder in which the config will lie; recordings below it are named by relative paths.
    """
    return "\n".join([*_head(proposal), *_trials(proposal, beside), *_tail(proposal)]) + "\n"


def _head(proposal: Proposal) -> Iterator[str]:
    yield f"# Made by `torchid new` from {clean(proposal.folder.name)}; every line may be changed (docs/config.md)."
    yield from (f"# In doubt: {clean(doubt)}." for doubt in proposal.doubts)
    told = proposal.told
    facts = {"name": proposal.name} | told.person.known
    yield f"subject: {{{', '.join(f'{key}: {_scalar(value)}' for key, value in facts.items())}}}"
    where = [f"{key}: {source}" for key, source in told.sources.items()]
    if where:
        yield f"# {clean('; '.join(where))}"
    markers = proposal.markers
    yield f"markers: {markers.name}  # lists {len(markers.listed)} of {markers.every} labels"
    if markers.unknown:
        yield f"# Not listed, and placed by how they move: {clean(listing(markers.unknown, 12))}."
        yield "# With `unlisted: leave_out` they are left out."


def _trials(proposal: Proposal, beside: Path) -> Iterator[str]:
    yield "trials:"
    for use in proposal.uses:
        entry = f"{{{', '.join(_entry(use, beside))}}}"
        if use.role:
            yield f"  - {entry}  # {clean(use.why)}"
        else:
            yield f"  # left out, {clean(use.why)}"
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
    yield f"out: {_scalar(f'out/{proposal.name}')}"


def _path(file: Path, beside: Path) -> str:
    beside = beside.resolve()
    return _scalar(os.path.relpath(file, beside) if file.is_relative_to(beside) else str(file))


def _scalar(value: str | float) -> str:
    """Return a value as YAML has it; text in quotes where it could be read as anything else."""
    if isinstance(value, float | int):
        return f"{value:.6g}"
    plain = PLAIN.fullmatch(value) and value.lower() not in RESERVED
    return value if plain else json.dumps(value, ensure_ascii=False)
