"""What was repaired, chosen or left out on the way from the files to the fits."""

import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import PurePath

import torch

from torchid.report.blocks import Paragraph, Section, Table
from torchid.session import Outcome
from torchid.wording import ABSENT, clean, listing, merge, number, pattern, percent, plural


@dataclass(frozen=True)
class NoteLine:
    """Notes of one kind that say the same, but for numbers."""

    code: str
    message: str
    where: str
    """Files or trials, empty for the whole session."""
    count: int


def grouped(outcome: Outcome) -> list[NoteLine]:
    """All notes, those of one code and wording in one line, in the order of their first occurrence."""
    groups: dict[tuple[str, str], list[tuple[str, str]]] = defaultdict(list)
    trial_of = _trial_of(outcome)
    for note in outcome.notes:
        source = trial_of.get(note.source, PurePath(note.source).name if note.source else "")
        entry = (note.message, source)
        group = groups[note.code, pattern(note.message)]
        if entry not in group:
            group.append(entry)
    lines = []
    for (code, _), entries in groups.items():
        sources = list(dict.fromkeys(source for _, source in entries if source))
        message = clean(merge([message for message, _ in entries]), 600)
        lines.append(NoteLine(code, message, _where(outcome, sources), len(entries)))
    return lines


def _trial_of(outcome: Outcome) -> dict[str, str]:
    """Trial by file."""
    files = outcome.session.files
    return {str(path): name for name, file in files.items() for path in (file.file, file.forces) if path is not None}


def _where(outcome: Outcome, sources: list[str]) -> str:
    if len(sources) > 1 and set(outcome.session.trials) <= set(sources):
        return f"all {len(outcome.session.trials)} trials"
    return listing(sources, 12) if sources else ""


def handling_section(outcome: Outcome) -> Section:
    """The section on data handling."""
    lines = sorted(grouped(outcome), key=lambda line: line.code)
    rows = tuple((line.code, line.where or "session", _sentence(line.message)) for line in lines)
    smoother = next(iter(outcome.followed.values())).motion.smoother
    how = "chosen from the markers' spectra" if outcome.config.motion.cutoff_hz == "auto" else "set in the config"
    kind = {"spline": "smoothing spline (response of a 3rd-order Butterworth run both ways)",
            "butterworth": "2nd-order Butterworth, run both ways"}[smoother.kind]  # fmt: skip
    blocks = (
        Paragraph(
            f"Kinematics and forces pass the same zero-lag low-pass filter: {kind}, −3 dB at "
            f"{number(outcome.cutoff_hz)} Hz ({how}). Marker errors are taken before the filter."
        ),
        Table("Notes", ("Code", "Where", "What was found or done"), rows, text=3, wrap=True),
        _gaps(outcome),
    )
    return Section("data", "Data handling", _finding(outcome, lines), blocks)


def _sentence(text: str) -> str:
    return re.sub(r"^\w", lambda match: match[0].upper(), text)


def _finding(outcome: Outcome, lines: list[NoteLine]) -> str:
    missing, samples = 0, 0
    for item in outcome.followed.values():
        missing += int((~torch.isfinite(item.tracked.error)).sum())
        samples += item.tracked.error.numel()
    excluded = [item.contact for item in outcome.followed.values() if item.contact is not None]
    frames = sum(len(contact.used) for contact in excluded)
    left = frames - sum(int(contact.used.sum()) for contact in excluded)
    said = (
        f"{plural(len(lines), 'kind')} of notes were made; {percent(missing / max(samples, 1), 1)} of the marker "
        "samples are missing"
    )
    if frames:
        said += f", and {left} of {frames} frames with forces were left out of all force figures"
    return f"{said}."


def _gaps(outcome: Outcome) -> Table:
    rows = []
    for name, item in outcome.followed.items():
        error, contact = item.tracked.error, item.contact
        present = torch.isfinite(error).any(dim=0)
        gaps = ~torch.isfinite(error)[:, present]
        rows.append((
            clean(name), str(len(error)), str(int((~present).sum())),
            percent(int(gaps.sum()) / max(1, gaps.numel()), 1),
            str(int((~item.tracked.observable).sum())),
            ABSENT if contact is None else str(contact.excluded),
            ABSENT if contact is None else str(len(contact.used) - int(contact.used.sum())),
        ))  # fmt: skip
    head = ("Trial", "Frames", "Markers never seen", "Samples missing of the others",
            "Frames that markers do not determine", "Frames with a foot beside the plates",
            "Frames left out in all")  # fmt: skip
    return Table("Gaps and frames left out", head, tuple(rows))
