"""A simulated subject on the page of a stream: it stands, is advised what to do, and does it until it is known.

scripts/demo --live                            # the subject is drawn from the clock; Ctrl-C ends it
scripts/demo --live 7                          # the same subject again
scripts/demo --live --headless --seconds 20 7  # without a page
"""

import json
import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from harness.command import ROOT, Command
from simulated_person.source import SimulatedSource

from torchid.config import load_config
from torchid.errors import TorchidError
from torchid.live.display.page import Address, Page
from torchid.live.estimation.identifier import LiveSubject
from torchid.live.estimation.pipeline import Moment
from torchid.live.exercises.advice import Advice
from torchid.live.exercises.exercises import Possibilities
from torchid.live.run import Display, run_live
from torchid.live.sources.stream import Source
from torchid.simulate.session import simulate_session
from torchid.simulate.subject import SimulatedSubject
from torchid.storage.logs import configure_logging

CONFIG = ROOT / "configs" / "demo.yaml"
PLATES = 2
"""Choice. No exercise needs more."""


class Follow:
    """Lets the subject hear what is found, says what changes, and hands everything on to a page where there is one."""

    def __init__(self, source: SimulatedSource, page: Page | None) -> None:
        self._source, self._page, self._advice, self._done = source, page, None, 0
        self.address = "" if page is None else page.address

    def show(self, moment: Moment) -> None:
        """Take up what was found in a packet."""
        if moment.found is not None:
            self._source.hear(moment.found.advice, moment.found.known)
            if moment.found.advice != self._advice:
                self._advice = moment.found.advice
                say_advice(self._advice, float(moment.markers.time[-1]))
        if len(self._source.done) > self._done:
            self._done = len(self._source.done)
            one = self._source.done[-1]
            say(f"{one.start_s:5.0f} s  it does {one.exercise} for {one.seconds:.0f} s")
        if self._page is not None:
            self._page.show(moment)

    def __enter__(self) -> "Follow":
        return self

    def __exit__(self, *_: object) -> None:
        if self._page is not None:
            self._page.close()


def main(arguments: list[str] | None = None) -> None:
    """Simulate, stream, advise, and say what came of it."""
    given = Command(
        __doc__, ("seed",), seed=({"nargs": "?", "type": int}, "of the subject, its motions and all noise"),
        headless=(False, "without a page"), seconds=(math.inf, "stop after so long"),
        out=(Path, "folder for the session; else below that of configs/demo.yaml"),
        port=(8080, "of the page; the next free one is taken"),
    ).asked(arguments)  # fmt: skip
    seed = given.seed if given.seed is not None else time.time_ns() // 10**6 % 10**6
    configure_logging()
    where = None if given.headless else Address(given.port, "127.0.0.1")
    try:
        demonstrate(seed, given.seconds, where, given.out)
    except TorchidError as error:
        raise SystemExit(f"torchid: {error}") from None
    except KeyboardInterrupt:  # before the stream, which takes it for its end
        raise SystemExit(130) from None


def demonstrate(seed: int, seconds: float, where: Address | None, out: Path | None) -> None:
    """Let a subject follow the advice until it ends, in a folder or beside the other demonstration's; None: no page."""
    say(f"Seed {seed} (`scripts/demo --live {seed}` is the same subject). It stands for its static trial ...")
    config = load_config(CONFIG, [f"seed={seed}"])
    assert config.simulate is not None
    options = replace(config.simulate, fit=(), heldout=(), plates=PLATES)
    out = config.out / "live" / str(seed) if out is None else out
    session = simulate_session(options, seed, out / "recordings")
    assert session.config is not None
    source = SimulatedSource(session.subject, options, seed)
    say("Finding its geometry from that trial's files, and rehearsing exercises on it ...")
    found = run_live(
        load_config(session.config, [f"out={out}"]), source, seconds=seconds, page=shown(where), opened=say_address,
        possibilities=Possibilities(),
    )  # fmt: skip
    say("\n".join(told(found, json.loads((out / "live.json").read_text()), session.subject)))
    say(f"Estimate: {out / 'live.json'}; truth: {session.config.parent / 'truth' / 'subject.json'}")


def shown(where: Address | None) -> Callable[[LiveSubject, Source], Display]:
    """What opens the page, if one is wanted, behind ``Follow``."""

    def opened(subject: LiveSubject, source: Source) -> Display:
        assert isinstance(source, SimulatedSource)
        page = None if where is None else Page(subject, source.labels, source.plates, where)
        return Follow(source, page)

    return opened


def say_address(address: str) -> None:
    """Where the page is, if there is one."""
    if address:
        say(f"Open {address} in a browser.")
    say("The stream begins: it stands, is advised, and does what it is advised. Ctrl-C ends it.")


def say_advice(advice: Advice | None, now_s: float) -> None:
    """What the subject is asked for."""
    if advice is not None:
        parts = ", ".join(name.replace("_", " ") for name in advice.segments)
        say(f"{now_s:5.0f} s  asked for {advice.name}, which tells most of {parts}: {advice.text}")


def told(found: dict[str, Any], estimate: dict[str, Any], who: SimulatedSubject) -> list[str]:
    """What was identified, beside the truth, and what each exercise brought."""
    mass, guidance, pose = found["mass_kg"], found["guidance"], found["latency_ms"]["pose"]
    lines = [
        f"Identified mass {mass['value']:.3f} ± {mass['sd']:.3f} kg, in truth {who.mass:.3f} kg.",
        f"{found['frames']} frames, {found['lost']} lost; postures within {pose['p50']} ms, 99 % in {pose['p99']} ms.",
        f"{'segment':14s}{'known':>8s}{'of what can be':>16s}{'mass [kg]':>18s}{'in truth':>10s}",
    ]
    truth = dict(zip(who.model.tree.names, who.phi[:, 0].tolist(), strict=True))
    for name, share in found["progress"].items():
        one = estimate["segments"][name]
        mass_kg = f"{one['mass_kg']:.2f} ± {one['sd']['mass_kg']:.2f}"
        lines.append(f"{name:14s}{share:8.0%}{guidance['determined'][name]:16.0%}{mass_kg:>18s}{truth[name]:10.2f}")
    lines.append(f"{'asked for':14s}{'blocks':>8s}{'information [nat]':>19s}{'rise of what is known, mean':>29s}")
    for one in guidance["exercises"]:
        rise = sum(one["progress"].values()) / len(one["progress"])
        lines.append(f"{one['exercise']:14s}{one['blocks']:8d}{one['nats']:19.1f}{rise:29.1%}")
    return lines


def say(text: str) -> None:
    """A line for whoever watches."""
    print(text, flush=True)


if __name__ == "__main__":
    main()
