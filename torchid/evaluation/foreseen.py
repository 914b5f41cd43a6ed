"""What is known of an evaluation before anything is recorded or computed: whether its tests can find anything."""

from collections import Counter
from collections.abc import Iterator

from torchid.config import Config
from torchid.errors import Note
from torchid.evaluation.statistics.arrangements import deal
from torchid.evaluation.statistics.units import needed_for, trial_units


def foreseen(config: Config) -> Iterator[Note]:
    """Comparisons of a config in which no finding is possible, whatever the recordings hold.

    Args:
        config: with conditions; blocks of cycles are not known before the cycles are.
    """
    options, others = config.evaluate, len(config.conditions) - 1
    reference = next((name for name, one in config.conditions.items() if one.reference), None)
    if reference is None or options.units != "trials":
        return
    counts = Counter(trial.condition for trial in config.trials)
    if not config.trials and config.simulate is not None:
        counts = Counter(dict.fromkeys(config.conditions, len(config.simulate.conditions)))
    for name in (name for name in config.conditions if name != reference):
        labels = [False] * counts[reference] + [True] * counts[name]
        units = trial_units([str(k) for k in range(len(labels))], labels)
        least = deal(units.second, options.permutations, config.seed).least_p
        needed = needed_for(units, least, options.permutations, options.level / others)
        if needed.said:
            yield Note("evaluate.untestable", f"{name} against {reference}: {needed.said}", "conditions")
