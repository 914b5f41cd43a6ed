"""The report page: whole, inert, without anything from outside, and with the numbers of the tables."""

import json
import math
import re
from dataclasses import dataclass, field, replace
from html.parser import HTMLParser

import numpy as np
import pytest
import torch
from report_run import LABEL, SUBJECT, TRIAL, Run, cause, finished_run

from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.evidence.detectable import Detectable
from torchid.diagnosis.testing.heldout import Errors
from torchid.diagnosis.verdict.records import Diagnosis, NearestEffect, Refuted, Twin
from torchid.dynamics.rows import residual_rms
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.recommendations import tell_apart
from torchid.errors import DataError, Note
from torchid.model_free.testimony import CheckAnswer
from torchid.report.before_after import draw_curves, sides, spectrum
from torchid.report.blocks import Details, Figure, Items, Paragraph, Table
from torchid.report.cause_sentences import likely, surely, told
from torchid.report.cause_sentences import name as labelled
from torchid.report.data_handling import grouped, handling_section
from torchid.report.detectable_table import sized
from torchid.report.diagnosis import diagnosis_section, gained
from torchid.report.facts import body_weight, wrenches
from torchid.report.forces import Score, _draw_trial, instructive
from torchid.report.glance import LOOK, NOTHING, SIDES, glance, next_step
from torchid.report.joints import joints_section
from torchid.report.page import render_report
from torchid.report.picture import LEAST, person_outline, person_picture, shown_frame
from torchid.report.summary import head_section
from torchid.report.witness_table import witness_table
from torchid.scene.embedded import OPENER
from torchid.scene.finished import FinishedRun
from torchid.scene.replay import replay
from torchid.session import Outcome
from torchid.session.judging import quality_of
from torchid.session.outcome import ORDER, Quality, QualityLevel
from torchid.session.person import UNLIKE, USED
from torchid.wording import bind, change, clean, listing, merge, number, pattern, segment, spread

VOID = {"meta", "link", "br", "img", "input", "hr", "path", "use"}
ALLOWED = set(
    "html head meta title style body header p h1 strong nav a main section h2 figure figcaption div table thead tbody "
    "tr th td ul li pre details summary svg g path defs use text clippath rect pattern tspan dl dt dd span code".split()
)


@pytest.fixture(scope="session")
def run(tmp_path_factory) -> Run:
    """A tiny simulated session with hostile names, identified into a folder."""
    return finished_run(tmp_path_factory.getbasetemp() / "report")


@dataclass
class Parsed(HTMLParser):
    """Tags, attributes, ids and table rows of a page; unbalanced tags fail."""

    tags: list[str] = field(default_factory=list)
    attributes: list[tuple[str, str, str]] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)
    words: dict[str, str] = field(default_factory=dict)
    """Text by the tag that holds it."""

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open and self.open.pop() == tag, f"</{tag}> closes another element"

    def handle_data(self, data: str) -> None:
        if self.open:
            self.words[self.open[-1]] = self.words.get(self.open[-1], "") + data
        if self.rows and self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data.replace("\N{NO-BREAK SPACE}", " ")


def parse(page: str) -> Parsed:
    """The page, read to its end."""
    found = Parsed()
    found.feed(page)
    found.close()
    assert found.open == []
    return found


def test_page_is_whole_small_and_reads_nothing_from_outside(run):
    """Every element is closed, every reference points into the page, the policy forbids the rest; 3 MB with replay."""
    page = render_report(run.outcome)
    found = parse(page)
    assert len(page.encode()) < 1e6 and len(run.page.encode()) < 3e6
    ids = [value for _, name, value in found.attributes if name == "id"]
    assert len(ids) == len(set(ids))
    links = [value for _, name, value in found.attributes if name in ("href", "xlink:href", "src")]
    links += [f"#{target}" for target in re.findall(r"url\(#([^)]*)\)", page)]
    assert links and set(links) <= {f"#{name}" for name in ids}
    assert "url(" not in page.replace("url(#", "") and "@import" not in page
    assert not re.search(r"(?i)https?:|//[a-z]+\.[a-z]", re.sub(r">[^<]*<", "><", page))
    policy = [value for tag, name, value in found.attributes if tag == "meta" and name == "content"]
    assert any(value.startswith("default-src 'none'") and "script" not in value for value in policy)


def test_a_replay_runs_its_own_scripts_alone_and_in_a_frame_of_its_own(run):
    """The policy names scripts by their hashes; names from the data are text as before, and the page stays small."""
    page = render_report(run.outcome, None, replay(FinishedRun(run.out), "squats"))
    found = parse(page)
    assert set(found.tags) <= ALLOWED | {"iframe", "script"} and len(page.encode()) < 3e6
    frames = {name: value for tag, name, value in found.attributes if tag == "iframe"}
    assert frames["sandbox"] == "allow-scripts" and "srcdoc" not in frames and "src" not in frames
    assert page.count("<script>") == 1 and found.words["script"].strip() == OPENER
    policy = next(value for tag, name, value in found.attributes if tag == "meta" and "default-src" in (value or ""))
    scripts = re.findall(r"script-src ([^;]*)", policy)[0].split()
    assert len(scripts) == 5 and all(one.startswith("'sha256-") for one in scripts[:4]), scripts
    assert scripts[4] == "'wasm-unsafe-eval'" and "http" not in policy
    assert SUBJECT in found.words["h1"]


def test_hostile_names_are_text(run):
    """Markup in the names of subject, trial and marker makes no element and no attribute, and is still readable."""
    found = parse(render_report(run.outcome))
    assert set(found.tags) <= ALLOWED
    assert not [name for _, name, _ in found.attributes if name.startswith("on") or name == "src"]
    assert SUBJECT in found.words["h1"]
    assert any(TRIAL in cell for row in found.rows for cell in row)
    assert LABEL in found.words["text"], "the marker's label is drawn as it is, not as a formula"


def test_sections_stand_in_order_and_begin_with_a_finding_in_numbers(run):
    """Head, skeleton, body, forces, moments, data, method; each opens with a sentence that holds a number."""
    found = parse(run.page)
    sections = [value for tag, name, value in found.attributes if (tag, name) == ("section", "id")]
    assert sections == ["summary", "skeleton", "body", "forces", "moments", "data", "method"]
    findings = re.findall(r'<p class="finding">(.*?)</p>', run.page, re.DOTALL)
    assert len(findings) == len(sections)
    assert all(re.search(r"\d", text) and text.rstrip().endswith(".") for text in findings)


def test_numbers_equal_those_of_the_json_files(run):
    """Masses, lengths, marker errors and residuals of the page are those of the tables, as far as it prints them."""
    rows = {row[0]: row for row in parse(run.page).rows if len(row) == 8 and "±" in "".join(row[2:4])}
    inertia = json.loads((run.out / "inertia.json").read_text(encoding="utf-8"))
    geometry = json.loads((run.out / "geometry.json").read_text(encoding="utf-8"))
    for name, own in inertia["segments"].items():
        row = rows[segment(name)]
        _same(row[2], [own["mass_kg"], own["sd"]["mass_kg"]], 0.005)
        _same(row[3], [own["prior"]["mass_kg"], own["prior"]["sd_kg"]], 0.005)
        _same(row[4], [1e3 * x for x in own["com_m"]], 0.5)
        _same(row[6], [100 * own["progress_mass"]], 0.5)
        length = geometry["segments"].get(name)
        if length and length["sd"]:
            _same(row[1], [1e3 * length["length_m"], 1e3 * length["sd"]], 0.05)
    _same(rows["total"][2], [inertia["total_mass"]["value_kg"], inertia["total_mass"]["sd_kg"]], 0.005)
    marker = [row for row in parse(run.page).rows if len(row) == 6]
    force = {row[0]: row for row in parse(run.page).rows if len(row) == 9}
    for name, own in geometry["marker_rmse_mm"].items():
        row = next(row for row in marker if row[0] == clean(name))
        _same(" ".join(row[3:5]), [own["identified"], own["scaled"]], 0.05)
        own = inertia["trials"][name]
        _same(
            " ".join((force[clean(name)][4], force[clean(name)][6])), [own["force_rmse_N"], own["moment_rmse_Nm"]], 0.05
        )


def _same(text: str, values: list[float], half_digit: float) -> None:
    shown = [float(x) for x in re.findall(r"-?\d+\.?\d*", text.replace("\N{MINUS SIGN}", "-"))]
    np.testing.assert_allclose(shown, values, rtol=0.0, atol=half_digit * 1.0001)


def test_a_failed_inertial_fit_is_said_at_the_top_and_the_rest_is_shown(run):
    """Without identified inertia the page names the failure before anything else and keeps what is known."""
    failure = DataError(
        "inertia.unexplained", "no physical inertia explains <b>the</b> forces", remedy="Check the plates"
    )
    page = render_report(replace(run.outcome, identified=None, residuals=()), failure)
    found = parse(page)
    assert set(found.tags) <= ALLOWED
    assert page.index("inertia.unexplained") < page.index('<section id="summary"')
    sections = [value for tag, name, value in found.attributes if (tag, name) == ("section", "id")]
    assert sections == ["summary", "skeleton", "body", "forces", "moments", "data", "method"]
    assert "masses are those of tables" in page and "ertificate, recomputed" not in page


def test_without_forces_static_and_held_out_trials_what_remains_is_shown(run):
    """Trials without forces, none of them static or held out: no section on forces and no claim of a test."""
    outcome = _bare(run.outcome)
    page = render_report(outcome)
    found = parse(page)
    sections = [value for tag, name, value in found.attributes if (tag, name) == ("section", "id")]
    assert sections == ["summary", "skeleton", "body", "data", "method"]
    assert "held-out" not in page and "No trial was held out" in page
    assert "nan" not in " ".join(cell for row in found.rows for cell in row).lower()


def _bare(outcome: Outcome) -> Outcome:
    names = [name for name, trial in outcome.session.trials.items() if trial.role != "static"]
    trials = {name: replace(outcome.session.trials[name], role="fit", forces=None) for name in names}
    files = {name: outcome.session.files[name] for name in names}
    empty = {name: torch.full_like(outcome.torque[name], torch.nan) for name in names}
    strip = lambda all_: {name: replace(all_[name], wrench=None, contact=None) for name in names}  # noqa: E731
    return replace(
        outcome,
        session=replace(outcome.session, trials=trials, files=files),
        followed=strip(outcome.followed),
        followed_scaled=strip(outcome.followed_scaled),
        torque=empty,
        torque_scaled=empty,
        identified=None,
        residuals=(),
    )


def test_moments_that_are_not_known_stay_blank(run):
    """Where a torque is NaN nothing is drawn or counted; where all are, the section is left out."""
    names = run.outcome.fit.model.tree.dof_names
    legs = [k for k, name in enumerate(names) if name.startswith(("hip", "knee", "ankle"))]
    torque = {name: values.clone() for name, values in run.outcome.torque.items()}
    torque[TRIAL][:10, legs] = torch.nan
    section = joints_section(replace(run.outcome, torque=torque))
    assert section is not None
    table = next(block for block in section.blocks if isinstance(block, Table))
    known = torch.isfinite(torque[TRIAL][:, names.index("knee_l_flexion")]).double().mean()
    row = next(row for row in table.rows if row[0] == "left knee, flexion")
    assert row[-1] == f"{number(known, 0, 100.0)} %"
    torque[TRIAL][:] = torch.nan
    assert joints_section(replace(run.outcome, torque=torque)) is None


def test_a_worse_held_out_residual_is_called_worse(run):
    """The words follow the numbers: inertia that predicts held-out forces badly is said to."""
    bad = replace(run.outcome.identified, fit=replace(run.outcome.identified.fit, phi=1.5 * run.outcome.prior.mean))
    outcome = replace(run.outcome, identified=bad)
    section = head_section(outcome, wrenches(outcome), None)
    said = [item for block in section.blocks for item in getattr(block, "items", ())]
    deciding = quality_of(outcome).deciding
    assert deciding is not None and section.finding.startswith(f"Do not use: {deciding.words}")
    (forces,) = [one for one in glance(outcome, quality_of(outcome)) if one.about == "Forces"]
    assert (
        forces.level is QualityLevel.UNUSABLE
        and " worse than with a scaled model and masses of tables (norm 8 %" in forces.text
    )
    assert any("Force residual higher than the scaled template's" in item for item in said), said
    assert any(item.startswith("Masses more than") and "prior standard deviations" in item for item in said), said


def test_one_look_tells_every_side_and_what_to_do_next(run):
    """Each line has the worst level of its figures; what comes next is the cure of what weighs most."""
    lights = {one.about: one for one in glance(run.outcome, quality_of(run.outcome))}
    quality = quality_of(run.outcome)
    for about, names in SIDES.items():
        own = [one for one in quality.criteria if one.name in names]
        if own:
            assert lights[about].level is max((one.level for one in own), key=ORDER.index)
            assert all(one.shown[1:] in lights[about].text for one in own if one.level is not QualityLevel.GOOD) or (
                about == "Mass"
            )
    assert list(lights)[-1] == "Next" and lights["Next"].level is None

    failure = DataError("inertia.unexplained", "no body explains the forces", remedy="Check the plates' corners")
    untold = replace(run.outcome, identified=None)
    failed = {one.about: one for one in glance(untold, quality_of(untold, failure))}
    assert failed["Next"].text == "Check the plates' corners." and "no body explains" in failed["Fit"].text.lower()
    assert "masses are those of tables" in failed["Mass"].text

    late = replace(cause("time_offset"), confidence=0.95)
    found = Diagnosis((), Errors(1.0, 1.0), Errors(1.0, 1.0), (late,), Adequacy(False, 0.5, 0.1, "little"))
    named = {one.about: one for one in glance(replace(run.outcome, diagnosis=found), quality)}
    assert named["Recordings"].level is QualityLevel.CARE and told(late) in named["Recordings"].text
    assert "forces_as" in named["Next"].text
    good = Quality(tuple(replace(one, level=QualityLevel.GOOD) for one in quality.criteria))
    assert next_step((), (), good) == ""
    calm = replace(run.outcome, session=replace(run.outcome.session, tracking=()), diagnosis=None)
    assert glance(calm, good)[-1].text == f"{NOTHING}."
    more = replace(found, causes=(), unexplained=Adequacy(True, 1e-9, 0.6, "much"))
    *_, recordings, after = glance(replace(calm, diagnosis=more), good)
    assert recordings.level is QualityLevel.CARE and after.text == f"{LOOK}."
    bad = Quality(tuple(replace(one, level=QualityLevel.UNUSABLE) for one in quality.criteria))
    assert glance(calm, bad)[0].level is QualityLevel.UNUSABLE and "not to be used" in glance(calm, bad)[0].text


def test_one_look_tells_for_whom_tables_were_changed(run):
    """A child's run says so on a line of its own, an adult's has none."""
    fit = replace(run.outcome.fit, model=replace(run.outcome.fit.model, build=("shifted and wider for a child",)))
    child = {one.about: one for one in glance(replace(run.outcome, fit=fit), quality_of(run.outcome))}
    assert child["Tables"].text == "Of adults, shifted and wider for a child." and child["Tables"].level is None
    assert "Tables" not in {one.about for one in glance(run.outcome, quality_of(run.outcome))}
    for code, level in ((USED, None), (UNLIKE, QualityLevel.CARE)):
        noted = replace(run.outcome, notes=(*run.outcome.notes, Note(code, "inertia begins from others", "a.nc")))
        shown = {one.about: one for one in glance(noted, quality_of(run.outcome))}
        assert shown["Tables"].text == "Inertia begins from others." and shown["Tables"].level is level


def test_the_picture_shows_the_person_on_the_plates(run):
    """As many arrows as plates are stood on, and every stick of the body."""
    svg, caption = person_picture(run.outcome)
    trial, frame = shown_frame(run.outcome)
    forces = run.outcome.session.trials[trial].forces
    stood = int((forces.wrench[frame, :, 2] > LEAST * body_weight(run.outcome)).sum())
    assert stood and svg.count("#8f1d14") >= stood and "forces of the plates" in caption
    assert svg.count("#0b5394") >= len(run.outcome.fit.model.tree.bodies) - 1
    outline = person_outline(run.outcome)
    assert len(outline["arrows"]) == stood and len(outline["sticks"]) >= len(run.outcome.fit.model.tree.bodies) - 1
    lowest, highest = (limit(y for _, a, _, b in outline["sticks"] for y in (a, b)) for limit in (max, min))
    assert 100 < lowest - highest < 200 and all(isinstance(x, int) for one in outline["sticks"] for x in one)


def test_notes_that_say_the_same_are_one_line(run):
    """Notes of one wording are one line with the range of their numbers and all their trials; nothing gets lost."""
    lines = grouped(run.outcome)
    codes = {note.code for note in run.outcome.notes}
    assert {line.code for line in lines} == codes and len(lines) <= len(run.outcome.notes)
    table = next(block for block in handling_section(run.outcome).blocks if isinstance(block, Table))
    assert {row[0] for row in table.rows} == codes
    messages = ["6 of 131 frames left out", "10 of 139 frames left out", "9 of 139 frames left out"]
    assert len({pattern(message) for message in messages}) == 1
    assert merge(messages) == "6 to 10 of 131 to 139 frames left out"
    assert pattern("marker L1 held") != pattern("marker L2 held"), "digits of a name are no number"


def test_the_drawn_trials_are_the_telling_ones():
    """At most four trials, each once: the worst and the best residual and the largest gain and loss."""
    scores = [Score(f"t{k}", 10.0 + k, 1.0, 10.0 + (7 * k) % 11, 1.0) for k in range(9)]
    chosen = [entry for entry, _ in instructive(scores)]
    assert len(chosen) == len({entry.name for entry in chosen}) == 4
    gains = [entry.prior_force - entry.force for entry in scores]
    for wanted in (scores[0], scores[-1], scores[int(np.argmax(gains))], scores[int(np.argmin(gains))]):
        assert wanted in chosen
    assert len(instructive(scores[:1])) == 1


def test_texts_have_sensible_digits_and_no_control_characters():
    """Numbers carry a true minus sign and never a negative zero; names lose what could disturb the page."""
    assert number(-0.04) == "0.0" and number(-1.26) == "\N{MINUS SIGN}1.3" and number(float("nan")) == "–"
    assert spread(0.40313, 0.00106, 1, 1e3) == "403.1 ± 1.1" and spread(None, 1.0) == "–"
    assert change(20.0, 15.0) == "\N{MINUS SIGN}25 %" and change(20.0, 25.0) == "+25 %" and change(0.0, 1.0) == "–"
    assert clean("a\x00\u202eb") == "a\N{REPLACEMENT CHARACTER}\N{REPLACEMENT CHARACTER}b"
    assert len(clean("x" * 500)) <= 120
    assert listing(["a", "b", "c"]) == "a, b and c" and listing([]) == "none" and listing(["a"]) == "a"
    assert listing(list("abcdefghij"), 4) == "a, b, c and 7 more"
    assert segment("thigh_l") == "left thigh" and segment("pelvis") == "pelvis"
    assert bind("12.5 N m at 3 s") == "12.5\N{NO-BREAK SPACE}N\N{NO-BREAK SPACE}m at 3\N{NO-BREAK SPACE}s"


def test_what_cannot_be_told_apart_has_a_size():
    """How sure is said with what else it could be, and how large that were."""
    one = cause("payload")
    said = surely(one)
    assert "20 % is a wrong body mass" in said and "If it is that:" in said and "74.0 kg" in said
    unsized = replace(one, indistinguishable=(Twin("body_mass", ("session",), 0.2),))
    assert "If it is that" not in surely(unsized)


def test_what_is_only_possible_stands_apart(run):
    """It is no finding, whatever else is named, and is called what it is up to even odds."""
    outcome, even = extended(run.outcome), replace(cause("drag"), confidence=0.5)
    assert outcome.diagnosis is not None and likely(even).startswith("possible, not confirmed")
    for causes, begins in (((cause("payload"), even), "The thorax"), ((even,), "No likely fault")):
        section = diagnosis_section(replace(outcome, diagnosis=replace(outcome.diagnosis, causes=causes)))
        assert section is not None and section.finding.startswith(begins) and told(even) not in section.finding
        (folded,) = [block for block in section.blocks if isinstance(block, Details) and "Possible" in block.summary]
        heading, listed = folded.blocks
        assert folded.summary.startswith("Possible: 1 cause") and isinstance(heading, Paragraph)
        assert heading.text.startswith("Possible (at most 50 %, nothing is corrected)")
        assert isinstance(listed, Items) and len(listed.items) == 1
        (item,) = listed.items
        assert "possible, not confirmed independently (50 %)" in item.lower() and told(even)[1:] in item


def test_a_cause_that_is_not_corrected_is_told_with_the_reason(run):
    """In the finding, beside its name, as sure as it is."""
    outcome = extended(run.outcome)
    assert outcome.diagnosis is not None
    sure = replace(cause("drag"), confidence=0.995, applied=False)
    section = diagnosis_section(replace(outcome, diagnosis=replace(outcome.diagnosis, causes=(sure,))))
    assert section is not None and f"{told(sure)} It is not corrected: the model" in section.finding


def test_witnesses_of_a_cause_are_shown():
    agreeing = CheckAnswer("clock_vertical", "walk", "", 0.021, 0.005, 0.019, 0.004, "s")
    against = replace(agreeing, name="zero_fx", where="plate_2", value=0.3, sd=1.5, expected=8.0, usual=0.0, unit="N")
    quiet, large = replace(against, value=3.9), replace(against, value=40.0)
    tiny = CheckAnswer("marker_quickness", "walk", "", 0.0018, 0.0033, 0.0, 0.03, "mm")
    some = (agreeing, against, quiet, large, tiny)
    (block,) = witness_table([replace(cause("time_offset"), witnesses=some)])
    assert isinstance(block, Details) and isinstance(table := block.blocks[0], Table)
    assert [row[-1] for row in table.rows] == ["agrees", "contradicts", "cannot tell", "another size", "agrees"]
    assert table.rows[4][3] == "0.0018 ± 0.0033 mm"
    assert table.rows[0][2:6] == ("walk", "21.0 ± 5.0 ms", "19.0 ms", "4.0 ms")
    assert witness_table([cause("drag")]) == []


@pytest.mark.parametrize("name", sorted(CATALOGUE))
@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_every_effect_has_a_sentence(name, scale):
    """In plain words: sizes with their unit, no key, no number that is none; and what tells it from its look-alikes."""
    own = effect(name)
    if scale < 0.0 and any(p.positive for p in own.parameters):
        return
    said = told(cause(name, scale))
    assert not said[0].islower() and said.endswith(".") and "nan" not in said and "tensor" not in said
    assert "_" not in said and (re.search(r"\d", said) or not cause(name).parameters)
    for other in CATALOGUE:
        assert tell_apart(name, other) == tell_apart(other, name) != ""
    sure = surely(replace(cause(name), doubted=True))
    assert sure.startswith("very likely (90 %)") and "an unexplained residual" in sure


def test_sentences_say_directions_and_sizes():
    """Late or early, too much or too little, with as many digits as are known."""
    assert "5.3 ms (sd 0.3 ms)" in told(replace(cause("time_offset"), parameters=one("lag_s", 0.0053, 3e-4)))
    assert "early" in told(replace(cause("time_offset"), parameters=one("lag_s", -0.0053, 3e-4)))
    assert "plate 1 reads 2.10 % (sd 0.10 %) too little" in told(
        replace(cause("plate_gain"), parameters=one("gain", 0.979, 1e-3))
    ).replace("Plate", "plate")


def one(key: str, value: float, sd: float) -> dict:
    """Parameters of a cause with a single scalar."""
    return {key: {"value": torch.tensor(value), "sd": torch.tensor(sd)}}


def extended(outcome: Outcome) -> Outcome:
    """The outcome as if naming two causes had led from the table's inertia to it."""
    identified = outcome.identified
    assert identified is not None
    table = replace(identified, fit=replace(identified.fit, phi=outcome.prior.mean))
    base = replace(outcome, identified=table, fit=replace(outcome.fit))
    errors = Errors(10.0, 3.0)
    causes = (cause("payload"), replace(cause("marker_shift"), where=(LABEL,)))
    rest = Adequacy(False, 0.2, 0.1, "")
    found = Diagnosis((), errors, errors, causes, rest, {"plate_gain": "not of plate_3: nobody steps there"})
    return replace(outcome, diagnosis=found, base=base)


def test_named_causes_are_told_drawn_and_counted(run):
    """The section has curves, bands, rivals and a table with the residuals of both models; the page is inert."""
    outcome = extended(run.outcome)
    section = diagnosis_section(outcome)
    assert section is not None and section.finding.startswith("The thorax carries 2.0")
    assert len([b for b in section.blocks if isinstance(b, Figure)]) == 4
    table = next(block for block in section.blocks if isinstance(block, Table))
    for row, name in zip(table.rows, (TRIAL, "squats"), strict=True):
        wrench = outcome.followed[name].wrench
        assert wrench is not None and outcome.base is not None
        pairs = [residual_rms([wrench], one.phi) for one in (outcome.base, outcome)]
        (force_0, moment_0), (force_1, moment_1) = pairs
        assert row[2:6] == (number(force_0), number(force_1), number(moment_0, 2), number(moment_1, 2))
    page = render_report(outcome)
    found = parse(page)
    assert set(found.tags) <= ALLOWED and 'id="diagnosis"' in page
    assert not [name for _, name, _ in found.attributes if name.startswith("on") or name == "src"]


def test_a_label_tells_what_skin_slides_with():
    """One segment's skin may be named with several coordinates: each bullet says which."""
    assert labelled(cause("soft_tissue")) == "Sliding skin of the thorax (left knee flexion)"
    assert labelled(cause("payload")) == "A load on the thorax"


def test_forces_are_drawn_where_plates_bear_all_contact(run):
    """Elsewhere the filter goes on by itself: what it makes of a frame that is left out changes no drawing."""
    outcome = extended(run.outcome)
    name, side = next(iter(sides(outcome).items()))
    late = torch.arange(len(side.used)) > len(side.used) // 2
    wild = torch.where(late, 5e4, 0.0).double()[:, None]
    used = side.used & ~late
    assert used.any()
    more = {"measured": side.measured + wild, "before": side.before + wild, "after": side.after + wild}
    curves = [draw_curves(replace(side, used=used)), draw_curves(replace(side, used=used, **more))]
    drawn = replace(wrenches(outcome)[name], used=used)
    other = replace(drawn, measured=drawn.measured + wild)
    trials = [_draw_trial(outcome, name, one, "a") for one in (drawn, other)]
    for calm, wrong in (curves, trials):
        assert re.sub(r"-[mp][0-9a-f]+", "", calm) == re.sub(r"-[mp][0-9a-f]+", "", wrong), "ids apart"


def test_bands_add_up_to_the_residual(run):
    """The squares of the bands are the square of the RMS of a residual that the filter lets through."""
    trial = next(side for side in sides(extended(run.outcome)).values()).trials[0]
    left = trial.motion.smoother(torch.randn(len(trial.used), 6, dtype=torch.float64))
    used = torch.cat([left[part] for part in trial.blocks()])
    whole = [float(used[:, k : k + 3].square().sum(1).mean().sqrt()) for k in (0, 3)]
    found = spectrum([(trial, left)]).square().sum(1).sqrt()
    torch.testing.assert_close(found, torch.tensor(whole, dtype=torch.float64), rtol=0.1, atol=0.0)


@pytest.mark.parametrize(
    ("rest", "said"),
    [
        (
            Adequacy(False, math.nan, math.nan, "cannot be told: no camera"),
            "remains unexplained cannot be told: no camera",
        ),
        (Adequacy(False, 0.4, 0.1, ""), "too little to matter"),
        (Adequacy(False, 1e-4, 0.3, ""), "slightly exceeds the noise"),
        (Adequacy(True, 1e-5, 0.6, "60 % of <b>it</b>"), "no known effect explains it: 60 %"),
    ],
)
def test_what_remains_is_said(run, rest, said):
    """Unknown, nothing and something are three sentences; without causes nothing is drawn or corrected."""
    none = Errors(math.nan, math.nan)
    outcome = replace(run.outcome, diagnosis=Diagnosis((), none, none, (), rest))
    section = diagnosis_section(outcome)
    assert section is not None and f"{len(CATALOGUE)} kinds tested" in section.finding
    assert said in " ".join(block.text for block in section.blocks if isinstance(block, Paragraph))
    assert not any(isinstance(block, Figure) for block in section.blocks)


@pytest.mark.parametrize(("nats", "said"), [(1.0, "left upper arm (odds 2.7 : 1"), (-1.0, None)])
def test_what_came_nearest_is_said(run, nats, said):
    """In words, where nothing is named and something is likelier than nothing; else not a word."""
    none, near = Errors(math.nan, math.nan), NearestEffect("wobbling_mass", ("upper_arm_l",), nats)
    found = Diagnosis((), none, none, (), Adequacy(False, 0.4, 0.1, ""), nearest=(near,))
    section = diagnosis_section(replace(run.outcome, diagnosis=found))
    assert section is not None
    assert said in section.finding if said else "nearest" not in section.finding


def test_what_would_have_been_shown_is_said(run):
    """In units that people read, with places; a fault that is not testable somewhere is in the table alone."""
    none, session = Errors(math.nan, math.nan), ("session",)
    sizes = (
        Detectable("time_offset", session, "lag_s", 0.00904),
        Detectable("plate_gain", ("plate_1",), "gain", 0.0187),
        Detectable("plate_gain", ("plate_2",), "gain", None),
        Detectable("plate_pose", ("plate_1",), "shift_m", 0.0191),
        Detectable("plate_pose", ("plate_1",), "rotation_rad", 0.0148),
        Detectable("marker_scale", session, "excess", None),
    )
    found = Diagnosis((), none, none, (), Adequacy(False, 0.4, 0.1, ""), detectable=sizes)
    section = diagnosis_section(replace(run.outcome, diagnosis=found))
    assert section is not None
    said = (
        "It would have shown, 8 times in 10 by its noise: a clock that is off from 9.0 ms and a wrong place from 19 mm."
    )
    assert said in section.finding
    (table,) = (b for d in section.blocks if isinstance(d, Details) for b in d.blocks if isinstance(b, Table))
    assert table.rows == (
        ("A clock that is off", "9.0 ms (the whole session)"),
        ("A wrong gain", "1.9 % (plate 1); not testable here (plate 2)"),
        ("A wrong place, shift", "19 mm (plate 1)"),
        ("A wrong place, rotation", "0.85° (plate 1)"),
        ("A wrong scale of the cameras", "not testable here"),
    )


@pytest.mark.parametrize(
    ("key", "size", "said"),
    [
        ("lag_s", 0.009, "9.0 ms"), ("gain", 0.041, "4.1 %"), ("roll_rad", 0.0175, "1.0°"), ("mass_kg", 2.0, "2.0 kg"),
        ("force_plate_N", 3.3, "3.3 N"), ("moment_plate_Nm", 0.68, "0.68 N m"), ("shift_1g_m", 0.0045, "4.5 mm"),
        ("coefficient_Ns_m", 1.6, "1.6 N s/m"), ("stiffness_N_m", 21.0, "21 N/m"), ("warmth_K", 0.5, "0.50 K"),
    ],
)  # fmt: skip
def test_sizes_are_in_units_that_people_read(key, size, said):
    """By the end of the key; an unknown one is told as it stands there."""
    assert sized(key, size) == said


@pytest.mark.parametrize(
    ("nats", "rule", "said"),
    [
        (
            -20.2,
            "heldout_density",
            "motion is more than a million times likelier without it: not corrected.",
        ),
        (-2.0, "heldout_density", "motion is 7 times likelier without it: not corrected"),
    ],
)
def test_what_held_out_motion_contradicts_is_said(run, nats, rule, said):
    """In words, with what it says against it."""
    none = Errors(math.nan, math.nan)
    against = Refuted("wobbling_mass", ("upper_arm_l",), nats, rule, {})
    found = Diagnosis((), none, none, (), Adequacy(False, 0.4, 0.1, ""), refuted=(against,))
    section = diagnosis_section(replace(run.outcome, diagnosis=found))
    assert section is not None
    assert "mass of the left upper arm, but held-out " in section.finding and said in section.finding


def test_gains_are_said_as_they_are():
    """Errors that fall, rise or stay are called so; without held-out trials nothing is claimed."""
    before = {"force_rmse_N": 18.0, "moment_rmse_Nm": 2.0, "marker_rmse_mm": 1.5}
    said = gained(before, before | {"force_rmse_N": 16.1, "moment_rmse_Nm": 2.5}, "held-out")
    assert "force error falls from 18.0 to 16.1 N" in said and "moment error rises" in said and "marker" not in said
    assert "stays at 18.0 N" in gained(before, before, "held-out")
    assert gained(dict.fromkeys(before, math.nan), before, "held-out").startswith("No held-out trial")
