"""When something that comes and goes began and ended, and its course between, once it is known what it is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate, Source
from torchid.diagnosis.candidates.enumeration import confined
from torchid.diagnosis.columns.design import Design, Terms
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.noise import Noise, standardised
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.spectra import TrialSpectra, with_columns
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.dynamics import wrench_about
from torchid.effects.columns import columns
from torchid.effects.place import Interval, Place
from torchid.observation.trial import TrialObservation

STEP_S = 0.1
"""By which both ends are moved. Moved again by half of it, forces of 2.5 s had the same means to 2 %."""
REACH = 3
"""Steps on either side."""
EDGES_S = (0.1, 0.25, 0.5)
"""It takes to come and to go. With a quarter of a second at most, what rose in 0.6 s seemed to begin 0.25 s late, and
its mean was 20 % too high."""


def refine_interval(
    observed: Sequence[TrialObservation], rows: Sequence[TrialSpectra], design: Design, prior: Prior, noise: Noise,
    statistics: Statistics, chosen: Sequence[Candidate],
) -> tuple[list[TrialSpectra], Design, Prior, Candidate]:  # fmt: skip
    """The last of the chosen effects with ends and course where the evidence is best, and the design that has it."""
    *others, best = chosen
    (trial,), base = best.trials, fit(statistics, others)
    for places in (moved_ends, best.effect.finer):
        if not (some := tuple(places(best.place))):
            break
        tried = with_places(design, best, (best.place, *some))
        extra, wide = extra_columns(observed[trial], tried), prior.widened(tried)
        own = with_columns(rows[trial], extra_terms(tried, trial, extra), observed[trial], extra, best.effect.noisy)
        raws = list(statistics.trials)
        raws[trial] = standardised(own, wide, tried, noise, trial)[0]
        gain = gains(replace(statistics, trials=tuple(raws)), base, tried.candidates)[0]
        best = tried.candidates[int(gain.argmax())]
    final = with_places(design, best, (best.place,))
    extra, trials, found = extra_columns(observed[trial], final), list(design.trials), list(rows)
    terms, before = extra_terms(final, trial, extra), trials[trial]
    trials[trial] = replace(before, wide=torch.cat([before.extra, extra], 1), kept=None, terms=terms)
    found[trial] = with_columns(rows[trial], terms, observed[trial], extra, best.effect.noisy)
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
    noise = None if own.noise_scores is None else torch.nn.functional.pad(own.noise_scores, (0, n))
    return replace(own, live=live, noise_scores=noise)


def extra_columns(observed: TrialObservation, design: Design) -> Float[Tensor, "6 more frames"]:
    """Columns of the candidates about the root's origin."""
    view, root = observed.view, observed.rows.motion.q[:, :3]
    some = [columns(c.effect, view.scene, view.reading, c.place) for c in design.candidates]
    found = torch.cat(some, 1).permute(1, 2, 0)
    return wrench_about(found, root.expand(len(found), -1, -1)).permute(2, 0, 1)
