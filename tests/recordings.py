"""This module is where the real recordings lie: ``$TORCHID_DATA``, else ``shared/data`` beside the project."""

import os
from pathlib import Path

DATA = Path(os.environ.get("TORCHID_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
"""Folder, which need not exist."""
