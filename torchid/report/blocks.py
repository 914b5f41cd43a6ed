"""What a section of the report is made of: plain data that one template turns into HTML."""

from dataclasses import dataclass, field

from markupsafe import Markup

from torchid.session.outcome import QualityLevel


@dataclass(frozen=True)
class Paragraph:
    """Text."""

    text: str
    kind = "paragraph"


@dataclass(frozen=True)
class Items:
    """A list of short texts."""

    items: tuple[str, ...]
    kind = "items"


@dataclass(frozen=True)
class Table:
    """A table whose columns are numbers unless ``text`` counts them as text."""

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    text: int = 1
    """Number of leading columns that hold text."""
    wrap: bool = False
    """The last column holds sentences."""
    strong: frozenset[int] = frozenset()
    """Rows that sum up others."""
    kind = "table"


@dataclass(frozen=True)
class Figure:
    """A drawing and what it shows."""

    svg: Markup
    caption: str
    kind = "figure"


@dataclass(frozen=True)
class Listing:
    """Preformatted text, such as a config."""

    text: str
    kind = "listing"


@dataclass(frozen=True)
class Details:
    """Blocks that open on request; printed open or not as the reader left them."""

    summary: str
    blocks: tuple["Block", ...]
    kind = "details"


@dataclass(frozen=True)
class Embedded:
    """A page of its own inside a frame, which runs only when it is opened."""

    page: str
    caption: str
    kind = "embedded"


@dataclass(frozen=True)
class Light:
    """What one look tells of one side of a result."""

    about: str
    """Such as ``Markers``."""
    level: QualityLevel | None
    """None where nothing is judged."""
    text: str
    """A sentence or two; empty where there are lines."""
    items: tuple[str, ...] = ()
    """Lines of a list."""


@dataclass(frozen=True)
class Glance:
    """A picture, and beside it what can be trusted."""

    picture: Markup
    caption: str
    lights: tuple[Light, ...]
    kind = "glance"


Block = Glance | Paragraph | Items | Table | Figure | Listing | Details | Embedded


@dataclass(frozen=True)
class Section:
    """A chapter of the page: its finding in one sentence, then what supports it."""

    key: str
    """Anchor."""
    title: str
    finding: str
    blocks: tuple[Block, ...] = field(default=())
    level: str = ""
    """Class that colours the finding: good, care or unusable; none by default."""
