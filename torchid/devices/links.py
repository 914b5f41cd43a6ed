"""Rigid parts from the links of a URDF file."""

from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from torchid.devices.device import Part
from torchid.devices.faults import fault
from torchid.devices.sheet import AttachedLink
from torchid.devices.values import SheetValue
from torchid.model.mechanics import phi_to_centre, rpy_to_matrix
from torchid.model.urdf import read_urdf


def attached_parts(path: Path, attachments: Mapping[str, str | AttachedLink]) -> list[Part]:
    """Read the links of a URDF file as parts of segments; links behind fixed joints are part of their parents.

    Args:
        path: the file.
        attachments: link: segment whose axes and origin are the link's, or the link's pose on one. Without any, the
            links carry the names of segments.

    Raises:
        ConfigError: ``device.attachment`` where a link is on no segment or an attachment has no link.
        InputError: the file cannot be read.
    """
    model, _ = read_urdf(path)
    names = model.tree.names
    where = dict(attachments) or dict(zip(names, names, strict=True))
    for name in where:
        if name not in names:
            near = get_close_matches(name, names, n=1, cutoff=0.5)
            remedy = f"Did you mean '{near[0]}'?" if near else f"Links that move by themselves: {', '.join(names)}."
            raise fault("attachment", "no such link", path, f"attach.{name}", remedy=remedy)
    lost = [name for name in names if name not in where]
    if lost:
        remedy = "List under `attach` the segment of every link that moves by itself."
        raise fault("attachment", "a link is on no segment", path, "attach", ", ".join(lost), remedy=remedy)
    phi = model.inertia.mean.numpy()
    return [_part(name, where[name], phi[k]) for k, name in enumerate(names)]


def _part(name: str, attachment: str | AttachedLink, phi: np.ndarray) -> Part:
    at = attachment if isinstance(attachment, AttachedLink) else AttachedLink(segment=attachment)
    R = rpy_to_matrix(*at.rpy)
    mass, centre, inertia = phi_to_centre(phi, name)
    x, y, z = (SheetValue(float(v)) for v in np.array(at.xyz) + R @ centre)
    turned = R @ inertia @ R.T
    a, b, c, d, e, f = (SheetValue(float(turned[i, j])) for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)))
    return Part(name, at.segment, SheetValue(mass), (x, y, z), (a, b, c, d, e, f))
