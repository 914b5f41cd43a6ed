"""What a study is: several subjects whose evaluations are tested together."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Gt, Lt
from pydantic import Field

from torchid.config.paths import UserPath
from torchid.config.sections import ConfigSection
from torchid.conventions import Name
from torchid.errors import OptionError


@dataclass(frozen=True)
class Member:
    """One subject of a study: where its evaluation is, or the config that makes it."""

    out: UserPath | None = None
    """Folder of a finished evaluation."""
    config: UserPath | None = None
    """Config of an evaluation, which is made first; what of it is finished is taken up again."""
    set: tuple[str, ...] = ()
    """Keys of that config that are replaced, written as on the command line: ``seed=2``."""

    def __post_init__(self) -> None:
        if (self.out is None) == (self.config is None) or (self.set and self.config is None):
            raise OptionError(
                "study.member", "a subject is either a finished evaluation or the config of one", place="config",
                found=f"out: {self.out}, config: {self.config}",
                remedy="Write {out: FOLDER}, or {config: FILE} with set: [key=value, ...] where keys differ",
            )  # fmt: skip


class Study(ConfigSection):
    """A study; relative paths have been resolved against its folder."""

    name: Name
    """Title of the study's report."""
    subjects: Annotated[tuple[Member, ...], Field(min_length=2)]
    """The evaluations that are tested together, two or more."""
    level: Annotated[float, Gt(0), Lt(0.5)] = 0.05
    """Family-wise rate of false findings."""
    permutations: Annotated[int, Ge(99)] = 9999
    """At most; where there are fewer ways of flipping signs, all of them."""
    out: UserPath = Field(default=Path("out"), validate_default=True)
    """Folder of the results."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Of random signs."""
