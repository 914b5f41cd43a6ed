"""Marker sets: files, matching of labels, priors of the markers' places."""

import os
from pathlib import Path

import ezc3d
import numpy as np
import pytest
import torch

from torchid.errors import ConfigError
from torchid.io.labels import named_outputs
from torchid.model.landmarks import LANDMARKS
from torchid.model.marker_set import MarkerSet, MarkerSpec, load_marker_set, marker_prior, marker_sets
from torchid.model.skeleton import SEGMENTS
from torchid.model.whole_body import whole_body

DATA = Path(os.environ.get("TORCHID_DATA", Path(__file__).parents[1] / ".." / "shared" / "data"))
FILES = [
    ("opencap", "opencap_subject4/MarkerData/static1.trc", ()),
    ("opencap", "opencap_subject4/MarkerData/walking1.trc", ()),
    ("opencap", "welk007_functional/c3d_Trimmed_static1.c3d", ()),
    ("opencap", "welk007_functional/c3d_Trimmed_RHJC1.c3d", ()),
    ("hamner2013", "hamner2013_subject04/trials/run200/markers.trc", ()),
    ("gait2354", "opensim_subject01_gait2354/subject01_static.trc", ()),
    ("gait2354", "opensim_subject01_gait2354/subject01_walk1.trc", ()),
    ("rajagopal2016", "opensim_rajagopal_walk/markers_walk.trc", ()),
    ("arnold2013", "arnold2013_synthetic_truth/subject01/trials/walk2/markers.trc", ()),
    ("plug_in_gait_oxford_foot", "biomechzoo_pig/HC030A01.c3d", ()),
    ("plug_in_gait_oxford_foot", "biomechzoo_pig/HC030A05.c3d", ()),
    ("plug_in_gait_oxford_foot", "biomechzoo_pig/HC040A14.c3d", ()),
    ("schreiber2019", "schreiber_moissenet_2014001/2014001_C1_01.c3d", ()),
    ("plug_in_gait", "btk_c3d/PiG/PiG_Calibration-FlatFoot-Full.c3d", ()),
    ("plug_in_gait", "btk_c3d/others/FunctionalWalk.c3d", ("#",)),
]
"""Set, file, labels that are neither markers of the set nor known outputs."""


def labels_of(path):
    """Labels of a TRC or C3D file, straight from its header."""
    if path.suffix == ".trc":
        line = path.read_text(encoding="latin-1").splitlines()[3]
        return [cell.strip() for cell in line.split("\t")[2:] if cell.strip()]
    point = ezc3d.c3d(str(path))["parameters"]["POINT"]
    keys = ["LABELS", *sorted(key for key in point if key.startswith("LABELS") and key != "LABELS")]
    return [label for key in keys for label in point[key]["value"]]


@pytest.mark.data
@pytest.mark.parametrize(("name", "file", "strange"), FILES)
def test_labels_of_real_recordings_are_sorted_completely(name, file, strange):
    """Every label of a recording is a marker, a computed point, or reported as unknown, once."""
    path = DATA / file
    if not path.exists():
        pytest.skip(f"no recording at {path}")
    labels = labels_of(path)
    match = load_marker_set(name).match(labels)
    assert match.unknown == strange
    assert sorted([*match.assigned, *match.computed, *match.unknown]) == sorted(labels)
    bodies = {spec.segment for spec in match.assigned.values()}
    assert {"pelvis", "thorax"} <= bodies
    assert {f"{part}_{side}" for part in ("thigh", "shank", "foot") for side in "lr"} <= bodies
    sided = [
        label
        for label, spec in match.assigned.items()
        if label.rsplit(":")[-1][0] in "LRlr" and spec.segment[-2:] in ("_l", "_r")
    ]
    assert all(match.assigned[label].segment[-1] == label.rsplit(":")[-1][0].lower() for label in sided)


def test_points_that_video_is_told_by_are_left_to_those_made_of_them():
    """A joint in the video is not the marker that a network makes near it; beside that marker itself its twin goes."""
    assert named_outputs(["RKnee", "r_knee_study", "r_toe_study"]) == set()
    assert named_outputs(["r_knee", "R_knee_study", "r_toe_study"]) == {1}
    labels = ["RHip", "RKnee", "Neck", "r.ASIS_study", "L_mknee_study", "C7_study", "RHJC_study"]
    match = load_marker_set("opencap_video").match(labels)
    assert set(match.assigned) == {"r.ASIS_study", "L_mknee_study", "C7_study"} and match.unknown == ()


@pytest.mark.parametrize("name", marker_sets())
def test_built_in_sets_load_and_sit_on_the_template(name):
    """Each set names known segments and landmarks, each landmark on the segment where the template has it."""
    chosen = load_marker_set(name)
    assert len(chosen.specs) > 30
    model = whole_body(1.75, 70.0, "male")
    mean, sd = marker_prior(model, chosen.specs.values())
    assert mean.shape == (len(chosen.specs), 3)
    assert bool((sd > 0.005).all()) and bool(torch.isfinite(mean).all())
    for label in chosen.specs:
        side = chosen.specs[label].segment[-2:]
        landmark = chosen.specs[label].landmark
        if landmark and side in ("_l", "_r"):
            assert landmark.endswith(side), label


def test_labels_match_exactly_then_loosely_then_by_alias():
    """Exact spelling wins, then case and punctuation are ignored, then aliases, then computed patterns."""
    chosen = MarkerSet(
        "own",
        {"L.ASIS": MarkerSpec("pelvis", "asis_l"), "KNEE": MarkerSpec("thigh_l")},
        {"KNEE": ("LKNE",)},
        ("*JC", "[LR]KNE"),
    )
    match = chosen.match(["L.ASIS", "l_asis", "Jim:L ASIS", "lkne", "LHJC", "RKNE", "*12", "knee2"])
    assert list(match.assigned) == ["L.ASIS", "l_asis", "Jim:L ASIS", "lkne"]
    assert match.assigned["lkne"] == MarkerSpec("thigh_l")
    assert match.computed == ("LHJC", "RKNE")
    assert match.unknown == ("*12", "knee2")


def test_listed_labels_stand_above_patterns_and_names():
    """What a set lists is wanted, in any of its spellings, but for markers that were only estimated."""
    chosen = MarkerSet("own", {"LKJC": MarkerSpec("thigh_l")}, {"LKJC": ("knee", "knee_study")}, ("L*",))
    assert list(chosen.match(["LKJC", "LHJC"]).assigned) == ["LKJC"]
    assert chosen.wanted == {"LKJC", "knee"}


def write(folder, text):
    path = folder / "own.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_an_own_set_may_extend_a_built_in_one(tmp_path):
    """Own entries come over those of the set that they extend; aliases and patterns add up."""
    text = "extends: plug_in_gait\nLTHI: shank_l\nBOX: hand_r\naliases: {BOX: [CRATE]}\ncomputed: ['V_*']\n"
    chosen = load_marker_set(write(tmp_path, text))
    assert chosen.specs["LTHI"] == MarkerSpec("shank_l")
    assert chosen.specs["LASI"] == MarkerSpec("pelvis", "asis_l")
    match = chosen.match(["crate", "V_1", "LHipAngles", "LKNEin"])
    assert match.assigned == {"crate": MarkerSpec("hand_r"), "LKNEin": MarkerSpec("thigh_l", "knee_medial_l")}
    assert match.computed == ("V_1", "LHipAngles")


@pytest.mark.parametrize(
    ("code", "place", "text", "said"),
    [
        ("markers.segment", "A", "A: thihg_l\n", "did you mean thigh_l"),
        ("markers.landmark", "A", "A: {segment: thigh_l, landmark: knee_latral_l}\n", "did you mean knee_lateral_l"),
        ("markers.entry", "A", "A: {segment: thigh_l, landmrk: knee_lateral_l}\n", "an entry is a segment"),
        ("markers.entry", "A", "A: {landmark: knee_lateral_l}\n", "an entry is a segment"),
        ("markers.entry", "A", "A: [thigh_l]\n", "an entry is a segment"),
        ("config.duplicate_key", "line 2, column 1", "A: thigh_l\nA: thigh_r\n", "stands twice"),
        ("markers.ambiguous", "ab, A.B", "ab: thigh_l\nA.B: thigh_r\n", "differ only in case"),
        ("config.key", "line 1, column 1", "1.5: thigh_l\n", "in quotes"),
        ("markers.aliases", "aliases", "A: thigh_l\naliases: [B, C]\n", "aliases are label"),
        ("markers.aliases", "aliases", "A: thigh_l\naliases: false\n", "aliases are label.*found: False"),
        ("markers.aliases", "aliases", "A: thigh_l\naliases: 0\n", "aliases are label.*found: 0"),
        ("markers.aliases", "aliases", "A: thigh_l\naliases: ''\n", "aliases are label.*found: ''"),
        ("markers.alias", "aliases.B", "A: thigh_l\naliases: {B: [C]}\n", "alias of a label that the set lacks"),
        ("markers.alias", "aliases.A", "A: thigh_l\naliases: {A: C}\n", "not a list"),
        ("markers.computed", "computed", "A: thigh_l\ncomputed: 3\n", "list of patterns"),
        ("markers.computed", "computed", "A: thigh_l\ncomputed: false\n", "list of patterns.*found: False"),
        ("markers.computed", "computed", "A: thigh_l\ncomputed: {}\n", "list of patterns"),
        ("markers.extends", "extends", "extends: plug_in_gate\n", "did you mean plug_in_gait"),
    ],
)
def test_mistakes_in_a_set_are_named_with_the_remedy(tmp_path, code, place, text, said):
    """Unknown names, wrong forms and contradictions raise a ConfigError that says which and where."""
    with pytest.raises(ConfigError, match=said) as caught:
        load_marker_set(write(tmp_path, text))
    assert (caught.value.code, caught.value.place) == (code, place)
    assert caught.value.source.endswith("own.yaml") and caught.value.remedy


BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
)
"""Three thousand million values in 12 lines."""


@pytest.mark.parametrize(
    ("code", "text"),
    [
        ("config.yaml", "A: ["),
        ("markers.not_a_mapping", "just text"),
        ("markers.not_a_mapping", "- A\n- B\n"),
        ("markers.not_a_mapping", ""),
        ("config.tag", "!!python/object/apply:os.getcwd []\n"),
        ("config.too_large", BOMB),
        ("config.too_deep", "A: " + 99 * "["),
    ],
)
def test_files_that_are_no_sets_are_refused(tmp_path, code, text):
    """Broken YAML, lists, text, empty files, tagged objects, alias bombs and towers are refused; nothing of it runs."""
    with pytest.raises(ConfigError) as caught:
        load_marker_set(write(tmp_path, text))
    assert caught.value.code == code and "own.yaml" in caught.value.source and caught.value.remedy


def test_keys_with_nothing_after_them_are_absent(tmp_path):
    """YAML's empty value stands for no aliases and no patterns."""
    chosen = load_marker_set(write(tmp_path, "A: thigh_l\naliases:\ncomputed:\nextends:\n"))
    assert (chosen.aliases, chosen.computed, tuple(chosen.specs)) == ({}, (), ("A",))


def test_an_unknown_set_names_the_nearest():
    """A misspelt name of a built-in set is answered with the nearest; a missing file is named."""
    with pytest.raises(ConfigError, match=r"did you mean hamner2013.*markers\.unknown_set") as caught:
        load_marker_set("hamner2031")
    assert caught.value.source == "hamner2031"
    with pytest.raises(ConfigError, match="no such file"):
        load_marker_set("no/such/file.yaml")


def test_free_markers_are_wide_about_the_segment_and_landmarks_narrow():
    """Without landmark a marker's prior is centred in the segment and at least 0.15 m wide at adult stature."""
    model = whole_body(1.75, 70.0, "male")
    mean, sd = marker_prior(model, [MarkerSpec("thigh_l"), MarkerSpec("thigh_l", "knee_lateral_l")])
    offset = model.geometry.geometry(model.geometry.mean).offset[SEGMENTS.index("shank_l")]
    assert offset[2] < mean[0, 2] < 0 and bool((sd[0] >= 0.15).all())
    np.testing.assert_allclose(mean[1].numpy(), model.landmarks["knee_lateral_l"].p_BM_B)
    assert bool((sd[1] < 0.02).all())
    empty, _ = marker_prior(model, [])
    assert empty.shape == (0, 3)


@pytest.mark.parametrize(
    ("spec", "code", "said", "remedy"),
    [
        (MarkerSpec("tail"), "markers.segment", "", "did you mean thigh_l"),
        (
            MarkerSpec("shank_l", "knee_lateral_l"), "markers.landmark", "knee_lateral_l; it lies on thigh_l",
            "write segment: thigh_l, or a landmark of shank_l (tuberosity_l, ankle_lateral_l, ankle_medial_l)",
        ),
        (MarkerSpec("shank_l", "knee_lateral"), "markers.landmark", "knee_lateral", "did you mean knee_lateral_"),
        (
            MarkerSpec("abdomen", "knee_lateral_l"), "markers.landmark", "knee_lateral_l; it lies on thigh_l", "(none)",
        ),
    ],
)  # fmt: skip
def test_places_that_the_model_lacks_are_refused(spec, code, said, remedy):
    """A segment or landmark that is not in the model, or lies on another segment, raises a ConfigError."""
    with pytest.raises(ConfigError) as caught:
        marker_prior(whole_body(1.75, 70.0, "male"), [spec])
    error = caught.value
    assert (error.code, error.place, error.found) == (code, spec.segment, said) and remedy in error.remedy


def test_landmark_names_are_those_of_the_template():
    """The names offered to marker sets are exactly the ones that the template places."""
    assert set(whole_body(1.75, 70.0, "female").landmarks) == set(LANDMARKS)
