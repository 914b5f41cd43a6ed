"""A cohort's people as the prior of one more: nearer to the truth than tables where they differ, and never silent."""

from dataclasses import replace

import numpy as np
import pytest
import small_session as small
import torch
from draws import seed_of
from rates import at_least
from test_cohort import row
from torch.testing import assert_close

from torchid.cohort.page import render_cohort
from torchid.cohort.people import FEWEST, OWN, people_like
from torchid.cohort.people_section import cohort_people, people_section
from torchid.config.sections import Subject
from torchid.errors import ConfigError, InputError
from torchid.extension.block_errors import HELD_OUT
from torchid.extension.open_geometry import with_open_geometry
from torchid.extension.people_or_tables import growth, people_or_tables
from torchid.model.anthropometry import inertial_prior, tables_of
from torchid.model.model import Geometry
from torchid.model.people import PARTS, SCORES, TOTAL, People, own_covariance, shared
from torchid.model.pseudo import com, mass
from torchid.model.whole_body import whole_body
from torchid.session import Outcome
from torchid.session.fitting import given_mass, identify
from torchid.session.people import people_dataset, people_of, read_people, subject_prior
from torchid.session.person import (
    PersonEvidence,
    people_note,
    person_dataset,
    person_evidence,
    read_person,
    together,
    unlike_note,
)
from torchid.storage.netcdf import write_netcdf
from torchid.storage.results import OutputFolder

GROUPS, PEOPLE, SEEN, NOISE = 24, 12, 40, 0.3
"""Groups by lot, people of each, combinations of scores that a session sees, and how well."""


def medium() -> Geometry:
    """Joint centres of the template."""
    prior = whole_body(1.75, 70.0).geometry
    return prior.geometry(prior.mean)


def seen(draw: np.random.Generator, score: torch.Tensor) -> PersonEvidence:
    """What a session says that sees some combinations of a person's scores."""
    design = torch.tensor(draw.normal(size=(SEEN, SCORES))) / SCORES**0.5 / NOISE
    told = design @ score + torch.tensor(draw.normal(size=SEEN))
    return PersonEvidence(design.T @ design, design.T @ told)


def group(draw: np.random.Generator, own: float) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """Mean scores of a group, and those of its people."""
    mean = shared() @ torch.tensor(draw.normal(size=shared().shape[1])) * (1.0 - own) ** 0.5
    return mean, [mean + one_own(draw, own) for _ in range(PEOPLE)]


def one_own(draw: np.random.Generator, own: float) -> torch.Tensor:
    """What is one person's own."""
    return torch.linalg.cholesky(own_covariance(own)) @ torch.tensor(draw.normal(size=SCORES))


def test_a_group_is_alike_on_both_sides():
    """Its mean moves left and right as in a mirror; what it cannot share stays as tables have it."""
    draw = np.random.default_rng(seed_of("mirror"))
    score = shared() @ torch.tensor(draw.normal(size=shared().shape[1]))
    phi = tables_of(medium(), 1.75, 70.0, 0.5, "male").at(score)[0].reshape(-1, 10)
    left = [k for k, part in enumerate(PARTS) if PARTS.count(part) > 1 and k == PARTS.index(part)]
    right = [k for k, part in enumerate(PARTS) if PARTS.count(part) > 1 and k != PARTS.index(part)]
    assert_close(mass(phi)[left], mass(phi)[right])
    assert_close(com(phi)[left] * torch.tensor([1.0, -1.0, 1.0]).double(), com(phi)[right])
    middle = [k for k, part in enumerate(PARTS) if PARTS.count(part) == 1]
    assert_close(com(phi)[middle, 1], torch.zeros(4).double())
    assert float(mass(phi).sum()) == pytest.approx(70.0)
    assert float(own_covariance(0.2)[TOTAL, TOTAL]) == 1.0 and float(shared()[TOTAL].abs().max()) == 0.0
    B = shared()
    assert_close(B.T @ B, torch.eye(B.shape[1]).double())


def test_a_group_of_whom_nothing_is_known_is_as_tables_have_it():
    """Whatever is each one's own; what makes left other than right scatters as before in every group."""
    for own in (0.1, 0.7):
        covariance = (1.0 - own) * shared() @ shared().T + own_covariance(own)
        people = People(torch.zeros(SCORES).double(), covariance, 0, own)
        before, after = (inertial_prior(medium(), 1.75, 70.0, 0.5, "male", None, one) for one in (None, people))
        assert_close(after.mean, before.mean)
        assert_close(after.covariance, before.covariance)
    draw = np.random.default_rng(seed_of("sides"))
    people = people_like([seen(draw, score) for score in group(draw, 0.2)[1]])
    assert people is not None
    apart = torch.zeros(SCORES).double()
    apart[10 * PARTS.index("thigh")], apart[10 * (PARTS.index("thigh") + 6)] = 0.5**0.5, -(0.5**0.5)
    assert PARTS[PARTS.index("thigh") + 6] == "thigh" and float(apart @ people.score) == pytest.approx(0.0, abs=1e-9)
    assert float(apart @ people.covariance @ apart) == pytest.approx(1.0)


def test_the_next_of_a_group_is_nearer_than_tables_and_within_what_is_said():
    """Over groups by lot: in nearly all the mean is nearer; deviations hold; the share that is one's own is found."""
    draw, nearer, z, shares = np.random.default_rng(seed_of("next")), 0, [], []
    for _ in range(GROUPS):
        own = float(draw.choice([0.2, 0.5]))
        mean, scores = group(draw, own)
        people = people_like([seen(draw, score) for score in scores])
        assert people is not None
        one = mean + one_own(draw, own)
        nearer += float((shared().T @ (one - people.score)).norm()) < float((shared().T @ one).norm())
        z += ((one - people.score) / people.covariance.diagonal().sqrt()).tolist()
        shares.append(people.own - own)
    assert nearer >= at_least(0.99, GROUPS)
    assert 0.92 < np.mean(np.abs(z) < 1.96) < 0.97
    assert abs(np.mean(shares)) < 0.1


def test_people_as_tables_have_them_change_nothing_much():
    """Who differ each in their own way: the share that is one's own is large, and so the mean stays near the tables."""
    draw, means = np.random.default_rng(seed_of("tables")), []
    for _ in range(GROUPS):
        people = people_like([seen(draw, score) for score in group(draw, 0.99)[1]])
        assert people is not None and people.own >= OWN[-3]
        means.append(float(people.score.square().mean()))
    assert np.mean(means) < 0.1


def test_too_few_people_are_nobodys_prior():
    draw = np.random.default_rng(seed_of("few"))
    some = [seen(draw, score) for score in group(draw, 0.5)[1][:FEWEST]]
    assert people_like(some[1:]) is None and people_like(some) is not None


def exact(outcome: Outcome) -> Outcome:
    """The outcome with its motion for known, and prior and rows of one weight."""
    found = outcome.identified
    assert found is not None
    fit = replace(found.fit, covariance=found.of_rows)
    return replace(outcome, identified=replace(found, fit=fit, given_motion=None))


def test_what_a_run_keeps_gives_its_inertia_back():
    """With the tables as a prior of the weight that the fit gave them; what geometry leaves open takes from it."""
    outcome = small.outcome()
    found = exact(outcome).identified
    assert found is not None
    who = outcome.config.subject
    kept = person_evidence(exact(outcome), who)
    assert kept is not None
    fit, prior = found.fit, found.fit.prior
    way = tables_of(outcome.fit.geometry, *outcome.config.subject.known).at(torch.zeros(SCORES).double())[1]
    precision, moment = kept.information + fit.omega_2 * torch.eye(SCORES).double(), kept.moment
    held = given_mass(outcome.config.inertia, who, outcome)
    if held is not None:  # no row of forces
        lever = way[::10].sum(0) / held[1]
        precision = precision + lever[:, None] * lever
        moment = moment + lever * (held[0] - float(prior.mean[:, 0].sum())) / held[1]
    score = torch.linalg.solve(precision, moment)
    assert_close((prior.mean.flatten() + way @ score), fit.phi.flatten(), rtol=1e-5, atol=1e-5)
    back = way @ torch.linalg.solve(precision, way.T)
    assert_close(back.diagonal().sqrt(), fit.covariance.diagonal().sqrt(), rtol=1e-4, atol=1e-9)
    wider = person_evidence(with_open_geometry(exact(outcome)), who)
    assert wider is not None
    less = torch.linalg.eigvalsh(kept.information - wider.information)
    assert float(less[0]) > -1e-6 * float(less[-1]) and float(less[-1]) > 0.0


def test_a_run_tells_what_its_prior_is_and_when_it_is_unlike(tmp_path):
    """People like the subject are a note; others, to whom the forces object, are another."""
    outcome = small.outcome()
    evidence = person_evidence(outcome, outcome.config.subject)
    assert evidence is not None and not list(people_note(outcome.config))
    at = torch.linalg.solve(evidence.information + torch.eye(SCORES).double(), evidence.moment)
    for name, score, code in (("like", at, "people.used"), ("unlike", -4.0 * at, "people.unlike")):
        path = tmp_path / f"{name}.nc"
        write_netcdf(path, [people_dataset(People(score, torch.eye(SCORES).double(), 5, 0.5))])
        who = outcome.config.subject.model_copy(update={"people": path})
        told = replace(outcome, config=outcome.config.model_copy(update={"subject": who}))
        first, *others = *people_note(told.config), *unlike_note(told, evidence)
        assert first.code == "people.used" and "5 people" in first.message and first.source == str(path)
        assert [one.code for one in others] == [code] * (code == "people.unlike")
        prior = subject_prior("whole_body", who, outcome.fit)
        assert float((prior.mean - outcome.prior.mean).abs().max()) > 1e-3


def test_people_who_make_predictions_worse_are_left(tmp_path):
    """People like the subject are begun from; with others tables alone stand, in the config of what follows, too."""
    outcome = replace(small.outcome(), diagnosis=None, base=None)
    tables = tables_of(outcome.fit.geometry, *outcome.config.subject.known)
    mean, way = tables.at(torch.zeros(SCORES).double())
    true = torch.linalg.pinv(way, rtol=1e-3) @ (small.session().subject.phi.flatten() - mean)
    sure = 0.05 * torch.eye(SCORES).double()
    for name, score, kept in (("like", true, True), ("unlike", -3.0 * true, False)):
        path = tmp_path / f"{name}.nc"
        write_netcdf(path, [people_dataset(People(score, sure, 5, 0.05))])
        who = outcome.config.subject.model_copy(update={"people": path})
        config = outcome.config.model_copy(update={"subject": who})
        prior = subject_prior(config.model, who, outcome.fit)
        begun = replace(outcome, config=config, prior=prior, notes=tuple(people_note(config)))
        begun = replace(begun, identified=identify(config.inertia, who, begun, quiet))
        with OutputFolder(tmp_path / name) as folder:
            found = people_or_tables(begun, folder, "key", quiet)
        (note,) = found.notes
        assert note.code == ("people.used" if kept else "people.left"), note
        assert (found.identified is begun.identified) == (found.config.subject.people is not None) == kept
        worse = [one for one in growth(small.outcome(), begun) if one.worse]
        assert bool(worse) != kept and {one.where for one in growth(outcome, begun)} == {HELD_OUT}
        if not kept:
            assert_close(found.phi, exact_again(outcome), rtol=1e-6, atol=1e-6)
            assert "held-out" in note.message and "5 people" in note.message


def exact_again(outcome: Outcome) -> torch.Tensor:
    """The inertia that tables alone give."""
    return identify(outcome.config.inertia, outcome.config.subject, outcome, quiet).fit.phi


def quiet(stage: str, fraction: float) -> None:
    """No bar."""


def test_files_that_are_none_are_refused(tmp_path):
    """Before any work, with what to do; a model from a file brings its own inertia."""
    kept = PersonEvidence(torch.eye(SCORES).double(), torch.ones(SCORES).double())
    write_netcdf(tmp_path / "person.nc", [person_dataset(kept)])
    assert_close(read_person(tmp_path / "person.nc").moment, kept.moment)
    people = People(torch.ones(SCORES).double(), torch.eye(SCORES).double(), 7, 0.3)
    write_netcdf(tmp_path / "people.nc", [people_dataset(people, "key")])
    again, key = read_people(tmp_path / "people.nc")
    assert (again.count, again.own, key) == (7, 0.3, "key")
    (tmp_path / "torn.nc").write_bytes((tmp_path / "people.nc").read_bytes()[:500])
    for name, code in (("person.nc", "people.form"), ("torn.nc", "people.unreadable")):
        with pytest.raises(InputError, match=code.replace(".", r"\.")):
            people_of("whole_body", Subject(name="A", people=tmp_path / name))
    with pytest.raises(ConfigError, match=r"people\.model"):
        people_of(tmp_path / "own.osim", Subject(name="A", people=tmp_path / "people.nc"))


def test_a_cohort_writes_its_people_once(tmp_path):
    """From all whose results may be used; the page has what they have in common."""
    draw = np.random.default_rng(seed_of("cohort"))
    names, scores = ["A", "B", "sub-1_ses-1", "sub-1_ses-2", "D"], group(draw, 0.2)[1]
    for name, score in zip(names, (scores[0], scores[1], scores[2], scores[2], scores[3]), strict=True):
        (tmp_path / name).mkdir()
        write_netcdf(tmp_path / name / "person.nc", [person_dataset(seen(draw, score))])
    rows = [row(name) for name in names]
    rows[-1] |= {"verdict": "do not use"}
    with OutputFolder(tmp_path, beside=True) as folder:
        people = cohort_people(rows, folder)
    assert people is not None and people.count == 3, "two sessions are one person"
    each = {name: read_person(tmp_path / name / "person.nc") for name in names[:-1]}
    one = together([each.pop(f"sub-1_ses-{k}") for k in (1, 2)])
    alone = people_like([*each.values(), one])
    assert alone is not None
    assert_close(people.score, alone.score)
    page = render_cohort(rows, tmp_path, [people_section(people)])
    assert "People" in page and "upper arm" in page and "people.nc" in page
    written = (tmp_path / "people.nc").stat().st_mtime_ns
    with OutputFolder(tmp_path, beside=True) as folder:
        again = cohort_people(rows, folder)
    assert again is not None and (tmp_path / "people.nc").stat().st_mtime_ns == written
    assert_close(again.score, people.score)
    with OutputFolder(tmp_path, beside=True) as folder:
        assert cohort_people(rows[:2], folder) is None and not (tmp_path / "people.nc").exists()
    assert people_section(None) is None
