"""What OpenSim's inverse dynamics needs beside the kinematics: forces under the feet, where they act, and a setup.

``<trial>_grf.mot`` holds the wrench under every contact through the filter of the motion,
``<trial>_external_loads.xml``
puts each on its body, and ``<trial>_id_setup.xml`` is a setup of OpenSim's tool for the frames in which all of them are
known: ``opensim-cmd run-tool <trial>_id_setup.xml``.
"""

from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.contact.sharing.records import ContactWrenches, WrenchSource
from torchid.conventions import LOADED_N
from torchid.io.storage import write_storage
from torchid.model.markup import document, node, plain_name, spelt, write_xml
from torchid.model.opensim.rotations import R_OW
from torchid.model.osim import VERSION
from torchid.recording import Forces, Plate
from torchid.runs import runs

SUFFIXES = "{}_grf.mot", "{}_external_loads.xml", "{}_id_setup.xml"
"""Names of a trial's files."""


class ToolFiles(NamedTuple):
    """Where files of one trial are."""

    forces: Path
    loads: Path
    setup: Path
    kinematics: Path
    """Of the same folder, as the model is."""


def write_tool_files(under: ContactWrenches, time: Float[Tensor, " frames"], files: ToolFiles) -> None:
    """Write forces, external loads and setup of one trial; loads and setup only where all contacts are known once.

    Args:
        under: wrenches under the contacts about the origin of W.
        time: of the frames [s].
        files: where to.

    Raises:
        InputError: a file cannot be written.
    """
    known = (under.source != WrenchSource.UNKNOWN).all(dim=1) & under.wrench.isfinite().flatten(1).all(dim=1)
    names: list[str] = []
    for name in under.contacts:
        names.append(plain_name(name, names))
    columns = [f"{name}_{kind}{axis}" for name in names for kind in ("force_v", "force_p", "torque_") for axis in "xyz"]
    values = torch.cat([applied(wrench) for wrench in under.wrench.nan_to_num(0.0).unbind(1)], dim=1)
    write_storage(files.forces, tuple(columns), time.numpy(), values.numpy(), title=files.forces.stem)
    spans = runs(known)
    if not spans:
        return
    start, stop = max(spans, key=lambda span: span[1] - span[0])
    _write_loads(files, names, under.body)
    _write_setup(files, float(time[start]), float(time[stop - 1]))


def applied(wrench: Float[Tensor, "frames 6"]) -> Float[Tensor, "frames 9"]:
    """Return force, point and torque in OpenSim's axes, which together are the wrench in every frame.

    The point is the centre of pressure on the ground while the contact is loaded, else the nearest one in time: the
    wrench between two frames is then close to the mean of theirs.

    Args:
        wrench: about the origin of W [N, N m].
    """
    force, moment = wrench[:, :3], wrench[:, 3:]
    ground = Forces(torch.arange(len(wrench), dtype=wrench.dtype), wrench[:, None], (Plate("ground"),))
    point = ground.centre_of_pressure(LOADED_N)[:, 0]
    loaded = point.isfinite().all(dim=1).nonzero()[:, 0]
    point = point[loaded][_nearest(loaded, len(wrench))] if len(loaded) else torch.zeros_like(force)
    turn = R_OW.to(wrench)
    return torch.cat([x @ turn.T for x in (force, point, moment - torch.linalg.cross(point, force))], dim=1)


def _nearest(some: Int[Tensor, " some"], frames: int) -> Int[Tensor, " frames"]:
    """Of every frame, which of some ascending frames is nearest."""
    every = torch.arange(frames, device=some.device)
    after = torch.searchsorted(some, every).clamp(max=len(some) - 1)
    before = (after - 1).clamp(min=0)
    return torch.where((every - some[before]).abs() <= (some[after] - every).abs(), before, after)


def _write_loads(files: ToolFiles, names: list[str], bodies: tuple[str, ...]) -> None:
    root = document("OpenSimDocument", Version=VERSION)
    loads = node(root, "ExternalLoads", name=files.loads.stem)
    objects = node(loads, "objects")
    for name, body in zip(names, bodies, strict=True):
        one = node(objects, "ExternalForce", name=name)
        node(one, "applied_to_body", body)
        for what in ("force_expressed_in_body", "point_expressed_in_body"):
            node(one, what, "ground")
        for what, kind in (("force", "force_v"), ("point", "force_p"), ("torque", "torque_")):
            node(one, f"{what}_identifier", f"{name}_{kind}")
        node(one, "data_source_name", files.forces.stem)
    node(loads, "datafile", files.forces.name)
    write_xml(files.loads, root)


def _write_setup(files: ToolFiles, start: float, end: float) -> None:
    root = document("OpenSimDocument", Version=VERSION)
    tool = node(root, "InverseDynamicsTool", name=files.setup.stem)
    for tag, text in (
        ("results_directory", "."),
        ("model_file", "model.osim"),
        ("time_range", spelt([start, end])),
        ("forces_to_exclude", "Muscles"),
        ("external_loads_file", files.loads.name),
        ("coordinates_file", files.kinematics.name),
        ("lowpass_cutoff_frequency_for_coordinates", "-1"),  # they are filtered, as the forces are
        ("output_gen_force_file", f"{files.setup.stem}_result.sto"),
    ):
        node(tool, tag, text)
    write_xml(files.setup, root)
