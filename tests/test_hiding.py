"""Effects hidden by lot: repeatable, plantable, of sizes that laboratories meet, and judged fairly."""

from dataclasses import replace

from torchid.effects.catalogue import CATALOGUE
from torchid.run import demo, run_simulation
from torchid.simulate.hiding import LOTS, draw_hidden, judge
from torchid.simulate.options import SimulateOptions
from torchid.simulate.planting import planted

OPTIONS = SimulateOptions(fit=("squats", "arms"), heldout=("sway_steps",), duration_s=2.0)


def test_lots_repeat_vary_and_can_be_planted():
    """A seed draws the same effect again; many seeds draw every lot; all that is drawn is complete."""
    drawn = [draw_hidden(seed, OPTIONS) for seed in range(200)]
    assert drawn == [draw_hidden(seed, OPTIONS) for seed in range(200)]
    names = {hidden[0].effect if hidden else None for hidden in drawn}
    assert len(names) == len(LOTS) and names - {None} <= set(CATALOGUE)
    for hidden in drawn:
        for one in hidden:
            theta = planted(one).theta
            assert bool(theta.isfinite().all()) and float(theta.norm()) > 0.0
            assert all(own.trial in OPTIONS.fit for own in one.when or ())


def test_verdicts_are_judged_by_effect_and_place():
    """Right are the first cause and what it cannot be told from; a later one gives the size only."""
    truth = [{"effect": "drag", "where": ["thorax"], "parameters": {"coefficient_Ns_m": 30.0}}]
    size = {"coefficient_Ns_m": {"value": 28.0, "sd": 2.0}}
    drag = {"effect": "drag", "where": ["thorax"], "parameters": size, "indistinguishable": []}
    other = {"effect": "tether", "where": ["head"], "parameters": {}, "indistinguishable": []}
    twin = dict(other, indistinguishable=[{"effect": "drag", "where": ["thorax"]}])
    skin = dict(other, effect="soft_tissue", where=["thigh_r"])
    right, sizes = judge(truth, [skin, drag, other])
    assert right and sizes == ["coefficient_Ns_m: 28 ± 2, in truth 30"]
    assert judge(truth, [dict(skin, indistinguishable=twin["indistinguishable"]), other])[0]
    assert judge(truth, [other, drag]) == (False, sizes)
    assert judge(truth, [twin]) == (True, [])
    assert judge(truth, [dict(drag, where=["head"])]) == (False, [])
    assert (
        judge(truth, []) == (False, [])
        and judge([], [drag]) == (False, [])
        and judge([], [skin]) == judge([], []) == (True, [])
    )


def test_the_demo_shows_the_fit_nothing_of_the_draw(tmp_path):
    """What is run after the simulation names recordings only; what was hidden stands in the truth alone."""
    seed = 7
    config = demo.demo_config(seed, [f"out={tmp_path}"])
    assert config.simulate is not None and config.out == tmp_path / str(seed)
    hidden = demo.hide(config.model_copy(update={"simulate": replace(OPTIONS, plates=2)}))
    assert hidden.simulate.effects == draw_hidden(seed, OPTIONS) != ()
    recordings = run_simulation(hidden)
    name = hidden.simulate.effects[0].effect
    assert name in (recordings.parent / "truth" / "subject.json").read_text()
    assert name not in recordings.read_text()
    given = demo.blind(hidden, recordings)
    assert given.simulate is None and name not in given.model_dump_json()
    assert all(trial.file.is_file() for trial in given.trials) and given.diagnosis.enabled
    kept = demo.hide(hidden.model_copy(update={"seed": seed + 1}))
    assert kept.simulate == hidden.simulate, "an effect that the config names is not drawn over"
