"""One member's run as an order says: a JSON file that tells what to run and where its row goes."""

import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchid.cohort.members import Participant
from torchid.config import Config, load_config
from torchid.errors import TorchidError, said_of_defect
from torchid.folder.proposal import SeveralPeople, propose
from torchid.folder.statements import Person
from torchid.folder.writing import write_config
from torchid.io.files import container_of
from torchid.report.cause_sentences import called
from torchid.report.picture import person_outline
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.session.tables import heldout_errors, identified_table, rms
from torchid.storage.files import write_json

Row = dict[str, Any]
"""What a table says of a member, by its columns."""


def write_order(order: Path, member: Participant, out: Path, config: Path, row: Path) -> None:
    """Write what one process is to run.

    Args:
        order: the file.
        member: whom.
        out: folder of its results.
        config: that is made of a folder of recordings.
        row: file that it writes when it ends.
    """
    person = member.person.known
    said = {"source": member.source, "person": person, "out": out, "config": config, "row": row}
    write_json(order, said | {"parent": os.getpid()})


def perform(order: Mapping[str, Any]) -> Row:
    """Run what an order says, and return the row of its results; a refusal is a row as well.

    Args:
        order: as ``write_order`` writes it.
    """
    begin = time.process_time()
    try:
        config = _config(order)
        row = {"status": "done", "reason": "", **_figures(run_experiment(config), config)}
    except SeveralPeople as error:
        row = {"status": "set aside", "reason": str(error), "code": error.code, "people": error.people}
    except TorchidError as error:
        row = {"status": "set aside", "reason": str(error), "code": error.code}
    except Exception as error:  # one of many: the others go on, and the row says it
        row = {"status": "set aside", "reason": f"a defect of torchid: {said_of_defect(error)}", "code": "defect"}
    return row | {"cpu_s": time.process_time() - begin}


def _config(order: Mapping[str, Any]) -> Config:
    """The member's own config, or one that is made of the files of its folder; its results go where the order says."""
    source, made = Path(order["source"]), Path(order["config"])
    files = source.is_dir() or container_of(source) == source
    if files:
        for old in (made, made.with_name(f"{made.stem}_markers.yaml")):
            old.unlink(missing_ok=True)  # of an earlier run of the same member
        write_config(propose(source, Person(**order["person"])), made)
    return load_config(made if files else source, [f"out={json.dumps(order['out'])}"])


def _figures(outcome: Outcome, config: Config) -> Row:
    """What the table says of a run that ended well."""
    quality, forces = outcome.quality, heldout_errors(outcome)
    mass = {} if outcome.identified is None else identified_table(outcome)["total_mass"]
    causes = () if outcome.diagnosis is None else outcome.diagnosis.likely
    return {
        "verdict": "" if quality is None else quality.level.value,
        "because": "" if quality is None or quality.deciding is None else quality.deciding.words,
        "mass_kg": mass.get("value_kg"),
        "mass_sd_kg": mass.get("sd_kg"),
        "recorded_kg": config.subject.mass_kg,
        "marker_rmse_mm": 1e3 * rms(*(one.tracked.error for one in outcome.followed.values())),
        "heldout_force_N": forces["force_rmse_N"],
        "heldout_moment_Nm": forces["moment_rmse_Nm"],
        "causes": list(dict.fromkeys(called(one) for one in causes)),
        "outline": person_outline(outcome),
    }
