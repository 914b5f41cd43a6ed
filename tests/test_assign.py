"""Labels find their segments, bodies without markers are locked, and every choice is said."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_session import session, template

from torchid.errors import DataError
from torchid.geometry.assign import Assignment, assign_markers
from torchid.geometry.placing import place
from torchid.geometry.placing.matching import allowed, bodies, matched_on_bodies, places
from torchid.model.marker_set import load_marker_set
from torchid.recording import Trial


def marker_set(*left_out: str):
    model = template()
    given = load_marker_set("simulated", model.tree.names, tuple(model.landmarks))
    return replace(given, specs={label: spec for label, spec in given.specs.items() if label not in left_out})


def trials() -> tuple[Trial, ...]:
    return tuple(item.trial for item in session().trials)


def cut(trial: Trial, labels: tuple[str, ...]) -> Trial:
    return replace(trial, markers=trial.markers.select(labels))


def segment(found: Assignment, label: str) -> str:
    return found.model.tree.names[int(found.attachment.body[found.attachment.labels.index(label)])]


def test_every_listed_label_is_attached():
    """All markers of the set are on their segments and nothing is said."""
    subject = session().subject
    found = assign_markers(template(), marker_set(), trials())
    assert {label: segment(found, label) for label in found.attachment.labels} == dict(
        zip(subject.labels, subject.segments, strict=True)
    )
    assert not found.notes


def test_unlisted_labels_join_the_segments_they_move_with():
    """Labels in no marker set: most go to their segments, the others are left out, and the result says of each.

    Of a forearm and a hand that hardly move against each other, either may carry a marker.
    """
    subject = session().subject
    own = dict(zip(subject.labels, subject.segments, strict=True))
    some = [label for label in own if label[1:4] in ("THI", "TIB", "FRA", "UPA")]
    found = assign_markers(template(), marker_set(*some), trials())
    joined = {label: segment(found, label) for label in some if label in found.attachment.labels}
    assert joined == {label: own[label] for label in joined}
    assert len(some) > 6 and len(joined) > len(some) / 2, joined
    said = {note.message.split(" ")[0]: note.code for note in found.notes}
    assert said == {label: "markers.assigned" if label in joined else "markers.unknown" for label in some}


def test_unlisted_labels_can_be_left_out():
    """With ``leave_out`` the set's labels alone are used; what is computed in one trial is no marker in another."""
    subject, given = session().subject, trials()
    label = next(x for x, s in zip(subject.labels, subject.segments, strict=True) if s == "thigh_l" and "THI" in x)
    found = assign_markers(template(), marker_set(label), given, "leave_out")
    assert set(found.attachment.labels) == set(subject.labels) - {label}
    assert [note.code for note in found.notes] == ["markers.unlisted"] and label in found.notes[0].message
    computed = (replace(given[0], computed=(label,)), *given[1:])
    found = assign_markers(template(), marker_set(label), computed)
    assert label not in found.attachment.labels and [note.code for note in found.notes] == ["markers.computed"]
    assert label in assign_markers(template(), marker_set(), computed).attachment.labels


def test_label_that_moves_with_nothing_is_left_out():
    """A marker on something else is left out by name."""
    given = []
    for trial in trials():
        time = trial.markers.time
        stray = torch.stack([torch.sin(3 * time), torch.cos(2 * time), 1 + 0 * time], dim=1)[:, None]
        position = torch.cat([trial.markers.position, stray], dim=1)
        markers = replace(trial.markers, labels=(*trial.markers.labels, "wand"), position=position)
        given.append(replace(trial, markers=markers))
    found = assign_markers(template(), marker_set(), tuple(given))
    assert "wand" not in found.attachment.labels
    assert [note.code for note in found.notes] == ["markers.unknown"] and "wand" in found.notes[0].message


def test_a_segment_with_one_listed_marker_takes_no_other_segments():
    """Where one marker is left on a shank, its others are told by where they stand, or left out: then the note says
    between which segments they may be."""
    subject = session().subject
    shank = [x for x, s in zip(subject.labels, subject.segments, strict=True) if s == "shank_l"]
    found = assign_markers(template(), marker_set(*shank[1:]), trials())
    joined = {label: segment(found, label) for label in shank[1:] if label in found.attachment.labels}
    assert set(joined.values()) <= {"shank_l"}
    notes = [note.message for note in found.notes if note.code == "markers.unknown"]
    assert len(notes) == len(shank) - 1 - len(joined)
    assert all("shank_l" in said or "no segment" in said for said in notes)


def test_a_segment_that_nobody_marks_keeps_no_label_from_its_neighbours():
    """The pelvis takes a label although the abdomen has no markers, as in nearly every laboratory's set; a listed
    marker that a trial never sees is not waited for."""
    subject = session().subject
    own = dict(zip(subject.labels, subject.segments, strict=True))
    pelvis = [label for label, name in own.items() if name == "pelvis"]
    kept = tuple(label for label, name in own.items() if name != "abdomen")
    found = assign_markers(template(), marker_set(pelvis[-1]), tuple(cut(trial, kept) for trial in trials()))
    assert segment(found, pelvis[-1]) == "pelvis"
    unseen = tuple(_blind(cut(trial, kept), pelvis[0]) for trial in trials())
    found = assign_markers(template(), marker_set(pelvis[-1]), unseen)
    assert segment(found, pelvis[-1]) == "pelvis"


def _blind(trial: Trial, label: str) -> Trial:
    position = trial.markers.position.clone()
    position[:, trial.markers.labels.index(label)] = torch.nan
    return replace(trial, markers=replace(trial.markers, position=position))


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_labels_that_say_nothing_are_placed(share, seed):
    """Half of the labels, by lot, or all of them, are taken out of the set: at most one goes astray, and most of those
    on segments with three markers are told. Those on the abdomen, which nobody marks, stay."""
    subject, lot = session().subject, np.random.default_rng(seed)
    own = {x: s for x, s in zip(subject.labels, subject.segments, strict=True) if s != "abdomen"}
    out = lot.permutation([*own])[: round(share * len(own))].tolist()
    given = trials() if share < 1.0 else tuple(cut(trial, tuple(own)) for trial in trials())
    found = assign_markers(template(), marker_set(*out), given)
    told = {x: segment(found, x) for x in out if x in found.attachment.labels}
    assert sum(told[x] != own[x] for x in told) <= 1, {x: (told[x], own[x]) for x in told if told[x] != own[x]}
    often = [x for x in out if list(own.values()).count(own[x]) >= 3]
    assert sum(told.get(x) == own[x] for x in often) >= 0.7 * len(often), told


def test_where_known_markers_hold_the_body_nobody_need_be_seen_to_stand(monkeypatch):
    """One label of many costs a fit, not a search among headings and postures."""
    monkeypatch.setattr(place, "stand", lambda *given, **options: pytest.fail("a standing person was looked for"))
    label = next(x for x in session().subject.labels if "THI" in x)
    found = assign_markers(template(), marker_set(label), trials())
    assert segment(found, label).startswith("thigh")


def test_markers_are_matched_with_landmarks_one_to_one(seed):
    """Markers near landmarks are on these, in whatever order; one far from all is on none, and of two
    on one place no more than one is."""
    model, draw = template(), torch.Generator().manual_seed(seed)
    order = torch.randperm(len(model.landmarks), generator=draw)
    own = places(model)[order]
    markers = torch.cat([own + 0.003 * torch.randn(own.shape, generator=draw, dtype=own.dtype), own[:1], own[:1] + 3.0])
    seen = torch.full((len(model.tree.names), len(markers), 3), torch.nan, dtype=own.dtype)
    for row, landmark in enumerate([*order.tolist(), int(order[0]), int(order[0])]):
        seen[bodies(model)[landmark], row] = markers[row]
    match = matched_on_bodies(model, seen, allowed(model, len(markers), {}), 0.02)
    assert match[1:-2].argmax(1).tolist() == order[1:].tolist()
    assert float(match[-1].sum()) < 1e-6
    assert bool((match.sum(0) <= 1.0 + 1e-6).all())


def test_a_static_trial_that_shows_nothing_does_not_stop_the_others():
    """Where nobody is seen to stand, motion tells a label, or it is left out."""
    label = next(x for x in session().subject.labels if "THI" in x)
    given = tuple(hidden(trial) if trial.role == "static" else trial for trial in trials())
    found = assign_markers(template(), marker_set(label), given)
    assert label not in found.attachment.labels or segment(found, label).startswith("thigh")


def test_bodies_without_markers_are_locked():
    """Without head markers the head stays, keeps its inertia, and its three coordinates leave the model."""
    subject = session().subject
    kept = tuple(x for x, s in zip(subject.labels, subject.segments, strict=True) if s != "head")
    found = assign_markers(template(), marker_set(), tuple(cut(trial, kept) for trial in trials()))
    assert found.model.tree.names == template().tree.names
    assert len(found.model.tree.dofs) == len(template().tree.dofs) - 3
    assert [note.code for note in found.notes] == ["model.locked"] and "head" in found.notes[0].message


def test_a_body_without_markers_between_marked_ones_keeps_its_joint_near_rest():
    """Without markers on a shank its knee still moves, held to a firm prior about rest, and the result says so."""
    subject = session().subject
    kept = tuple(x for x, s in zip(subject.labels, subject.segments, strict=True) if s != "shank_l")
    found = assign_markers(template(), marker_set(), tuple(cut(trial, kept) for trial in trials()))
    assert found.model.tree.dof_names == template().tree.dof_names
    held = [new.name for new, old in zip(found.model.tree.dofs, template().tree.dofs, strict=True) if new.sd != old.sd]
    assert held and all("knee_l" in name for name in held)
    assert [note.code for note in found.notes] == ["model.between"] and "shank_l" in found.notes[0].message


def test_a_pelvis_without_markers_is_refused():
    """Without the root's markers there is an error that names what was found and what to do."""
    subject = session().subject
    kept = tuple(x for x, s in zip(subject.labels, subject.segments, strict=True) if s != "pelvis")
    with pytest.raises(DataError, match="markers.root") as caught:
        assign_markers(template(), marker_set(), tuple(cut(trial, kept) for trial in trials()))
    assert kept[0] in caught.value.found and "marker set" in caught.value.remedy


def test_trials_without_a_labelled_marker_are_refused_as_such():
    """No labels at all, and labels that are hardly ever seen, are told from labels that no marker set knows."""
    for change, said in ((lambda t: cut(t, ()), "no labelled markers"), (hidden, "no labelled marker is seen")):
        with pytest.raises(DataError, match="markers.none") as caught:
            assign_markers(template(), marker_set(), tuple(change(trial) for trial in trials()))
        assert caught.value.message.startswith(said) and "Label the points" in caught.value.remedy


def hidden(trial):
    return replace(trial, markers=replace(trial.markers, position=torch.full_like(trial.markers.position, torch.nan)))


def test_rarely_seen_marker_takes_no_part():
    """A marker visible in a tenth of the frames is not attached."""
    label, given = session().subject.labels[-1], []
    for trial in trials():
        position = trial.markers.position.clone()
        position[len(position) // 10 :, trial.markers.labels.index(label)] = torch.nan
        given.append(replace(trial, markers=replace(trial.markers, position=position)))
    assert label not in assign_markers(template(), marker_set(), tuple(given)).attachment.labels
