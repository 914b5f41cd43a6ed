"""What every recording of a folder holds, as far as its use in a session is decided by it."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from torchid.checks.recording import TrialCheck
from torchid.checks.report import Given, Refusal, check_recordings
from torchid.conventions import SAMPLE_LOADED_N
from torchid.io.files import recording_name, unique_names
from torchid.io.pairing import find_recordings, trial_name
from torchid.recording import Markers, Trial

SEEN = 0.5
"""Choice. A label counts where it is seen in this share of the frames."""
MOVING = 0.9
"""Choice. A body is as still as the marker of which nine in ten move less."""
MOST_FRAMES = 2000
"""Resolution. Frames that tell how far markers wander."""
SOME_FRAMES = 150
"""Resolution. Frames that are kept, of which places and motion tell markers whose labels say nothing."""
STATED = ("subject", "mass_kg", "height_m", "sex", "age_years")
"""Facts of a file about whom it shows."""


@dataclass(frozen=True)
class Surveyed:
    """A recording and what of it decides its use."""

    name: str
    file: Path
    forces: Path | None
    check: TrialCheck | None = None
    """What is wrong with it; None where it cannot be read."""
    refusal: Refusal | None = None
    """Why it cannot be read."""
    labels: tuple[str, ...] = ()
    """That are seen in half of the frames."""
    stated: Mapping[str, str] = field(default_factory=dict)
    """Subject, mass, stature and sex, where the file states them."""
    wander_m: float = 0.0
    """How far markers are from their mean places: nine in ten are nearer."""
    travel_m: float = 0.0
    """How far the middle of the body comes along the floor."""
    carried: float = 0.0
    """Share of the time that plates carry somebody."""
    heights: Mapping[str, float] = field(default_factory=dict)
    """Median height of each label above the lowest one [m]."""
    some: Markers | None = None
    """Some frames of the labels that are seen."""
    computed: tuple[str, ...] = ()
    """Labels that were left out because they move as if computed from others."""

    @property
    def seconds(self) -> float:
        """Duration."""
        return self.check.duration if self.check else 0.0

    @property
    def has_forces(self) -> bool:
        """Whether plates carry somebody at some time."""
        return self.carried > 0.0


def survey(folder: Path, progress: Callable[[str, float], None] = lambda stage, part: None) -> tuple[Surveyed, ...]:
    """Read every recording below a folder, and judge its forces as a run does.

    Args:
        folder: with C3D files, or TRC files beside MOT or STO files (``torchid.io.pairing``).
        progress: gets the stage and the part of it that is done.

    Raises:
        InputError: ``check.empty`` for a folder without recordings.
    """
    pairs = find_recordings(folder)
    names = names_of([file for file, _ in pairs], folder)
    found = {name: Surveyed(name, *files) for name, files in zip(names, pairs, strict=True)}
    asked: list[str] = []

    def given() -> Iterator[Given]:
        for name, one in tuple(found.items()):
            progress("reading", len(asked) / len(found))
            asked.append(name)
            yield Given(name, one.file, one.forces)

    def keep(trial: Trial) -> None:
        found[trial.name] = _facts(found[trial.name], trial)

    for said in check_recordings(given(), keep, one_session=True):
        if isinstance(said, TrialCheck):
            found[said.name] = replace(found[said.name], check=said)
        else:  # of the one that was asked for last
            found[asked[-1]] = replace(found[asked[-1]], refusal=said)
    progress("reading", 1.0)
    return tuple(found.values())


def names_of(files: list[Path], folder: Path) -> list[str]:
    """Return a name for each recording: of its file without words such as ``markers``, else of its folder.

    Names that are alike are lengthened by the folders above, and numbered where that does not part them.
    """
    own = [trial_name(file) or file.parent.name for file in files]
    with_folder = [
        f"{file.parent.name}_{name}" if trial_name(file) else name for file, name in zip(files, own, strict=True)
    ]
    whole = ["_".join((*file.relative_to(folder).parent.parts, recording_name(file))) for file in files]
    names = [plain_name(name) for name in own]
    for longer in (with_folder, whole):
        alike = [k for k, name in enumerate(names) if names.count(name) > 1]
        for k in alike:
            names[k] = plain_name(longer[k])
    return unique_names(names)


def plain_name(text: str) -> str:
    """Return a name without blanks and signs that a file's name or a config could not have."""
    return re.sub(r"[^\w.+-]+", "_", text).strip("_.") or "_"


def _facts(of: Surveyed, trial: Trial) -> Surveyed:
    """Return a recording with what its trial shows."""
    position = trial.markers.position
    often = position[..., 0].isfinite().double().mean(dim=0) >= SEEN
    seen = position[:, often]
    labels = tuple(label for label, k in zip(trial.markers.labels, often.tolist(), strict=True) if k)
    if not labels:
        return of
    some = seen[:: max(1, len(seen) // MOST_FRAMES)]
    away = (some - some.nanmean(dim=0)).norm(dim=-1)
    height = seen[..., 2].nanmedian(dim=0).values
    return replace(
        of,
        labels=labels,
        stated={key: trial.parameters[key] for key in STATED if trial.parameters.get(key)},
        wander_m=float(away.nanquantile(MOVING)),
        travel_m=_travel(seen),
        carried=_carried(trial),
        heights=dict(zip(labels, (height - height.min()).tolist(), strict=True)),
        some=trial.markers.select(labels).frames(slice(None, None, -(-len(seen) // SOME_FRAMES))),
        computed=trial.computed,
    )


def _travel(position: Float[Tensor, "frames markers 3"]) -> float:
    """Return how far the middle of the markers comes along the floor [m]."""
    middle = position[..., :2].nanmean(dim=1)
    middle = middle[middle.isfinite().all(dim=1)]
    return float((middle.amax(dim=0) - middle.amin(dim=0)).norm()) if len(middle) else 0.0


def _carried(trial: Trial) -> float:
    """Return the share of the time in which plates carry somebody."""
    if trial.forces is None or not len(trial.forces.time):
        return 0.0
    return float((trial.forces.total[:, 2].nan_to_num() > SAMPLE_LOADED_N).double().mean())
