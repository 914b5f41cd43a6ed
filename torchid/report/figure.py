"""Matplotlib figures as inline SVG: one style, text as text, nothing that points outside the page."""

import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import matplotlib
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure as Canvas

IDENTIFIED, SCALED, MEASURED = "#0b5394", "#b45f06", "#111111"
"""Dark blue, brown and black: told apart by luminance in grey print and under any colour blindness."""
MUTED = "#8a8a8a"
SHADE = "#e4e4e4"
STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "torchid",
    "text.parse_math": False,
    "axes.formatter.use_mathtext": False,
    "axes.formatter.useoffset": False,  # what is written above an axis would lie under the title
    "axes.formatter.limits": (-9, 9),
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.unicode_minus": True,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.5,
}
_SVG = re.compile(r"<svg.*</svg>", re.DOTALL)
_DROPPED = re.compile(r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<!--.*?-->", re.DOTALL)
_ANCHOR = re.compile(r'(\bid="|href="#|url\(#)')


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib's settings for the report; names in scripts that the font lacks are the browser's to draw."""
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
        yield


def draw(key: str, size: tuple[float, float], describe: str, paint: Callable[[Canvas], None]) -> Markup:
    """A figure as inline SVG.

    Args:
        key: prefix of its ids, so that figures of one page do not share them.
        size: width and height [inch]; 7.5 inches fill the page.
        describe: what a reader without the picture is told.
    """
    with style():
        canvas = Canvas(figsize=size, layout="constrained")
        FigureCanvasSVG(canvas)
        paint(canvas)
        # Laid out here: savefig would draw everything once more for it.
        engine = canvas.get_layout_engine()
        assert engine is not None
        engine.execute(canvas)
        canvas.set_layout_engine("none")
        buffer = BytesIO()
        canvas.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return inline(buffer.getvalue().decode("utf-8", "replace"), key, size, describe)


def inline(text: str, key: str, size: tuple[float, float], describe: str) -> Markup:
    """The ``svg`` element alone: no prologue, metadata, namespaces or page-wide style; ids start with ``key``."""
    found = _SVG.search(text)
    assert found, "matplotlib wrote no svg element"
    body = _DROPPED.sub("", found[0])
    opening, _, rest = body.partition(">")
    view = re.search(r'viewBox="[\d. -]+"', opening)
    assert view, "matplotlib gave no viewBox"
    rest = _ANCHOR.sub(lambda match: f"{match[1]}{key}-", rest)
    head = f'<svg {view[0]} role="img" aria-label="{escape(describe)}" style="min-width: {60 * size[0]:.0f}px"'
    return Markup(f"{head}>{rest}")  # noqa: S704 - matplotlib escapes every text


def tidy(axes: Axes, grid: str = "both") -> None:
    """Light grid behind the data."""
    axes.grid(True, axis=grid)  # type: ignore[arg-type]
    axes.set_axisbelow(True)
    axes.tick_params(length=2.5, width=0.6)
