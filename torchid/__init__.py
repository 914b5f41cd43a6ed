"""Geometry, motion and inertia of a moving person from marker trajectories and force plates.

The names below are fetched on first use, since torch alone takes seconds and ``torchid --help`` needs none of it.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torchid.config import load_config as load_config
    from torchid.diagnosis.diagnose import diagnose as diagnose
    from torchid.diagnosis.options import DiagnosisOptions as DiagnosisOptions
    from torchid.errors import TorchidError as TorchidError
    from torchid.extension.diagnosing import diagnose_outcome as diagnose_outcome
    from torchid.geometry.assign import assign_markers as assign_markers
    from torchid.geometry.fit import fit_geometry as fit_geometry
    from torchid.geometry.tracking import track as track
    from torchid.inertia.identify import identify_inertia as identify_inertia
    from torchid.inertia.rows_fit import fit_inertia_rows as fit_inertia_rows
    from torchid.io import read_trial as read_trial
    from torchid.model.marker_set import load_marker_set as load_marker_set
    from torchid.model.whole_body import whole_body as whole_body
    from torchid.run import run_experiment as run_experiment
    from torchid.simulate.session import simulate_session as simulate_session

_HOMES = {
    "load_config": "torchid.config",
    "diagnose": "torchid.diagnosis.diagnose",
    "DiagnosisOptions": "torchid.diagnosis.options",
    "TorchidError": "torchid.errors",
    "run_experiment": "torchid.run",
    "diagnose_outcome": "torchid.extension.diagnosing",
    "assign_markers": "torchid.geometry.assign",
    "fit_geometry": "torchid.geometry.fit",
    "track": "torchid.geometry.tracking",
    "identify_inertia": "torchid.inertia.identify",
    "fit_inertia_rows": "torchid.inertia.rows_fit",
    "read_trial": "torchid.io",
    "load_marker_set": "torchid.model.marker_set",
    "whole_body": "torchid.model.whole_body",
    "simulate_session": "torchid.simulate.session",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'torchid' has no attribute '{name}'")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(_HOMES)
