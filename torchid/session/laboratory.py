"""What a run keeps of its laboratory's instruments for other sessions of the same: ``laboratory.nc``.

Information and moment of all lasting faults together, in the information form of a normal distribution, with the plates
that they are about. A hundred such files pool in seconds, and another session adds to them.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import xarray
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.evidence.earlier_sessions import among
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.place import SESSION, Place
from torchid.effects.scene import PlateFrame
from torchid.errors import InputError
from torchid.observation.plate_registry import SAME_CORNERS, SAME_PRESSURE, SessionPlate
from torchid.session.plates import session_plates
from torchid.session.session import Session
from torchid.storage.netcdf import read_netcdf
from torchid.wording import listing

NAME = "laboratory.nc"
"""Of the file in a run's folder."""
FORM = 1
"""Version of its form."""
BETWEEN = " + "
"""Word between the names of a place of several plates."""


@dataclass(frozen=True)
class LaboratoryPlate:
    """A plate of a laboratory."""

    frame: PlateFrame
    """Its name and its frame; its middle is NaN where neither corners nor a pressure tell it."""
    corners: Float[Tensor, "4 3"]
    """Its corners in W [m]; NaN where no file has them."""


@dataclass(frozen=True)
class SessionEvidence:
    """What a finished run, or several together, say of their laboratory."""

    evidence: LaboratoryEvidence
    """Information on lasting faults."""
    plates: tuple[LaboratoryPlate, ...]
    """Plates that the faults are about."""
    pooled: bool = False
    """Whether it is of one session more than those that tell it: what varies between sessions is integrated out, the
    lag of their bodies among it."""


def laboratory_plate(plate: SessionPlate) -> LaboratoryPlate:
    """Return a plate of a session as one of its laboratory.

    Args:
        plate: the plate.
    """
    unknown = torch.full((4, 3), torch.nan, dtype=torch.float64)
    untold = plate.corners is None and not bool(plate.frame.p_WF.any())
    frame = replace(plate.frame, p_WF=torch.full_like(plate.frame.p_WF, torch.nan)) if untold else plate.frame
    return LaboratoryPlate(frame, unknown if plate.corners is None else plate.corners)


def names_in(plates: Sequence[LaboratoryPlate], own: Sequence[LaboratoryPlate]) -> dict[str, str]:
    """Return the laboratory's name of each plate of a session that lies where one of its own does, each at most once,
    the nearest first; without those that are new, or of which nothing tells where they are.

    Args:
        plates: of the laboratory.
        own: of the session.
    """
    near = ((_apart(one, other), j, k) for j, one in enumerate(own) for k, other in enumerate(plates))
    called: dict[str, str] = {}
    for apart, j, k in sorted(near):
        mine, theirs = own[j].frame.name, plates[k].frame.name
        if apart < 1.0 and mine not in called and theirs not in called.values():
            called[mine] = theirs
    return called


def _apart(one: LaboratoryPlate, other: LaboratoryPlate) -> float:
    """Distance of two plates over that from which on they are not the same; infinite where only one has corners, or
    nothing tells where one is."""
    corners = one.corners - other.corners
    if bool(corners.isfinite().all()):
        return float(corners.norm(dim=1).max()) / SAME_CORNERS
    away = float((one.frame.p_WF - other.frame.p_WF)[:2].norm())
    alike = bool(one.corners.isfinite().all()) is bool(other.corners.isfinite().all())
    return away / SAME_PRESSURE if alike and math.isfinite(away) else math.inf


def renamed(evidence: LaboratoryEvidence, called: Mapping[str, str]) -> LaboratoryEvidence:
    """Return evidence with other names of plates.

    Args:
        evidence: of faults.
        called: new name of each plate.
    """
    faults = tuple(
        (effect, tuple(sorted(called.get(place, place) for place in where))) for effect, where in evidence.faults
    )
    return replace(evidence, faults=faults)


def laboratory_dataset(kept: SessionEvidence) -> xarray.Dataset:
    """Return the content of ``laboratory.nc``.

    Args:
        kept: what a session, or several, say of their laboratory.
    """
    evidence, plates = kept.evidence, kept.plates
    square = ("parameter", "other")
    owners = np.repeat(np.arange(len(evidence.sizes)), evidence.sizes)
    return xarray.Dataset(
        {
            "information": (square, evidence.information.numpy()),
            "moment": (("parameter",), evidence.moment.numpy()),
            "stated_information": (square, evidence.stated_information.numpy()),
            "stated_moment": (("parameter",), evidence.stated_moment.numpy()),
            "prior_sd": (("parameter",), np.array(_scales(evidence)), {"units": "those of the effect's parameters"}),
            "fault": (("parameter",), owners.astype(np.int64)),
            "plate_position": (("plate", "axis"), _stacked([one.frame.p_WF for one in plates], (0, 3))),
            "plate_axes": (("plate", "axis", "column"), _stacked([one.frame.R_WF for one in plates], (0, 3, 3))),
            "plate_corners": (("plate", "corner", "axis"), _stacked([one.corners for one in plates], (0, 4, 3))),
        },
        coords={"plate": [one.frame.name for one in plates], "axis": list("xyz")},
        attrs={
            "form": FORM,
            "pooled": int(kept.pooled),
            "effects": [name for name, _ in evidence.faults],
            "places": [BETWEEN.join(where) for _, where in evidence.faults],
            "meaning": "information and moment of all lasting faults of instruments, in units of prior_sd",
        },
    )  # fmt: skip


def read_laboratory(path: Path) -> SessionEvidence:
    """Return what a finished run, or a cohort, says of a laboratory.

    Args:
        path: the file of it.

    Raises:
        InputError: ``laboratory.unreadable``, or ``laboratory.form`` where another version of torchid wrote it or not
            all of it is there.
    """
    remedy = "Run the session again, or the cohort"
    found = read_netcdf(path, "laboratory.unreadable", "file of a laboratory", remedy)
    with suppress(KeyError, ValueError, TypeError):
        if int(found.attrs["form"]) == FORM:
            evidence = _evidence(found)
            numbers = (evidence.information, evidence.moment, evidence.stated_information, evidence.stated_moment)
            if found["prior_sd"].values.tolist() == _scales(evidence) and all(
                bool(x.isfinite().all()) for x in numbers
            ):
                return SessionEvidence(evidence, tuple(_plates(found)), bool(found.attrs.get("pooled", 0)))
    raise InputError(
        "laboratory.form", "another version of torchid wrote this file, or it is damaged", source=path, remedy=remedy
    )


def earlier_sessions(path: Path | None, session: Session) -> LaboratoryEvidence | None:
    """Return what earlier sessions of the laboratory say of this session's instruments; None where no file is
    named.

    Args:
        path: of a laboratory's file, as a config names it; None: none.
        session: its trials.

    Raises:
        InputError: the file cannot be read, is of a single session (``laboratory.one_session``), or none of its plates
            is this session's.
    """
    if path is None:
        return None
    told, plates = read_laboratory(path), [laboratory_plate(one) for one in session_plates(session)[0]]
    if not told.pooled:
        raise InputError(
            "laboratory.one_session", "what bodies do looks like a fault of instruments in one session", source=path,
            remedy="Give a cohort's file of the laboratory, of two sessions or more (laboratories/NAME.nc)",
        )  # fmt: skip
    called = names_in(told.plates, plates)
    if not called:
        places = [f"({x:.2f}, {y:.2f})" for x, y, _ in (one.frame.p_WF.tolist() for one in told.plates)]
        raise InputError(
            "laboratory.other_plates", "none of these plates is one of the session's", source=path,
            found=f"plates at {listing(places, 4)} m",
            remedy="Give the file of the laboratory in which the session was recorded, or leave `laboratory` out",
        )  # fmt: skip
    own = {theirs: mine for mine, theirs in called.items()}
    known = [f for f in told.evidence.faults if all(name in own for name in f[1]) or f[1] == SESSION.where]
    return renamed(among(told.evidence, known), own)


def _evidence(file: xarray.Dataset) -> LaboratoryEvidence:
    effects, places = (np.atleast_1d(file.attrs[name]).tolist() for name in ("effects", "places"))
    faults = tuple((name, tuple(place.split(BETWEEN))) for name, place in zip(effects, places, strict=True))
    sizes = tuple(np.bincount(file["fault"].values, minlength=len(faults)).tolist())
    names = ("information", "moment", "stated_information", "stated_moment")
    return LaboratoryEvidence(faults, sizes, *(torch.tensor(file[name].values) for name in names))


def _plates(file: xarray.Dataset) -> Iterator[LaboratoryPlate]:
    where = (torch.tensor(file[name].values) for name in ("plate_position", "plate_axes", "plate_corners"))
    for name, position, axes, corners in zip(file["plate"].values.tolist(), *where, strict=True):
        yield LaboratoryPlate(PlateFrame(name, position, axes), corners)


def _scales(evidence: LaboratoryEvidence) -> list[float]:
    """Return the prior standard deviations of all parameters."""
    return [sd for name, where in evidence.faults for sd in CATALOGUE[name].scale(Place(where))]


def _stacked(some: list[Tensor], shape: tuple[int, ...]) -> np.ndarray:
    return torch.stack(some).numpy() if some else np.zeros(shape)
