"""Inverse kinematics at fixed geometry: frames per second and what the cost lacks to the optimum."""

import subprocess
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import opensim
import torch
from harness.command import ROOT
from harness.opensim_tools import follow_markers
from scipy.spatial.transform import Rotation

from benchmarks.subject import RATE, Session, by_turns, make_session
from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.model.osim import osim_coordinates, osim_names, write_osim

PEER_PYTHON = ROOT / ".venv-bench" / "bin" / "python"
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def bench_ik(frames: int, peer_frames: int, rounds: int) -> dict[str, object]:
    """torchid, OpenSim's tool and nimblephysics on one model and trial, by turns."""
    session = make_session(frames, 3)
    problem, xi = session.problem, session.xi
    few = torch.arange(peer_frames)
    best = solve_poses(problem, solve_poses(problem, session.start, xi)[0], xi, iterations=200, tolerance=1e-13)[1]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_inputs(session, peer_frames, folder)
        runs = {
            "torchid": lambda: solve_poses(problem, session.start, xi),
            "opensim": lambda: _opensim(folder),
            "nimblephysics": lambda: _nimble(folder, peer_frames),
        }
        times = by_turns(runs, rounds, warm=False)
        cost = {"torchid": solve_poses(problem, session.start, xi)[1].sum() / best.sum()}
        found = _read_motion(folder / "ik.mot", session)
        count = found.shape[1]
        cost["opensim"] = problem.frames(few[:count]).frame_cost(found, xi).sum() / best[:count].sum()
    speed = {name: (frames if name == "torchid" else peer_frames) / t for name, t in times.items()}
    return {"frames_per_s": speed, "gap": {name: float(c) - 1 for name, c in cost.items()}}


def write_inputs(session: Session, frames: int, folder: Path) -> None:
    """Model, markers (TRC, Y up) and starting coordinates for the peers."""
    problem, tree = session.problem, session.model.tree
    geometry, place = problem.split(session.xi)
    labels = [f"m{k}" for k in range(len(place))]
    order = [tree.names[problem.plan.order[k]] for k in problem.body.tolist()]
    markers = {label: (segment, p.numpy()) for label, segment, p in zip(labels, order, place, strict=True)}
    write_osim(tree, geometry, session.model.inertia.mean, folder / "model.osim", markers)
    _free_root(folder / "model.osim", folder / "nimble.osim", tree.names[0])
    p = np.einsum("ij,mjt->tmi", Y_UP, problem.target[:, :, :frames].numpy())
    start = osim_coordinates(session.start.T).numpy()
    start[:, 1] *= -1.0  # as in nimble.osim
    np.savez(folder / "trial.npz", p=p, start=start[0], names=np.array(osim_names(tree)), labels=np.array(labels))
    head = [
        "PathFileType\t4\t(X/Y/Z)\tmarkers.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{RATE}\t{RATE}\t{frames}\t{len(labels)}\tm\t{RATE}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(labels) + "\t\t",
        "\t\t" + "\t".join(f"X{k}\tY{k}\tZ{k}" for k in range(1, len(labels) + 1)),
        "",
    ]
    rows = [f"{t + 1}\t{t / RATE:.6f}\t" + "\t".join(f"{x:.9f}" for x in p[t].ravel()) for t in range(frames)]
    (folder / "markers.trc").write_text("\n".join(head + rows) + "\n")


def _free_root(source: Path, target: Path, root: str) -> None:
    """The same model for nimblephysics, whose free joints slide along X, Y, Z of the file (our x, z, -y)."""
    document = ElementTree.parse(source)  # noqa: S314 (our own file)
    joint = next(x for x in document.iter("CustomJoint") if x.get("name") == f"ground_{root}")
    wanted = zip(np.eye(3), (f"{root}_x", f"{root}_z", f"{root}_y"), strict=True)
    slides = [x for x in joint.iter("TransformAxis") if (x.get("name") or "").startswith("translation")]
    for slide, (axis, name) in zip(slides, wanted, strict=True):
        for tag, text in (("axis", " ".join(map(str, axis))), ("coordinates", name)):
            found = slide.find(tag)
            assert found is not None
            found.text = text
    document.write(target)


def _opensim(folder: Path) -> float:
    """CPU seconds of OpenSim's IK tool, loading of the model left out."""
    opensim.Logger.setLevelString("Off")
    model = opensim.Model(str(folder / "model.osim"))
    return follow_markers(model, folder / "markers.trc", folder / "ik.mot", (0.0, 1e3))


def _read_motion(path: Path, session: Session) -> torch.Tensor:
    """q (dofs, frames) of the motion that OpenSim wrote."""
    table = opensim.TimeSeriesTable(str(path))
    degrees = table.getTableMetaDataString("inDegrees") == "yes"
    tree, names = session.model.tree, osim_names(session.model.tree)
    q = np.stack([table.getDependentColumn(name).to_numpy() for name in names])
    turning = np.array([dof.unit == "rad" for dof in tree.dofs])
    q[turning] *= np.pi / 180 if degrees else 1.0
    out = torch.tensor(q)
    out[3:6] = _rotation_vectors(q[3:6])
    return out


def _rotation_vectors(angles: np.ndarray) -> torch.Tensor:
    """Rotation vectors in Z-up axes of tilt (Z), list (X), rotation (Y) of a Y-up model."""
    R = Rotation.from_euler("ZXY", angles.T).as_matrix()
    return torch.tensor(Rotation.from_matrix(Y_UP.T @ R @ Y_UP).as_rotvec().T)


def _nimble(folder: Path, frames: int) -> float:
    child = Path(__file__).with_name("nimble_child.py")
    line = [str(PEER_PYTHON), str(child), str(folder), str(min(frames, 40))]
    done = subprocess.run(line, capture_output=True, text=True, check=True, timeout=600)  # noqa: S603
    return float(done.stdout.split()[-1]) * frames
