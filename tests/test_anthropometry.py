"""Inertial prior and its table: sums, symmetry, physical consistency, covariance."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from torchid.conventions import Inertial
from torchid.errors import ConfigError
from torchid.model import anthropometry as module
from torchid.model.anthropometry import body_mass, inertial_prior
from torchid.model.build import Build
from torchid.model.de_leva import DE_LEVA, segments
from torchid.model.model import Geometry
from torchid.model.skeleton import SEGMENTS
from torchid.model.whole_body import whole_body

PEOPLE = [(1.755, 77.0, "male"), (1.63, 60.0, "female"), (None, None, "unknown"), (1.2, 25.0, "unknown")]
PAIRED = [n for n in SEGMENTS if n.endswith("_l")]


def prior_of(person, mass_sd=None):
    model = whole_body(*person)
    geometry = model.geometry.geometry(model.geometry.mean)
    return inertial_prior(geometry, person[0], person[1], mass_sd, person[2]), geometry, model


def pseudo_inertia(row):
    """Sigma and first moment of one body: [[Sigma, mc], [mc', m]]."""
    m, h = row[Inertial.M], row[[Inertial.MCX, Inertial.MCY, Inertial.MCZ]]
    I = row.new_zeros(3, 3)
    for value, (i, j) in zip(row[4:], ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), strict=True):
        I[i, j] = I[j, i] = value
    J = row.new_zeros(4, 4)
    J[:3, :3] = 0.5 * I.trace() * torch.eye(3) - I
    J[:3, 3] = J[3, :3] = h
    J[3, 3] = m
    return J


@pytest.mark.parametrize("sex", ["male", "female"])
def test_fractions_of_the_table_sum_to_one(sex):
    """The mass fractions of trunk, head and both sides of the limbs make up the body."""
    limbs = ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")
    total = sum(row.mass * (2 if name in limbs else 1) for name, row in DE_LEVA[sex].items())
    assert total == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize("person", PEOPLE)
def test_masses_sum_to_the_body_and_every_body_is_physical(person):
    """Mean masses add up to the total, pseudo-inertias are positive definite, the covariance is too."""
    prior, _, _ = prior_of(person)
    mass = body_mass(person[0] or 1.69, person[1], None)[0]
    torch.testing.assert_close(prior.mean[:, 0].sum(), prior.mean.new_tensor(mass))
    for row in prior.mean:
        assert torch.linalg.eigvalsh(pseudo_inertia(row)).min() > 0
    torch.testing.assert_close(prior.covariance, prior.covariance.T)
    sd = prior.covariance.diagonal().sqrt()
    assert torch.linalg.eigvalsh(prior.covariance / sd / sd[:, None]).min() > 1e-6


@pytest.mark.parametrize("person", PEOPLE)
def test_left_and_right_are_mirror_images(person):
    """Equal masses; y of the centre and xy, yz products change sign."""
    prior, _, _ = prior_of(person)
    sign = torch.ones(10, dtype=torch.float64)
    sign[[Inertial.MCY, Inertial.IXY, Inertial.IYZ]] = -1
    for name in PAIRED:
        left, right = (prior.mean[SEGMENTS.index(n)] for n in (name, name[:-1] + "r"))
        torch.testing.assert_close(left, right * sign)


@pytest.mark.parametrize("mass_sd", [0.2, 2.0])
def test_the_total_scatters_as_the_scale_says(mass_sd):
    """Fractions sum to one: the covariance of all masses together is that of the total alone."""
    prior, _, _ = prior_of(PEOPLE[0], mass_sd)
    masses = prior.covariance[Inertial.M :: 10, Inertial.M :: 10]
    torch.testing.assert_close(masses.sum().sqrt(), masses.new_tensor(mass_sd))


@pytest.mark.parametrize("sex", ["male", "female"])
def test_trunk_keeps_mass_and_first_moment_of_the_table(sex):
    """Cutting the middle part at the upper spine joint moves no mass along the trunk."""
    person = (1.70, 65.0, sex)
    prior, geometry, model = prior_of(person)
    height = torch.tensor([0.0, geometry.offset[1, 2], geometry.offset[1, 2] + geometry.offset[2, 2]])
    trunk = prior.mean[:3]
    mass = trunk[:, Inertial.M]
    centre = (trunk[:, Inertial.MCZ] + mass * height).sum() / mass.sum()
    rows = [DE_LEVA[sex][f"{part}_trunk"] for part in ("lower", "middle", "upper")]
    total = sum(row.mass for row in rows)
    assert float(mass.sum()) / 65.0 == pytest.approx(total, abs=1e-4)
    starts = np.cumsum([0.0] + [row.length for row in rows])
    expected = sum(
        row.mass * (start + (1 - row.com) * row.length) for row, start in zip(rows, starts[:-1], strict=True)
    )
    stretch = float(height[2] + geometry.offset[3, 2]) / starts[-1]
    assert float(centre) == pytest.approx(expected / total * stretch, rel=1e-6)


@pytest.mark.parametrize("cuts", [(-0.03, 0.02), (0.03, 0.03)])
def test_wherever_the_trunk_is_cut_it_is_the_same(cuts):
    """Mass and first moment of the whole trunk stay; what one part gains its neighbours lose."""
    _, geometry, _ = prior_of(PEOPLE[0])
    height = torch.tensor([0.0, geometry.offset[1, 2], geometry.offset[1, 2] + geometry.offset[2, 2]]).double()

    def trunk(at: tuple[float, float]) -> tuple[torch.Tensor, torch.Tensor]:
        parts = segments(geometry, PEOPLE[0][0], "male", at)[:3]
        mass = torch.tensor([part.fraction for part in parts]).double()
        return mass, mass * (torch.tensor([part.com[2] for part in parts]).double() + height)

    (usual, first), (mass, moment) = trunk((0.0, 0.0)), trunk(cuts)
    torch.testing.assert_close(mass.sum(), usual.sum())
    torch.testing.assert_close(moment.sum(), first.sum())
    assert (mass[0] > usual[0]) == (cuts[0] > 0.0) and mass[2] < usual[2]


@pytest.mark.parametrize("lower", [0.12, 0.16])
def test_joints_where_nobody_has_them_still_have_a_prior(lower):
    """A thorax whose joint is at the height of the navel, as exchanged labels make it."""
    _, geometry, _ = prior_of(PEOPLE[0])
    offset = geometry.offset.clone()
    offset[2, 2] -= lower
    offset[3, 2] += lower
    person = PEOPLE[0]
    prior = inertial_prior(replace(geometry, offset=offset), person[0], person[1], None, person[2])
    assert bool(torch.isfinite(prior.covariance).all()) and bool((prior.mean[:, Inertial.M] > 0.0).all())


def test_tables_that_cut_elsewhere_are_within_the_scatter():
    """Pelvis and abdomen scatter against each other by more than each table says of its own part."""
    prior, _, _ = prior_of(PEOPLE[0])
    masses = prior.covariance[Inertial.M :: 10, Inertial.M :: 10][:3, :3]
    sd = masses.diagonal().sqrt()
    assert float(masses[0, 1] / sd[0] / sd[1]) < -0.3 and float(masses[1, 2] / sd[1] / sd[2]) < -0.3
    assert float(sd[1] / prior.mean[1, Inertial.M]) > 1.5 * module.MASS_SD["abdomen"]


@pytest.mark.parametrize("person", PEOPLE[:2])
def test_centre_of_mass_of_the_standing_body_is_where_people_have_it(person):
    """Between 0.54 and 0.58 of stature, within 3 cm of the hips fore and aft, in the middle."""
    prior, geometry, model = prior_of(person)
    origin = torch.zeros(len(SEGMENTS), 3, dtype=torch.float64)
    origin[0, 2] = model.tree.dofs[2].rest
    for k, body in enumerate(model.tree.bodies[1:], start=1):
        origin[k] = origin[body.parent] + geometry.offset[k]
    centre = (prior.mean[:, 1:4] + prior.mean[:, :1] * origin).sum(dim=0) / prior.mean[:, 0].sum()
    assert 0.54 < float(centre[2]) / model.height < 0.58
    assert abs(float(centre[0])) < 0.03 and abs(float(centre[1])) < 1e-9


def test_a_longer_segment_carries_its_centre_and_inertia_with_it():
    """After identification of a longer thigh its centre moves down in proportion, and no other limb changes."""
    person = PEOPLE[0]
    before, geometry, _ = prior_of(person)
    offset = geometry.offset.clone()
    offset[SEGMENTS.index("shank_l"), 2] *= 1.1
    after = inertial_prior(Geometry(offset, geometry.hinge), person[0], person[1], None, person[2])
    k = SEGMENTS.index("thigh_l")
    torch.testing.assert_close(after.mean[k, Inertial.MCZ], 1.1 * before.mean[k, Inertial.MCZ])
    assert after.mean[k, Inertial.IXX] > 1.15 * before.mean[k, Inertial.IXX]
    rest = [j for j in range(len(SEGMENTS)) if j != k]
    torch.testing.assert_close(after.mean[rest], before.mean[rest])


def test_linearised_covariance_matches_sampling(seed):
    """Scatter of mass, centre and inertia sampled through the exact map agrees with the linearised one."""
    person = PEOPLE[0]
    prior, geometry, model = prior_of(person)
    rng = np.random.default_rng(seed)
    centre = module._encode(segments(geometry, person[0], "male"))
    sd = module._scatter(person[0], Build())
    draws = torch.stack(
        [
            module._decode(
                torch.cat(
                    [
                        (centre + sd * torch.tensor(rng.normal(size=sd.shape))).flatten(),
                        torch.tensor([module.SCALE_SD * rng.normal(), 77.0 + 0.77 * rng.normal()], dtype=torch.float64),
                    ]
                )
            )
            for _ in range(3000)
        ]
    )
    ratio = draws.std(dim=0) / prior.covariance.diagonal().sqrt()
    thigh = SEGMENTS.index("thigh_l") * 10
    rows = [thigh + k for k in (Inertial.M, Inertial.MCX, Inertial.MCY, Inertial.MCZ, Inertial.IXX, Inertial.IYY)]
    np.testing.assert_allclose(ratio[rows].numpy(), 1.0, atol=0.12)


def test_unknown_sex_is_between_the_tables_and_wider():
    """The mean of the shanks' share lies between both sexes', and its scatter is wider than either."""
    share, wide = {}, {}
    for sex in ("male", "female", "unknown"):
        prior, _, _ = prior_of((1.70, 65.0, sex))
        k = 10 * SEGMENTS.index("thigh_l")
        share[sex] = float(prior.mean[SEGMENTS.index("shank_l"), 0])
        wide[sex] = float(prior.covariance[k + Inertial.MCZ, k + Inertial.MCZ]) ** 0.5
    assert share["male"] < share["unknown"] < share["female"]
    assert wide["unknown"] > max(wide["male"], wide["female"])


@pytest.mark.parametrize(
    ("mass", "mass_sd", "key"),
    [
        (1.0, None, "mass"),
        (float("nan"), None, "mass"),
        (70.0, 0.0, "mass_sd"),
        (70.0, -1.0, "mass_sd"),
        (70.0, 80.0, "mass_sd"),
        (70.0, float("nan"), "mass_sd"),
    ],
)
def test_impossible_masses_are_refused(mass, mass_sd, key):
    """Masses and scatters that no person has raise a ConfigError that names the key and what it holds."""
    with pytest.raises(ConfigError) as caught:
        body_mass(1.75, mass, mass_sd)
    error = caught.value
    assert (error.code, error.place) == {
        "mass": ("subject.mass", "mass_kg"),
        "mass_sd": ("subject.mass_sd", "mass_sd_kg"),
    }[key]
    assert error.found == f"{mass if key == 'mass' else mass_sd:g}" and error.remedy
