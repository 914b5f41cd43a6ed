"""A synthetic session from a config."""

from collections.abc import Callable
from pathlib import Path

import torch

from torchid.config import Config, load_config
from torchid.errors import ConfigError
from torchid.simulate.session import simulate_session
from torchid.storage.results import OutputFolder

RECORDINGS = "recordings"
"""Folder inside ``out``; the truth stands apart from the recordings, in ``recordings/truth``."""


def run_simulation(config: Config, progress: Callable[[str, float], None] = lambda stage, fraction: None) -> Path:
    """Write the recordings that ``simulate:`` asks for, with a config that identifies them; returns its path.

    Raises:
        ConfigError: the config has no ``simulate:`` section.
        InputError: ``results.foreign``, ``results.locked`` or ``results.unwritable``, as of ``OutputFolder``.
    """
    if config.simulate is None:
        raise ConfigError(
            "simulate.missing", "the config has no `simulate:` section", remedy="add one, if only `simulate: {}`"
        )
    torch.set_num_threads(config.threads)
    progress("simulate", 0.0)
    with OutputFolder(config.out / RECORDINGS) as folder:
        written = simulate_session(config.simulate, config.seed, folder.staging).config
    progress("simulate", 1.0)
    assert written is not None
    return folder.out / written.name


def with_recordings(config: Config, progress: Callable[[str, float], None]) -> Config:
    """What the fits may know: the config without ``simulate:``, which would tell them what is hidden.

    Where it lists no trials, the session is simulated first, and its subject and trials are listed.
    """
    if config.trials or config.simulate is None:
        return config.model_copy(update={"simulate": None})
    made = load_config(run_simulation(config, progress))
    found = {"subject": made.subject, "trials": made.trials, "markers": made.markers}
    return config.model_copy(update={**found, "simulate": None})
