"""Models from files: URDF and MJCF."""

from pathlib import Path

from torchid.errors import ConfigError, InputError, Note
from torchid.model.mjcf import read_mjcf
from torchid.model.model import Model
from torchid.model.tree_of_links import FileScatter
from torchid.model.urdf import read_urdf

READERS = {".urdf": read_urdf, ".xml": read_mjcf}


def load_model(path: str | Path, scatter: FileScatter | None = None) -> tuple[Model, tuple[Note, ...]]:
    """Model of a ``.urdf`` or MJCF ``.xml`` file, and what was changed in reading it.

    Args:
        path: the file.
        scatter: how uncertain its numbers are; default ``FileScatter()``.

    Raises:
        ConfigError: another suffix.
        InputError: what the reader says.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".osim":
        remedy = "Use `model: whole_body`, or a URDF of the model; torchid.model.opensim reads and poses it by itself."
        raise InputError("model.osim", "an OpenSim model cannot be identified yet", source=path, remedy=remedy)
    if suffix not in READERS:
        remedy = f"Known: {', '.join(READERS)}."
        raise ConfigError("model.suffix", "not a model file", source=path, found=suffix, remedy=remedy)
    return READERS[suffix](path, scatter)
