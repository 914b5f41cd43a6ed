"""When something that comes and goes began and ended, and its course between, once it is known what it is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates import confined
from torchid.diagnosis.design import Candidate, Design, Source, Terms
from torchid.diagnosis.evidence import fit, gains
from torchid.diagnosis.noise import Noise, standardised
from torchid.diagnosis.spectral import Rows, with_columns
from torchid.diagnosis.sums import Prior, Sums
from torchid.diagnosis.watched import Watched
from torchid.dynamics import wrench_about
from torchid.effects.columns import columns
from torchid.effects.place import Interval, Place

STEP_S = 0.1
"""By which both ends are moved. Moved again by half of it, forces of 2.5 s had the same means to 2 %."""
REACH = 3
"""Steps on either side."""
EDGES_S = (0.1, 0.25, 0.5)
"""It takes to come and to go. With a quarter of a second at most, what rose in 0.6 s seemed to begin 0.25 s late, and
its mean was 20 % too high."""


def timed(
    watched: Sequence[Watched], rows: Sequence[Rows], design: Design, prior: Prior, noise: Noise,
    sums: Sums, chosen: Sequence[Candidate],
) -> tuple[list[Rows], Design, Prior, Candidate]:  # fmt: skip
    """The last of the chosen effects with ends and course where the evidence is best, and the design that has it."""
    *others, best = chosen
    (trial,), base = best.trials, fit(sums, others)
    for places in (moved_ends, best.effect.finer):
        if not (some := tuple(places(best.place))):
            break
        tried = with_places(design, best, (best.place, *some))
        extra, wide = extra_columns(watched[trial], tried), prior.widened(tried)
        own = with_columns(rows[trial], extra_terms(tried, trial, extra), watched[trial], extra, best.effect.noisy)
        raws = list(sums.trials)
        raws[trial] = standardised(own, wide, tried, noise, trial)[0]
        gain = gains(replace(sums, trials=tuple(raws)), base, tried.candidates)[0]
        best = tried.candidates[int(gain.argmax())]
    final = with_places(design, best, (best.place,))
    extra, trials, found = extra_columns(watched[trial], final), list(design.trials), list(rows)
    terms, before = extra_terms(final, trial, extra), trials[trial]
    trials[trial] = replace(before, wide=torch.cat([before.extra, extra], 1), kept=None, terms=terms)
    found[trial] = with_columns(rows[trial], terms, watched[trial], extra, best.effect.noisy)
    (best,) = final.candidates
    whole = replace(final, candidates=(*design.candidates, best), trials=tuple(trials))
    return found, whole, prior.widened(whole), best


def moved_ends(place: Place) -> Iterator[Place]:
    """The same with its interval's ends moved, and quicker or slower to come and go."""
    assert place.when is not None
    (own,) = place.when
    steps = [k * STEP_S for k in range(-REACH, REACH + 1)]
    for t0, t1 in ((own.t0 + a, own.t1 + b) for a in steps for b in steps):
        for edge in (e for e in EDGES_S if 2.0 * e < t1 - t0):
            yield replace(place, when=(Interval(own.trial, t0, t1),), grid={"edge_s": edge})


def with_places(design: Design, one: Candidate, places: Sequence[Place]) -> Design:
    """Further places of an effect as the only candidates; columns are not there yet."""
    at, sources = design.width, []
    for place in places:
        scale = one.effect.scale(place)
        part, trial = slice(at, at + len(scale)), confined(one.effect, place)
        sources.append(Source(one.effect, place, part, (0.0,) * len(scale), scale, trial))
        at += len(scale)
    fresh = tuple(replace(one, place=s.place, source=s, proposed=one.proposed or one.place) for s in sources)
    return replace(design, sources=(*design.sources, *sources), candidates=fresh)


def extra_terms(design: Design, trial: int, extra: Tensor) -> Terms:
    """With columns of further places behind the others."""
    own, n = design.trials[trial].terms, extra.shape[1]
    live = torch.cat([own.live, torch.arange(design.width - n, design.width)])
    noise = None if own.covariation is None else torch.nn.functional.pad(own.covariation, (0, n))
    return replace(own, live=live, covariation=noise)


def extra_columns(watched: Watched, design: Design) -> Float[Tensor, "6 more frames"]:
    """Columns of the candidates about the root's origin."""
    view, root = watched.view, watched.rows.motion.q[:, :3]
    some = [columns(c.effect, view.scene, view.reading, c.place) for c in design.candidates]
    found = torch.cat(some, 1).permute(1, 2, 0)
    return wrench_about(found, root.expand(len(found), -1, -1)).permute(2, 0, 1)
