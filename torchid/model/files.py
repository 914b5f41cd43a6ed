"""Models from files: URDF, MJCF and OpenSim."""

from pathlib import Path

from torchid.errors import ConfigError, Note
from torchid.model.mjcf import read_mjcf
from torchid.model.model import Model
from torchid.model.opensim.as_model import read_osim_model
from torchid.model.tree_of_links import FileScatter
from torchid.model.urdf import read_urdf

READERS = {".urdf": read_urdf, ".xml": read_mjcf, ".osim": read_osim_model, ".b3d": read_osim_model}


def load_model(path: str | Path, scatter: FileScatter | None = None) -> tuple[Model, tuple[Note, ...]]:
    """Model of a ``.urdf``, MJCF ``.xml`` or ``.osim`` file, or in a ``.b3d``, and what was changed in reading it.

    Args:
        scatter: how uncertain its numbers are; default ``FileScatter()``.

    Raises:
        ConfigError: another suffix.
        InputError: what the reader says.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in READERS:
        remedy = f"Known: {', '.join(READERS)}."
        raise ConfigError("model.suffix", "not a model file", source=path, found=suffix, remedy=remedy)
    return READERS[suffix](path, scatter)
