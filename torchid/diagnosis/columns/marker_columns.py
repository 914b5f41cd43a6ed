"""Response of the markers' rows to unit parameters of an effect."""

from itertools import groupby

import torch

from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.effects.columns import STEP
from torchid.effects.marker_scene import Sight
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.response_cache import ResponseCache
from torchid.observation.row_response import RowResponse, concatenate


def response_of(
    response: MarkerResponse, source: ColumnSource, sight: Sight | None = None, fixed: ResponseCache | None = None
) -> RowResponse:
    """Return the response to unit parameters of an effect, in the trial's motion or in another.

    Args:
        response: markers of the trial.
        source: source of the columns.
        sight: markers in another motion, such as one with another draw of noise; None: the trial's own.
        fixed: responses to displacements in fixed ways, which several sources share; None: they are made here.
    """
    effect, place = source.effect, source.place
    plain = sight is None and source.at is None
    if plain and (sway := effect.sway(response.sight, place)) is not None:
        return (fixed or ResponseCache(response)).swayed(sway)
    sight, slid, moved = sight or response.sight, [], []
    if source.at is not None:
        sight = effect.beneath(sight, place, sight.p_BM_B.new_tensor(source.at))
    for k, scale in enumerate(effect.scale(place)):
        theta = sight.p_BM_B.new_zeros(effect.size(place))
        theta[k] = STEP * scale
        slid.append((effect.slide(sight, place, theta), theta[k]))
        moved.append((effect.move(sight.scene, place, theta), theta[k]))
    answers = []
    seen = [(s.which, s.by / step) for s, step in slid if s is not None]
    if seen:
        # Where each parameter is about markers of its own, all of them would be ten times the work.
        together = groupby(seen, key=lambda both: both[0])
        answers.append(
            concatenate([response.respond(which, torch.stack([by for _, by in own])) for which, own in together])
        )
    away = [(m, step) for m, step in moved if m is not None]
    if away:
        answers.append(response.moved([m for m, _ in away]).per(torch.stack([step for _, step in away])))
    return answers[0] if len(answers) == 1 else answers[0] + answers[1]
