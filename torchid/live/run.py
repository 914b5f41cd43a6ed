"""``torchid live``: a config's subject, a stream, and the estimate that comes of it."""

import importlib
import math
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

from torchid.config import Config
from torchid.errors import ConfigError, DataError
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import track
from torchid.inertia.identify import Identified
from torchid.io.files import files_on_disk
from torchid.live.estimation.identifier import LiveSubject
from torchid.live.estimation.pipeline import Moment, Pipeline
from torchid.live.exercises.exercises import Possibilities
from torchid.live.exercises.guidance import make_guide
from torchid.live.sources.recorder import Recorder
from torchid.live.sources.stream import Replay, Source
from torchid.model.model import InertialPrior
from torchid.run.sequence import GEOMETRY, UNKEYED, run_key
from torchid.session import Outcome, Session
from torchid.session.fitting import fit_session, given_mass
from torchid.session.following import Following
from torchid.session.opening import open_as_recorded, read_session, setup_of
from torchid.session.other_contacts import refuse_plates
from torchid.session.people import subject_prior
from torchid.session.standing import follow_each, standing_weight
from torchid.session.tables import identified_table
from torchid.session.unseen import refuse_unseen
from torchid.storage.files import file_sha256, write_json
from torchid.storage.provenance import stage_key
from torchid.storage.results import OutputFolder

CUTOFF_HZ = 6.0
"""Cited. Of the filter, where the config leaves it to recordings that have not been made yet: Winter, Biomechanics and
Motor Control of Human Movement, 4th ed. (2009), section 3.4.4, for walking."""
REPLAY, XDF, LSL, QUALISYS = "replay:", "xdf:", "lsl", "qualisys"
RESULT = "live.json"
OnStage = Callable[[str, float], None]


class Display(Protocol):
    """What shows a stream, such as ``live.display.page.Page``."""

    address: str

    def show(self, moment: Moment) -> None:
        """Take up what was found in a packet, and return at once."""

    def __enter__(self) -> "Display": ...

    def __exit__(self, *_: object) -> None: ...


def run_live(
    config: Config,
    source: str | Source,
    speed: float = 1.0,
    seconds: float = math.inf,
    record: Path | None = None,
    progress: OnStage = lambda stage, share: None,
    page: Callable[[LiveSubject, Source], Display] | None = None,
    opened: Callable[[str], None] = lambda address: None,
    possibilities: Possibilities | None = None,
    half_life_s: float = math.inf,
) -> dict[str, Any]:
    """Identify a subject while a stream comes, and leave the estimate in ``live.json`` of the config's ``out``.

    Args:
        config: the subject, its static trial, and for a replay the trial itself.
        source: ``replay:TRIAL``, a trial of the config; ``lsl`` or ``lsl:NAME``, streams of Lab Streaming Layer;
            ``xdf:FILE``, a recording of such streams; ``qualisys``, ``qualisys:HOST`` or ``qualisys:HOST:PORT``,
            Qualisys Track Manager; or a source of the caller's own.
        speed: multiple of a recording's own pace; infinite: as fast as it is worked off.
        record: folder for what comes; None keeps nothing. A disk that gets full ends the recording alone.
        page: opens what shows the stream; None shows nothing.
        possibilities: of a subject who is to be advised; None gives no advice.
        half_life_s: time after which a row counts half, for a body that changes; infinite: all count alike.

    Returns:
        Figures of speed, loss, mass and progress, as ``torchid live`` prints them, and what each exercise has brought.

    Raises:
        TorchidError: the config, its static trial or the source is at fault, a file cannot be written, or the stream
            does not support a result.
    """
    if isinstance(source, str):
        _refuse_other(source, config)
    with OutputFolder(config.out, beside=True) as folder:
        folder.claim((RESULT,))
        recorded = _replayed(source, config, speed)  # what is wrong with it is said before the geometry is fitted
        subject, base = prepare_subject(config, folder, progress)
        subject = replace(subject, half_life_s=half_life_s)
        if possibilities is not None:
            subject = guided(subject, possibilities)
        stream = recorded or (_opened(source, speed) if isinstance(source, str) else source)
        refuse_plates(config.contact, stream.plates)
        progress("live", 0.0)
        performance, identified, guidance, (fit, prior) = _streamed(
            subject, stream, record, seconds, page, opened, progress
        )  # fmt: skip
        table = identified_table(replace(base, fit=fit, prior=prior, identified=identified))
        write_json(folder.path(RESULT), table)
        progress("estimate", 1.0)
    total = table["total_mass"]
    return {
        **performance,
        "geometry": "run" if subject.static is None else "static",
        "mass_kg": {"value": float(total["value_kg"]), "sd": float(total["sd_kg"])},
        "progress": {name: float(one["progress"]) for name, one in table["segments"].items()},
        **({} if guidance is None else {"guidance": guidance}),
    }


def prepare_subject(config: Config, folder: OutputFolder, progress: OnStage) -> tuple[LiveSubject, Outcome]:
    """Geometry and prior of a config's subject, from a run of it that is finished, else from its static trials alone.

    Args:
        folder: where the geometry is stored, and taken up again.

    Returns:
        The subject, and an outcome that has everything but an inertia.

    Raises:
        ConfigError: ``live.static`` without a static trial, ``contact.live`` where intervals tell when a contact bears.
        TorchidError: as ``read_session`` and ``fit_session``.
    """
    _refuse_intervals(config)
    static = tuple(file for file in config.trials if file.role == "static")
    if not static:
        raise ConfigError(
            "live.static", "no trial tells the geometry before the stream begins", place="trials",
            found=", ".join(f"{file.name} ({file.role})" for file in config.trials) or "no trials",
            remedy="Give a standing trial the role static",
        )  # fmt: skip
    # Standing shows nothing of how skin slides: markers scatter as the options say.
    stated = replace(config.geometry, reestimate_sigma=False)
    alone = config.model_copy(update={"trials": static, "geometry": stated})
    progress("read", 0.0)
    session = read_session(alone, folder.aside)
    finished = None
    with suppress(OSError):  # a trial that is not there has no part in a finished run
        finished = folder.stored(GEOMETRY, run_key(config.body))
    fit = finished or _from_standing(alone, session, folder, progress)
    cutoff_hz = CUTOFF_HZ if config.motion.cutoff_hz == "auto" else float(config.motion.cutoff_hz)
    tracked = {name: track(fit, trial.markers) for name, trial in session.trials.items()}
    prior = subject_prior(config.model, config.subject, fit)
    way = Following.of(config, cutoff_hz)
    followed = {one.name: one for one in follow_each(fit, session, tracked.__getitem__, way, prior)}
    outcome = Outcome(config, session, fit, fit, cutoff_hz, followed, followed, prior, prior)
    if config.inertia.refuse:
        refuse_unseen(fit, prior)
    weight = standing_weight(followed.values(), session, config.subject.mass_kg)
    assert session.static is not None
    refining = session.static.markers if finished is None else None
    return LiveSubject(
        config, fit, prior, given_mass(config.inertia, config.subject, outcome), weight, cutoff_hz, refining
    ), outcome


def _refuse_intervals(config: Config) -> None:
    """Intervals are of trials that are recorded already: in a stream they would never bear."""
    for name, one in config.contact.others.items():
        if isinstance(one.when, dict) and one.when:
            raise ConfigError(
                "contact.live", "a stream has no intervals in which a contact bears",
                place=f"contact.others.{name}.when", found=", ".join(one.when),
                remedy="Give when: {at_m: [x, y, z]}, always, or the plate that measures it",
            )  # fmt: skip


def _from_standing(config: Config, session: Session, folder: OutputFolder, progress: OnStage) -> GeometryFit:
    paths = [path for file in config.trials for path in (file.file, file.forces) if path is not None]
    own = config.model_dump(mode="json", exclude={**UNKEYED, "diagnosis": True, "inertia": True})
    key = stage_key(inputs=[file_sha256(one) for path in paths for one in files_on_disk(path)], config=own)
    return folder.stage("live_geometry", key, lambda: fit_session(config.geometry, session, True, progress))


def guided(subject: LiveSubject, possibilities: Possibilities) -> LiveSubject:
    """Return the subject with exercises from which it is advised; takes seconds.

    Args:
        subject: whose geometry and prior are known.
        possibilities: what it can be asked for.

    Raises:
        ConfigError: as ``make_guide``.
    """
    config = subject.config
    guide = make_guide(
        subject.fit, subject.prior, subject.mass, config.subject.sex, subject.cutoff_hz, possibilities,
        config.motion.filter,
    )  # fmt: skip
    return replace(subject, guide=guide)


def _streamed(
    subject: LiveSubject, source: Source, record: Path | None, seconds: float,
    page: Callable[[LiveSubject, Source], Display] | None, opened: Callable[[str], None], progress: OnStage,
) -> tuple[dict[str, Any], Identified, dict[str, Any] | None, tuple[GeometryFit, InertialPrior]]:  # fmt: skip
    stream = (source.labels, source.rate_hz, source.plates, source.force_rate_hz)
    with ExitStack() as stack:
        recorder = None if record is None else stack.enter_context(Recorder(record, *stream))
        if isinstance(source, AbstractContextManager):
            stack.enter_context(source)
        show: Callable[[Moment], None] = lambda moment: None  # noqa: E731
        if page is not None:
            display = stack.enter_context(page(subject, source))
            opened(display.address)
            show = display.show
        pipeline = stack.enter_context(Pipeline(subject, source, recorder))
        with suppress(KeyboardInterrupt):  # how a session ends that has no end of its own
            pipeline.run(seconds, show)
        if recorder is not None:
            recorder.close()  # before it is said how far it goes
        performance = pipeline.performance()
        progress("live", 1.0)
        progress("estimate", 0.0)
        return performance, pipeline.finish(), pipeline.guidance(), pipeline.geometry


def _replayed(source: str | Source, config: Config, speed: float) -> Source | None:
    """A trial of the config as a source, None where the source is another."""
    if not isinstance(source, str) or not source.startswith(REPLAY):
        return None
    name = source.removeprefix(REPLAY)
    trial = open_as_recorded(setup_of(config), next(file for file in config.trials if file.name == name))
    if trial.forces is None:
        raise DataError(
            "live.no_forces", "nothing can be identified without force plates",
            source=trial.parameters.get("file", ""), place=f"trial {trial.name}", found="markers alone",
            remedy="Give its forces, or replay a trial that has some",
        )  # fmt: skip
    return Replay(trial, speed)


def _opened(source: str, speed: float) -> Source:
    if source.startswith(XDF):
        return _extra("torchid.live.sources.xdf").replay_xdf(Path(source.removeprefix(XDF)), speed)
    if _is(QUALISYS, source):
        return _extra("torchid.live.sources.qualisys").QualisysSource(source.removeprefix(QUALISYS).removeprefix(":"))
    return _extra("torchid.live.sources.lsl").LslSource(source.removeprefix(LSL).removeprefix(":"))


def _is(kind: str, source: str) -> bool:
    return source == kind or source.startswith(f"{kind}:")


def _extra(module: str) -> ModuleType:
    """A module that needs packages of the extra ``live``."""
    try:
        return importlib.import_module(module)
    except (ImportError, RuntimeError) as error:  # RuntimeError: pylsl without its library
        raise ConfigError(
            "live.extra", "needs packages that are not installed", place="--source", found=str(error)[:160],
            remedy="Install them: pip install 'torchid[live]'",
        ) from error  # fmt: skip


def _refuse_other(source: str, config: Config) -> None:
    """Refuse what is no source, and before the geometry is found a package that is missing or a file that is."""
    names = [file.name for file in config.trials]
    if source.startswith(REPLAY) and source.removeprefix(REPLAY) in names:
        return
    if source.startswith(XDF) and Path(source.removeprefix(XDF)).is_file():
        _extra("torchid.live.sources.xdf")
    elif _is(LSL, source):
        _extra("torchid.live.sources.lsl")
    elif _is(QUALISYS, source):
        _extra("torchid.live.sources.qualisys").address_of(source.removeprefix(QUALISYS).removeprefix(":"))
    else:
        raise ConfigError(
            "live.source", "is no source", place="--source", found=source[:80],
            remedy=f"Give {LSL}, {LSL}:NAME, {QUALISYS}, {QUALISYS}:HOST, {QUALISYS}:HOST:PORT, {XDF}FILE with a file "
            f"that is there, or {REPLAY}TRIAL with one of "
            + (", ".join(names) or "the trials of a config that has some"),
        )  # fmt: skip
