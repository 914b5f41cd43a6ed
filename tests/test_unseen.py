"""Bodies that nobody saw moving go with the total mass and keep their shape; what is seen is identified."""

import dataclasses
from pathlib import Path

import pytest
import small_session as small
import torch
import yaml
from torch.testing import assert_close

from torchid.config import load_config
from torchid.config.sections import Inertia
from torchid.conventions import Inertial
from torchid.errors import DataError
from torchid.geometry.attachment import Attachment
from torchid.model.marker_set import load_marker_set
from torchid.run import run_experiment
from torchid.session.unseen import HELD, hold_shape, hold_unseen, refuse_unseen
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session
from torchid.simulate.subject import MARKER_SET

LEGS = ("pelvis", "thigh", "shank", "foot", "toes")


def test_held_bodies_go_with_the_total_mass_and_scatter_less_about_it():
    """What is said of the total mass stays; where that is known, held bodies scatter by a part of what they did."""
    model = small.session().subject.model
    held = _above(model.tree.names)
    before, after = model.inertia, hold_shape(model.inertia, held, 0.2)
    mass = torch.zeros_like(before.covariance[0])
    mass[Inertial.M :: len(Inertial)] = 1.0
    assert_close(after.covariance @ mass, before.covariance @ mass, atol=1e-9, rtol=1e-9)
    own = held.repeat_interleave(len(Inertial))

    def known(C):
        return (C - torch.outer(C @ mass, C @ mass) / (mass @ C @ mass))[own][:, own]

    assert_close(known(after.covariance), 0.04 * known(before.covariance), atol=1e-12, rtol=1e-6)
    torch.linalg.cholesky(after.covariance)
    assert after.mean is before.mean


def test_who_is_seen_is_not_held_and_who_is_not_is_refused_where_that_is_asked():
    """A whole body keeps its prior and options; legs alone are held, weighed as tables say, and told by name."""
    fit, prior, options = small.outcome().fit, small.session().subject.model.inertia, Inertia()
    same, unheld = hold_unseen(options, prior, fit)
    assert same is options and unheld is prior
    refuse_unseen(fit, prior)
    names = fit.model.tree.names
    kept = torch.tensor([names[int(k)].startswith(LEGS) for k in fit.attachment.body])
    marks = fit.attachment
    some = Attachment(
        tuple(label for label, own in zip(marks.labels, kept.tolist(), strict=True) if own),
        marks.body[kept], marks.mean[kept], marks.sd[kept],
        tuple(one for one, own in zip(marks.landmark, kept.tolist(), strict=True) if own),
    )  # fmt: skip
    legs = dataclasses.replace(fit, attachment=some)
    weighed, held = hold_unseen(options, prior, legs)
    assert_close(held.covariance, hold_shape(prior, _above(names), HELD).covariance)
    assert weighed.prior_weight == 1.0
    own = Inertia(prior_weight=3.0)
    assert hold_unseen(own, prior, legs)[0] is own
    with pytest.raises(DataError) as refusal:
        refuse_unseen(legs, prior)
    assert refusal.value.code == "inertia.unseen_bodies" and "thorax" in refusal.value.found


def _above(names):
    """Mask of the bodies above the pelvis."""
    return torch.tensor([not name.startswith(LEGS) for name in names])


@pytest.mark.slow
def test_legs_alone_tell_the_mass_and_the_legs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_report) -> None:
    """Of squats in which trunk and arms move and nobody sees them: the total mass is right, the legs' masses are within
    five deviations, the others are those of the tables, and the first line says what rests on what."""
    options = SimulateOptions(fit=("squats", "hip_rom"), heldout=(), duration_s=4.0)
    session = simulate_session(options, small.SEED, tmp_path / "recordings")
    whole, path = load_marker_set(MARKER_SET), tmp_path / "legs.yaml"
    seen = {label: spec for label, spec in whole.specs.items() if spec.segment.startswith(LEGS)}
    path.write_text(yaml.safe_dump({label: _entry(spec) for label, spec in seen.items()}))
    settings = [f"markers={path}", f"out={tmp_path / 'out'}", "diagnosis.enabled=false"]
    outcome = run_experiment(load_config(session.config, settings))
    assert outcome.identified is not None and outcome.quality is not None
    fit, true = outcome.identified.fit, session.subject.phi[:, Inertial.M]
    assert float(fit.mass.sum()) == pytest.approx(float(true.sum()), rel=0.015)
    legs = [k for k, name in enumerate(fit.names) if name.startswith(LEGS)]
    assert bool(((fit.mass - true).abs() < 5.0 * fit.sd.mass)[legs].all())
    rest = [k for k in range(len(fit.names)) if k not in legs]
    tables = outcome.prior.mean[rest, Inertial.M]
    share = fit.mass[rest] / float(fit.mass[rest].sum())
    assert_close(share, tables / float(tables.sum()), rtol=0.2, atol=0.0)
    assert outcome.quality.deciding is not None and outcome.quality.deciding.name == "unseen"


def _entry(spec):
    """An entry of a marker set's file."""
    return {"segment": spec.segment} | ({"landmark": spec.landmark} if spec.landmark else {})
