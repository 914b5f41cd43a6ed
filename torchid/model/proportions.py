"""Proportions of the standing body as fractions of stature: joint centres, and how much they scatter between people.

Arm lengths follow de Leva 1996 (J Biomech 29:1223, Table 4, mean statures 1.741 m and 1.735 m). Legs: de Leva's thigh
and shank (male 0.243 and 0.253) with an ankle at 0.042 would put the hip at 0.538, his female thigh (0.212) at 0.507;
iliospinale height (0.56, Gordon et al. 2014, ANSUR II) less the hip's depth below it, and the functional hip centres of
one public recording (0.515), put it at 0.52 for both sexes, so thigh and shank are 0.236 and 0.2435. Foot length:
ANSUR II. Hip centres: Harrington et al. 2007 (J Biomech 40:595) at mean pelvic width and depth. Sacral endplate against
the hip axis: Legaye et al. 1998 and Vaz et al. 2002 (Eur Spine J): pelvic tilt about 12 degrees, 11 cm. Lumbar and
thoracic heights share what remains up to the cervicale (0.86, ANSUR II) as the vertebral and disc heights of Panjabi et
al. 1991-92 (Spine). Scatter of a length at given stature is 4-5 percent (ANSUR II: residual of limb lengths after
regression on stature); positions across the body scatter by 5-20 mm, a choice by the anatomical scatter in these
sources.
"""

from dataclasses import dataclass, fields

from torchid.errors import ConfigError
from torchid.model.build import build_of

SEXES = ("male", "female", "unknown")
STATURE = {"male": (1.755, 0.07), "female": (1.63, 0.065), "unknown": (1.69, 0.095)}
"""Mean and standard deviation of adults' stature [m] (ANSUR II), used when the height is not given."""


@dataclass(frozen=True)
class Proportions:
    """Fractions of stature; x forward, y outward from the midline, z up, each from the parent's joint centre."""

    pelvis_width: float
    """Between the hip centres."""
    lower_spine_x: float
    lower_spine_z: float
    upper_spine_x: float
    upper_spine_z: float
    neck_x: float
    neck_z: float
    shoulder_x: float
    shoulder_y: float
    shoulder_z: float
    upper_arm_length: float
    forearm_length: float
    thigh_length: float
    shank_length: float
    ankle_height: float
    """Ankle joint centre above the sole."""
    foot_length: float
    """Heel to tip of the longest toe."""
    asis_width: float
    asis_x: float
    asis_z: float
    """Of the bony points, from the midpoint of the hip centres."""

    @property
    def hip_height(self) -> float:
        """Hip centre above the sole."""
        return self.thigh_length + self.shank_length + self.ankle_height


MALE = Proportions(
    pelvis_width=0.101,
    lower_spine_x=-0.015,
    lower_spine_z=0.066,
    upper_spine_x=-0.008,
    upper_spine_z=0.110,
    neck_x=0.005,
    neck_z=0.163,
    shoulder_x=0.017,
    shoulder_y=0.1025,
    shoulder_z=0.100,
    upper_arm_length=0.1618,
    forearm_length=0.1545,
    thigh_length=0.2360,
    shank_length=0.2435,
    ankle_height=0.0420,
    foot_length=0.152,
    asis_width=0.136,
    asis_x=0.0345,
    asis_z=0.0415,
)
FEMALE = Proportions(
    pelvis_width=0.108,
    lower_spine_x=-0.015,
    lower_spine_z=0.067,
    upper_spine_x=-0.008,
    upper_spine_z=0.111,
    neck_x=0.005,
    neck_z=0.160,
    shoulder_x=0.017,
    shoulder_y=0.0975,
    shoulder_z=0.098,
    upper_arm_length=0.1586,
    forearm_length=0.1523,
    thigh_length=0.2360,
    shank_length=0.2430,
    ankle_height=0.0415,
    foot_length=0.150,
    asis_width=0.147,
    asis_x=0.0355,
    asis_z=0.0430,
)


def proportions(sex: str) -> Proportions:
    """Proportions of one sex; unknown: the mean of both.

    Raises:
        ConfigError: ``sex`` is none of male, female, unknown.
    """
    check_sex(sex)
    if sex == "unknown":
        names = [f.name for f in fields(Proportions)]
        return Proportions(**{n: 0.5 * (getattr(MALE, n) + getattr(FEMALE, n)) for n in names})
    return MALE if sex == "male" else FEMALE


def check_sex(sex: str) -> None:
    """Refuse a sex for which no table exists."""
    if sex not in SEXES:
        raise ConfigError(
            "subject.sex", "no body table for this sex", place="sex", found=repr(sex), remedy=f"use {', '.join(SEXES)}"
        )


def stature(height: float | None, sex: str, age: float | None = None) -> tuple[float, float]:
    """Height and its standard deviation [m]: as given (to 1 cm), or what people of that sex and age have.

    Raises:
        ConfigError: ``height`` is not between 0.5 and 2.5 m.
    """
    check_sex(sex)
    if height is None:
        mean, sd = STATURE[sex]
        return mean * build_of(None, None, age).stature, sd
    if not 0.5 <= height <= 2.5:
        raise ConfigError(
            "subject.height", "not the height of a person in metres", place="height_m", found=f"{height:g}",
            remedy="give metres",
        )  # fmt: skip
    return height, 0.01
