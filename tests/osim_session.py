"""A simulated session of somebody whose body is an OpenSim model: standing on two plates, everything else moving."""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import yaml
from draws import seed_of
from recordings import DATA
from small_session import SHARED, shared
from torch import Tensor

from torchid.config import load_config
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import WrenchTrial, predict
from torchid.filters import Smoother
from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.geometry.problem import MarkerProblem, PosturePrior
from torchid.geometry.result import fixed
from torchid.io.c3d_write import write_c3d
from torchid.kinematics.chain import chain_points
from torchid.kinematics.plan import plan_tree
from torchid.model.model import Geometry, Model
from torchid.model.opensim.as_model import read_osim_model
from torchid.model.pseudo import params_to_pseudo
from torchid.motion import Motion, smooth_motion
from torchid.recording import Forces, Markers, Plate, Trial
from torchid.run import run_experiment
from torchid.session import Outcome

RATE = 60.0
FUNCTION_KNEES = "opensim_rajagopal_walk/subject_walk_scaled.osim"
"""A model whose knees turn about three axes and slide along three by functions of one coordinate, with kneecaps that
follow."""
ASKEW = 0.06
"""How far beside the feet the ground may push [m]."""
FIRM, LOOSE = 1e-3, 0.3
"""Scatter of planted feet [m], and of all else about its course [rad or m]."""


@dataclass(frozen=True)
class Truth:
    """What a run should find."""

    model: Model
    geometry: Geometry
    phi: Tensor
    place: Tensor
    labels: tuple[str, ...]


def write_osim_session(folder: Path, source: Path, rng: np.random.Generator, seconds: float = 5.0) -> Truth:
    """Write ``static.c3d``, ``fit.c3d``, ``heldout.c3d`` and ``config.yaml``, and return the truth."""
    model, _ = read_osim_model(source)
    roles, trials, truth = ("static", "fit", "heldout"), [None], None
    while truth is None or not all(trials):  # a body that could not stand like this is drawn anew
        truth = _truth(model, rng)
        trials = [_trial(truth, name, rng, 1.0 if name == "static" else seconds) for name in roles]
    for trial in trials:
        assert trial is not None
        write_c3d(folder / f"{trial.name}.c3d", trial)
    mass = float(truth.phi[:, 0].sum())
    config = {
        "subject": {"name": "osim", "mass_kg": mass, "mass_sd_kg": 0.1},
        "model": str(source),
        "markers": "model",
        "trials": [{"name": name, "file": f"{name}.c3d", "role": name} for name in roles],
        "geometry": {"max_frames": 160},
        "motion": {"cutoff_hz": 6.0},
        "diagnosis": {"enabled": False},
        "out": "out",
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
    return truth


@shared
def identified() -> tuple[Path, Truth, Outcome]:
    """Folder, truth and run of somebody whose knees and kneecaps follow functions, made once for all tests."""
    folder = (SHARED or Path(tempfile.mkdtemp())) / "osim"
    folder.mkdir()
    truth = write_osim_session(folder, DATA / FUNCTION_KNEES, np.random.default_rng(seed_of(__name__)))
    return folder, truth, run_experiment(load_config(folder / "config.yaml"))


def _truth(model: Model, rng: np.random.Generator) -> Truth:
    """A body of the model's kind."""
    prior = model.geometry
    geometry = prior.geometry(prior.mean + 0.7 * prior.sd * torch.tensor(rng.normal(size=len(prior.mean))))
    marks = {marker.name: model.landmarks[marker.name] for marker in model.osim.model.markers}  # type: ignore[union-attr]
    mean = torch.tensor([mark.p_BM_B for mark in marks.values()], dtype=torch.float64)
    place = mean + 0.01 * torch.tensor(rng.normal(size=mean.shape))
    return Truth(model, geometry, _inertia(model, rng), place, tuple(marks))


def _inertia(model: Model, rng: np.random.Generator) -> Tensor:
    """Drawn from the prior, body by body, again until a body can have it (bodies, 10)."""
    found = model.inertia.mean.clone()
    for k, mean in enumerate(model.inertia.mean):
        block = slice(10 * k, 10 * k + 10)
        L = torch.linalg.cholesky(model.inertia.covariance[block, block] + 1e-18 * torch.eye(10).double())
        while bool((found[k] == mean).all()) or bool((torch.linalg.eigvalsh(params_to_pseudo(found[k])) <= 0.0).any()):
            found[k] = mean + L @ torch.tensor(rng.normal(size=10))
    return found


def _trial(truth: Truth, name: str, rng: np.random.Generator, seconds: float) -> Trial | None:
    """One recording, 1 mm and 2 N of noise; None where nobody could stand like this."""
    tree = truth.model.tree
    time = torch.arange(round(seconds * RATE) + 1, dtype=torch.float64) / RATE
    course = _courses(tree.dofs, time, rng)
    # Feet that stay where they are do not hold every motion: the same one is made smaller until they do.
    for part in (0.0,) if name == "static" else (1.0, 0.75, 0.5, 0.35, 0.25):
        motion = smooth_motion(tree, time, _planted(truth, part * course).T.contiguous(), Smoother(6.0, RATE))
        total, soles = _total(truth, name, motion), _soles(truth, motion.q)
        if _balanced(total, soles):
            break
    else:
        return None
    body = torch.tensor([tree.index(truth.model.landmarks[label].segment) for label in truth.labels])
    seen = chain_points(tree, motion.q, truth.geometry, body, truth.place)
    seen = seen + 1e-3 * torch.tensor(rng.normal(size=seen.shape))
    wrench = _shared(total, soles)
    wrench[..., :3] += 2.0 * torch.tensor(rng.normal(size=wrench[..., :3].shape))
    forces = Forces(time, wrench, _plates(soles))
    return Trial(name=name, role=name, markers=Markers(truth.labels, time, seen), forces=forces)


def _total(truth: Truth, name: str, motion: Motion) -> Tensor:
    """Wrench that the ground gives, about the world's origin (frames, 6)."""
    unused = torch.ones(len(motion.q), dtype=torch.bool)
    rows = WrenchTrial(name, truth.model.tree, truth.geometry, motion, motion.q.new_zeros(len(motion.q), 6), unused)
    return wrench_about(predict(rows, truth.phi), -motion.q[:, :3])


def _pressed(total: Tensor) -> Tensor:
    """Where the total acts on the ground [m]."""
    return torch.stack([-total[:, 4], total[:, 3]], 1) / total[:, 2:3]


def _balanced(total: Tensor, soles: Tensor) -> bool:
    """Whether the total acts on the feet or between them, within ``ASKEW``, throughout."""
    first, last = soles.reshape(-1, 3)[:, :2].aminmax(dim=0)
    pressed = _pressed(total)
    return bool(((pressed > first - ASKEW) & (pressed < last + ASKEW)).all())


def _courses(dofs, time: Tensor, rng: np.random.Generator) -> Tensor:
    """What the coordinates would do by themselves (dofs, frames): slow sines of all kinds."""
    reach = [0.03, 0.03, 0.0, 0.1, 0.1, 0.15]
    reach = torch.tensor(reach + [0.2 if dof.name.startswith("lumbar") else 0.6 for dof in dofs[6:]])
    out = torch.zeros(len(dofs), len(time), dtype=torch.float64)
    for hertz in (0.31, 0.53, 0.97, 1.4):
        phase = torch.tensor(rng.uniform(0.0, 2.0 * np.pi, size=(len(dofs), 1)))
        out += 0.6 * (0.31 / hertz) ** 1.5 * reach[:, None] * torch.sin(2.0 * torch.pi * hertz * time + phase)
    return out


def _planted(truth: Truth, course: Tensor) -> Tensor:
    """Coordinates near rest plus a course in which both feet stay where they are at rest (dofs, frames)."""
    model, tree, frames = truth.model, truth.model.tree, course.shape[1]
    rest = course.new_tensor([dof.rest for dof in tree.dofs])[:, None] + torch.zeros_like(course)
    bend = {"hip_flexion": 0.35, "knee_angle": 0.6, "ankle_angle": 0.25}
    for row, dof in enumerate(tree.dofs):
        rest[row] += next((value for start, value in bend.items() if dof.name.startswith(start)), 0.0)
    names = [f"{point}_{side}" for side in "lr" for point in ("heel", "toe", "mt1", "mt5")]
    body = torch.tensor([tree.index(model.landmarks[name].segment) for name in names])
    place = course.new_tensor([model.landmarks[name].p_BM_B for name in names])
    goal = chain_points(tree, rest.T[:1].contiguous(), truth.geometry, body, place)[0]
    plan = plan_tree(tree)
    precision = torch.full((len(tree.dofs), 1), LOOSE**-2, dtype=torch.float64)
    wide = torch.full((len(tree.dofs), 1), 1e6, dtype=torch.float64)
    posture = PosturePrior(rest + course, precision, -wide, wide, 1.0)
    problem = MarkerProblem(
        plan, fixed(replace(model.geometry, constant=_raw(truth.geometry), map=0.0 * model.geometry.map)),
        torch.tensor(plan.position)[body], goal[:, :, None].expand(-1, -1, frames).contiguous(),
        torch.full((len(names), frames), FIRM**-2, dtype=torch.float64), place, torch.ones_like(place),
        torch.zeros(0, dtype=torch.long), posture,
    )  # fmt: skip
    return solve_poses(problem, rest + course, problem.xi_mean, iterations=200, tolerance=1e-12)[0]


def _raw(geometry: Geometry) -> Tensor:
    return torch.cat([geometry.offset.reshape(-1), geometry.hinge])


def _soles(truth: Truth, q: Tensor) -> Tensor:
    """Heel and toe of both feet (left, right) in the first frame, on the ground [m]."""
    tree, marks = truth.model.tree, truth.model.landmarks
    names = ["heel_l", "toe_l", "heel_r", "toe_r"]
    body = torch.tensor([tree.index(marks[name].segment) for name in names])
    place = q.new_tensor([marks[name].p_BM_B for name in names])
    points = chain_points(tree, q[:1], truth.geometry, body, place)[0].view(2, 2, 3).clone()
    points[..., 2] = 0.0
    return points


def _shared(total: Tensor, soles: Tensor) -> Tensor:
    """The wrench of two plates (frames, 2, 6): by the lever rule, the sum exact."""
    pressed, middle = _pressed(total), soles.mean(1)
    share = ((pressed[:, 1] - middle[1, 1]) / (middle[0, 1] - middle[1, 1])).clamp(0.05, 0.95)
    point = torch.stack([pressed[:, 0], middle[0, 1].expand_as(share), torch.zeros_like(share)], 1)
    force = share[:, None] * total[:, :3]
    left = torch.cat([force, torch.linalg.cross(point, force)], 1)
    return torch.stack([left, total - left], 1)


def _plates(soles: Tensor) -> tuple[Plate, ...]:
    found = []
    for k, (x, y, _) in enumerate(soles.mean(1).tolist()):
        corners = [(x + 0.3 * a, y + b * abs(float(soles[0, 0, 1] - soles[1, 0, 1])) / 2.05, 0.0)
                   for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]  # fmt: skip
        found.append(Plate(f"plate {k + 1}", torch.tensor(corners, dtype=torch.float64)))
    return tuple(found)
