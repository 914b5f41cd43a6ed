"""What is said of contacts' wrenches: where each comes from, and how far it may be off."""

from dataclasses import dataclass
from enum import IntEnum

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.contact.sharing.solver import SharingStatus


class WrenchSource(IntEnum):
    """Where a contact's wrench comes from."""

    MEASURED = 0
    """From plates that bear this contact alone, or the contact is in the air."""
    SHARED = 1
    """Its part of a plate that bears others too."""
    PREDICTED = 2
    """Its part of what the body needs beyond the plates."""
    UNKNOWN = 3
    """Touches, and neither a plate nor the body tells."""


@dataclass(frozen=True)
class Needed:
    """What the motion of the whole body needs of its contacts, through the filter of the motion."""

    wrench: Float[Tensor, "frames 6"]
    """About the world's origin [N, N m]."""
    known: Bool[Tensor, " frames"]
    sd: Float[Tensor, "6"]
    """Of the force and of the moment about ``about``, as far as plates told them apart from what was measured."""
    about: Float[Tensor, "frames 3"] | None = None
    """Point in W [m]; None: the world's origin."""

    @property
    def factor(self) -> Float[Tensor, "frames 6 6"]:
        """Wrench about the world's origin per standard normal error of each component [N, N m]."""
        found = torch.diag(self.sd).repeat(len(self.wrench), 1, 1)
        if self.about is not None:
            force = found[:, :3].mT
            found[:, 3:] += torch.linalg.cross(self.about[:, None].expand_as(force), force).mT
        return found


@dataclass(frozen=True)
class ContactWrenches:
    """Wrench on the subject under every contact, through the filter of the motion."""

    contacts: tuple[str, ...]
    wrench: Float[Tensor, "frames contacts 6"]
    """About the world's origin, in W [N, N m]; of an unknown contact, what plates measured of it."""
    source: Int[Tensor, "frames contacts"]
    """``WrenchSource`` of every one."""
    doubtful: Int[Tensor, " some"]
    """Frames in which some wrench is not measured."""
    doubt: Float[Tensor, "some wrenches causes"]
    """What is added to the wrenches of these frames, contact by contact, per standard normal cause [N, N m]. Causes are
    common to the frames: an expectation that is wrong stays wrong for a step."""
    status: SharingStatus = SharingStatus.SOLVED
    """The worst that any block of frames ended with; contacts of an unconverged block are unknown."""
    bodies: tuple[str, ...] = ()
    """Body of each; none where contacts are named as their bodies."""

    @property
    def body(self) -> tuple[str, ...]:
        """Return the body of each contact."""
        return self.bodies or self.contacts

    @property
    def sd(self) -> Float[Tensor, "frames contacts 6"]:
        """Standard deviations of what is not measured, about the world's origin [N, N m]; 0 where it is, NaN if
        unknown."""
        found = torch.zeros_like(self.wrench)
        found[self.doubtful] = self.doubt.square().sum(2).sqrt().unflatten(1, found.shape[1:])
        return torch.where((self.source == WrenchSource.UNKNOWN)[..., None], torch.nan, found)

    def of(self, contact: str) -> Float[Tensor, "frames 6"]:
        """The wrench under one contact."""
        return self.wrench[:, self.contacts.index(contact)]
