"""Faults of a laboratory, hidden in what its sessions say, found by all of them together; and the files in between."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from draws import seed_of
from laboratory_sessions import FAULTS, PARAMETERS, SIZES, columns, here, hidden, laboratory, session
from rates import at_least

from torchid.cohort.laboratories import laboratories
from torchid.cohort.pooling import LaboratoryVerdict, pooled
from torchid.cohort.shared_faults import laboratories_section, laboratories_table, laboratory_table
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence
from torchid.effects.scene import PlateFrame
from torchid.errors import InputError
from torchid.session.laboratory import NAME as EVIDENCE
from torchid.session.laboratory import LaboratoryPlate, SessionEvidence, laboratory_dataset, names_in, read_laboratory
from torchid.storage.netcdf import write_netcdf
from torchid.storage.results import OutputFolder

LABORATORIES = 16


def likely(found: LaboratoryVerdict) -> list[tuple[str, tuple[str, ...]]]:
    """Effects and places that are more than possible."""
    return [(one.effect, one.where) for one in found.faults if one.confidence > 0.5]


def test_what_all_sessions_share_is_named_and_sized() -> None:
    draw, right, off = np.random.default_rng(seed_of("shared")), 0, []
    for _ in range(LABORATORIES):
        fault, theta = hidden(draw)
        found = pooled(laboratory(draw, theta))
        right += likely(found) == [FAULTS[fault]]
        if likely(found) == [FAULTS[fault]] and FAULTS[fault][0] == "time_offset":
            value, sd = (float(found.faults[0].parameters["lag_s"][key]) for key in ("value", "sd"))
            off.append((value - 0.01 * theta[0]) / sd)
    assert right >= at_least(0.98, LABORATORIES)
    assert all(abs(z) < 4.5 for z in off)


def test_nothing_is_named_where_nothing_is_shared() -> None:
    draw = np.random.default_rng(seed_of("nothing shared"))
    named = sum(bool(likely(pooled(laboratory(draw, np.zeros(PARAMETERS))))) for _ in range(LABORATORIES))
    assert named <= 2  # odds of twelve to one, and far fewer by its price


def test_what_one_session_cannot_tell_is_no_louder_alone() -> None:
    """Each session by itself is silent about what all together name, or the test above would show nothing."""
    draw, alone = np.random.default_rng(seed_of("alone")), 0
    for _ in range(LABORATORIES):
        fault, theta = hidden(draw)
        one = laboratory(draw, 0.5 * theta)
        single = pooled(replace(one, visits=one.visits[:1]))
        alone += likely(single) == [FAULTS[fault]]
    assert alone <= LABORATORIES // 2


def test_a_plate_that_was_moved_is_dated() -> None:
    draw, right = np.random.default_rng(seed_of("moved")), 0
    for _ in range(LABORATORIES // 2):
        fault, theta = hidden(draw)
        begin = int(draw.integers(4, 9))
        found = [one for one in pooled(laboratory(draw, theta, begin, dated=True)).faults if one.confidence > 0.5]
        right += any(
            (one.effect, one.where) == FAULTS[fault] and abs(int(one.first[1:]) - begin) <= 1 and one.last == "s11"
            for one in found
        )
    assert right >= at_least(0.95, LABORATORIES // 2)


def test_sessions_on_the_same_plates_are_one_laboratory_whatever_their_files_number() -> None:
    draw = np.random.default_rng(seed_of("plates"))
    one, other, third, far = (session(draw, np.zeros(PARAMETERS)) for _ in range(4))
    each = {"a": here(one), "b": here(other, swapped=True), "c": here(third), "d": here(far, away=3.0)}
    home, apart = laboratories(each, {})
    assert [visit.name for visit in home.visits] == ["a", "b", "c"] and [v.name for v in apart.visits] == ["d"]
    assert home.visits[1].evidence.faults[1] == ("plate_gain", ("plate_2",))
    named = laboratories(each, {"c": {"laboratory": "south"}, "a": {"laboratory": "north"}})
    assert [lab.name for lab in named][:2] == ["north", "south"]


def test_no_two_laboratories_have_one_name_whose_file_would_be_the_last_ones() -> None:
    draw = np.random.default_rng(seed_of("names"))
    each = {f"s{k}": here(session(draw, np.zeros(PARAMETERS)), away=5.0 * k) for k in range(4)}
    words = dict(zip(each, ("north", "North", "north_2", ""), strict=True))
    named = laboratories(each, {name: {"laboratory": word} for name, word in words.items()})
    assert [lab.name for lab in named] == ["north", "North_3", "north_2", "laboratory_1"]


def plates_at(**across: float) -> list[LaboratoryPlate]:
    """Plates without corners, by where they bear across the laboratory [m]."""
    nowhere, eye = torch.full((4, 3), torch.nan).double(), torch.eye(3).double()
    return [
        LaboratoryPlate(PlateFrame(n, torch.tensor([0.0, y, 0.0]).double(), eye), nowhere) for n, y in across.items()
    ]


def test_the_nearest_plate_has_the_name_whichever_comes_first() -> None:
    """A plate that is new, within half a plate of a known one, took its name."""
    known = plates_at(plate_1=0.0)
    assert names_in(known, plates_at(new=0.3, old=0.02)) == {"old": "plate_1"}
    assert names_in(known, plates_at(far=0.4, nowhere=np.nan)) == {}


def test_evidence_comes_back_from_its_file(tmp_path: Path) -> None:
    evidence = session(np.random.default_rng(seed_of("file")), np.zeros(PARAMETERS))
    own = here(evidence)
    path = tmp_path / EVIDENCE
    write_netcdf(path, [laboratory_dataset(own)])
    found = read_laboratory(path)
    assert found.evidence.faults == FAULTS and found.evidence.sizes == SIZES
    assert torch.equal(found.evidence.information, evidence.information)
    for one, other in zip(found.plates, own.plates, strict=True):
        assert torch.equal(one.corners, other.corners) and one.frame.name == other.frame.name


@pytest.mark.parametrize("content", [b"", b"no netCDF", None])
def test_a_file_that_is_no_evidence_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / EVIDENCE
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="laboratory"):
        read_laboratory(path)


def test_evidence_of_other_priors_is_refused(tmp_path: Path) -> None:
    evidence = session(np.random.default_rng(0), np.zeros(PARAMETERS))
    data = laboratory_dataset(SessionEvidence(evidence, ()))
    path = tmp_path / EVIDENCE
    write_netcdf(path, [data.assign(prior_sd=2.0 * data["prior_sd"])])
    with pytest.raises(InputError, match="another version"):
        read_laboratory(path)


def test_page_and_file_say_what_sessions_share(tmp_path: Path) -> None:
    theta = np.zeros(PARAMETERS)
    theta[columns(3)] = (0.9, 0.0, 0.0, 0.0, 0.0, 0.0)
    found = pooled(laboratory(np.random.default_rng(seed_of("page")), theta))
    table = [json.loads(json.dumps(laboratory_table(found), default=lambda one: one.tolist()))]
    (fault,) = table[0]["faults"]
    assert fault["effect"] == "plate_pose" and fault["throughout"] and "lies elsewhere" in fault["sentence"]
    section = laboratories_section({"laboratories": table, "without": ["lost"]})
    assert section is not None and section.finding == "1 laboratory with several sessions; 1 fault that sessions share."
    assert laboratories_section({"laboratories": [], "without": []}) is None


def kept(folder: Path, name: str, own: SessionEvidence) -> dict:
    """A row of a session whose evidence is in its folder."""
    (folder / name).mkdir(exist_ok=True)
    write_netcdf(folder / name / EVIDENCE, [laboratory_dataset(own)])
    return {"subject": name, "status": "done"}


def told(rows: list[dict], out: Path) -> dict:
    """What a call of the cohort writes, by way of its folder."""
    with OutputFolder(out, beside=True) as folder:
        return laboratories_table(rows, folder)


def test_nothing_is_pooled_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    draw = np.random.default_rng(seed_of("twice"))
    rows = [kept(tmp_path, name, here(session(draw, np.zeros(PARAMETERS)))) for name in ("a", "b", "c")]
    rows.append({"subject": "lost", "status": "done"})
    first = told(rows, tmp_path)
    assert [one["sessions"] for one in first["laboratories"]] == [["a", "b", "c"]] and first["without"] == ["lost"]
    with monkeypatch.context() as forbidden:
        forbidden.setattr("torchid.cohort.shared_faults.pooled", lambda one: pytest.fail("pooled again"))
        assert told(rows, tmp_path) == first
    file = tmp_path / first["laboratories"][0]["file"]
    assert read_laboratory(file).pooled
    file.unlink()
    assert told(rows, tmp_path) == first and file.is_file()
    (tmp_path / "c" / EVIDENCE).unlink()
    assert told(rows, tmp_path)["laboratories"][0]["sessions"] == ["a", "b"]


def test_sessions_that_say_nothing_of_a_laboratory_harm_nobody(tmp_path: Path) -> None:
    none = torch.zeros(0, dtype=torch.float64)
    empty = LaboratoryEvidence((), (), none[:, None] @ none[None], none, none[:, None] @ none[None], none)
    (silent,) = laboratories({"a": here(empty), "b": here(empty)}, {})
    assert not pooled(silent).faults
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / EVIDENCE).write_bytes(b"damaged")
    said = told([{"subject": "a", "status": "done"}], tmp_path)
    assert said["without"] == ["a"] and not said["laboratories"]


def test_two_plates_without_corners_stay_two() -> None:
    """Belts of a treadmill are nearer to each other than pressures scatter; a plate that bore nothing is nowhere."""
    draw, eye = np.random.default_rng(seed_of("belts")), torch.eye(3, dtype=torch.float64)
    unknown = torch.full((2, 4, 3), torch.nan, dtype=torch.float64)

    def belts(y: float, other: float) -> SessionEvidence:
        places = (torch.tensor([0.0, at, 0.0], dtype=torch.float64) for at in (y, other))
        frames = tuple(PlateFrame(f"plate_{k}", p, eye) for k, p in enumerate(places, 1))
        return SessionEvidence(session(draw, np.zeros(PARAMETERS)), tuple(map(LaboratoryPlate, frames, unknown)))

    both, named = {"a": belts(0.0, 0.25), "b": belts(0.27, 0.02)}, dict.fromkeys("ab", {"laboratory": "hall"})
    assert len(laboratories(both, {})) == 2, "in many laboratories feet bear there"
    (home,) = laboratories(both, named)
    assert len(home.plates) == 2 and home.visits[1].evidence.faults[1] == ("plate_gain", ("plate_2",))
    apart = laboratories({"a": belts(0.0, math.nan), "b": belts(5.0, math.nan)}, named)
    assert len(apart) == 2


def test_order_in_time_is_of_dates_and_numbers_alone() -> None:
    draw = np.random.default_rng(seed_of("order"))
    each = {name: here(session(draw, np.zeros(PARAMETERS))) for name in ("a", "b", "c")}

    def ranks(*when: str) -> tuple[tuple[str, ...], tuple[int, ...]]:
        (home,) = laboratories(each, {name: {"session": own} for name, own in zip(each, when, strict=True)})
        return tuple(one.name for one in home.visits), home.ranks

    assert ranks("10", "9", "1") == (("c", "b", "a"), (0, 1, 2))
    assert ranks("2024-05-01", "2024-03-01", "2024-03-01") == (("b", "c", "a"), (0, 0, 1))
    assert ranks("pre", "post", "") == (("a", "b", "c"), ())
