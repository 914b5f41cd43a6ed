"""Bars of how probable each named cause and each of its rivals is."""

from markupsafe import Markup
from matplotlib.figure import Figure as Canvas

from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.report.blocks import Block, Figure
from torchid.report.cause_sentences import WORTH, name, rivals
from torchid.report.figure import IDENTIFIED, MUTED, draw, tidy
from torchid.wording import clean, percent


def rival_bars(found: Diagnosis) -> list[Block]:
    """Bars for causes that have rivals; certainty needs none."""
    contested = [cause for cause in found.causes if any(a.confidence >= WORTH for a in rivals(cause))]
    if not contested:
        return []
    caption = "How probable each explanation is, given catalogue and recordings."
    if any(cause.indistinguishable for cause in contested):
        caption += " Hatched: what these recordings cannot tell from the cause that is named."
    if any(cause.doubted for cause in contested):
        caption += " Confidence in what forces tell is lowered by what contradicts the model or cannot be checked."
    return [Figure(_draw_rivals(contested), caption)]


def _bars(cause: Cause) -> list[tuple[str, float, str]]:
    """Label, probability and kind (cause, twin, rival) of a cause and everything it competes with."""
    twins = {(t.effect, t.where) for t in cause.indistinguishable}
    own = max(0.0, cause.confidence - sum(t.confidence for t in cause.indistinguishable))
    return [(name(cause), own, "cause")] + [
        (name(a), a.confidence, "twin" if (a.effect, a.where) in twins else "rival") for a in rivals(cause)
    ]


def _draw_rivals(causes: list[Cause]) -> Markup:
    groups = [_bars(cause) for cause in causes]
    looks: dict[str, dict] = {
        "cause": {"color": IDENTIFIED},
        "twin": {"facecolor": "#ffffff", "edgecolor": IDENTIFIED, "hatch": "////", "linewidth": 0.8},
        "rival": {"color": MUTED},
    }

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(len(groups), 1, sharex=True, squeeze=False, height_ratios=[len(g) for g in groups])
        for axes, group in zip(panels[:, 0], groups, strict=True):
            for row, (_, share, kind) in enumerate(group):
                axes.barh(row, 100.0 * share, 0.66, **looks[kind])
                axes.text(100.0 * share + 1.0, row, percent(share) if share >= 0.005 else "< 1 %", va="center")
            axes.set_yticks(range(len(group)), [clean(label, 48) for label, *_ in group])
            axes.set_ylim(len(group) - 0.4, -0.6)
            axes.set_xlim(0.0, 112.0)
            axes.set_xticks(range(0, 101, 25))
            tidy(axes, "x")
        panels[-1, 0].set_xlabel("probability [%]")

    height = 0.75 + 0.28 * sum(len(group) for group in groups)
    return draw("rivals", (7.5, height), "Probability of each named cause and of its rivals", paint)
