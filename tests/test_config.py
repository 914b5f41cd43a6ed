"""The config: strict reading, all errors at once, overrides, paths, round trip."""

import json
from dataclasses import FrozenInstanceError, fields
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from torchid.config import Config, InvalidConfig, dump_config, load_config
from torchid.config.explain import MOST
from torchid.contact.options import ContactOptions
from torchid.errors import ConfigError
from torchid.geometry.options import GeometryOptions
from torchid.inertia.options import IdentifyOptions
from torchid.simulate.options import SimulateOptions
from torchid.storage.documents import MAX_BYTES, dump_document, parse_document

MINIMAL = """
subject: {name: S01, mass_kg: 70}
markers: plug_in_gait
trials: [{name: squat, file: squat.c3d}]
"""


@pytest.fixture
def write(tmp_path: Path):
    (tmp_path / "squat.c3d").write_bytes(b"")

    def _write(text: str, name: str = "config.yaml") -> Path:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return _write


def problems(path: Path, *overrides: str) -> dict[str, ConfigError]:
    with pytest.raises(InvalidConfig) as caught:
        load_config(path, overrides)
    return {problem.place: problem for problem in caught.value.problems}


def test_minimal_config_has_defaults_and_absolute_paths(write, tmp_path):
    """Defaults fill in, and relative paths start at the config's folder, whatever the working directory."""
    config = load_config(write(MINIMAL))
    assert config.model == "whole_body"
    assert config.geometry.solver == "arrow"
    assert config.inertia.lmi is True
    assert config.trials[0].file == tmp_path / "squat.c3d"
    assert config.out == tmp_path / "out"


def test_all_errors_are_reported_at_once_with_the_nearest_key_and_value(write):
    """Each key at fault gets its own problem: code, key path, file and what was probably meant."""
    path = write(MINIMAL)
    found = problems(
        path,
        "geometry.solvr=adam",
        "geometry.symmetry=tide",
        "inertia.lmi=no",
        "trials.0.role=heldot",
        "model=whole_bdy",
        "lmi=true",
        "subject.mass_kg=-1",
        "geometry.sigma_mm={LASI: 0}",
        "motion.cutoff_hz=.nan",
    )
    assert found["geometry.solvr"].code == "config.unknown_key"
    assert "'solver'" in found["geometry.solvr"].remedy
    assert found["geometry.symmetry"].code == "config.unknown_value"
    assert "'tied'" in found["geometry.symmetry"].remedy
    assert "true or false" in found["inertia.lmi"].message
    assert "'heldout'" in found["trials.0.role"].remedy
    assert "'whole_body'" in found["model"].remedy
    assert "inertia" in found["lmi"].remedy
    assert set(found) >= {"subject.mass_kg", "geometry.sigma_mm.LASI", "motion.cutoff_hz"}
    assert all(problem.exit_code == 2 and str(path) in str(problem) for problem in found.values())


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("a: 1\na: 2", "config.duplicate_key"),
        ('{"a": 1, "a": 2}', "config.duplicate_key"),
        ("a: !!python/object/apply:os.system [ls]", "config.tag"),
        ("&a [*a]", "config.recursive_alias"),
        ("[" * 100_000, "config.too_deep"),
        ("[" * 500 + "]" * 500, "config.too_deep"),
        ("{a: " * 500, "config.too_deep"),
        ("a: [1", "config.yaml"),
        ("a: 1\n---\na: 2", "config.yaml"),
        ("a: " + "9" * 5000, "config.yaml"),
        ("1.5: 2", "config.key"),
        ("a: \x07", "config.yaml"),
        ("x" * (MAX_BYTES + 1), "config.too_large"),
        ("", "config.not_a_mapping"),
        ("- 1", "config.not_a_mapping"),
    ],
)
def test_hostile_documents_are_refused_with_a_code(write, text, code):
    """Duplicate keys, tags, deep nesting and the like are config errors, never a crash."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(text))
    assert caught.value.code == code
    assert caught.value.source


@pytest.mark.parametrize("name", [f"{'x' * 300}.yaml", "/proc/self/mem"])
def test_a_config_that_the_system_does_not_hand_over_is_refused(name):
    """A name longer than a file may have, or a file that cannot be read, is told with the system's own words."""
    if name.startswith("/proc") and not Path(name).exists():
        pytest.skip("no such file on this system")
    with pytest.raises(ConfigError) as caught:
        load_config(Path(name))
    error = caught.value
    assert error.code == "config.unreadable" and error.source == name and "Errno" in error.found and error.remedy


def test_more_than_anybody_writes_is_refused_in_bounded_time(write):
    """Ten thousand keys of YAML are too many, and of thousands of wrong keys in JSON the first are explained."""
    many = "\n".join(f"k{k}: {k}" for k in range(6000))
    with pytest.raises(ConfigError, match="JSON") as caught:
        load_config(write(many))
    assert caught.value.code == "config.too_large"
    found = problems(write(json.dumps({f"k{k}": k for k in range(6000)}), "c.json"))
    assert len(found) == MOST + 1 and found[""].code == "config.more_problems"


def test_alias_bomb_is_refused():
    """Aliases count as often as they are used, so that nine to the ninth never comes to be."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 10)]
    with pytest.raises(ConfigError, match="aliases"):
        parse_document("\n".join(lines))
    assert parse_document("a: &x {b: 1}\nc: *x") == {"a": {"b": 1}, "c": {"b": 1}}


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"\x80abc"])
def test_other_encodings_are_refused(tmp_path, content):
    """A file that is no UTF-8 is refused with the byte; a byte order mark is not."""
    path = tmp_path / "c.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert caught.value.code == "config.encoding"
    path.write_bytes(b"\xef\xbb\xbfa: 1")
    assert problems(path)["a"].code == "config.unknown_key"


def test_words_and_numbers_follow_yaml_1_2():
    """``no`` is a word and ``1e3`` a number, unlike in YAML 1.1."""
    text = "{no: no, x: 1e3, time: 12:30, day: 2020-01-01, n: ~}"
    assert parse_document(text) == {"no": "no", "x": 1000.0, "time": "12:30", "day": "2020-01-01", "n": None}


def test_json_reads_like_yaml(write):
    """The same config as JSON, tabs included, is the same config."""
    text = json.dumps(parse_document(MINIMAL), indent="\t")
    assert load_config(write(text, "c.json")) == load_config(write(MINIMAL))


def test_overrides_set_single_keys(write):
    """Dotted keys and list places are replaced; a section that is absent is made."""
    path = write(MINIMAL)
    config = load_config(path, ["geometry.solver=adam", "trials.0.role=heldout", "seed=7", "subject.name=no"])
    assert (config.geometry.solver, config.trials[0].role, config.seed) == ("adam", "heldout", 7)
    assert config.subject.name == "no"


def test_a_word_in_place_of_a_list_is_told_how_a_list_is_written(write):
    """As it would be right, which loads."""
    assert "[parquet]" in problems(write(MINIMAL), "tables=parquet")["tables"].remedy
    assert load_config(write(MINIMAL), ["tables=[parquet]"]).tables == ("parquet",)


@pytest.mark.parametrize(("text", "subject"), [("BodyL", "BodyL"), ("[BodyL, ArmL]", ("BodyL", "ArmL"))])
def test_a_trial_names_one_subject_or_several_bodies(write, text, subject):
    """``subject`` of a trial is a prefix or a list of them."""
    assert load_config(write(MINIMAL), [f"trials.0.subject={text}"]).trials[0].subject == subject


@pytest.mark.parametrize("override", ["seed", "=1", "a..b=1", "trials.1.role=fit", "trials.x=1", "subject.name.x=1"])
def test_malformed_overrides_are_refused(write, override):
    """An override without a key, a value or a place says so."""
    with pytest.raises(ConfigError) as caught:
        load_config(write(MINIMAL), [override])
    assert caught.value.code == "config.override"


def test_variables_expand_in_paths_only(write, tmp_path, monkeypatch):
    """``${VAR}`` in a path is the environment's; in a name it is text; an unset one is an error."""
    monkeypatch.setenv("SESSION", str(tmp_path))
    path = write(MINIMAL)
    config = load_config(path, ["trials.0.file=${SESSION}/squat.c3d", "subject.name=${SESSION}"])
    assert config.trials[0].file == tmp_path / "squat.c3d"
    assert config.subject.name == "${SESSION}"
    monkeypatch.delenv("SESSION")
    found = problems(path, "trials.0.file=${SESSION}/squat.c3d")
    assert found["trials.0.file"].code == "config.unset_variable"


def test_data_variable_has_the_environment_first(write, tmp_path, monkeypatch):
    """``${TORCHID_DATA}`` of the environment wins over the folder beside the project."""
    monkeypatch.setenv("TORCHID_DATA", str(tmp_path))
    assert load_config(write(MINIMAL), ["trials.0.file=${TORCHID_DATA}/squat.c3d"]).trials[0].file.parent == tmp_path


def test_missing_recordings_are_listed_before_anything_runs(write):
    """All absent files are named at once, each at its key."""
    absent = ("trials.0.file=a.trc", "trials.0.forces=a.mot", "markers=m.yaml", "laboratory=l.nc")
    found = problems(write(MINIMAL), *absent)
    assert {place: problem.code for place, problem in found.items()} == {
        "trials.0.file": "config.missing_file",
        "trials.0.forces": "config.missing_file",
        "markers": "config.missing_file",
        "laboratory": "config.missing_file",
    }


def test_a_users_own_marker_set_is_kept_to(write, tmp_path):
    """Labels that a set does not list are left out by a set of the user's own; the key says otherwise."""
    for name in ("a.trc", "lab.yaml"):
        (tmp_path / name).touch()
    path = write(MINIMAL)
    assert load_config(path, ["trials.0.file=a.trc"]).unlisted_choice == "assign"
    own = ["trials.0.file=a.trc", "markers=lab.yaml"]
    assert load_config(path, own).unlisted_choice == "leave_out"
    assert load_config(path, [*own, "unlisted=assign"]).unlisted_choice == "assign"
    assert problems(path, "unlisted=sometimes")["unlisted"].code == "config.unknown_value"


def test_contradictions_are_refused(write):
    """Paths that cannot be, no trials, trials of one name, and a known mass that is not given are errors."""
    path = write(MINIMAL)
    assert problems(path, "trials.0.file=~nobody_of_this_name/a.c3d")["trials.0.file"].code == "config.path"
    assert problems(path, f"trials.0.file={'x' * 300}.c3d")["trials.0.file"].code == "config.missing_file"
    assert problems(path, "trials=[]")[""].code == "config.no_trials"
    assert problems(path, "inertia.known_mass=true", "subject.mass_kg=")[""].code == "config.no_mass"
    twice = "trials=[{name: a, file: squat.c3d}, {name: a, file: squat.c3d}]"
    assert problems(path, twice)["trials"].code == "config.duplicate_trial"
    assert load_config(path, ["trials=[]", "simulate={fit: [squats]}"]).simulate is not None


def test_resolved_config_reads_back_equal(write, tmp_path):
    """What is saved with the results gives the same config, from any folder."""
    config = load_config(
        write(MINIMAL),
        [
            "subject.name='1e3'",
            "geometry={sigma_mm: {no: 3.5, '12:30': 1e-7}, groups: {legs: [thigh_l_length, thigh_r_length]}}",
            "simulate={fit: [squats, arms], skin_motion_mm: 2, sex: female}",
        ],
    )
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "config.yaml").write_text(dump_config(config), encoding="utf-8")
    assert load_config(folder / "config.yaml") == config


def test_a_sections_faults_name_its_keys(write):
    """Bounds, types and contradictions of the stages' options, as config errors at their keys, all at once."""
    found = problems(
        write(MINIMAL),
        "geometry.groups={'': [a]}",
        "geometry.iterations=1e9",
        "contact.reach_m=0",
        "inertia.prior_weight_range=[3, 1]",
        "inertia.noise=estimated",
        "device=cuda",
        "motion=fast",
        "simulate={rate_hz: 7}",
        "diagnosis={max_effect: 2}",
    )
    assert found["geometry.iterations"].message == "must be a whole number"
    assert {"geometry.groups.", "contact.reach_m"} <= set(found)
    assert found["inertia.noise"].code == found["device"].code == "config.unknown_key"
    assert found["motion"].message == "must be a mapping {key: value}"
    assert (found["simulate.rate_hz"].code, found["simulate.rate_hz"].found) == ("simulate.rate_hz", "7.0")
    assert "'max_effects'" in found["diagnosis.max_effect"].remedy
    again = problems(write(MINIMAL), "inertia.prior_weight_range=[3, 1]", "contact=[1]", "simulate={gap_fractoin: 0}")
    assert again["inertia.prior_weight_range"].code == "inertia.option"
    assert again["contact"].message == "must be a mapping {key: value}"
    assert "'gap_fraction'" in again["simulate.gap_fractoin"].remedy
    assert all(problem.exit_code == 2 for problem in (found | again).values())


def test_stages_take_their_sections_as_they_are(write):
    """The options of a stage are what the config holds: an option without a key, or a key unread, cannot be."""
    config = load_config(write(MINIMAL), ["simulate={}"])
    for section, kind in (
        (config.geometry, GeometryOptions),
        (config.contact, ContactOptions),
        (config.inertia, IdentifyOptions),
        (config.simulate, SimulateOptions),
    ):
        assert isinstance(section, kind)
        assert {field.name for field in fields(kind)} <= {field.name for field in fields(section)}


def test_config_cannot_change_after_loading(write):
    """A stage cannot alter what another stage sees."""
    config = load_config(write(MINIMAL))
    with pytest.raises(ValueError, match="frozen"):
        config.seed = 1
    for section in (config.geometry, config.inertia, config.contact):
        with pytest.raises(FrozenInstanceError):
            section.enabled = False


TEXT = st.text(st.characters(exclude_categories=("Cs", "Cc")), max_size=20) | st.sampled_from(["no", "1e3", "0o7", "="])
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | TEXT,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=12,
)


@given(PLAIN)
def test_documents_round_trip(document: Any):
    """Any plain data written as YAML reads back equal and of the same types."""
    again = parse_document(dump_document(document))
    assert again == document
    assert json.dumps(again) == json.dumps(document)


@given(st.dictionaries(st.sampled_from(sorted(Config.model_fields)), PLAIN))
def test_any_document_is_a_config_or_a_config_error(tmp_path_factory, document: dict):
    """No content of the known sections leads to anything else than a config or a list of its faults."""
    path = tmp_path_factory.mktemp("config") / "c.yaml"
    path.write_text(dump_document(document), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert all(problem.code.startswith("config.") for problem in getattr(caught.value, "problems", (caught.value,)))


@given(st.binary(max_size=200))
def test_random_bytes_are_refused(tmp_path_factory, content: bytes):
    """Bytes that are no config are a config error."""
    path = tmp_path_factory.mktemp("config") / "c.yaml"
    path.write_bytes(content)
    with pytest.raises(ConfigError):
        load_config(path)
