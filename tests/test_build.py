"""Builds: adults of medium build keep the tables, all others are changed without a jump and as published."""

import math

import numpy as np
import pytest
import torch

from torchid.errors import ConfigError
from torchid.model import anthropometry
from torchid.model.anthropometry import MASS_SD, PARTS, inertial_prior
from torchid.model.build import AGEING, BMI, CHANGES, CHILD_M, GROWN, OBESE, THIN, YOUNGEST, Build, build_of
from torchid.model.de_leva import segments
from torchid.model.proportions import SEXES, stature
from torchid.model.skeleton import SEGMENTS
from torchid.model.whole_body import whole_body

LIMBS = ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")
JENSEN = (7.0, 44.6, 3.6, 1.9, 0.9, 11.4, 4.8, 1.7)
AE = {"unknown": (7.2, 47.3, 2.65, 1.55, 0.6, 11.65, 5.2, 1.1), "male": (6.9, 48.9, 2.7, 1.6, 0.6, 11.0, 5.1, 1.1),
      "female": (7.5, 45.7, 2.6, 1.5, 0.6, 12.3, 5.3, 1.1)}  # fmt: skip
DE_LEVA = {"male": (6.94, 43.46, 2.71, 1.62, 0.61, 14.16, 4.33, 1.37),
           "female": (6.68, 42.57, 2.55, 1.38, 0.56, 14.78, 4.81, 1.29)}  # fmt: skip
PUBLISHED = {
    "Jensen 1989, 6 years": (6.0, (18.2, 43.0, 2.4, 1.3, 0.8, 8.5, 4.6, 1.9), JENSEN),
    "Jensen 1986, 12 years": (12.0, (10.1, 41.7, 3.2, 1.7, 0.9, 11.0, 5.3, 2.1), JENSEN),
    "Jensen 1986, 15 years": (15.0, (6.7, 41.6, 3.5, 1.7, 0.8, 12.1, 5.6, 2.1), JENSEN),
    "Yokoi et al. 1986, 3-5 years": (4.0, (16.4, 47.3, 2.4, 1.5, 0.7, 8.0, 3.9, 1.7), AE["unknown"]),
    "Yokoi et al. 1986, 6-8 years": (7.0, (14.0, 45.0, 2.4, 1.4, 0.9, 9.5, 4.2, 2.0), AE["unknown"]),
    "Jensen & Fletcher 1994, men": (70.0, (6.9, 51.5, 3.2, 1.8, 0.7, 9.5, 4.3, 1.4), JENSEN),
    "Okada et al. 1996, men": (70.0, (9.1, 49.7, 2.5, 1.7, 0.8, 9.2, 4.7, 1.7), AE["male"]),
    "Okada et al. 1996, women": (70.0, (8.8, 49.3, 2.5, 1.6, 0.6, 9.8, 4.8, 1.5), AE["female"]),
    "Pavol et al. 2002, men": (70.0, (6.62, 48.71, 2.99, 1.75, 0.65, 11.27, 4.41, 1.27), DE_LEVA["male"]),
    "Pavol et al. 2002, women": (70.0, (7.39, 47.86, 3.01, 1.41, 0.54, 11.62, 4.56, 1.23), DE_LEVA["female"]),
    # Of which ``CHANGES`` took nothing.
    "Jensen & Fletcher 1994, women": (70.0, (7.4, 46.2, 3.2, 1.1, 0.5, 12.8, 4.4, 1.2), DE_LEVA["female"]),
}
"""Age; shares of the body's mass in percent: head with neck, whole trunk, limbs of one side; those of grown, young
people that they are taken over (Jensen 1989 at 18 years, Ae et al. 1992, de Leva 1996)."""
REGRESSED = {
    "head": (1.296, 0.0171, 0.0143), "upper_arm": (0.25, 0.03012, -0.0027), "forearm": (0.3185, 0.01445, -0.00114),
    "hand": (-0.1165, 0.0036, 0.00175), "thigh": (-2.649, 0.1463, 0.0137), "shank": (-1.592, 0.0362, 0.0121),
    "foot": (-0.829, 0.0077, 0.0073), "upper": (8.2144, 0.1862, -0.0584), "middle": (7.181, 0.2234, -0.0663),
    "lower": (-7.498, 0.0976, 0.04896),
}  # fmt: skip
"""Zatsiorsky & Seluyanov 1983: mass of a segment [kg] = a + b mass [kg] + c stature [cm]; the trunk in three parts."""


def mean_of(model):
    return dict(zip(SEGMENTS, (model.inertia.mean[:, 0] / model.inertia.mean[:, 0].sum()).tolist(), strict=True))


def test_adults_of_medium_build_keep_the_tables(seed):
    """Shares, centres and scatter are those of de Leva's table and of the constants, to 1e-12."""
    rng = np.random.default_rng(seed)
    for _ in range(5):
        age = None if rng.random() < 0.5 else rng.uniform(GROWN, AGEING[0])
        height = rng.uniform(CHILD_M[1] if age is None else 1.3, 2.1)
        mass, sex = rng.uniform(THIN, OBESE) * height**2, SEXES[rng.integers(2)]
        assert build_of(height, mass, age) == Build()
        model = whole_body(height, mass, sex, age=age)
        table = segments(model.geometry.geometry(model.geometry.mean), height, sex)
        found = model.inertia.mean
        expected = torch.tensor([mass * s.fraction for s in table], dtype=torch.float64)
        torch.testing.assert_close(found[:, 0], expected, rtol=1e-12, atol=0.0)
        centres = torch.tensor([s.com for s in table], dtype=torch.float64)
        torch.testing.assert_close(found[:, 1:4] / found[:, :1], centres, rtol=1e-12, atol=1e-14)
        scatter = anthropometry._scatter(height, build_of(height, mass, age))[:, 0]
        assert scatter.tolist() == [MASS_SD[part] for part in PARTS]
        assert not model.build


@pytest.mark.parametrize("part", CHANGES)
def test_nothing_jumps(part):
    """Along age, stature and mass the change of a share and its scatter are continuous, at every bound of theirs."""
    step = 1e-7
    along = {
        "age": (lambda x: (1.6, 60.0, x), (YOUNGEST, 6.0, GROWN, *AGEING)),
        "stature": (lambda x: (x, None, None), (1.015, 1.15, 1.277, 1.383, *CHILD_M)),
        "mass": (lambda x: (1.0, x, 30.0), (THIN**2 / BMI, THIN, BMI, OBESE, OBESE**2 / BMI)),
    }
    for person, bounds in along.values():
        for bound in bounds:
            below, above = (build_of(*person(bound + s)).change(part) for s in (-step, step))
            # The scatter of who may be a child begins as a root.
            assert below == pytest.approx(above, abs=1e-2), (part, bound)


@pytest.mark.parametrize("source", PUBLISHED)
def test_published_changes_are_within_the_scatter(source):
    """Of each limb's and the head's logarithm within 2.5 standard deviations, of the whole trunk's within 0.1."""
    age, percent, young = PUBLISHED[source]
    share, grown = (mean_of(whole_body(None, None, age=years)) for years in (age, None))
    trunk = ("pelvis", "abdomen", "thorax")
    published = [math.log(a / b) for a, b in zip(percent, young, strict=True)]
    whole = sum(share[part] for part in trunk) / sum(grown[part] for part in trunk)
    assert math.log(whole) == pytest.approx(published.pop(1), abs=0.1)
    for part, expected in zip(("head", *LIMBS), published, strict=True):
        name = part if part == "head" else f"{part}_l"
        sd = math.hypot(MASS_SD[part], build_of(None, None, age).change(part)[1])
        assert abs(math.log(share[name] / grown[name]) - expected) < 2.5 * sd, part


def test_heavy_people_are_as_regressed():
    """The slopes of shares against mass at one stature are those of the regressions at their mean."""
    mass, stature_cm = 73.0, 174.1
    slope = {name: b * mass / (a + b * mass + c * stature_cm) - 1.0 for name, (a, b, c) in REGRESSED.items()}
    names = {"abdomen": "middle", "pelvis": "lower"}
    for part in CHANGES:
        if part == "thorax":  # the upper part and a piece of the middle one
            assert slope["upper"] < CHANGES[part][2][0] < slope["middle"]
        else:
            assert CHANGES[part][2][0] == pytest.approx(slope[names.get(part, part)], abs=0.006), part


def test_a_known_age_tells_more_than_a_stature():
    """Both shift a child's head to more than twice an adult's share; the stature leaves more scatter."""
    grown = mean_of(whole_body(1.75, 70.0))["head"]
    told, known = whole_body(1.2, 23.0), whole_body(1.2, 23.0, age=6.8)
    assert mean_of(told)["head"] > 2.0 * grown and mean_of(known)["head"] > 2.0 * grown
    narrow, wide = build_of(1.2, 23.0, 6.8).change("head")[1], build_of(1.2, 23.0, None).change("head")[1]
    assert 0.0 < narrow < wide
    # A small adult is no child where the age says so.
    assert whole_body(1.35, 40.0, age=30.0).build == ()


def test_a_stature_near_an_adults_leaves_open_what_it_is():
    """Between the bounds the scatter covers a child and an adult alike."""
    build = build_of(1.45, None, None)
    years = GROWN - 11.0
    assert abs(build.growing - years) < 1.5 * build.growing_sd and build.growing < 1.5 * build.growing_sd


@pytest.mark.parametrize("index", [42.0, 55.0])
def test_very_heavy_segments_are_as_dense_as_medium_ones(index):
    """Mass over the product of extents is that of a medium build: fat widens, it does not condense."""
    dense = []
    for mass in (BMI * 1.75**2, index * 1.75**2):
        model = whole_body(1.75, mass, "male")
        table = segments(model.geometry.geometry(model.geometry.mean), 1.75, "male")
        latent = anthropometry._built(anthropometry._encode(table), build_of(1.75, mass, None))
        dense.append(mass * latent[:, 0].softmax(0) / latent[:, 4:7].sum(dim=1).exp())
    torch.testing.assert_close(dense[0], dense[1])


def test_unknown_statures_and_masses_are_those_of_the_age():
    """A child of seven has 1.21 m and 22 kg within a tenth (CDC 2000), and an adult's where the age is unknown."""
    model = whole_body(None, None, age=7.0)
    assert model.height == pytest.approx(1.21, rel=0.1)
    assert float(model.inertia.mean[:, 0].sum()) == pytest.approx(22.9, rel=0.1)
    assert stature(None, "male", GROWN) == stature(None, "male")


def test_the_total_mass_is_that_of_the_scale_for_every_build():
    """Total and scatter of the total are as given, whatever the shares are."""
    for height, mass, age in ((1.1, 19.0, 5.0), (1.45, 40.0, None), (1.7, 130.0, None), (1.6, 50.0, 80.0)):
        model = whole_body(height, mass, age=age, mass_sd=0.5)
        torch.testing.assert_close(model.inertia.mean[:, 0].sum(), torch.tensor(mass, dtype=torch.float64))
        block = model.inertia.covariance[::10, ::10]
        torch.testing.assert_close(block.sum().sqrt(), torch.tensor(0.5, dtype=torch.float64))


def test_what_was_changed_is_said_with_its_source():
    """A child, a person between child and adult, an old one and a heavy one."""
    said = {
        (1.2, 23.0, 7.0): "a child of 7 years (Jensen", (1.2, 23.0, None): "about 7 years, as the stature tells",
        (1.46, 40.0, None): "a child or a small adult", (1.7, 70.0, 72.0): "for 72 years (Jensen & Fletcher 1994",
        (1.74, 103.0, None): "body mass index of 34 (Zatsiorsky",
        (0.8, 11.0, 2.0): "a child of 2 years, taken for 4 years",
    }  # fmt: skip
    for (height, mass, age), words in said.items():
        model = whole_body(height, mass, age=age)
        (line,) = model.build
        assert words in line and line in model.sources[-1]
    assert any("mean at 2 years, taken for 4 years" in line for line in whole_body(None, None, age=2.0).sources)


@pytest.mark.parametrize("age", [0.0, -3.0, 120.0, float("nan")])
def test_impossible_ages_are_refused(age):
    """With the key and what it holds."""
    model = whole_body(1.7, 70.0)
    with pytest.raises(ConfigError) as caught:
        inertial_prior(model.geometry.geometry(model.geometry.mean), 1.7, 70.0, None, "male", age)
    assert (caught.value.code, caught.value.place) == ("subject.age", "age_years") and caught.value.remedy
