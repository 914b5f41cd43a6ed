"""A table of the goals of reliability: what is reached, by which command, and whether that is enough.

    scripts/reliability                    # quick ones measured now, long ones as they were last recorded
    scripts/reliability --only G5 G28
    scripts/reliability --record G8 "0 of 250 corrupt" yes "scripts/faults --kills 50"

Long measurements write their row to reliability.json beside this, by `reliability_table.record` or as above; those that
never did read "not measured here". The exit code is 1 where a goal that was measured is not reached.
"""

import sys

from harness.command import Among, Command, said_seed

from reliability_table.goals import GOALS, Measuring
from reliability_table.record import Figure, record, recorded


def main() -> None:
    """Measure, and print the table as it grows."""
    args = Command(
        __doc__, only=Among(GOALS, list(GOALS), True, "GOAL"),
        count=(2000, "C3D mutants; others in proportion (default 2000)"),
        seed=(int, "of the draws; default: a new one, which is printed"),
        record=({"nargs": 4, "metavar": ("GOAL", "FIGURE", "yes|no", "COMMAND")}, "note a figure"),
    ).asked()  # fmt: skip
    if args.record:
        goal, text, reached, command = args.record
        record(goal, text, reached == "yes", command)
        return
    seed = said_seed(args.seed, 2**32)
    print("\n| id | goal | figure | reached | how |\n|---|---|---|---|---|")
    found = [_row(name, Measuring(seed, args.count)) for name in args.only]
    sys.exit(1 if False in found else 0)


def _row(name: str, by: Measuring) -> bool | None:
    """Print the row of a goal, and what is recorded of it; returns whether it is reached."""
    words, how = GOALS[name]
    records = {key: figure for key, figure in recorded().items() if key.split()[0] == name}
    if isinstance(how, str):
        figure = records.pop(name, Figure("not measured here", None, how))
    else:
        figure = how(by)
    _print(name, words, figure)
    for key, one in records.items():
        _print(key, "recorded", one)
    return figure.reached


def _print(name: str, words: str, figure: Figure) -> None:
    reached = {True: "yes", False: "NO", None: "-"}[figure.reached]
    date = f" ({figure.date})" if figure.date else ""
    print(f"| {name} | {words} | {figure.text}{date} | {reached} | `{figure.command}` |", flush=True)


if __name__ == "__main__":
    main()
