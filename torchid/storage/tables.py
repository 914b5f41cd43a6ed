"""Tables as statistics programs and spreadsheets take them: CSV, Parquet, Excel."""

from collections.abc import Callable, Iterable
from pathlib import Path

import pandas as pd

from torchid.storage.files import writing
from torchid.storage.table_forms import Form
from torchid.wording import clean

CELL = 32767
"""Resolution. Letters of a cell of Excel."""
SHEET = (1 << 20) - 1
"""Resolution. Lines of a sheet of Excel below its head."""


def write_table(table: pd.DataFrame, name: str, forms: Iterable[Form], place: Callable[[str], Path]) -> None:
    """Write a table as CSV, and in other forms that are wanted.

    Args:
        table: without an index.
        name: of the files, without their endings.
        forms: beside CSV.
        place: where a file of a name is to be written.

    Raises:
        InputError: ``results.unwritable``.
    """
    for form in ("csv", *forms):
        path = place(f"{name}.{form}")
        with writing(path):
            if form == "csv":
                table.to_csv(path, index=False, lineterminator="\n")
            elif form == "parquet":
                table.to_parquet(path, engine="pyarrow", index=False)
            else:
                _write_workbook(table, name, path)


def _write_workbook(table: pd.DataFrame, name: str, path: Path) -> None:
    """Write a workbook, whose sheets go on where one is full; no text in it is a formula."""
    texts = table.select_dtypes(exclude="number").columns
    table = table.assign(**{column: table[column].map(lambda text: clean(text, CELL)) for column in texts})
    with pd.ExcelWriter(path, engine="openpyxl") as book:
        for k, start in enumerate(range(0, max(1, len(table)), SHEET)):
            sheet = f"{name} {k + 1}" if k else name
            table.iloc[start : start + SHEET].to_excel(book, sheet_name=sheet, index=False)
            for row in book.sheets[sheet].iter_rows():
                for cell in row:
                    cell.data_type = "s" if cell.data_type == "f" else cell.data_type
