"""A synthetic subject: true geometry, marker places and inertia, drawn from the priors that fits start from."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Planted
from torchid.errors import ConfigError
from torchid.model.anthropometry import inertial_prior
from torchid.model.build import BMI
from torchid.model.landmarks import ANKLE_FROM_HEEL
from torchid.model.marker_set import MarkerSpec, load_marker_set, marker_prior
from torchid.model.model import Geometry, GeometryPrior, Model
from torchid.model.proportions import STATURE, proportions
from torchid.model.pseudo import params_to_pseudo
from torchid.model.skeleton import SIDES
from torchid.model.whole_body import whole_body
from torchid.simulate.options import SimulateOptions
from torchid.simulate.planting import planted

MARKER_SET = "simulated"
LEFT, RIGHT = 0, 1
SIDE_CORRELATION = 0.95
"""Between left and right lengths of one person; legs drawn independently would differ by 4 cm on average."""
BOUND = 2.2
"""Draws beyond so many standard deviations are repeated."""
HINGE_BOUND = 1.5
"""The same for hinge angles: ankles at the ends of Inman's ranges on all axes at once cannot keep a foot flat."""
ROLL_AUTHORITY = 0.60
"""Least part of the subtalar axis along the foot; below 0.58 some walks never kept the foot flat on the floor."""
FREE_SCATTER = 0.010
"""Of markers that sit on no landmark, about ``FREE_PLACES`` [m]."""
FREE_PLACES = {
    "RBAK": (-0.055, -0.055, 0.075), "SACR": (-0.062, 0.0, 0.035),
    "ABDF": (0.075, 0.0, 0.045), "ABDB": (-0.035, 0.0, 0.050), "ABDL": (0.020, 0.085, 0.040),
    "ABDR": (0.025, -0.085, 0.055), "UPA": (0.005, 0.035, -0.075), "FRA": (-0.010, 0.028, -0.070),
    "FIN": (0.010, 0.014, -0.055), "HA2": (0.022, 0.012, -0.042), "HA5": (-0.020, 0.012, -0.035),
    "THI": (0.015, 0.052, -0.130), "THAP": (0.052, 0.010, -0.095), "TIB": (0.010, 0.038, -0.110),
    "TIAP": (0.032, 0.000, -0.075),
}  # fmt: skip
"""x forward, y outward (left where the label has no side), z up from the segment's origin, fractions of stature."""
SKIN_FACTOR = {
    "thigh": 1.0, "upper_arm": 0.8, "shank": 0.5, "forearm": 0.5, "pelvis": 0.5, "abdomen": 0.8, "thorax": 0.5,
    "hand": 0.2, "foot": 0.2, "head": 0.1,
}  # fmt: skip
"""Skin motion against the thigh's, a choice: of the lower limb, it is largest there (Leardini et al., Gait & Posture
21, 2005)."""


@dataclass(frozen=True)
class Sole:
    """Where a foot can bear, in the foot's axes from the ankle [m]."""

    heel: float
    ball: float
    half_width: float
    height: float
    """Ankle above the sole."""

    def corners(self) -> list[tuple[float, float, float]]:
        """Corners of the rectangle that bears."""
        return [(x, y, -self.height) for x in (self.heel, self.ball) for y in (-self.half_width, self.half_width)]


@dataclass(frozen=True)
class Stance:
    """Where the feet start."""

    left: tuple[float, float]
    right: tuple[float, float]
    toe_out: float = 0.1

    def place(self, side: int) -> tuple[float, float]:
        """Ankle of one foot [m]."""
        return self.left if side == LEFT else self.right


@dataclass(frozen=True)
class SimulatedSubject:
    """The truth about a person."""

    seed: int
    sex: str
    height: float
    mass: float
    recorded_height: float
    """As a laboratory would write it down [m]."""
    recorded_mass: float
    """As a bathroom scale shows it [kg]."""
    model: Model
    """Template for the true height, mass and sex; its priors are what was drawn from."""
    xi: Float[Tensor, " params"]
    """True values of ``model.geometry.names``."""
    geometry: Geometry
    phi: Float[Tensor, "bodies 10"]
    """True inertial parameters."""
    labels: tuple[str, ...]
    segments: tuple[str, ...]
    """Segment of each marker."""
    p_BM_B: Float[Tensor, "markers 3"]
    """True places of the markers [m]."""
    skin: Float[Tensor, "markers 3 cues"]
    """Directions in which a marker slides for each cue of its segment (see ``noise.skin_shift``), unit scatter."""
    sole: Sole
    hidden: tuple[Planted, ...] = ()
    """Effects that nobody wrote down."""
    trial: str = ""
    """In which the person moves: some effects concern single trials."""
    stance: Stance | None = None
    """Where the feet stand before every motion on the spot, and after it as well; None: each motion draws its own."""


def simulate_subject(options: SimulateOptions | None = None, seed: int = 0) -> SimulatedSubject:
    """Draw a subject.

    Geometry is normal about the geometry prior with left and right lengths correlated, markers on landmarks about the
    landmark prior, other markers about plausible places on the skin, inertia about the inertial prior (for the true
    joint centres) until every body's pseudo-inertia is positive definite.

    Raises:
        ConfigError: the mass, height or sex asked for is no person's.
    """
    options = options or SimulateOptions()
    rng = np.random.default_rng((seed, 1))
    sex: str = options.sex or ("male" if rng.random() < 0.5 else "female")
    tall, tall_sd = STATURE[sex]
    height = options.height_m or tall + tall_sd * _bounded(rng)
    mass = options.mass_kg or (BMI + 2.5 * _bounded(rng)) * height**2
    model = whole_body(height, mass, sex, mass_sd=0.005 * mass)
    xi = draw_geometry(rng, model.geometry, options.scatter)
    geometry = model.geometry.geometry(xi)
    model = replace(model, inertia=inertial_prior(geometry, height, mass, 0.005 * mass, sex))
    phi = draw_inertia(rng, model, options.scatter)
    specs = load_marker_set(MARKER_SET).specs
    cues = 3 + 3 + 3
    shape = proportions(sex)
    foot = shape.foot_length * height
    return SimulatedSubject(
        seed=seed,
        sex=sex,
        height=height,
        mass=float(phi[:, 0].sum()),
        recorded_height=round(height + 0.004 * _bounded(rng), 3),
        recorded_mass=round(float(phi[:, 0].sum()) + 0.2 * _bounded(rng), 1),
        model=model,
        xi=xi,
        geometry=geometry,
        phi=phi,
        labels=tuple(specs),
        segments=tuple(spec.segment for spec in specs.values()),
        p_BM_B=draw_markers(rng, model, specs, options.scatter),
        skin=_skin(rng, specs, cues),
        hidden=tuple(planted(own) for own in options.effects),
        sole=Sole(-ANKLE_FROM_HEEL * foot, 0.5 * foot, 0.17 * foot, shape.ankle_height * height),
    )


def draw_geometry(rng: np.random.Generator, prior: GeometryPrior, scatter: float) -> Float[Tensor, " params"]:
    """Named geometric parameters; those of the left share most of their deviation with the right's."""
    bounds = [HINGE_BOUND if unit == "rad" else BOUND for unit in prior.units]
    unit = {name: _bounded(rng, bound) for name, bound in zip(prior.names, bounds, strict=True)}
    for name in prior.names:
        twin = name.replace("_l_", "_r_")
        if twin != name and twin in unit and name.endswith("_length"):
            unit[name] = SIDE_CORRELATION * unit[twin] + (1.0 - SIDE_CORRELATION**2) ** 0.5 * unit[name]
    xi = prior.mean + scatter * prior.sd * prior.mean.new_tensor([unit[name] for name in prior.names])
    angle = dict(zip(prior.names, xi.tolist(), strict=True))
    rolls = [math.cos(angle[f"subtalar_{s}_axis_y"]) * math.cos(angle[f"subtalar_{s}_axis_z"]) for s in SIDES]
    return xi if min(rolls) >= ROLL_AUTHORITY else draw_geometry(rng, prior, scatter)


def draw_inertia(rng: np.random.Generator, model: Model, scatter: float) -> Float[Tensor, "bodies 10"]:
    """Inertial parameters of all bodies, drawn again until each is a possible distribution of positive mass.

    Raises:
        ConfigError: the prior is so wide that no draw is possible.
    """
    values, vectors = torch.linalg.eigh(model.inertia.covariance)
    half = vectors * values.clamp(min=0.0).sqrt()
    for _ in range(2000):
        unit = values.new_tensor(rng.normal(size=len(values)).clip(-BOUND, BOUND))
        phi = model.inertia.mean + scatter * (half @ unit).reshape(-1, 10)
        if is_physical(phi):
            return phi
    raise ConfigError(
        "simulate.inertia", "no draw from the inertial prior is physical", remedy="Lower simulate.scatter"
    )


def draw_markers(
    rng: np.random.Generator, model: Model, specs: dict[str, MarkerSpec], scatter: float
) -> Float[Tensor, "markers 3"]:
    """True places of the markers on their segments."""
    mean, sd = marker_prior(model, specs.values())
    for k, (label, spec) in enumerate(specs.items()):
        if spec.landmark is None:
            side = label[0] if label not in FREE_PLACES else "L"
            x, y, z = FREE_PLACES.get(label) or FREE_PLACES[label[1:]]
            mean[k] = model.height * mean.new_tensor([x, y if side == "L" else -y, z])
            sd[k] = FREE_SCATTER
    unit = [[_bounded(rng) for _ in range(3)] for _ in specs]
    return mean + scatter * sd * mean.new_tensor(unit)


def is_physical(phi: Float[Tensor, "bodies 10"]) -> bool:
    """Whether every body's pseudo-inertia is positive definite (Wensing et al. 2018)."""
    return bool((torch.linalg.eigvalsh(params_to_pseudo(phi)) > 0.0).all())


def _bounded(rng: np.random.Generator, bound: float = BOUND) -> float:
    while abs(value := float(rng.normal())) > bound:
        pass
    return value


def _skin(rng: np.random.Generator, specs: dict[str, MarkerSpec], cues: int) -> Float[Tensor, "markers 3 cues"]:
    """Markers of one segment slide mostly together."""
    common = {segment: rng.normal(size=(3, cues)) for segment in sorted({s.segment for s in specs.values()})}
    rows = []
    for spec in specs.values():
        part = spec.segment[:-2] if spec.segment[-2:] in tuple(f"_{s}" for s in SIDES) else spec.segment
        own = 0.8 * common[spec.segment] + 0.6 * rng.normal(size=(3, cues))
        rows.append(SKIN_FACTOR[part] * own / np.sqrt(3.0))
    return torch.tensor(np.array(rows))
