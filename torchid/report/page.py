"""Sections into one HTML file without anything from outside, and without scripts but those of a replay."""

import re
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from torchid.errors import DataError
from torchid.report.blocks import Section
from torchid.report.body import body_section
from torchid.report.consistent import consistent_section
from torchid.report.data_handling import handling_section
from torchid.report.diagnosis import diagnosis_section
from torchid.report.facts import wrenches
from torchid.report.forces import forces_section
from torchid.report.gait import gait_section
from torchid.report.joints import joints_section
from torchid.report.method import method_section
from torchid.report.skeleton import skeleton_section
from torchid.report.summary import head_section
from torchid.scene.embedded import OPENER, EmbeddedPage, hashed
from torchid.session import Outcome
from torchid.session.joint_cycles import joint_cycles
from torchid.session.judging import quality_of
from torchid.storage.files import write_text
from torchid.storage.provenance import versions
from torchid.wording import bind, clean

INERT = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
"""Policy of a page without scripts; with a replay only scripts with its hashes run, whoever writes others into it."""

_TYPED = re.compile("`([^`]+)`")
STOPPED, REFUSED = "Not everything could be identified.", "No body could give this result."
"""What is said above a failure."""


def sections(
    outcome: Outcome, failure: DataError | None = None, replay: EmbeddedPage | None = None
) -> list[Section]:  # fmt: skip
    """All sections that the outcome has data for, in the order in which they are read."""
    outcome = replace(outcome, quality=quality_of(outcome, failure))
    forces = wrenches(outcome)
    found = [
        head_section(outcome, forces, failure),
        skeleton_section(outcome, replay),
        body_section(outcome),
        forces_section(outcome, forces),
        diagnosis_section(outcome),
        gait_section(joint_cycles(outcome)),
        joints_section(outcome),
        consistent_section(outcome),
        handling_section(outcome),
        method_section(outcome),
    ]
    return [section for section in found if section is not None]


def _maker() -> str:
    version = versions()["torchid"]
    return f"torchid {version}" if version[0].isdigit() else "torchid, run from its source tree"


def render_report(outcome: Outcome, failure: DataError | None = None, replay: EmbeddedPage | None = None) -> str:
    """The page as text; every name from the data is escaped by the template."""
    title = f"{clean(outcome.config.subject.name)}: identified body model"
    return render_page(title, sections(outcome, failure, replay), failure, replay)


def running(script: str) -> str:
    """The policy of a page on which one script runs and no other."""
    return f"{INERT}; script-src {hashed(script)}"


def _shown(text: str) -> Markup:
    """Text of the page: numbers stay with their units, what stands between grave accents is typed as it is."""
    return Markup(_TYPED.sub(r"<code>\1</code>", str(escape(bind(text)))))  # noqa: S704 - escaped before


def render_page(
    title: str,
    chapters: Sequence[Section],
    failure: DataError | None = None,
    replay: EmbeddedPage | None = None,
    styles: str = "",
    script: str = "",
) -> str:
    """Sections as one page of text; every name from the data is escaped by the template.

    Args:
        chapters: in the order in which they are read.
        failure: why the rest was not found; said at the top.
        styles: more rules beside those that all pages share.
        script: that runs, of the package's own; a page with a replay has the replay's.
    """
    environment = Environment(
        loader=PackageLoader("torchid.report", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["bind"] = _shown
    css = files("torchid.report").joinpath("page.css").read_text(encoding="utf-8") + styles
    return environment.get_template("page.html.j2").render(
        title=title,
        css=Markup(css),  # noqa: S704 - the package's own file
        sections=list(chapters),
        opener=Markup(OPENER if replay else script),  # noqa: S704 - the package's own
        policy=Markup(replay.policy if replay else running(script) if script else INERT),  # noqa: S704 - quotes it needs, of our own making
        failure=None if failure is None else clean(str(failure), 1000),
        alarm=REFUSED if failure is not None and failure.code.startswith("result.") else STOPPED,
        maker=_maker(),
    )


def write_report(
    outcome: Outcome, path: Path, failure: DataError | None = None, replay: EmbeddedPage | None = None
) -> None:  # fmt: skip
    """Write ``report.html``: one self-contained page about a run.

    Args:
        failure: why the rest was not found; said at the top.

    Raises:
        InputError: the file cannot be written.
    """
    write_text(path, render_report(outcome, failure, replay))
