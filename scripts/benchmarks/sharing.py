"""Shared contact: the batched solver beside Clarabel on the same problem, and its throughput."""

from sharing_by_clarabel import share_by_clarabel

from benchmarks.sharing_problem import random_problem
from benchmarks.subject import by_turns
from torchid.contact.sharing.solver import share

SEED = 4


def bench_sharing(frames: int, few: int, rounds: int) -> dict[str, float]:
    """CPU seconds by turns: frames per second of many frames, and Clarabel's time over ours on few, set-up included."""
    many, _ = random_problem(frames, SEED)
    both, _ = random_problem(few, SEED)
    spent = by_turns({"torchid": lambda: share(both), "clarabel": lambda: share_by_clarabel(both)}, rounds)
    whole = by_turns({"torchid": lambda: share(many)}, rounds)["torchid"]
    apart = float((share(both).wrench - share_by_clarabel(both))[..., :3].abs().max())
    return {"frames_per_s": frames / whole, "clarabel": spent["clarabel"] / spent["torchid"], "apart_N": apart}
