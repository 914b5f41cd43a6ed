"""What was chosen from a folder, in one screen."""

from collections.abc import Iterator
from pathlib import Path

from torchid.folder.config_text import LONG
from torchid.folder.proposal import Proposal
from torchid.wording import clean, listing

UNITS = {"mass_kg": ("mass", "kg"), "height_m": ("stature", "m"), "sex": ("sex", ""), "age_years": ("age", "years")}
MOST = 12
"""Choice. Names or reasons that are listed; the config has them all."""


def said_of(proposal: Proposal, config: Path) -> Iterator[tuple[str, str]]:
    """Return lines with what stands before each.

    Args:
        proposal: the session.
        config: into which it was written.
    """
    yield "subject", ", ".join((proposal.name, *_facts(proposal)))
    markers = proposal.markers
    rest = f"; by how they move, if that is sure: {listing(markers.unknown)}" if markers.unknown else ""
    yield "markers", markers.said + rest
    for role, word in (("static", "standing"), ("fit", "fit"), ("heldout", "held out")):
        names = [use.of.name + (f" ({use.mend})" if use.mend else "") for use in proposal.of(role)]
        yield word, listing(names, MOST)
    left = proposal.of("")
    yield from (("left out", f"{use.of.name}: {use.why}") for use in left[:MOST])
    if len(left) > MOST:
        yield "", f"and {len(left) - MOST} more (see {config})"
    yield from (("in doubt", clean(doubt, LONG)) for doubt in proposal.doubts)


def _facts(proposal: Proposal) -> Iterator[str]:
    person, sources = proposal.told.person.known, proposal.told.sources
    for key, (word, unit) in UNITS.items():
        if key in person:
            value = person[key]
            said = f"{value:.5g} {unit}" if isinstance(value, float) else str(value)
            yield f"{said} ({sources[key]})"
        else:
            yield f"{word} not stated"
