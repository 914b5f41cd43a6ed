"""Whether the inertia begins from the people whom a subject is like, or from tables alone.

As a cause is corrected only where the model then predicts no worse (``publishing``), other people are believed only as
far as motion that was not used agrees: the fit with tables alone is always one solution away.
"""

import logging
from dataclasses import replace

from torchid.errors import DataError, Note
from torchid.extension.block_errors import HELD_OUT, LEFT_OUT, block_errors, cut_blocks
from torchid.extension.never_worse import Growth, compare
from torchid.session import Outcome
from torchid.session.fitting import OnStage, identify
from torchid.session.people import people_of, subject_prior
from torchid.session.person import LEFT, USED
from torchid.storage.results import OutputFolder
from torchid.wording import percent

log = logging.getLogger(__name__)


def people_or_tables(outcome: Outcome, folder: OutputFolder, key: str, progress: OnStage) -> Outcome:
    """Return the outcome as it is, or from tables alone where the people of its config make it predict worse.

    Held-out trials decide; without any, blocks of the fit trials left out in turn. A note says which it is, where the
    config names people.

    Args:
        outcome: up to the inertia.
        folder: for stages.
        key: of all that these depend on.
        progress: called with stages and fractions.

    Raises:
        InputError, ConfigError: as ``people_of``.
    """
    config = outcome.config
    people = people_of(config.model, config.subject)
    if people is None:
        return outcome
    try:
        plain = _from_tables(outcome, folder, key, progress)
    except DataError as failure:
        log.info("with tables alone: %s", failure)
        return outcome
    grown = [one for one in growth(plain, outcome) if one.worse]
    if not grown:
        return outcome
    worst = max(grown, key=lambda one: one.least_log)
    said = (
        f"inertia begins from tables alone: with {people.count} people of a cohort, errors of {worst.kind}s in "
        f"{worst.where} grow by {percent(worst.part)}"
    )
    others = tuple(note for note in plain.notes if note.code != USED)
    return replace(plain, notes=(*others, Note(LEFT, said, str(config.subject.people))))


def _from_tables(outcome: Outcome, folder: OutputFolder, key: str, progress: OnStage) -> Outcome:
    """The same session without the people of its config; followed as before, on the same frames."""
    who = outcome.config.subject.model_copy(update={"people": None})
    config = outcome.config.model_copy(update={"subject": who})
    prior, scaled = (subject_prior(config.model, who, fit) for fit in (outcome.fit, outcome.scaled))
    plain = replace(outcome, config=config, prior=prior, prior_scaled=scaled)
    return replace(
        plain, identified=folder.stage("inertia_tables", key, lambda: identify(config.inertia, who, plain, progress))
    )


def growth(reference: Outcome, other: Outcome) -> tuple[Growth, ...]:
    """Growth of errors of forces and moments on what a fit has not used, from one inertia of a session to another.

    Args:
        reference: up to its inertia.
        other: the same session and geometry with another inertia.
    """
    blocks = cut_blocks(reference)
    before, after = (block_errors(one, reference, one.config, blocks) for one in (reference, other))
    where = next((group for group in (HELD_OUT, LEFT_OUT) if (group, "force") in before), None)
    own = {group: errors for group, errors in before.items() if group[0] == where and group[1] != "markers"}
    return compare(own, after, reference.config.diagnosis.thresholds.never_worse)
