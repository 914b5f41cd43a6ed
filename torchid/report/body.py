"""Lengths, masses and centres of mass: what the motion determined and what the anthropometric tables still say."""

import numpy as np
import torch
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from torch import Tensor

from torchid.report.blocks import Block, Figure, Items, Paragraph, Section, Table
from torchid.report.figure import IDENTIFIED, MUTED, SCALED, draw, tidy
from torchid.report.stick_figure import rest, stick_points, tips
from torchid.session import Outcome
from torchid.session.judging import ASYMMETRY, uneven
from torchid.session.tables import identified_table, segment_lengths
from torchid.wording import ABSENT, clean, listing, number, percent, plural, segment, spread

DETERMINED = 0.5
"""Progress of a mass above which the motion, not the table, decided it."""
LONGEST = 0.2
"""Longest error bar of a centre of mass that is drawn [m]."""
PROGRESS = LinearSegmentedColormap.from_list("progress", ["#ffffff", "#a9c6e3", "#0b3d6e"])


def body_section(outcome: Outcome) -> Section:
    """The section on the body."""
    blocks: list[Block] = []
    if outcome.identified is not None:
        blocks += [
            Figure(
                _draw_body(outcome),
                "Neutral posture from the front (the left side on the right). The area of a circle is its segment's "
                "mass, its fill the share determined by the data (of the prior variance); bars are ±1 "
                "standard deviation of the centre of mass (left out beyond 200 mm, where there is next to no mass), "
                "the plus sign its prior. Right: masses, ±1 standard deviation.",
            ),
            *(Paragraph(text) for text in in_words(outcome)),
        ]
    blocks += [_table(outcome), *_directions(outcome)]
    return Section("body", "Body", _finding(outcome), tuple(blocks))


def _finding(outcome: Outcome) -> str:
    if outcome.identified is None:
        total = number(outcome.prior.mean[:, 0].sum())
        return f"No inertia was identified: the {total} kg of the body are shared out by anthropometric tables."
    fit = outcome.identified.fit
    if outcome.quality is not None and not outcome.quality.usable:
        return f"The {len(fit.names)} segment masses below are not to be used: see the verdict in the summary."
    pairs = [one for one in uneven(outcome) if one[3] > ASYMMETRY]
    if pairs:
        part, left, right, share = pairs[0]
        return (
            f"The {part} is {number(left)} kg left and {number(right)} kg right, {percent(share)} apart. Few people "
            "are that uneven: do not use the masses of single segments."
        )
    return f"{spread(fit.mass.sum(), fit.sd.total_mass, 2)} kg in all. {_determined_words(outcome)}"


def _determined_words(outcome: Outcome) -> str:
    assert outcome.identified is not None
    known, count = determined(outcome), len(outcome.identified.fit.names)
    if not known:
        return f"The data determine none of the {count} segment masses by more than half."
    return f"The data determine {len(known)} of {count} segment masses by more than half: {listing(known, 16)}."


def determined(outcome: Outcome) -> list[str]:
    """Segments whose mass owes more to the motion than to the prior."""
    assert outcome.identified is not None
    fit = outcome.identified.fit
    return [segment(n) for n, share in zip(fit.names, fit.progress.mass.tolist(), strict=True) if share > DETERMINED]


def in_words(outcome: Outcome) -> list[str]:
    """What the picture means."""
    assert outcome.identified is not None
    fit = outcome.identified.fit
    entries = list(zip(fit.names, fit.progress.mass.tolist(), strict=True))
    rest_ = [segment(n) for n, share in entries if 0.1 < share <= DETERMINED]
    prior = [segment(n) for n, share in entries if share <= 0.1]
    said = []
    if _determined_words(outcome) not in _finding(outcome):
        said.append(_determined_words(outcome))
    if rest_:
        said.append(f"Partly determined by the data (10 to 50 %): {listing(rest_, 16)}.")
    if prior:
        said.append(f"Practically the table's (share up to 10 %): {listing(prior, 16)}.")
    pairs = [one for one in uneven(outcome) if one[3] > ASYMMETRY]
    if pairs:
        worst = "; ".join(
            f"{part} {number(left, 2)} kg left, {number(right, 2)} kg right" for part, left, right, _ in pairs
        )
        said.append(
            f"Left and right differ by more than {percent(ASYMMETRY)}, beyond chance, in "
            f"{plural(len(pairs), 'pair')} of segments ({worst}). Usually the motion or the plates cannot "
            "tell the sides apart."
        )
    if fit.certificate.active:
        names = listing([segment(name) for name in fit.certificate.active])
        said.append(
            f"At the limit of what is physical, which usually means that errors elsewhere ended up there: {names}."
        )
    return said


def _draw_body(outcome: Outcome) -> Markup:
    assert outcome.identified is not None
    fit, model = outcome.identified.fit, outcome.fit.model
    X_WB, sticks = stick_points(model, outcome.fit.geometry, rest(model), tips(model))
    place = lambda com: (X_WB[:, :3, :3] @ com[..., None])[..., 0] + X_WB[:, :3, 3]  # noqa: E731
    com, prior = place(fit.com), place(outcome.prior.mean[:, 1:4] / outcome.prior.mean[:, :1])
    sd = (X_WB[:, :3, :3].square() @ fit.sd.com.square()[..., None])[..., 0].sqrt()
    sd = torch.where(sd < LONGEST, sd, torch.nan)
    shade = fit.progress.mass.numpy()

    def paint(canvas: Canvas) -> None:
        panel, masses = canvas.subplots(1, 2, width_ratios=(1.0, 1.15))
        for stick in sticks:
            panel.plot(stick[:, 1], stick[:, 2], color=MUTED, linewidth=1.3, zorder=1)
        panel.scatter(com[:, 1], com[:, 2], s=62.0 * fit.mass.numpy(), c=shade, cmap=PROGRESS, vmin=0.0, vmax=1.0,
                      edgecolors=IDENTIFIED, linewidths=1.0, zorder=2)  # fmt: skip
        panel.errorbar(
            com[:, 1], com[:, 2], xerr=sd[:, 1], yerr=sd[:, 2], fmt="none", ecolor="#000000", elinewidth=0.9, zorder=4
        )
        panel.plot(prior[:, 1], prior[:, 2], "+", color=SCALED, markersize=7, markeredgewidth=1.3, zorder=5)
        _frame(panel, torch.cat(sticks))
        panel.set_xlabel("left [m]")
        panel.set_ylabel("height [m]")
        tidy(panel)
        canvas.legend(
            handles=_progress_steps(),
            loc="outside lower center",
            ncols=5,
            title="share of a segment's mass determined by the data",
        )
        _paint_masses(masses, outcome)

    return draw("body", (7.5, 6.6), "Masses and centres of mass of all segments on a front view of the body", paint)


def _progress_steps() -> list[Line2D]:
    """Balls of the legend, from nothing identified to all."""
    ball = {"marker": "o", "linestyle": "none", "markersize": 9, "markeredgecolor": IDENTIFIED}
    return [
        Line2D([], [], markerfacecolor=PROGRESS(share), label=f"{share:.0%}", **ball)
        for share in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]


def _frame(axes: Axes, points: Tensor) -> None:
    """Limits around the body: where a mass is nearly zero, its centre and the bars may lie anywhere."""
    low, high = points.amin(dim=0).tolist(), points.amax(dim=0).tolist()
    axes.set_xlim(low[1] - 0.2, high[1] + 0.2)
    axes.set_ylim(low[2] - 0.1, high[2] + 0.1)
    axes.set_aspect("equal", adjustable="box")


def _paint_masses(axes: Axes, outcome: Outcome) -> None:
    assert outcome.identified is not None
    fit = outcome.identified.fit
    rows = np.arange(len(fit.names))
    prior_sd = torch.diagonal(outcome.prior.covariance).sqrt().reshape(-1, 10)[:, 0]
    prior = {"fmt": "+", "color": SCALED, "elinewidth": 1.0, "capsize": 2, "markersize": 6, "label": "prior"}
    found = {"fmt": "o", "color": IDENTIFIED, "elinewidth": 1.4, "capsize": 2, "markersize": 4, "label": "identified"}
    axes.errorbar(outcome.prior.mean[:, 0], rows + 0.17, xerr=prior_sd, **prior)
    axes.errorbar(fit.mass, rows - 0.17, xerr=fit.sd.mass, **found)
    axes.set_yticks(rows, [clean(segment(name), 24) for name in fit.names])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("mass [kg]")
    axes.legend(loc="lower right")
    tidy(axes)


def _table(outcome: Outcome) -> Table:
    lengths, prior = segment_lengths(outcome.fit), outcome.prior.mean
    found = None if outcome.identified is None else identified_table(outcome)["segments"]
    prior_sd = torch.diagonal(outcome.prior.covariance).sqrt().reshape(-1, 10)[:, 0]
    rows = []
    for k, name in enumerate(outcome.fit.model.tree.names):
        length = lengths.get(name)
        own = None if found is None else found[name]
        com = prior[k, 1:4] / prior[k, 0] if own is None else own["com_m"]
        rows.append((
            segment(name),
            ABSENT if length is None else _length(length),
            ABSENT if own is None else spread(own["mass_kg"], own["sd"]["mass_kg"], 2),
            spread(prior[k, 0], prior_sd[k], 2),
            ", ".join(number(x, 0, 1e3) for x in com),
            ABSENT if own is None else ", ".join(_reach(x) for x in own["sd"]["com_m"]),
            ABSENT if own is None else percent(own["progress_mass"]),
            ABSENT if own is None else percent(own["progress"]),
        ))  # fmt: skip
    rows.append(
        ("total", "", ABSENT if found is None else _total(outcome), number(prior[:, 0].sum(), 2), "", "", "", "")
    )
    head = ("Segment", "Length [mm]", "Mass [kg]", "Prior mass [kg]", "Centre of mass: forward, left, up [mm]",
            "its ± [mm]", "Progress of the mass", "Progress of all ten parameters")  # fmt: skip
    caption = (
        "Segments, ± one standard deviation. Length: from a segment's joint to the next; “fixed”: held at the "
        "template's. Centre of mass from the segment's own joint centre in its own axes."
    )
    return Table(caption, head, tuple(rows), strong=frozenset({len(rows) - 1}))


def _length(length: dict[str, float]) -> str:
    if length["sd"] == 0.0:
        return f"{number(length['length_m'], 0, 1e3)}, fixed"
    return spread(length["length_m"], length["sd"], 1, 1e3)


def _reach(sd: Tensor) -> str:
    """Scatter of a centre of mass [mm]; that of next to no mass is no length worth printing."""
    return "> 1000" if float(sd) > 1.0 else number(sd, 0, 1e3)


def _total(outcome: Outcome) -> str:
    total = identified_table(outcome)["total_mass"]
    return spread(total["value_kg"], total["sd_kg"], 2)


def _directions(outcome: Outcome) -> list[Block]:
    """Combinations of geometric parameters that the motion left to the prior."""
    uncertainty = outcome.fit.uncertainty
    if uncertainty is None or not uncertainty.undetermined:
        return []
    items = []
    for direction in uncertainty.undetermined:
        terms = (f"{clean(name)} ({number(weight, 2)})" for name, weight in direction.parameters.items())
        items.append(f"{', '.join(terms)}: {percent(direction.share)} of the prior variance removed")
    return [
        Paragraph(
            "Directions of the geometry that these motions leave to the prior (largest components, in prior standard "
            "deviations); moving along one of them hardly changes the markers:"
        ),
        Items(tuple(items)),
    ]
