"""Masses, centres of mass and moments of inertia of the segments before any force is seen, and how well they are known.

Means: de Leva's table (``torchid.model.de_leva``), changed for people who are no adults of medium build
(``torchid.model.build``).

Scatter: no source gives a covariance for these segments. The standard deviations are a choice, sized by how far
published tables stand apart for the same segment, which bounds what a table can say about one person: thigh mass
0.100 (Dempster 1955 in Winter 2009), 0.123 (Dumas et al. 2007, J Biomech 40:543), 0.142 (de Leva); shank 0.0465, 0.048,
0.043; foot 0.0145, 0.012, 0.014; upper arm 0.028, 0.024, 0.027; head 0.081, 0.067, 0.069; thigh centre 0.433, 0.429,
0.41 of its length. Trunk parts differ most, since no two tables cut alike.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import INERTIA_PAIRS
from torchid.errors import ConfigError
from torchid.model.build import BMI, BMI_SD, Build, build_of
from torchid.model.de_leva import Segment, segments
from torchid.model.model import Geometry, InertialPrior
from torchid.model.people import LATENT, PARTS, People
from torchid.model.proportions import stature

MASS_SD = {"head": 0.10, "thorax": 0.12, "abdomen": 0.18, "pelvis": 0.18, "upper_arm": 0.12, "forearm": 0.10,
           "hand": 0.15, "thigh": 0.12, "shank": 0.10, "foot": 0.14}  # fmt: skip
"""Of the logarithm of the mass fraction."""
COM_SD = {"head": (0.015, 0.005, 0.015), "thorax": (0.015, 0.006, 0.025), "abdomen": (0.015, 0.006, 0.020),
          "pelvis": (0.015, 0.006, 0.020), "upper_arm": (0.008, 0.008, 0.012), "forearm": (0.006, 0.006, 0.010),
          "hand": (0.006, 0.006, 0.010), "thigh": (0.012, 0.012, 0.018), "shank": (0.010, 0.008, 0.014),
          "foot": (0.012, 0.006, 0.006)}  # fmt: skip
"""Of the centre of mass in body axes, for a stature of 1.74 m [m]."""
EXTENT_SD = 0.10
"""Of the logarithm of each extent (root of the second moment per mass along a body axis)."""
PRODUCT_SD = 0.08
"""Of a product of inertia over mass and the two extents: principal axes lean by some degrees."""
SCALE_SD = 0.02
"""Of the logarithm of one length scale common to all segments."""
CUT_SD = 0.035
"""Choice. Of the heights at which pelvis, abdomen and thorax are cut, for a stature of 1.74 m [m]: at the omphalion or
at the joint L5/S1, at the xiphoid, T12/L1 or T8, as tables have it. What one part loses is the other's."""


@dataclass(frozen=True)
class Tabulated:
    """What tables say of a person: latents, and what one standard deviation of each score changes of them."""

    latent: Float[Tensor, " latents"]
    """``LATENT`` of each segment, the log scale, the total mass [kg]."""
    ways: Float[Tensor, "latents scores"]
    """Change of the latents by each score: of ``latent`` itself, then of the two cuts of the trunk."""

    def at(self, score: Float[Tensor, " scores"]) -> tuple[Float[Tensor, " params"], Float[Tensor, "params scores"]]:
        """Return the parameters of a person of given scores, and their derivative by the scores.

        Args:
            score: standard deviations away from the tables.
        """
        latent = self.latent + self.ways @ score
        jacobian = torch.autograd.functional.jacobian(_decode, latent)
        assert isinstance(jacobian, Tensor)
        return _decode(latent), jacobian @ self.ways


def inertial_prior(
    geometry: Geometry, height: float | None, mass: float | None, mass_sd: float | None, sex: str,
    age: float | None = None, people: People | None = None,
) -> InertialPrior:  # fmt: skip
    """Prior of the whole body's inertia for given joint centres; geometry may be the template's or identified.

    The covariance is that of independent latents (``LATENT`` per segment, one length scale, the total mass), carried
    through the map to (m, mc, I about the origin) by linearisation; mass fractions sum to one, so that masses
    together scatter as the total does.

    Args:
        height: [m], None for the mean of adults, or of children of a known age.
        mass: [kg], None for a body mass index of 23 (sd 4) kg/m^2, or what a child has for it.
        mass_sd: [kg], None for 1 percent of a given mass.
        sex: unknown takes the mean of both tables and adds half their difference to the scatter.
        age: [years], None where it is not known.
        people: how people like this one differ from the tables; None: as the tables have it.

    Raises:
        ConfigError: height, mass or age is no person's, or ``mass_sd`` is not positive.
    """
    tables = tables_of(geometry, height, mass, mass_sd, sex, age)
    mean, way = tables.at(tables.ways.new_zeros(tables.ways.shape[1]) if people is None else people.score)
    covariance = way @ way.T if people is None else way @ people.covariance @ way.T
    return InertialPrior(mean=mean.reshape(-1, 10), covariance=covariance)


def tables_of(
    geometry: Geometry, height: float | None, mass: float | None, mass_sd: float | None, sex: str,
    age: float | None = None,
) -> Tabulated:  # fmt: skip
    """Return what tables say of a person.

    Args:
        geometry, height, mass, mass_sd, sex, age: as for ``inertial_prior``.

    Raises:
        ConfigError: as for ``inertial_prior``.
    """
    tall, _ = stature(height, sex, age)
    build = build_of(height, mass, age)
    total, total_sd = body_mass(tall, mass, mass_sd, build.slender)
    sexes = ("male", "female") if sex == "unknown" else (sex,)
    tables = [segments(geometry, tall, own) for own in sexes]
    both = torch.stack([_encode(table) for table in tables]).to(geometry.offset)
    centre, apart = both.mean(dim=0), 0.5 * (both[0] - both[-1]).abs()
    scatter = torch.hypot(_scatter(tall, build).to(apart), apart)
    centre = _built(centre, build)
    latent = torch.cat([centre.flatten(), centre.new_tensor([0.0, total])])
    sd = torch.cat([scatter.flatten(), scatter.new_tensor([SCALE_SD, total_sd])])
    cuts = torch.stack([_cuts(geometry, tall, own) for own in sexes]).mean(0).to(latent).flatten(1)
    return Tabulated(latent, torch.cat([torch.diag(sd), torch.nn.functional.pad(cuts, (0, 2)).T], 1))


def body_mass(
    height: float, mass: float | None, mass_sd: float | None, slender: float = 1.0
) -> tuple[float, float]:  # fmt: skip
    """Total mass and its standard deviation [kg]; where no mass is given, of ``slender`` times an adult's index.

    Raises:
        ConfigError: the mass is outside 5 to 350 kg or its standard deviation is not positive.
    """
    if mass is None:
        return slender * BMI * height**2, slender * BMI_SD * height**2
    if not 5.0 <= mass <= 350.0:
        raise ConfigError(
            "subject.mass", "not the mass of a person in kg", place="mass_kg", found=f"{mass:g}", remedy="give kg"
        )
    if mass_sd is not None and not 0.0 < mass_sd <= mass:
        raise ConfigError(
            "subject.mass_sd", "needs to be positive and below the mass", place="mass_sd_kg", found=f"{mass_sd:g}",
            remedy="0.1 for a good scale, 1 for a questionnaire",
        )  # fmt: skip
    return mass, 0.01 * mass if mass_sd is None else mass_sd


def _cuts(geometry: Geometry, height: float, sex: str) -> Float[Tensor, "2 bodies 10"]:
    """Changes of the latents by a standard deviation of where each of the trunk's two cuts is."""
    sd = CUT_SD * height / 1.74
    sides = [[_encode(segments(geometry, height, sex, at)) for at in ((s, 0.0), (0.0, s))] for s in (-sd, sd)]
    return torch.stack([0.5 * (up - down) for down, up in zip(*sides, strict=True)])


def _encode(table: list[Segment]) -> Float[Tensor, "bodies 10"]:
    rows = [[math.log(s.fraction), *s.com, *(math.log(e) for e in s.extent), 0.0, 0.0, 0.0] for s in table]
    return torch.tensor(rows, dtype=torch.float64)


def _scatter(height: float, build: Build) -> Float[Tensor, "bodies 10"]:
    rows = []
    for part in PARTS:
        mass = math.hypot(MASS_SD[part], build.change(part)[1])
        com = [sd * height / 1.74 * mass / MASS_SD[part] for sd in COM_SD[part]]
        rows.append([mass, *com, *[EXTENT_SD * mass / MASS_SD[part]] * 3, *[PRODUCT_SD] * 3])
    return torch.tensor(rows, dtype=torch.float64)


def _built(latent: Float[Tensor, "bodies 10"], build: Build) -> Float[Tensor, "bodies 10"]:
    """Latents of the tables, changed for a build at constant density.

    Lengths between joints stay, so that what a segment gains of volume widens it; a head grows in all directions, its
    centre with it.
    """
    found = latent.clone()
    found[:, 0] += latent.new_tensor([build.change(part)[0] for part in PARTS])
    volume = found[:, 0].log_softmax(0) - latent[:, 0].log_softmax(0) + build.heavy
    for k, part in enumerate(PARTS):
        axes = {"head": (4, 5, 6), "foot": (5, 6)}.get(part, (4, 5))
        found[k, list(axes)] += volume[k] / len(axes)
    head = PARTS.index("head")
    found[head, 1:4] *= (volume[head] / 3.0).exp()
    return found


def _decode(latent: Float[Tensor, " latents"]) -> Float[Tensor, " params"]:
    """Ten parameters of every body, flattened, from the latents of all segments, the log scale and the total mass."""
    body, scale, total = latent[:-2].reshape(-1, LATENT), latent[-2].exp(), latent[-1]
    mass = total * torch.softmax(body[:, 0], dim=0)
    com, extent = scale * body[:, 1:4], scale * body[:, 4:7].exp()
    x, y, z = extent.unbind(dim=1)
    product = body[:, 7:10] * torch.stack([x * y, x * z, y * z], dim=1)
    second = torch.diag_embed(extent**2)
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        unit = second.new_zeros(3, 3)
        unit[i, j] = unit[j, i] = 1.0
        second = second + product[:, k, None, None] * unit
    second = second + com[:, :, None] * com[:, None, :]
    trace = second.diagonal(dim1=1, dim2=2).sum(dim=1)
    inertia = mass[:, None, None] * (trace[:, None, None] * torch.eye(3).to(second) - second)
    moments = [inertia[:, i, j] for i, j in INERTIA_PAIRS]
    return torch.stack([mass, *(mass[:, None] * com).unbind(dim=1), *moments], dim=1).flatten()
