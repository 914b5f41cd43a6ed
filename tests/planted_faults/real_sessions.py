"""The sessions of the shared recordings: whom they show, their trials, the ways of leaving one out, and what is wrong
with them as they are.

Subjects are those of the data's own manifest; what is known to be wrong was measured on the recordings as they are, by
quiet standing, markers against each other and the static trial, spectra and unloaded plates, without a body model. Of
the sets kept aside it was measured after a first look at what is named there (``docs/decisions.md``).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

CHILDREN = ("HC030A", "HC031A", "HC033A", "HC038A", "HC040A", "HC044A")
ASIDE = ("HC033A", "HC044A", "opensim_rajagopal_walk")
"""Choice. Sets that no threshold, prior or rule of the diagnosis is tuned on; they are run with ``--aside`` alone."""


@dataclass(frozen=True)
class File:
    """One trial as it lies in the data folder."""

    name: str
    markers: str
    """C3D or TRC, below the data folder."""
    forces: str | None = None
    """MOT beside a TRC."""


@dataclass(frozen=True)
class RealSession:
    """One person's recordings."""

    name: str
    subject: dict[str, object]
    """The section ``subject`` of a config."""
    markers: str
    """Marker set."""
    moving: tuple[File, ...]
    static: File | None = None
    weighs_kg: float | None = None
    """What the plates read of the person in quiet standing, else over whole contacts; None: as recorded."""
    known: tuple[tuple[str, str], ...] = ()
    """What is wrong as recorded: effect and place, ``*`` for any place. To name it is right at any time."""
    sections: dict[str, object] = field(default_factory=dict)
    """Further sections of the config."""

    @property
    def ways(self) -> tuple[str, ...]:
        """Every way of leaving a trial out: ``none``, and each moving trial where there are several."""
        return ("none", *(file.name for file in self.moving)) if len(self.moving) > 1 else ("none",)

    def roles(self, way: str) -> Iterator[tuple[File, str]]:
        """Files with their roles, the static trial first."""
        if self.static is not None:
            yield self.static, "static"
        for file in self.moving:
            yield file, "heldout" if file.name == way else "fit"


def _child(
    code: str, mass: float, height: float | None, weighs: float, numbers: tuple[str, str, str], *known: tuple[str, str]
) -> RealSession:
    subject: dict[str, object] = {"name": code, "mass_kg": mass, "mass_sd_kg": 0.5}
    static, straight, turn = (
        File(name, f"biomechzoo_pig/{code}{number}.c3d")
        for name, number in zip(("static", "straight", "turn"), numbers, strict=True)
    )
    subject |= {} if height is None else {"height_m": height}
    return RealSession(code, subject, "plug_in_gait_oxford_foot", (straight, turn), static, weighs, known)


def _opencap(name: str, trials: tuple[str, ...], weighs: float) -> RealSession:
    static, *moving = (
        File(t, f"opencap_subject4/MarkerData/{t}.trc", f"opencap_subject4/ID/{t}_grf.mot")
        for t in ("static1", *trials)
    )
    # The two groups of plates differ by 6 %, and nobody knows which is right.
    known = (("plate_gain", "*"), ("body_mass", "*"))
    subject = {"name": name, "mass_kg": 62.6, "mass_sd_kg": 1.0, "height_m": 1.68, "sex": "female"}
    return RealSession(name, subject, "opencap", tuple(moving), static, weighs, known, {"motion": {"cutoff_hz": 6.0}})


def _hamner(trial: str) -> File:
    folder = f"hamner2013_subject04/trials/{trial}"
    return File(trial, f"{folder}/markers.trc", f"{folder}/grf.mot")


SESSIONS: tuple[RealSession, ...] = (
    # The moving trials of HC030A, HC038A and HC044A hold 0.0016 to 0.0053 mm between 12 and 20 Hz, where cameras alone
    # leave 0.03 and more (``torchid.model_free.smoothness``): somebody has filtered them.
    _child("HC030A", 45.8, 1.48, 45.85, ("01", "05", "22"), ("filter_lag", "session")),
    _child("HC031A", 27.7, None, 27.70, ("01", "06", "23"), ("marker_shift", "LCPG")),
    # In the turning walk's last 90 frames the label T10 is on the marker of T6, which is missing: 123 mm from C7, not
    # 241.
    _child("HC033A", 51.5, None, 51.47, ("01", "10", "22"), ("marker_swap", "*")),
    _child("HC038A", 56.8, None, 56.79, ("01", "11", "27"), ("filter_lag", "session")),
    # The head's left and right labels are exchanged in the whole of the turning walk.
    _child("HC040A", 25.0, 1.225, 27.21, ("04", "14", "40"), ("body_mass", "session"), ("plate_gain", "*"),
           ("marker_swap", "*"), ("marker_shift", "RCPG"), ("marker_shift", "LCPG")),
    _child("HC044A", 39.4, None, 39.54, ("01", "15", "29"), ("filter_lag", "session")),
    _opencap("opencap_mixed", ("squats1", "walking1", "walkingTI1"), 62.6),
    _opencap("opencap_walks", ("walking2", "walkingTS1", "walkingTO1"), 63.5),
    RealSession(
        "hamner2013_subject04",
        {"name": "hamner", "mass_kg": 80.47, "mass_sd_kg": 1.0, "height_m": 1.772, "sex": "male"},
        "hamner2013", tuple(map(_hamner, ("run200", "run300", "run400", "run500"))), None, 81.4,
        (("marker_shift", "LTOE"),),
    ),
    RealSession(
        "opensim_rajagopal_walk",
        {"name": "rajagopal", "mass_kg": 85.07, "mass_sd_kg": 1.0, "height_m": 1.829, "sex": "male"},
        "rajagopal2016",
        (File("walk", "opensim_rajagopal_walk/markers_walk.trc", "opensim_rajagopal_walk/grf_walk.mot"),),
    ),
    RealSession(
        "opensim_gait2354", {"name": "gait2354", "mass_kg": 72.6, "mass_sd_kg": 1.0, "height_m": 1.8034, "sex": "male"},
        "gait2354",
        (File("walk1", "opensim_subject01_gait2354/subject01_walk1.trc",
              "opensim_subject01_gait2354/subject01_walk1_grf.mot"),),
        File("static", "opensim_subject01_gait2354/subject01_static.trc"), 72.9,
    ),
    # Its plates read 8 N of 457 N sideways while the subject stands still: that would move it by 80 mm in the second.
    RealSession(
        "btk_flatfoot", {"name": "btk_flatfoot", "mass_kg": 47.5, "mass_sd_kg": 1.0, "height_m": 1.505}, "plug_in_gait",
        (File("walk", "btk_c3d/PiG/PiG_Motion-FlatFoot-Full.c3d"),),
        File("static", "btk_c3d/PiG/PiG_Calibration-FlatFoot-Full.c3d"), 46.29,
        (("body_mass", "session"), ("plate_crosstalk", "*"), ("plate_pose", "*")),
    ),
    # Its third plate reads -20 N horizontally and -6 to -11 N vertically in the air.
    RealSession(
        "btk_functional", {"name": "btk_functional", "mass_kg": 60.0, "mass_sd_kg": 1.0, "height_m": 1.68},
        "plug_in_gait", (File("walk", "btk_c3d/others/FunctionalWalk.c3d"),),
        File("static", "btk_c3d/others/FunctionalStatic.c3d"), 59.63, (("plate_offset", "*"), ("plate_drift", "*")),
    ),
    RealSession(
        "schreiber_moissenet_2014001", {"name": "schreiber"}, "schreiber2019",
        (File("walk", "schreiber_moissenet_2014001/2014001_C1_01.c3d"),),
        File("static", "schreiber_moissenet_2014001/2014001_ST.c3d"), 67.0,
    ),
    # While the subject circles a leg on the second plate, the first, which nobody touches, reads 0.2 N rising to 0.7 N
    # vertically, 0.3 and 0.5 N along it, 0.6 N m about either axis.
    RealSession(
        "welk007_functional", {"name": "welk007", "mass_kg": 57.2, "mass_sd_kg": 1.0}, "opencap",
        (File("hip_circles", "welk007_functional/c3d_Trimmed_RHJC1.c3d"),),
        File("static", "welk007_functional/c3d_Trimmed_static1.c3d"), 57.13,
        (("plate_gain", "*"), ("plate_offset", "plate_1"), ("plate_drift", "plate_1")),
    ),
    # From 2.3 to 2.6 s the plates bear 203 N falling to 68 N of a child of 27 kg who walks: the left foot is off them.
    RealSession("omcs_overground", {"name": "omcs"}, "plug_in_gait",
                (File("walk", "omcs_overground/exampleOverground.c3d"),), known=(("unmeasured_contact", "foot_l"),)),
)  # fmt: skip


def of_child(code: str, trials: Iterable[tuple[str, str]], root: str | Path, **sections: object) -> dict[str, object]:
    """A config for a child's static trial and two walks by name and role, with its mass alone and more sections."""
    one = next(one for one in SESSIONS if one.name == code)
    assert one.static is not None
    files = zip((one.static, *one.moving), trials, strict=True)
    listed = [{"name": name, "role": role, "file": f"{root}/{file.markers}"} for file, (name, role) in files]
    subject = {key: one.subject[key] for key in ("name", "mass_kg", "mass_sd_kg")}
    return {"subject": subject, "markers": one.markers, "trials": listed, "out": "out"} | sections


def sessions(root: Path, aside: bool) -> dict[str, RealSession]:
    """Sessions by name whose recordings are there: those kept aside, or all others."""
    return {
        one.name: one
        for one in SESSIONS
        if (one.name in ASIDE) is aside and all((root / file.markers).is_file() for file in one.moving)
    }
