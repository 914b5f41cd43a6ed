"""This module lets processes beside a stream begin at once, as copies of one that has imported torchid already."""

import multiprocessing
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

NEEDED = ("torchid.live.estimation.beside", "torchid.live.display.page")
"""What these processes import, which takes seconds."""


@contextmanager
def quick_children() -> Iterator[None]:
    """Within, ``spawn`` means ``forkserver``; elsewhere processes begin as a user's do."""
    begin = multiprocessing.get_context
    multiprocessing.set_forkserver_preload(list(NEEDED))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(multiprocessing, "get_context", lambda how: begin({"spawn": "forkserver"}.get(how, how)))
        yield
