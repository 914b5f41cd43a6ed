"""The inertial prior of a subject: tables, or what a cohort's people say of one more (``people.nc``)."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
import xarray
from torch import Tensor

from torchid.config.sections import ModelSource, Subject
from torchid.errors import ConfigError, InputError
from torchid.geometry.result import GeometryFit
from torchid.model.anthropometry import inertial_prior
from torchid.model.model import InertialPrior
from torchid.model.people import SCORES, People
from torchid.storage.netcdf import read_netcdf

FORM = 1
"""Version of the form of a person's file, and of a cohort's people's."""


def subject_prior(model: ModelSource, who: Subject, fit: GeometryFit) -> InertialPrior:
    """Inertial prior for the fit's segment lengths; a model from a file brings its own.

    Raises:
        InputError, ConfigError: as for ``people_of``.
    """
    people = people_of(model, who)
    return inertial_prior(fit.geometry, *who.known, people) if model == "whole_body" else fit.model.inertia


def people_of(model: ModelSource, who: Subject) -> People | None:
    """Return what other people say of a subject; None where no file is named.

    Args:
        model: of the config.
        who: the subject.

    Raises:
        InputError: ``people.unreadable``, ``people.form``: the file cannot be used.
        ConfigError: ``people.model``: it is given to a model from a file.
    """
    if who.people is None:
        return None
    if model != "whole_body":
        raise ConfigError(
            "people.model", "a model from a file has an inertia of its own", place="subject.people",
            found=str(model), remedy="Leave subject.people out, or use the built-in model",
        )  # fmt: skip
    return read_people(who.people)[0]


def read_people(path: Path) -> tuple[People, str]:
    """Return what a cohort's people say of one more, and of which sessions.

    Args:
        path: of its ``people.nc``.

    Raises:
        InputError: ``people.unreadable``, ``people.form``.
    """
    said, (score, covariance) = numbers_of(path, {"score": (SCORES,), "covariance": (SCORES, SCORES)})
    return People(score, covariance, int(said.get("count", 0)), float(said.get("own", 1.0))), str(said.get("key", ""))


def people_dataset(people: People, key: str = "") -> xarray.Dataset:
    """Return the content of a cohort's ``people.nc``.

    Args:
        people: what its sessions say of one more person.
        key: of these sessions.
    """
    return xarray.Dataset(
        {
            "score": (("score",), people.score.numpy()),
            "covariance": (("score", "other"), people.covariance.numpy()),
        },
        attrs={
            "form": FORM, "count": people.count, "own": people.own, "key": key,
            "meaning": "how people of a cohort differ from the tables, in standard deviations of these",
        },
    )  # fmt: skip


def numbers_of(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> tuple[dict[str, Any], tuple[Tensor, ...]]:
    """Return attributes and arrays of a file about a person or about people.

    Args:
        path: of the file.
        shapes: of the arrays, by name.

    Raises:
        InputError: ``people.unreadable``, or ``people.form`` where another version of torchid wrote it or not all of it
            is there.
    """
    remedy = "Run the cohort again, and name its people.nc"
    found = read_netcdf(path, "people.unreadable", "file of a cohort's people", remedy)
    with suppress(KeyError, ValueError, TypeError):
        arrays = tuple(torch.tensor(found[name].values, dtype=torch.float64) for name in shapes)
        right = [tuple(one.shape) for one in arrays] == list(shapes.values())
        if int(found.attrs["form"]) == FORM and right and all(bool(one.isfinite().all()) for one in arrays):
            return dict(found.attrs), arrays
    raise InputError(
        "people.form", "another version of torchid wrote this file, or it is no cohort's", source=path, remedy=remedy
    )
