"""What is asked of the groups of a cohort."""

from pathlib import Path
from typing import Annotated

from annotated_types import Ge, Gt, Lt
from pydantic import Field

from torchid.config.sections import ConfigSection


class GroupQuestion(ConfigSection):
    """Groups of a finished cohort that are compared."""

    cohort: Path
    """Folder of the cohort."""
    reference: str | None = None
    """Group that the others are compared with; absent: that of the first person who walks."""
    level: Annotated[float, Gt(0), Lt(0.5)] = 0.05
    """Family-wise rate of false findings."""
    permutations: Annotated[int, Ge(99)] = 9999
    """At most; where there are fewer ways of dealing people to groups, all of them."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Of random ways."""
