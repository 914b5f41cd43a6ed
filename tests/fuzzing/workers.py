"""Mutants made and read in child processes with limits, so that a crash, a hang or a blow-up is a result too."""

import json
import os
import resource
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch

from fuzzing.changes import changes
from fuzzing.damage_bytes import Damaged, cut, damage_c3d
from fuzzing.damage_text import damage_text
from fuzzing.damage_tree import damage_xml, damage_yaml
from fuzzing.reading import Reading, read
from fuzzing.seeds import KINDS, Seed, seeds
from torchid.errors import TorchidError

DAMAGE = {"c3d": damage_c3d, "trc": damage_text, "mot": damage_text, "sto": damage_text, "config": damage_yaml,
          "marker_set": damage_yaml, "urdf": damage_xml, "mjcf": damage_xml}  # fmt: skip
MISSPELT = ("renamed", "attribute renamed")
"""Damage to a model after which a name is there that the format does not have."""
CPU_S = 2.0
"""CPU time for one mutant; a machine under load does not make a hang."""
WALL_S = 60.0
MEMORY = 100 << 20
"""Bytes that reading may take beside eight times the file."""
BATCH = 500
"""Mutants per child process."""


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant."""

    number: int
    seed: str
    how: str
    place: str
    outcome: str
    """refused | noted | equal | silent | bad."""
    detail: str
    """The error's code; notes; rules of the change; what went wrong."""
    seconds: float = 0.0
    remedy: bool = True


def mutant(kind: str, number: int, seed: int, truncate: bool, sound: Sequence[Seed]) -> tuple[Seed, Damaged]:
    """The mutant of this number, always the same for the same seed; some read their sound file unchanged."""
    random = np.random.default_rng([seed, KINDS.index(kind), number, truncate])
    small = [one for one in sound if len(one.content) < 30_000]
    chosen = sound if random.random() < 0.1 or not small else small
    one = chosen[random.integers(len(chosen))]
    return one, (cut if truncate else DAMAGE[kind])(one.content, random)


def run(kind: str, numbers: Sequence[int], seed: int, truncate: bool) -> list[Verdict]:
    """Verdicts on the mutants of these numbers, read in children of this process, one after the other."""
    found: list[Verdict] = []
    for start in range(0, len(numbers), BATCH):
        left = list(numbers[start : start + BATCH])
        while left:
            done = list(_child(kind, left, seed, truncate))
            found += done
            left = left[len(done) :]
    return found


def _child(kind: str, numbers: Sequence[int], seed: int, truncate: bool) -> Iterator[Verdict]:
    """Verdicts up to the first mutant that ends the child."""
    source, sink = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(source)
        try:
            with os.fdopen(sink, "w") as stream, tempfile.TemporaryDirectory() as folder:
                for line in _verdicts(kind, numbers, seed, truncate, Path(folder)):
                    stream.write(json.dumps(line) + "\n")
                    stream.flush()
        finally:
            os._exit(0)
    os.close(sink)
    begun: dict | None = None
    with os.fdopen(source) as stream:
        for line in stream:
            content = json.loads(line)
            if "outcome" in content:
                yield Verdict(**content)
                begun = None
            else:
                begun = content
    _, status = os.waitpid(pid, 0)
    if begun is not None:
        code = os.waitstatus_to_exitcode(status)
        why = {-signal.SIGPROF: "hang", -signal.SIGALRM: "hang"}.get(code, f"crash: ended with {code}")
        yield Verdict(**begun, outcome="bad", detail=why)


def _verdicts(kind: str, numbers: Sequence[int], seed: int, truncate: bool, folder: Path) -> Iterator[dict]:
    """For each mutant what it is, then what became of it."""
    torch.set_num_threads(1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sound = seeds(kind, folder)
    known: dict[str, Reading] = {}
    for number in numbers:
        one, damaged = mutant(kind, number, seed, truncate, sound)
        path = folder / f"file{one.suffix}"
        for name, content in one.beside.items():
            (folder / name).write_bytes(content)
        if one.name not in known:
            path.write_bytes(one.content)
            known[one.name] = read(kind, path)
        path.write_bytes(damaged.content)
        begun = {"number": number, "seed": one.name, "how": damaged.how, "place": damaged.place}
        yield begun
        yield asdict(_verdict(kind, path, known[one.name], begun, len(damaged.content)))


def _verdict(kind: str, path: Path, original: Reading, begun: dict, size: int) -> Verdict:
    begin = time.process_time()
    try:
        with _limits(size):
            reading = read(kind, path)
    except TorchidError as error:
        seconds = time.process_time() - begin
        return Verdict(**begun, outcome="refused", detail=error.code, seconds=seconds, remedy=bool(error.remedy))
    except MemoryError:
        return Verdict(**begun, outcome="bad", detail="memory")
    except Exception as error:  # an untyped error is what is looked for
        text = f"{type(error).__name__}: {str(error)[:150]}"
        return Verdict(**begun, outcome="bad", detail=text, seconds=time.process_time() - begin)
    seconds = time.process_time() - begin
    said = reading.notes - original.notes
    if said:
        codes = ", ".join(sorted({text.split(": ")[0] for text in said}))
        return Verdict(**begun, outcome="noted", detail=codes, seconds=seconds)
    rules = changes(kind, original, reading)
    if rules and begun["how"] in MISSPELT:
        rules = ("!a misspelt name",)
    return Verdict(**begun, outcome="silent" if rules else "equal", detail=", ".join(rules), seconds=seconds)


class _limits:
    """Memory and time while a mutant is read; where time runs out, a signal ends the process."""

    def __init__(self, size: int) -> None:
        self.bytes = MEMORY + 8 * size

    def __enter__(self) -> None:
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + self.bytes, resource.RLIM_INFINITY))
        signal.setitimer(signal.ITIMER_PROF, CPU_S)
        signal.setitimer(signal.ITIMER_REAL, WALL_S)

    def __exit__(self, *_: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
