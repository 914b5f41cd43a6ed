"""What a user may say about a file that the file itself leaves open or gets wrong."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from torchid.io.mend import ForcesAs, PlateAs


@dataclass(frozen=True)
class ReadOptions:
    """Choices for reading one trial; the defaults trust the file and refuse where it contradicts itself."""

    subject: str | tuple[str, ...] | None = None
    """Subject whose markers are read, where a file holds several (``Subj:LASI``), or all bodies of one."""
    up: Literal["y", "z"] | None = None
    """Vertical axis of the file, where it cannot be told or the file is wrong."""
    units: Literal["mm", "cm", "dm", "m", "in"] | None = None
    """Unit of the marker positions, where the file states none or a wrong one."""
    allow_truncated: bool = False
    """Read what is there of a C3D whose data section ends early, and say so."""
    forces_as: ForcesAs = ForcesAs()
    """What is wrong with all forces of the file."""
    plates: Mapping[int, PlateAs] = field(default_factory=dict)
    """What is wrong with single force plates, by number."""
    wanted: frozenset[str] = frozenset()
    """Labels that the user's marker set lists: never left out as outputs of a program, whatever their names and how
    they move; compared without case, blanks, dots, dashes and underscores."""
    moments_read: bool = False
    """Free moments have been scaled while they were read: a ``moment_gain`` is not to be applied again."""
