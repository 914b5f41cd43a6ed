"""Named causes in plain words: what, where, how much, when and how sure."""

import math
from collections.abc import Callable
from dataclasses import replace

import torch

from torchid.conventions import GRAVITY
from torchid.diagnosis.verdict.records import Alternative, Cause
from torchid.effects.place import Interval
from torchid.effects.recommendations import tell_apart
from torchid.report.effect_words import NOUN, called, place
from torchid.report.quantities import BODY, ROOM, length, much, of, parts, size, vector
from torchid.report.text import clean, listing, number, percent, segment, stated

DEGREES = 180.0 / math.pi
CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
CERTAIN = 2.0
"""Standard deviations from which a rest length is worth a word."""
FEW = 6
"""Intervals that are listed."""
WORTH = 0.01
"""Probability below which a rival is not worth a word."""
WORDS = ((0.99, "practically certain"), (0.9, "very likely"), (0.66, "likely"), (0.5, "more likely than not"),
         (0.0, "only one of several possibilities"))  # fmt: skip


def told(cause: Cause) -> str:
    """The cause as one sentence."""
    sentence = STORY[cause.effect](cause) if cause.effect in STORY else NOUN.get(cause.effect, cause.effect)
    sentence = sentence[0].upper() + sentence[1:]
    return f"{sentence}{_when(cause.when, cause.effect)}."


def likely(cause: Cause) -> str:
    """How sure that is, in words and as a chance."""
    sure = next(word for least, word in WORDS if cause.confidence >= least)
    return f"{sure} ({chance(cause.confidence)})"


def surely(cause: Cause) -> str:
    """How sure that is, and what else it could be."""
    said = [likely(cause)]
    for twin in cause.indistinguishable:
        part = f"Of that, {chance(twin.confidence)} is {called(twin)}, which cannot be told apart here"
        said.append(f"{part}; to tell them apart, record {tell_apart(cause.effect, twin.effect)}")
        if twin.parameters is not None and twin.place is not None:
            acts = {"place": twin.place, "when": twin.place.when, "parameters": twin.parameters}
            own = replace(cause, effect=twin.effect, where=twin.where, **acts)
            said.append(f"If it is that: {told(own).rstrip('.')}")
    twins = {(t.effect, t.where) for t in cause.indistinguishable}
    others = [a for a in rivals(cause) if (a.effect, a.where) not in twins and a.confidence >= WORTH]
    if others:
        record = tell_apart(cause.effect, others[0].effect)
        said.append(
            f"Next comes {called(others[0])} ({chance(others[0].confidence)}); to tell them apart, record {record}"
        )
    elif not twins and not cause.doubted:
        said.append(f"No other entry of the catalogue reaches {percent(WORTH)}")
    if cause.doubted:
        said.append("The confidence is lowered by what remains unexplained or cannot be told, see below")
    return ". ".join(said) + "."


def rivals(cause: Cause) -> list[Alternative]:
    """Everything that a cause competes with, the likeliest first."""
    found = {(a.effect, a.where): a for a in (*cause.indistinguishable, *cause.alternatives)}
    return sorted(found.values(), key=lambda a: -a.confidence)


def name(one: Cause | Alternative) -> str:
    """The cause as a label, with the coordinate that it follows: skin of one segment may slide with several."""
    text = called(one)
    if isinstance(one, Cause) and one.place.follows is not None:
        text = f"{text} ({segment_motion(one)})"
    return text[0].upper() + text[1:]


def chance(confidence: float) -> str:
    """A probability that is never called certain."""
    return "over 99 %" if confidence > 0.99 else "under 1 %" if confidence < 0.01 else percent(confidence)


def _when(when: tuple[Interval, ...] | None, effect: str) -> str:
    if not when:
        return ""
    if effect == "marker_shift":
        trials = [clean(one.trial) for one in when]
        return f" in trial{'s' if len(trials) > 1 else ''} {listing(trials)}"
    spans = [f"from {number(w.t0, 2)} to {number(w.t1, 2)} s of {clean(w.trial)}" for w in when]
    return f", {listing(spans, FEW)}"


def _late(cause: Cause) -> str:
    lag, sd = of(cause, "lag_s")
    return f"forces come {stated(lag.abs()[0], sd[0], 'ms', 1e3)} {'late' if lag[0] > 0 else 'early'} in {place(cause)}"


def _plate_pose(cause: Cause) -> str:
    (turn, turn_sd) = of(cause, "rotation_rad")
    return (
        f"{place(cause)} lies elsewhere than the file has it: by {vector(cause, 'shift_m', 'mm', 1e3, ROOM)}, and "
        f"turned by {length(turn, turn_sd, '°', DEGREES)}"
    )


def _plate_zero(cause: Cause) -> str:
    force, moment = (
        length(*of(cause, key), unit) for key, unit in (("force_plate_N", "N"), ("moment_plate_Nm", "N m"))
    )
    return f"{place(cause)} reads {force} and {moment} when it bears nothing"


def _plate_drift(cause: Cause) -> str:
    value, sd = of(cause, "rate_plate")
    return (
        f"the zero of {place(cause)} drifts by {length(value[:3], sd[:3], 'N/s')} and "
        f"{length(value[3:], sd[3:], 'N m/s')}"
    )


def _crosstalk(cause: Cause) -> str:
    value, sd = of(cause, "matrix_plate")
    k = int(value.abs().argmax())
    row, column = divmod(k, 6)
    unit = f"{'N' if row < 3 else 'N m'} per {'N' if column < 3 else 'N m'}"
    return (
        f"channels of {place(cause)} leak into each other, most of all {CHANNELS[column]} into {CHANNELS[row]}: "
        f"{stated(value[k], sd[k], unit)}"
    )


def _tilt(cause: Cause) -> str:
    (roll, roll_sd), (pitch, pitch_sd) = of(cause, "roll_rad"), of(cause, "pitch_rad")
    both = length(torch.cat([roll, pitch]), torch.cat([roll_sd, pitch_sd]), "°", DEGREES)
    return (
        f"the vertical of the cameras leans by {both} against gravity: {number(roll[0], 2, DEGREES)}° about x, "
        f"{number(pitch[0], 2, DEGREES)}° about y"
    )


def _payload(cause: Cause) -> str:
    value, sd = of(cause, "point_seg_m")
    said = f"{place(cause)} carries {size(cause, 'mass_kg', 'kg')} more than its own mass"
    where = parts(value, sd, "mm", 1e3, BODY)
    where = f"{where} from" if where else "about at"
    return f"{said}, {where} the segment's origin (sd up to {number(sd.max(), 0, 1e3)} mm)"


def _wobble(cause: Cause) -> str:
    frequency, damping = of(cause, "frequency_hz")[0], of(cause, "damping_ratio")[0]
    return (
        f"{size(cause, 'mass_kg', 'kg')} of the mass of {place(cause)} lag behind the bone and ring at about "
        f"{number(frequency[0])} Hz, damped by {percent(damping[0])} of the critical"
    )


def _spin(cause: Cause) -> str:
    value, sd = of(cause, "momentum_seg_Nms")
    axis = ("forward", "left", "upward")[int(value.abs().argmax())]
    momentum = length(value, sd, "N m s")
    return f"something spins inside {place(cause)}: angular momentum {momentum}, mostly about its {axis} axis"


def _harness(cause: Cause) -> str:
    weight = number(of(cause, "force_N")[0][0] / GRAVITY)
    return f"a harness at {place(cause)} carries {size(cause, 'force_N', 'N')}, the weight of {weight} kg"


def _tether(cause: Cause) -> str:
    anchor = ", ".join(number(x, 2) for x in of(cause, "anchor_m")[0].tolist())
    stiffness = size(cause, "stiffness_N_m", "N/m")
    rest, sd = (float(x) for x in of(cause, "rest_m"))
    slack = f", once it is longer than {size(cause, 'rest_m', 'm')}" if rest > CERTAIN * sd else ""
    return f"a spring of {stiffness} pulls {place(cause)} towards a fixed point at x, y, z = {anchor} m{slack}"


def _contact(cause: Cause) -> str:
    impulse = length(*of(cause, "impulse_Ns"), "N s") if "impulse_Ns" in cause.parameters else ""
    said = f"{place(cause)} touches something beside the plates, with {vector(cause, 'force_N', 'N', 1.0, ROOM)}"
    return f"{said}; impulse {impulse}" if impulse else said


def _skin(cause: Cause) -> str:
    value, sd = (x.view(-1, 3) for x in of(cause, "shift_90_m"))
    most = int(value.norm(dim=1).argmax())
    markers = cause.place.markers
    label = f" (marker {clean(markers[most])})" if len(markers) == len(value) else ""
    return (
        f"skin slides under the markers of {place(cause)} as {segment_motion(cause)} changes: by up to "
        f"{length(value[most], sd[most], 'mm', 1e3)} at 90°{label}"
    )


def _lag(cause: Cause) -> str:
    value, sd = of(cause, "shift_1g_m")
    most, least = int(value.argmax()), int(value.argmin())
    # A softness is never negative: what is none within its error is no size to read.
    ends = [
        (stated(value[k], sd[k], "mm", 1e3) if value[k] > 2.0 * sd[k] else "hardly anything")
        + f" on the {segment(cause.where[k])}"
        for k in dict.fromkeys((most, least))
    ]
    said = listing(ends)
    return f"the flesh under the markers gives way: where a segment is accelerated by 1 g they stay behind, by {said}"


def segment_motion(cause: Cause) -> str:
    """The coordinate that an effect follows, in words: ``knee_l_flexion`` as ``left knee flexion``."""
    follows = cause.place.follows
    if follows is None:
        return "a neighbouring joint"
    words = follows.dof.split("_")
    sides = [{"l": "left", "r": "right"}[w] for w in words if w in ("l", "r")]
    said = " ".join([*sides, *(w for w in words if w not in ("l", "r"))])
    return clean(said if follows.before is None else f"{said} (before {follows.before.rpartition('_')[2]})")


def _lacking(cause: Cause) -> str:
    turning = "range_rad" in cause.parameters
    reach = size(cause, "range_rad", "°", DEGREES) if turning else size(cause, "range_m", "mm", 1e3)
    axis = of(cause, "axis_seg" if turning else "direction_seg")[0]
    main = ("forward", "left", "upward")[int(axis.abs().argmax())]
    verb, along = ("turns", "about") if turning else ("slides", "along")
    return f"{place(cause)} {verb} by {reach} {along} an axis that the model lacks, mostly the segment's {main} axis"


def _glide(cause: Cause) -> str:
    shift = vector(cause, "shift_90_seg_m", "mm", 1e3, BODY)
    return f"the centre of {place(cause)} glides as {segment_motion(cause)} changes: at 90° by {shift}"


def _mass(cause: Cause) -> str:
    said = f"the person weighs {size(cause, 'mass_kg', 'kg')}"
    if "recorded_kg" not in cause.parameters:
        return f"{said}, not what is on record"
    return f"{said}, not the {number(of(cause, 'recorded_kg')[0][0])} kg on record"


STORY: dict[str, Callable[[Cause], str]] = {
    "time_offset": _late,
    "filter_lag": lambda c: (
        f"the markers had been low-passed at {size(c, 'cutoff_hz', 'Hz')} before anybody read them, "
        "so that quick accelerations come out too small"
    ),
    "plate_gain": lambda c: f"{place(c)} {'read' if len(c.where) > 1 else 'reads'} {much(c, 'gain')}",
    "plate_offset": _plate_zero,
    "plate_drift": _plate_drift,
    "plate_pose": _plate_pose,
    "plate_crosstalk": _crosstalk,
    "plate_assignment": lambda c: f"the cables of {place(c)} are swapped: each is read with the other's geometry",
    "gravity_tilt": _tilt,
    "moving_ground": lambda c: (
        f"the laboratory shakes at {number(of(c, 'frequency_hz')[0][0], 2)} Hz with {size(c, 'rms_m_s2', 'm/s²')} RMS"
    ),
    "body_mass": _mass,
    "payload": _payload,
    "grasped_object": lambda c: f"{place(c)} holds {size(c, 'mass_kg', 'kg')}",
    "wobbling_mass": _wobble,
    "flywheel": _spin,
    "unmeasured_contact": _contact,
    "external_force": lambda c: (
        f"a constant force that no plate measures acts on {place(c)}: {vector(c, 'force_N', 'N', 1.0, ROOM)}"
    ),
    "body_weight_support": _harness,
    "tether": _tether,
    "drag": lambda c: f"{place(c)} moves against a drag of {size(c, 'coefficient_Ns_m', 'N s/m')}",
    "marker_shift": lambda c: f"{place(c)} sat off its usual place by {vector(c, 'shift_seg_m', 'mm', 1e3, BODY)}",
    "marker_swap": lambda c: f"{place(c)} carry each other's name",
    "marker_scale": lambda c: f"all lengths that the cameras see are {much(c, 'scale', ('long', 'short'))}",
    "soft_tissue": _skin,
    "skin_lag": _lag,
    "joint_centre_shift": _glide,
    "missing_dof": _lacking,
}
"""One sentence for each effect of the catalogue."""
