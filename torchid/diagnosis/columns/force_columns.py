"""Columns of effects on forces: change of the plates' total wrench per unit parameter."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.dynamics.equations_of_motion import wrenches_about
from torchid.effects.columns import columns
from torchid.effects.marker_scene import View
from torchid.observation.trial import TrialObservation


def plate_columns(view: View, alike: Sequence[ColumnSource]) -> Float[Tensor, "6 columns frames"]:
    """Return the columns of sources of one effect about the origin of W [N, N m per unit parameter].

    Args:
        view: trial as effects see it.
        alike: sources of the effect.
    """
    effect = alike[0].effect
    if (at_once := effect.loads(view.scene, [s.place for s in alike])) is not None:
        return at_once.transpose(0, 1)
    return torch.cat([columns(effect, view.scene, view.read(effect.reads_measured), s.place) for s in alike], 1)


def force_columns(observed: TrialObservation, source: ColumnSource) -> Float[Tensor, "6 columns frames"]:
    """Return the columns of one source about the root's origin [N, N m per unit parameter].

    Args:
        observed: the trial.
        source: source of the columns.
    """
    return about_root(observed, plate_columns(observed.view, [source]))


def about_root(observed: TrialObservation, wrench: Float[Tensor, "6 more frames"]) -> Float[Tensor, "6 more frames"]:
    """Return wrenches about the origin of W as they are about the root's origin [N, N m].

    Args:
        observed: the trial.
        wrench: wrenches about the origin of W.
    """
    return wrenches_about(wrench, observed.rows.motion.q[:, :3].T)
