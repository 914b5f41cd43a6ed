"""Types of options with their bounds, which the config checks (https://github.com/annotated-types/annotated-types)."""

from typing import Annotated

from annotated_types import Ge, Gt, Le, Len

Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Gt(0)]
Name = Annotated[str, Len(1, 200)]
