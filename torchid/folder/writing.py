"""The config of a folder on disk: written whole and valid, or not at all, and taken up again if it is the folder's."""

from pathlib import Path

from torchid.config import load_config
from torchid.config.loading import config_of_text
from torchid.errors import ConfigError, TorchidError
from torchid.folder.config_text import config_text, marker_map_text
from torchid.folder.proposal import Proposal
from torchid.storage.files import write_text


def refuse_taken(config: Path) -> None:
    """Refuse a place at which a config cannot be written.

    Raises:
        ConfigError: ``folder.config_exists``, ``folder.config_place``.
    """
    if config.is_dir() or not config.parent.is_dir():
        seen = "a folder of that name" if config.is_dir() else "no such folder"
        raise ConfigError(
            "folder.config_place", "the config cannot be written here", source=str(config), found=seen,
            remedy="Make the folder, or give another file with -o",
        )  # fmt: skip
    if config.exists():
        raise ConfigError(
            "folder.config_exists", "this config is there already", source=str(config), found="a file of that name",
            remedy="Run it, remove it, or give another name with -o",
        )  # fmt: skip


def write_config(proposal: Proposal, config: Path) -> tuple[Path, ...]:
    """Write the config of a proposal, and the marker map where labels are told beside a set.

    Args:
        proposal: the session.
        config: the file.

    Returns:
        The files that were written, the config first.

    Raises:
        ConfigError: as of ``refuse_taken``; InvalidConfig where what was given or found makes no config.
        InputError: a file cannot be written.
    """
    refuse_taken(config)
    markers = config.with_name(f"{config.stem}_markers.yaml") if proposal.markers.beside else None
    if markers is not None:
        refuse_taken(markers)
        write_text(markers, marker_map_text(proposal.markers))
    try:
        text = config_text(proposal, config.parent, markers.name if markers else "")
        config_of_text(text, config)
    except TorchidError:
        if markers is not None:
            markers.unlink()
        raise
    write_text(config, text)
    return (config,) if markers is None else (config, markers)


def refuse_other(config: Path, folder: Path) -> None:
    """Refuse a config that is not about the recordings of a folder.

    Args:
        config: a file that is there.
        folder: of the recordings.

    Raises:
        ConfigError: ``folder.config_other``, or the file is no config.
    """
    folder = folder.resolve()
    strange = [t.file for t in load_config(config).trials if folder not in t.file.resolve().parents]
    if strange:
        raise ConfigError(
            "folder.config_other", "a config of this name is about other recordings", source=str(config),
            found=str(strange[0]), remedy="Remove it, or name another one: torchid new FOLDER -o CONFIG",
        )  # fmt: skip
