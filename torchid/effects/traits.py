"""Enumerations that tell effects apart beside what they act on; each effect declares one member of each, once."""

from enum import Enum, auto
from typing import ClassVar, final


class Origin(Enum):
    """The one whose error an effect is."""

    LABORATORY = auto()
    """Something that a laboratory did, or that a body does now: nobody has it unless it is named."""
    IMITATED = auto()
    """A laboratory did something of which living bodies do a little at every place: what is named must stand out from
    the other places. All places have equally many parameters."""
    BODY = auto()
    """Every living body has some of it at some places: it is named where it is there, and counted apart."""
    WHOLE_BODY = auto()
    """Every living body has some of it, all over at once: it is looked for beside all single places that are named."""
    RECORD = auto()
    """A record of the subject is wrong, not a measurement."""


class Occurrence(Enum):
    """The times at which an effect is there."""

    THROUGHOUT = auto()
    """The effect is in the whole of every trial that its place includes, with the same parameters."""
    INTERVALS = auto()
    """The effect comes and goes: its places need intervals."""
    SOME_RECORDINGS = auto()
    """The effect is a state of single recordings: only another recording itself says whether it is there too."""
    ANEW_PER_TRIAL = auto()
    """The effect is there throughout, with parameters of its own in every trial."""


class Response(Enum):
    """The way in which the changes that an effect makes depend on its parameters."""

    LINEAR = auto()
    NONLINEAR = auto()
    """Columns taken where the effect was found, times the parameters there, are all of what it does."""
    TIME_SHIFT = auto()
    """The effect shifts readings in time. Its columns are made of what plates measured: taking the effect out of that
    takes the columns away (``Effect.undone``)."""
    ALL_OR_NOTHING = auto()
    """The one parameter is one, or zero. The columns are made of what plates measured, as those of a shift in time."""


class ColumnNoise(Enum):
    """The treatment of the noise of markers in an effect's columns."""

    NEGLECTED = auto()
    """Noise is neglected: the columns go with places or speeds, as those of ropes and drag do, or with no motion."""
    SHRUNK = auto()
    """The columns are believed as far as the total is: they are accelerations of displaced bodies."""
    CORRECTED = auto()
    """Besides, they share the noise of the total, which is taken off (corrected scores): they follow accelerations of
    the found motion or the loads that these make. If the effect changes readings, it maps every sample alike."""


class Correction(Enum):
    """The way in which an extended model takes a named effect into account."""

    WRENCH = auto()
    """The effect's share of the plates' total is taken off."""
    MARKERS = auto()
    """The markers are moved back to where the bodies carry them, and geometry is fitted again."""
    READING = auto()
    """The plates' readings are put right (``Effect.undone``) before anything is fitted, standing included."""
    LABELS = auto()
    """The markers of the place exchange their names in its intervals, and geometry is fitted again."""
    RECORD = auto()
    """The record takes the values that were found, see ``RecordEffect.entries``; no force is corrected."""


class Proof(Enum):
    """The kind of measurement that can bear an effect out without a body model."""

    FORCES = auto()
    """Readings of plates, and the way of the centre of mass (``torchid.model_free``)."""
    DISTANCES = auto()
    """Distances between the markers of a segment (``torchid.checks.marker_tracks``)."""
    SMOOTHNESS = auto()
    """Quick motion that markers still show."""
    NOTHING = auto()
    """Nothing that a session records."""


class Site(Enum):
    """The kind of things that the names of an effect's places name; ``("session",)`` is a place of every kind."""

    SESSION = auto()
    TRIAL = auto()
    PLATE = auto()
    MARKER = auto()
    SEGMENT = auto()
    JOINT = auto()


class Traits:
    """The enumerations of an effect, and what the diagnosis asks of them, derived here and nowhere else."""

    origin: ClassVar[Origin] = Origin.LABORATORY
    occurrence: ClassVar[Occurrence] = Occurrence.THROUGHOUT
    response: ClassVar[Response] = Response.LINEAR
    column_noise: ClassVar[ColumnNoise] = ColumnNoise.NEGLECTED
    proof: ClassVar[Proof] = Proof.FORCES
    mistaken: ClassVar[float] = 0.04
    """Estimator. Share of sound sessions that seem to have as much of it as one that has it, by a body model alone
    (``torchid.diagnosis.evidence.apparent``): of thirteen public ones, beside four that are like all effects together;
    this is where none does. Zero: it is there in full or not at all, and nothing else looks like it."""
    correction: ClassVar[Correction] = Correction.WRENCH

    @final
    @property
    def bodily(self) -> bool:
        """True if every living body has some of it."""
        return self.origin in (Origin.BODY, Origin.WHOLE_BODY)

    @final
    @property
    def whole_body(self) -> bool:
        """True if it is all over the body at once."""
        return self.origin is Origin.WHOLE_BODY

    @final
    @property
    def on_record(self) -> bool:
        """True if a record of the subject is wrong."""
        return self.origin is Origin.RECORD

    @final
    @property
    def widespread(self) -> bool:
        """True if living bodies do some of the same at every place."""
        return self.origin is Origin.IMITATED

    @final
    @property
    def intermittent(self) -> bool:
        """True if it comes and goes."""
        return self.occurrence is Occurrence.INTERVALS

    @final
    @property
    def per_recording(self) -> bool:
        """True if it is a state of single recordings."""
        return self.occurrence is Occurrence.SOME_RECORDINGS

    @final
    @property
    def per_trial(self) -> bool:
        """True if its parameters are others in every trial."""
        return self.occurrence is Occurrence.ANEW_PER_TRIAL

    @final
    @property
    def nonlinear(self) -> bool:
        """True if its columns must be taken where it was found."""
        return self.response is Response.NONLINEAR

    @final
    @property
    def shifts_time(self) -> bool:
        """True if it shifts the plates' readings in time."""
        return self.response is Response.TIME_SHIFT

    @final
    @property
    def all_or_nothing(self) -> bool:
        """True if its one parameter is one or zero."""
        return self.response is Response.ALL_OR_NOTHING

    @final
    @property
    def reads_measured(self) -> bool:
        """True if its columns are what taking it out of the plates' readings takes away (``undone``)."""
        return self.response in (Response.TIME_SHIFT, Response.ALL_OR_NOTHING)

    @final
    @property
    def follows_acceleration(self) -> bool:
        """True if its columns share the noise of the total, which is taken off."""
        return self.column_noise is ColumnNoise.CORRECTED

    @final
    @property
    def noisy(self) -> bool:
        """True if its columns hold noise of markers that counts."""
        return self.column_noise is not ColumnNoise.NEGLECTED
