"""Products that the noise of markers leaves between columns and the total, and their correction.

Columns that come from the found motion hold its noise, and so does the residual: their noises agree where no truth
does. Each column's moment gains what the two are expected to share (corrected scores; Carroll et al. 2006, Measurement
Error in Nonlinear Models). Shrinking the columns by what is believed of the total is not enough: the thorax has markers
that make most of the noise, while legs make most of the motion.

Most columns are fixed combinations of those of the inertia, or of what plates bore, and so is what they share.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.diagnosis.columns.marker_columns import response_of
from torchid.dynamics.equations_of_motion import body_rows, wrenches_about
from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import BAND_EDGES_HZ, band_of, coefficients, cosine_matrix, frequencies
from torchid.effects.columns import columns
from torchid.effects.kinds import ReadingEffect
from torchid.effects.marker_scene import View
from torchid.effects.scene import Scene
from torchid.observation.noise_budget import NoiseBudget
from torchid.observation.trial import TrialObservation

Pair = Float[Tensor, "6 rows frames"]
"""A draw's noise in each channel of the total and band (rows), times the part of it that each channel of a column
keeps."""


def noise_scores(
    observed: TrialObservation, noise_budget: NoiseBudget, sources: Sequence[ColumnSource], inertia: bool
) -> Float[Tensor, "bands 6 6 all"]:
    """Return products of the noise of each channel of the total with that of each channel of columns, band by band.

    Args:
        observed: the trial.
        noise_budget: reliability to which columns are shrunk, and the part of the noise that is there.
        sources: sources of the columns; without the inertia's, only of such as are no combinations of others.
        inertia: True if the inertia's columns stand before them.
    """
    few = observed.thinned
    rigid = [s.effect.rigid(observed.view.scene, s.place) for s in sources]
    reads = [isinstance(s.effect, ReadingEffect) for s in sources]
    own = [s for s, fixed, read in zip(sources, rigid, reads, strict=True) if fixed is None and not read]
    assert inertia or len(own) == len(sources), "combinations need what they combine"
    body, plates, rest = torch.zeros(3, 1, 1, 1).to(few.rows.wrench)
    for scene, pair in _draws(observed, noise_budget):
        rest = rest + _of_columns(few, scene, own, pair)
        if inertia:
            body, plates = body + _of_inertia(few, scene, pair), plates + _of_plates(few, scene, pair)
    parts, each = [body] if inertia else [], iter(rest.split([len(s.scale) for s in own], 2))
    for source, fixed, read in zip(sources, rigid, reads, strict=True):
        if fixed is not None:
            parts.append(body @ fixed.flatten(0, 1))
        else:
            parts.append(_mapped(plates, _unit(observed.view, source)) if read else next(each))
    found = torch.cat(parts, 2).unflatten(1, (-1, 6)).permute(1, 2, 0, 3) / len(observed.noise_draws)
    return found * noise_budget.there[:, :, None, None]


def _draws(observed: TrialObservation, noise_budget: NoiseBudget) -> Iterator[tuple[Scene, Pair]]:
    """Yield scene and noise of each draw at a few frames; at last the scene as it was found, to take off all noise."""
    thin, whole = slice(None, None, observed.thinning), torch.zeros(1, 1, 1).to(observed.rows.wrench)
    for one in observed.noise_draws:
        pair = observed.thinning * _paired(observed.rows, noise_budget, one.total)[:, :, thin]
        whole = whole + pair
        yield observed.thinned.under(one.motion.frames(thin)), pair
    yield observed.thinned.view.scene, -whole


def _of_inertia(observed: TrialObservation, scene: Scene, pair: Pair) -> Float[Tensor, "6 rows params"]:
    """Return products with the columns of the inertia."""
    state = scene.state
    rows, position = body_rows(state, _root(observed)), list(state.plan.position)
    found = pair.new_zeros(6, pair.shape[1], len(position), 10)
    for part, own in ((slice(0, 3), rows.force), (slice(3, 6), rows.moment)):
        product = pair[part] @ own.flatten(0, 1).permute(1, 2, 0)
        found[part, :, :, : own.shape[1]] = product.unflatten(2, own.shape[:2])[:, :, position]
    return found.flatten(2)


def _of_plates(observed: TrialObservation, scene: Scene, pair: Pair) -> Float[Tensor, "12 rows channels"]:
    """Return products with the channels of what each plate bore, and of what none did, as ``_mapped`` needs them."""
    reading, away = observed.bore(scene), _root(observed)[:, None]
    none = torch.zeros_like(observed.rows.wrench) if reading.unborne is None else reading.unborne
    turned = [pair[3:] * away.roll(-k, 0) for k in (1, 2)]
    return torch.cat([pair, *turned]) @ torch.cat([reading.wrench.flatten(1), none], 1)


def _mapped(
    plates: Float[Tensor, "12 rows channels"], unit: Float[Tensor, "6 channels params"]
) -> Float[Tensor, "6 rows params"]:
    """Return products with columns that an effect makes of the plates' channels.

    With d the vector to the root, the moment about the root has component j less than that about the origin of W by
    d[j+1] F[j+2] - d[j+2] F[j+1]: the last rows of ``plates`` hold noise times d[j+1] and d[j+2].
    """
    found, force = plates[:6] @ unit, unit[:3]
    found[3:] += plates[9:] @ force.roll(-1, 0) - plates[6:9] @ force.roll(-2, 0)
    return found


def _unit(view: View, source: ColumnSource) -> Float[Tensor, "6 channels params"]:
    """Return columns of an effect on readings, channel by channel that bears one unit."""
    plates = len(view.reading.frames)
    unit = torch.eye(6 * plates + 6).to(view.reading.wrench).unflatten(1, (-1, 6))
    time = torch.arange(len(unit)).to(unit)
    reading = replace(view.reading, time=time, wrench=unit[:, :plates], unborne=unit[:, plates], zeroed=None)
    return columns(source.effect, view.scene, reading, source.place).mT


def _of_columns(
    observed: TrialObservation, scene: Scene, sources: Sequence[ColumnSource], pair: Pair
) -> Float[Tensor, "6 rows some"]:
    """Return products with columns as they are in another scene."""
    root, parts = _root(observed), [pair[:, :, :0]]
    for _, alike in groupby(sources, key=lambda s: s.effect):
        parts.append(pair @ wrenches_about(_seen(observed, scene, list(alike)), root).mT)
    return torch.cat(parts, 2)


def _seen(observed: TrialObservation, scene: Scene, alike: Sequence[ColumnSource]) -> Float[Tensor, "6 some frames"]:
    """Return columns of one effect in another scene, to which postures respond as they did."""
    effect, response = alike[0].effect, observed.response
    if effect.moves_markers and response is not None:
        sight = replace(response.sight, scene=scene)
        return response.wrench([response_of(response, s, sight) for s in alike])
    at_once = effect.loads(scene, [s.place for s in alike])
    if at_once is not None:
        return at_once.transpose(0, 1)
    return torch.cat([columns(effect, scene, observed.view.reading, s.place) for s in alike], 1)


def _root(observed: TrialObservation) -> Float[Tensor, "3 frames"]:
    """Return the point that the columns' moments are taken about [m]."""
    return observed.rows.motion.q[:, :3].T


def _paired(rows: WrenchTrial, noise_budget: NoiseBudget, total: Float[Tensor, "6 frames"]) -> Pair:
    """Return the noise of one draw as ``Pair`` has it, zero where frames are not used.

    What multiplies the columns is transformed back: it has fewer rows than they have coefficients.
    """
    found = total.new_zeros(6, len(BAND_EDGES_HZ) + 1, 6, total.shape[1])
    for part in rows.blocks():
        frames = part.stop - part.start
        kept = coefficients(rows, frames)
        C, frequency = cosine_matrix(frames, kept).to(total)[1:], frequencies(frames, kept, rows.rate).to(total)
        reliability, band = noise_budget.reliability(frequency)[1:].T, band_of(frequency[1:])
        other = total[:, part] @ C.T
        for b in band.unique().tolist():
            own = band == b
            found[:, b, :, part] = torch.einsum("ik,jk->jik", other[:, own], reliability[:, own]) @ C[own]
    return found.flatten(1, 2)
