"""What unit parameters of effects do to the plates' total wrench about the root's origin."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Source
from torchid.dynamics import wrenches_about
from torchid.effects.columns import columns
from torchid.effects.marker_scene import View
from torchid.observation.trial import TrialObservation


def plate_columns(view: View, alike: Sequence[Source]) -> Float[Tensor, "6 columns frames"]:
    """Columns of one effect."""
    effect = alike[0].effect
    if (at_once := effect.loads(view.scene, [s.place for s in alike])) is not None:
        return at_once.transpose(0, 1)
    return torch.cat([columns(effect, view.scene, view.read(effect.reads_measured), s.place) for s in alike], 1)


def about_root(observed: TrialObservation, wrench: Float[Tensor, "6 more frames"]) -> Float[Tensor, "6 more frames"]:
    return wrenches_about(wrench, observed.rows.motion.q[:, :3].T)
