"""Fits of markers, found once for all faults that leave markers alone.

A battery that plants twelve faults of plates in a session fits the same markers thirteen times, which is most of what
the witnesses' runs cost. What a fit is made of names its file; a fault of markers is another name.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ParamSpec, TypeVar
from unittest.mock import patch

import torchid.run.sequence as run
import torchid.session.fitting as fits
from torchid.storage.files import atomic_write
from torchid.storage.provenance import stage_key
from torchid.storage.snapshot import load_snapshot, write_snapshot

Given = ParamSpec("Given")
Found = TypeVar("Found")


@contextmanager
def remembering(folder: Path) -> Iterator[None]:
    """Runs within take fits of geometry and followed trials from a folder where the same was asked before."""
    folder.mkdir(parents=True, exist_ok=True)
    fit, track = remembered(fits.fit_geometry, folder), remembered(run.track, folder)
    with patch.object(fits, "fit_geometry", fit), patch.object(run, "track", track):
        yield


def remembered(function: Callable[Given, Found], folder: Path) -> Callable[Given, Found]:
    """The function, its results kept in a folder under what it was given, callbacks and torchid's code beside."""

    def found(*args: Given.args, **kwargs: Given.kwargs) -> Found:
        asked = [one for one in args if not callable(one)]
        file = folder / f"{stage_key(name=function.__name__, args=asked, kwargs=kwargs)[:32]}.snapshot"
        if not file.is_file():
            result = function(*args, **kwargs)
            with atomic_write(file) as target:
                write_snapshot(target, {"result": result})
        return load_snapshot(file)["result"]

    return found
