"""Parts of a page that a script makes: they stand between ``<!-- name -->`` and ``<!-- /name -->``."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Part:
    """One such part."""

    page: Path
    name: str

    def read(self) -> str:
        """What stands there at present."""
        start, stop = self._marks
        return self.page.read_text(encoding="utf-8").split(start)[1].split(stop)[0]

    def write(self, text: str) -> None:
        """Put a text in its place; the rest of the page stays.

        Args:
            text: without a line's end at its end.
        """
        start, stop = self._marks
        before, rest = self.page.read_text(encoding="utf-8").split(start)
        self.page.write_text(f"{before}{start}{text}{stop}{rest.split(stop)[1]}", encoding="utf-8")

    @property
    def _marks(self) -> tuple[str, str]:
        return f"<!-- {self.name} -->\n", f"\n<!-- /{self.name} -->"
