"""The diagnosis finds what is hidden, says nothing where nothing is, and its evidence is what it claims to be."""

import dataclasses

import numpy as np
import pytest
import torch
from balance import in_balance
from draws import seed_of
from torch.testing import assert_close

from torchid.diagnosis.columns.assemble import make_design
from torchid.diagnosis.diagnose import diagnose, select_effects
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.model import Identification
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.prior import make_prior
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search.elimination import stands_out
from torchid.diagnosis.search.estimates import estimate, internal
from torchid.diagnosis.search.stepwise import search
from torchid.diagnosis.testing.vibration import with_vibration
from torchid.diagnosis.trace import StepKind
from torchid.diagnosis.verdict.records import Diagnosis
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import accumulate, initial_whitening, spectra
from torchid.effects.catalogue import BODILY
from torchid.effects.effect import Planted
from torchid.effects.forces import Tether
from torchid.effects.masses import Payload
from torchid.effects.place import Place
from torchid.errors import ConfigError
from torchid.extension.correction import _added
from torchid.filters import Smoother
from torchid.inertia.identify import Identified, identify_inertia
from torchid.io.resample import synchronise
from torchid.model.model import InertialPrior
from torchid.motion import smooth_motion
from torchid.observation.plate_registry import SessionPlate, recognise
from torchid.observation.trial import BodyEstimate, TrialObservation, observe_trial
from torchid.recording import Forces, Plate
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.session import SimulatedSession, simulate_session

SEED = seed_of(__name__)
FIT, HELDOUT = ("squats", "arms", "trunk", "sway_steps"), ("hip_rom",)


def draw(rng: np.random.Generator, low: float, high: float, size: int | None = None) -> float | list:
    """Log-uniform with a random sign, or a vector of that length in a random direction."""
    length = float(np.exp(rng.uniform(np.log(low), np.log(high))))
    if size is None:
        return length
    way = rng.normal(size=size)
    return (length * way / np.linalg.norm(way)).tolist()


def hidden_plates(rng: np.random.Generator) -> PlantedOptions:
    where = (f"plate_{rng.integers(1, 3)}",)
    return [
        lambda: PlantedOptions("plate_gain", where, None, {"gain": 1.0 + rng.choice([-1, 1]) * draw(rng, 0.02, 0.06)}),
        lambda: PlantedOptions(
            "plate_pose", where, None,
            {"shift_m": [*draw(rng, 0.015, 0.03, 2), 0.0], "rotation_rad": [0.0, 0.0, draw(rng, 0.005, 0.02)]},
        ),
    ][rng.integers(2)]()  # fmt: skip


def hidden_forces(rng: np.random.Generator) -> PlantedOptions:
    return [
        lambda: PlantedOptions("drag", ("thorax",), None, {"coefficient_Ns_m": draw(rng, 20.0, 60.0)}),
        lambda: PlantedOptions("body_weight_support", ("pelvis",), None, {"force_N": draw(rng, 60.0, 150.0)}),
        lambda: PlantedOptions(
            "tether", ("pelvis",), None,
            {"stiffness_N_m": draw(rng, 25.0, 60.0), "anchor_m": [-1.0, float(rng.normal(0.0, 0.2)), 1.0]},
        ),
    ][rng.integers(3)]()  # fmt: skip


def hidden_masses(rng: np.random.Generator) -> PlantedOptions:
    return [
        lambda: PlantedOptions("flywheel", ("thorax",), None, {"momentum_seg_Nms": [0.0, 0.0, draw(rng, 4.0, 10.0)]}),
        lambda: PlantedOptions(
            "payload", ("thorax",), None, {"mass_kg": draw(rng, 3.0, 6.0), "point_seg_m": [-0.12, 0.0, 0.2]}
        ),
    ][rng.integers(2)]()


def hidden_session(rng: np.random.Generator) -> PlantedOptions:
    return [
        # Beyond what living bodies' forces are late of themselves, 4.5 ms with a standard deviation of 4.5.
        lambda: PlantedOptions("time_offset", ("session",), None, {"lag_s": draw(rng, 0.02, 0.03)}),
        lambda: PlantedOptions(
            "gravity_tilt", ("session",), None, {"roll_rad": draw(rng, 0.01, 0.02), "pitch_rad": -draw(rng, 0.01, 0.02)}
        ),
    ][rng.integers(2)]()


FAMILIES = {
    "plates": hidden_plates,
    "forces": hidden_forces,
    "masses": hidden_masses,
    "session": hidden_session,
}


def simulated(effects: tuple[PlantedOptions, ...], seed: int) -> SimulatedSession:
    """A session with these effects."""
    options = SimulateOptions(fit=FIT, heldout=HELDOUT, duration_s=6.0, effects=effects)
    return in_balance(lambda attempt: simulate_session(options, attempt), seed)


def verdict(session: SimulatedSession) -> Diagnosis:
    """Of a session whose motion and geometry are known, forces noisy: the rest of the chain is tested elsewhere."""
    observed, plates, prior, found = seen(session)
    fits, held = [observed[n] for n in FIT], [observed[n] for n in HELDOUT]
    effects = select_effects((), ())
    known = Identification(prior, found.fit.omega_2, found.whitening)
    said = diagnose(fits, held, plates, effects, known, 2)
    entered = {(step.effect, step.where) for step in said.trace if step.kind is StepKind.ENTER}
    assert {(cause.effect, cause.where) for cause in said.causes} <= entered, "the trace leaves out a cause"
    refused = {(step.effect, step.where) for step in said.trace if step.kind is StepKind.REFUSE}
    assert {(one.effect, one.where) for one in said.refuted} <= refused, "the trace leaves out a refutation"
    return said


def seen(
    session: SimulatedSession,
) -> tuple[dict[str, TrialObservation], tuple[SessionPlate, ...], InertialPrior, Identified]:
    """Its trials, plates, prior and inertial fit."""
    subject = session.subject
    tree, geometry, prior = subject.model.tree, subject.geometry, subject.model.inertia
    forces, rows = {}, {}
    for item in session.trials[1:]:
        name, motion = item.trial.name, item.truth.motion
        smoother = Smoother(10.0, 100.0)
        own = synchronise(item.trial).forces
        assert own is not None
        forces[name] = own
        total = smoother(torch.nan_to_num(own.total))
        used = item.truth.complete & (torch.arange(len(total)) > 5) & (torch.arange(len(total)) < len(total) - 5)
        smooth = smooth_motion(tree, motion.time, motion.q, smoother)
        rows[name] = WrenchTrial(name, tree, geometry, smooth, total, used)
    scale = subject.recorded_mass / float(prior.mean[:, 0].sum())
    prior = dataclasses.replace(prior, mean=scale * prior.mean)
    found = identify_inertia([rows[n] for n in FIT], prior)
    plates, frames = recognise(forces)
    known = BodyEstimate(prior.mean, found.fit.phi, subject.recorded_mass)
    return {n: observe_trial(r, forces[n], r.used, frames[n], known) for n, r in rows.items()}, plates, prior, found


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_what_is_hidden_is_found(family):
    """The first cause is the planted one, or cannot be told from it, with its size, and it helps on unseen motion."""
    rng = np.random.default_rng([SEED, sorted(FAMILIES).index(family)])
    planted = FAMILIES[family](rng)
    said = verdict(simulated((planted,), int(rng.integers(2**31))))
    print(planted, [(c.effect, c.where, c.confidence) for c in said.causes])  # noqa: T201
    assert said.causes, "nothing was named"
    first = said.causes[0]
    names = [first.effect, *(twin.effect for twin in first.indistinguishable)]
    assert planted.effect in names
    # What a load does, the segment's own mass explains but for its prior: nothing is left to gain by its name.
    assert first.gain["heldout_log_likelihood"] > (-NamingOptions().consent_nats if family == "masses" else 0.0)
    same = [cause for cause in said.causes if cause.effect == planted.effect]
    # Two neighbours may share one force; its size is judged where it is alone.
    if first.effect == planted.effect and first.where == planted.where and len(same) == 1:
        for key, wanted_value in planted.parameters.items():
            value, sd = (torch.as_tensor(first.parameters[key][k]) for k in ("value", "sd"))
            miss = (value - torch.as_tensor(wanted_value)).abs()
            assert bool((miss < torch.maximum(5.0 * sd, 0.15 * value.abs())).all()), (key, value, sd, wanted_value)


def test_nothing_is_found_where_nothing_is():
    """Plates, time, mass and contacts stay silent."""
    said = verdict(simulated((), SEED % 2**31))
    assert {cause.effect for cause in said.causes} <= BODILY
    if not said.causes:
        assert said.baseline == said.extended


@pytest.mark.slow
@pytest.mark.parametrize(("low", "high", "first"), [(0.003, 0.007, "body_lag"), (-0.025, -0.012, "time_offset")])
def test_a_body_is_late_and_a_clock_may_be_early(low, high, first):
    """A few milliseconds late is a body's, surest of all, with the clock named beside it; early no body is."""
    rng = np.random.default_rng([SEED, 17])
    lag = float(rng.uniform(low, high))
    planted = PlantedOptions("time_offset", ("session",), None, {"lag_s": lag})
    said = verdict(simulated((planted,), int(rng.integers(2**31))))
    print(lag, [(c.effect, c.where, c.confidence) for c in said.causes])  # noqa: T201
    cause = max(said.causes, key=lambda one: one.confidence)
    assert cause.effect == first
    assert ("time_offset" in {twin.effect for twin in cause.indistinguishable}) == (first == "body_lag")


@pytest.mark.slow
def test_what_held_out_motion_contradicts_is_refuted():
    """A clock that is late in the fit trials and early in the others is named by the former, and taken back; or it is
    named as a clock of single recordings, which the others do not contradict; or it never was more than sound sessions
    seem to have."""
    rng = np.random.default_rng([SEED, 7])
    lag, seed = draw(rng, 0.02, 0.03), int(rng.integers(2**31))
    late, early = (simulated((PlantedOptions("time_offset", ("session",), None, {"lag_s": s * lag}),), seed)
                   for s in (1.0, -1.0))  # fmt: skip
    said = verdict(dataclasses.replace(late, trials=(*late.trials[:-1], early.trials[-1])))
    found = [(c.effect, c.where, c.gain) for c in said.causes]
    clocks = {where for effect, where, _ in found if effect == "time_offset"}
    assert clocks <= {(trial.trial.name,) for trial in late.trials[:-1]}, (found, said.refuted)
    gone = {(r.effect, r.where) for r in said.refuted} | {
        (s.effect, s.where) for s in said.trace if s.rule == "ordinary"
    }
    assert clocks or ("time_offset", ("session",)) in gone, (found, said.refuted)
    assert all(r.heldout_log_likelihood < 0.0 for r in said.refuted)
    assert not {(c.effect, c.where) for c in said.causes} & {(r.effect, r.where) for r in said.refuted}


@pytest.mark.slow
def test_a_named_drift_is_all_of_it():
    """Not the part alone that is out of the ordinary: of a plate's usual drift nobody knows that much."""
    rng = np.random.default_rng([SEED, 11])
    rate = torch.tensor([*draw(rng, 0.4, 0.8, 3), *draw(rng, 0.05, 0.1, 3)], dtype=torch.float64)
    planted = PlantedOptions("plate_drift", ("plate_1",), None, {"rate_plate": rate.tolist()})
    observed, _, prior, found = seen(simulated((planted,), int(rng.integers(2**31))))
    fits = [observed[name] for name in FIT]
    said = search(
        fits, select_effects(("plate_drift",), ()), Identification(prior, found.fit.omega_2, found.whitening), 1
    )
    assert [one.place.where for one in said.chosen] == [("plate_1",)]
    value, sd = estimate(said, 0)["rate_plate"]
    assert float(((value - rate) / sd).abs().max()) < 5.0, (value, sd, rate)
    # Told apart from what is usual there, each would be uncertain by the share of it that data leave open.
    at = said.model.design.base + torch.arange(6)
    apart = (
        value.new_tensor(said.chosen[0].effect.scale(said.chosen[0].place)) * said.posterior.covariance[at, at].sqrt()
    )
    assert bool((sd < apart).all())


@pytest.mark.slow
def test_an_extension_takes_out_all_of_a_curved_load():
    """A load's square of distance and a spring's rest length too: what is named is what is corrected."""
    observed = seen(simulated((), SEED % 2**31))[0]["arms"]
    scene = observed.view.scene
    load = Planted(Payload(), Place(("forearm_l",), point=(0.0, 0.0, 0.0)), scene.phi.new_tensor([3.0, 0.3, 0.2, -0.9]))
    spring = Planted(Tether(), Place(("forearm_r",)), scene.phi.new_tensor([14.0, 12.0, 11.0, 20.0, 9.0]))
    for one in (load, spring):
        exact = one.load(scene).T
        assert float((_added(observed, one) - exact).norm()) < 1e-5 * float(exact.norm())


@pytest.mark.slow
def test_what_stands_out_is_what_its_own_load_takes_away():
    """Of the residual that everything leaves; a hundredth of the load would not stand out."""
    rng = np.random.default_rng([SEED, 13])
    planted = PlantedOptions("drag", ("thorax",), None, {"coefficient_Ns_m": draw(rng, 30.0, 60.0)})
    observed, _, prior, found = seen(simulated((planted,), int(rng.integers(2**31))))
    fits = [observed[name] for name in FIT]
    known = Identification(prior, found.fit.omega_2, found.whitening)
    said = search(fits, select_effects(("drag",), ()), known, 1)
    (one,) = said.chosen
    left = residuals(fits, said.model, said.posterior)

    def grown(part: float) -> float:
        """By the load itself, trial by trial, in the middle of the force's and moment's logarithms."""
        ratio = []
        for w, rest in zip(fits, left, strict=True):
            load = Planted(one.effect, one.place, part * internal(said, 0)).load(w.view.scene).T
            more = rest + wrench_about(load, w.rows.motion.q[:, :3])
            ratio.append(
                [float(more[w.rows.used, k].norm() / rest[w.rows.used, k].norm()) for k in (slice(3), slice(3, 6))]
            )
        return 1.0 - float(1.0 / np.exp(np.log(ratio).mean(0)).max())

    assert stands_out(said, fits, 0) == pytest.approx(grown(1.0), rel=1e-6)
    assert grown(1.0) > said.options.elimination.residual_part > grown(0.01)


@pytest.mark.slow
@pytest.mark.parametrize("where", [FIT, FIT[:-1]])
def test_a_vibration_above_the_filter_is_no_secret(where):
    """A motor that runs in every trial is flagged, with its frequency; one that rests in one of them is not."""
    rng = np.random.default_rng([SEED, 9])
    hz, clean = float(rng.uniform(13.5, 18.0)), Adequacy(False, 0.5, 0.1, "")
    observed = seen(simulated((), int(rng.integers(2**31))))[0]
    assert with_vibration(clean, [observed[name] for name in FIT]) == clean
    some = []
    for name in FIT:
        phase = 2.0 * np.pi * (hz * observed[name].rows.motion.time + rng.uniform())
        motor = 6.0 * torch.stack([torch.cos(phase), 0.0 * phase, torch.sin(phase)], 1)
        raw = observed[name].raw + (motor if name in where else 0.0)
        some.append(dataclasses.replace(observed[name], raw=raw))
    said = with_vibration(clean, some)
    assert said.significant == (where == FIT)
    if said.significant:
        assert said.beyond
        found = float(said.description.split("a vibration of ")[1].split(" Hz")[0])
        assert found == pytest.approx(hz, abs=0.25)


@pytest.mark.slow
def test_evidence_is_that_of_the_marginal_likelihood():
    """Gains by Schur complements equal differences of log densities of the whitened data under each model."""
    session = simulated((), SEED % 2**31)
    observed = [seen(session)[0][name] for name in FIT[:2]]
    design = make_design(observed, select_effects(("time_offset", "drag", "payload"), ()))
    prior = make_prior(session.subject.model.inertia, 1.0, design)
    trials = []
    for own, columns in zip(observed, design.trials, strict=True):
        both = accumulate(spectra(own.rows, columns.extra), initial_whitening(prior.mean))
        trials.append(prior.standard(both.gram, both.moment, columns.terms.live))
    statistics = Statistics(design.base, design.shared, tuple(trials))
    base = fit(statistics)
    for one, found in zip(design.candidates, gains(statistics, base, design.candidates)[0], strict=True):
        more = fit(statistics, (one,))
        exact = more.log_evidence - base.log_evidence
        for at in range(design.base, design.base + one.effect.positives(one.place)):
            z, sd = more.mean[at], more.covariance[at, at].sqrt()
            exact += float(np.log(2.0) + torch.special.log_ndtr(z / sd))
        assert float(found) == pytest.approx(exact, rel=1e-6, abs=1e-6)


def test_plates_are_known_again():
    """By their corners, whatever their order; without corners by where they bear."""
    square = torch.tensor([[0.3, 0.2, 0.0], [0.3, -0.2, 0.0], [-0.3, -0.2, 0.0], [-0.3, 0.2, 0.0]]).double()
    a, b = Plate("one", square), Plate("two", square + torch.tensor([0.0, 0.5, 0.0]))
    time, nothing = torch.arange(5) / 100.0, torch.zeros(5, 2, 6, dtype=torch.float64)
    plates, frames = recognise({"x": Forces(time, nothing, (a, b)), "y": Forces(time, nothing, (b, a))})
    assert [p.channels for p in plates] == [{"x": "one", "y": "one"}, {"x": "two", "y": "two"}]
    assert [f.name for f in frames["y"]] == ["plate_2", "plate_1"]
    bare = (Plate("fp1"), Plate("fp2"))
    wrench = nothing.clone()
    for k, x in enumerate((0.0, 1.0)):
        wrench[:, k, 2], wrench[:, k, 4] = 500.0, -500.0 * x
    plates, frames = recognise({"x": Forces(time, wrench, bare), "y": Forces(time, wrench.flip(1), bare)})
    assert [f.name for f in frames["x"]] == ["plate_1", "plate_2"] == [f.name for f in frames["y"]][::-1]
    assert_close(plates[1].frame.p_WF, torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64))


def test_unknown_effects_are_refused():
    """As entries of ``diagnosis.include``."""
    with pytest.raises(ConfigError, match="no such effect"):
        select_effects(("plate_gian",), ())
    assert [e.name for e in select_effects(("drag", "plate_gain"), ("drag",))] == ["plate_gain"]
