"""Reading whole files within limits, and writing them whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from torchid.errors import InputError

MAX_BYTES = 4 << 30


def read_bytes(path: Path) -> bytes:
    """The file's bytes.

    Raises:
        InputError: ``file.unreadable`` where it is absent, forbidden or larger than 4 GiB.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(
                "file.unreadable",
                "the file is too large",
                source=path,
                found=f"{path.stat().st_size} bytes",
                remedy="Split the recording",
            )
        return path.read_bytes()
    except OSError as error:
        raise InputError(
            "file.unreadable",
            "the file cannot be read",
            source=path,
            found=error.strerror or str(error),
            remedy="Check the path and the permissions",
        ) from error


def read_lines(path: Path) -> list[str]:
    """Lines of a text file in UTF-8 with or without byte order mark; undecodable bytes become U+FFFD."""
    text = read_bytes(path).decode("utf-8-sig", "replace")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when the block ends well, and vanishes when it does not."""
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb") as stream:
            os.fsync(stream.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
