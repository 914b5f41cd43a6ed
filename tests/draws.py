"""This module is what tests draw from: seeds that nobody chose, and the ledger of those that failed once.

In the gate the seed of a test is a hash of its name and ``VERSION``, so that no author picks it and every run is the
same. ``TORCHID_SEED`` takes its place everywhere: that is a draw (``scripts/test --draw``, ``scripts/draws``). A draw
that fails is an entry of ``draws.jsonl``, open until its cause is mended or explained.
"""

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Literal

VERSION = 1
"""Of all seeds of the gate: another number draws every test anew."""
LEDGER = Path(__file__).with_name("draws.jsonl")
"""One entry a line, oldest first."""
GIVEN = os.environ.get("TORCHID_SEED")
"""Seed of a draw, or None in the gate."""


def seed_of(name: str) -> int:
    """Return the seed, below 2^32, of what has this name.

    Args:
        name: of a test with its case, or of a module whose tests share what they draw.
    """
    if GIVEN is not None:
        return int(GIVEN)
    return int.from_bytes(hashlib.sha256(f"{VERSION} {name}".encode()).digest()[:4], "big")


@dataclass(frozen=True)
class Failure:
    """A test that failed on a draw."""

    test: str
    """Its id, with the case where it has some."""
    seed: int
    date: str
    said: str
    """Head of its message."""
    state: Literal["open", "mended", "explained"]
    """Mended failures are run in every gate; an explained one is a chance that the method or the test leaves."""
    cause: str
    """What was wrong and what was done, or why nothing is; empty while it is open."""

    @property
    def of(self) -> str:
        """The test without its case."""
        return self.test.partition("[")[0]


def ledger(path: Path = LEDGER) -> tuple[Failure, ...]:
    """Return all that failed once.

    Args:
        path: the ledger, which need not exist.
    """
    return tuple(Failure(**json.loads(line)) for line in path.read_text().splitlines()) if path.exists() else ()


@cache
def pinned() -> tuple[Failure, ...]:
    """Return the failures that the gate runs again: those whose cause is mended."""
    return tuple(one for one in ledger() if one.state == "mended" and GIVEN is None)


def pins_of(test: str) -> tuple[int, ...]:
    """Return the seeds on which a test failed once.

    Args:
        test: its id, without a case.
    """
    return tuple(dict.fromkeys(one.seed for one in pinned() if one.of == test))


@cache
def pinned_ids() -> frozenset[str]:
    """Return the ids of tests on their pinned seeds: of a test with cases, of the case that failed."""
    cases = ((one, one.test.removeprefix(one.of).removeprefix("[").removesuffix("]")) for one in pinned())
    return frozenset(f"{one.of}[seed={one.seed}{'-' if case else ''}{case}]" for one, case in cases)


def enter(test: str, seed: int, said: str, path: Path = LEDGER) -> None:
    """Write a failure down as open, unless the ledger has it.

    Args:
        test: id of the test.
        seed: of the draw.
        said: head of its message.
        path: the ledger.
    """
    if any((one.test, one.seed) == (test, seed) for one in ledger(path)):
        return
    found = Failure(test, seed, datetime.now(UTC).date().isoformat(), " ".join(said.split())[:300], "open", "")
    with path.open("a") as file:
        file.write(json.dumps(asdict(found), ensure_ascii=False) + "\n")
