"""How the build of a person differs from that of the adults in the tables, by age, stature and body mass index.

Three numbers describe a build: years until grown up, how far age has changed it, and the logarithm of its heaviness. An
adult of medium build has zeros, and de Leva's table as it is. For all others ``CHANGES`` shifts the logarithms of mass
fractions in proportion to these numbers, and widens them by how far sources stand apart. A published fraction is taken
over that of grown, young adults of the same laboratory, since no two laboratories cut a body alike:

- children: Jensen 1989 (J Biomech 22:529) at 6 and 18 years, Jensen 1986 (J Biomech 19:359) at 12 and 15 years, boys;
  Yokoi et al. 1986 (Jpn J Phys Educ 31:53) at 3-5 and 6-8 years, both sexes, over Ae et al. 1992 (Biomechanisms 11:23);
- elderly: Jensen & Fletcher 1994 (J Biomech 27:89), men, over Jensen 1989; Okada et al. 1996 (Biomechanisms 13:125),
  over Ae et al.; Pavol et al. 2002 (J Biomech 35:707), over de Leva;
- heavy and light people: Zatsiorsky & Seluyanov 1983 (Biomechanics VIII-B:1152), masses of segments regressed on mass
  and stature of the 100 men of de Leva's table. That the trunk's share grows with the index and those of limbs fall is
  also seen by Wang et al. 2007 (Obesity 15:2688) and Chambers et al. 2010 (Clin Biomech 25:131).
"""

import math
from dataclasses import dataclass

import numpy as np

from torchid.errors import ConfigError
from torchid.wording import number

GROWN = 18.0
"""Age from which on adults' tables are taken at their word [years]: of Jensen's oldest boys."""
YOUNGEST = 4.0
"""Age of the youngest in the tables [years]; younger children are taken for so old."""
AGEING = (50.0, 70.0)
"""Ages from which on a person differs from young adults, and as much as the elderly of the tables do, who were 61 to 86
[years]; chosen."""
BMI, BMI_SD = 23.0, 4.0
"""Body mass index of adults where the mass is not given [kg/m^2]."""
THIN, OBESE = 17.0, 30.0
"""Body mass indices of adults beyond which the build is not medium [kg/m^2]: WHO's moderate thinness and obesity."""
CATCH_UP = 2.0
"""How many times faster than the index heaviness grows beyond these bounds, until it is the index over ``BMI``; chosen,
so that nothing jumps at them."""

CHILD_M = (1.40, 1.50)
"""Statures below which a person of unknown age is a child, and from which on an adult [m]; chosen: half of all
children of eleven, and one woman in forty, lie between."""
AGE_SD = 1.0
"""Standard deviation of the age of a child of known stature [years]: stature scatters by 4 to 5 %, and they grow
by 5 to 7 cm a year (CDC 2000)."""
YEARS_LEFT = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0)
"""Years until ``GROWN`` of the medians below."""
MEDIAN_M = (1.696, 1.680, 1.621, 1.501, 1.383, 1.277, 1.150, 1.015)
"""Median stature, the mean of both sexes [m] (CDC 2000)."""
MEDIAN_BMI = (21.87, 20.53, 19.13, 17.79, 16.63, 15.77, 15.38, 15.64)
"""Median body mass index of boys [kg/m^2] (CDC 2000)."""

CHANGES: dict[str, tuple[tuple[float, float], tuple[float, float], tuple[float, float]]] = {
    "head": ((0.064, 0.014), (0.10, 0.13), (-0.75, 0.25)),
    "thorax": ((-0.003, 0.010), (0.09, 0.05), (0.23, 0.25)),
    "abdomen": ((-0.003, 0.010), (0.09, 0.05), (0.37, 0.25)),
    "pelvis": ((-0.003, 0.010), (0.09, 0.05), (-0.13, 0.25)),
    "upper_arm": ((-0.016, 0.012), (0.01, 0.12), (0.11, 0.25)),
    "forearm": ((-0.014, 0.013), (0.03, 0.05), (-0.10, 0.25)),
    "hand": ((0.010, 0.018), (0.01, 0.19), (-0.42, 0.25)),
    "thigh": ((-0.022, 0.008), (-0.21, 0.05), (0.03, 0.25)),
    "shank": ((-0.012, 0.014), (-0.07, 0.05), (-0.16, 0.25)),
    "foot": ((0.031, 0.017), (0.09, 0.27), (-0.44, 0.25)),
}
"""Change of the logarithm of a mass fraction, and its standard deviation: for a year until grown up, for an old person,
for a heaviness of one.

The first two are the line through zero, or the mean, of the ratios in the sources above, and what these scatter by
about it, at least 0.05 for the old. None of them splits the trunk as it is split here, so that its parts share a
mean; 0.010 for a year is chosen. The third is the slope at a mass of 73 kg. Its scatter is chosen: at an index of 40
the mass beyond a medium one is 0.43 of the body, and a thigh that holds 8 or 18 % of that has 15 % more or less of
its share."""


@dataclass(frozen=True)
class Build:
    """How a person differs from adults of medium build; zeros are one of these."""

    growing: float = 0.0
    """Years until grown up."""
    growing_sd: float = 0.0
    ageing: float = 0.0
    """From 0, not yet old, to 1."""
    heavy: float = 0.0
    """Logarithm of the heaviness over that of a medium build."""
    said: tuple[str, ...] = ()
    """What the tables were changed for, with sources; empty for an adult of medium build."""

    def change(self, part: str) -> tuple[float, float]:
        """Change of the logarithm of a segment's mass fraction, and its standard deviation."""
        (year, year_sd), (old, old_sd), (fat, fat_sd) = CHANGES[part]
        mean = self.growing * year + self.ageing * old + self.heavy * fat
        apart = (self.growing * year_sd, self.growing_sd * year, self.ageing * old_sd, self.heavy * fat_sd)
        return mean, math.hypot(*apart)

    @property
    def stature(self) -> float:
        """Median stature at this age over that of adults."""
        return float(np.interp(self.growing, YEARS_LEFT, MEDIAN_M)) / MEDIAN_M[0]

    @property
    def slender(self) -> float:
        """Median body mass index at this age over that of adults."""
        return float(np.interp(self.growing, YEARS_LEFT, MEDIAN_BMI)) / MEDIAN_BMI[0]


def build_of(height: float | None, mass: float | None, age: float | None) -> Build:
    """The build of a person of whom all, some or nothing is known.

    Args:
        height: [m]; None: medium at any mass, and grown up unless an age says otherwise.
        mass: [kg]; None: medium.
        age: [years]; None: told from the stature where no adult is so small.

    Raises:
        ConfigError: the age is not between 0 and 120 years.
    """
    if age is not None and not 0.0 < age < 120.0:
        raise ConfigError(
            "subject.age", "not the age of a person in years", place="age_years", found=f"{age:g}",
            remedy="give years, or leave it out",
        )  # fmt: skip
    aged, own_sd = _growing(height, age)
    old = 0.0 if age is None else min(max((age - AGEING[0]) / (AGEING[1] - AGEING[0]), 0.0), 1.0)
    build = Build(aged, own_sd, old)
    # A mass that is nobody's is refused by ``body_mass``.
    index = None if height is None or mass is None or not mass > 0.0 else mass / height**2
    heavy = 0.0 if index is None else _heaviness(index / build.slender)
    return Build(aged, own_sd, old, heavy, tuple(_said(build, age, index if heavy else None)))


def _growing(height: float | None, age: float | None) -> tuple[float, float]:
    """Years until grown up and their standard deviation.

    A person of unknown age between the statures of ``CHILD_M`` is a child or an adult: the mean and scatter of both.
    """
    if age is not None:
        return min(max(GROWN - age, 0.0), GROWN - YOUNGEST), 0.0
    if height is None or height >= CHILD_M[1]:
        return 0.0, 0.0
    child = min((CHILD_M[1] - height) / (CHILD_M[1] - CHILD_M[0]), 1.0)
    years = float(np.interp(height, MEDIAN_M[::-1], YEARS_LEFT[::-1]))
    return child * years, math.sqrt(child * AGE_SD**2 + child * (1.0 - child) * years**2)


def _heaviness(index: float) -> float:
    """Logarithm of the heaviness of a body mass index, zero between ``THIN`` and ``OBESE``."""
    whole, beyond = math.log(index / BMI), CATCH_UP * math.log(index / (OBESE if index > BMI else THIN))
    return max(min(whole, beyond), 0.0) if index > BMI else min(max(whole, beyond), 0.0)


def age_said(age: float) -> str:
    """An age in words, with the one for which it is taken where that is another."""
    return f"{age:g} years" + (f", taken for {YOUNGEST:g} years" if age < YOUNGEST else "")


def _said(build: Build, age: float | None, index: float | None) -> list[str]:
    """What the tables were changed for."""
    lines = []
    if build.growing > 0.0:
        about = f"about {number(GROWN - build.growing, 0)} years, as the stature tells"
        child = f"a child of {about if age is None else age_said(age)}"
        child = child if build.growing_sd <= AGE_SD else "a child or a small adult, which the stature does not tell"
        lines.append(f"shifted and wider for {child} (Jensen 1986, 1989; Yokoi et al. 1986)")
    if build.ageing > 0.0:
        lines.append(
            f"shifted and wider for {age:g} years (Jensen & Fletcher 1994; Okada et al. 1996; Pavol et al. 2002)"
        )
    if index is not None:
        lines.append(f"shifted and wider for a body mass index of {number(index, 0)} (Zatsiorsky & Seluyanov 1983)")
    return lines
