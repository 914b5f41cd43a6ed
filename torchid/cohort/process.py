"""The process of one member's run, which ends when the one that waits for it does.

``python -m torchid.cohort.process ORDER``; heavy imports wait, as in the command.
"""

import json
import os
import sys
import threading
import time
from pathlib import Path

from torchid.storage.allocator import keep_memory, seldom_collect

WATCH_S = 1.0
"""Resolution. Time between looks for the process that waits [s]."""
ORPHAN = 9
"""Exit code of a run that nobody waits for any more."""


def end_with(parent: int) -> None:
    """End this process once the one that started it is gone: what it runs may be run elsewhere by then."""
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os._exit(ORPHAN)


def main(order: Path) -> None:
    """Run an order and write its row."""
    said = json.loads(order.read_text(encoding="utf-8"))
    threading.Thread(target=end_with, args=(said["parent"],), daemon=True).start()
    keep_memory()
    seldom_collect()
    from torchid.cohort.one_run import perform  # noqa: PLC0415 - after what is decided for the process
    from torchid.storage.files import plain, write_json  # noqa: PLC0415

    write_json(Path(said["row"]), plain(perform(said)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
