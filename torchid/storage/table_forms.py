"""Which forms of tables there are, and which of them can be written here."""

from collections.abc import Iterable
from importlib.util import find_spec
from typing import Literal

from torchid.errors import ConfigError

Form = Literal["parquet", "xlsx"]
"""Forms beside CSV in which tables may be written."""
PACKAGES: dict[Form, str] = {"parquet": "pyarrow", "xlsx": "openpyxl"}
"""What writes each form; it need not be installed."""


def installed(forms: Iterable[Form]) -> tuple[Form, ...]:
    """Return those forms of tables whose package is installed."""
    return tuple(form for form in forms if find_spec(PACKAGES[form]) is not None)


def refuse_missing(forms: Iterable[Form]) -> None:
    """Refuse forms of tables whose package is not installed.

    Raises:
        ConfigError: ``tables.package``.
    """
    for form in forms:
        if form not in installed((form,)):
            raise ConfigError(
                "tables.package", f"tables as {form} need the package {PACKAGES[form]}, which is not installed",
                place="tables", found=form, remedy="pip install 'torchid[tables]', or leave it out: CSV is there",
            )  # fmt: skip
