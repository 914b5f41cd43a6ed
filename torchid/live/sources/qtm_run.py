"""One run of Qualisys Track Manager: where its frames and its force samples are in time, and which belong together."""

import logging
import time
from dataclasses import dataclass

import torch
from jaxtyping import Float
from qtm_rt.packet import QRTPacket
from torch import Tensor

from torchid.live.sources.intake import JUMP_S
from torchid.live.sources.qtm_settings import Settings, fault

PAUSE_S = 1.5 * JUMP_S
"""Choice. Between two runs: more than the jump by which a clock is known to be set, so that nothing is smoothed across,
however the server counts and whatever the subject did meanwhile."""
LAG_S = 0.5
"""Choice. How far force samples may lie from the frame with which they come: chunks and the work on markers take tenths
of a second; what lies further was counted from another instant."""
CHECKED = 10
"""Choice. Frames after which time stamps must agree with the rate: each frame lost by then is seen in both alike."""
PACE = 0.01
"""Choice. By how much they may disagree: accelerations are then off by 2 %; clocks drift by a thousandth of that."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Arrival:
    """What one packet brought."""

    time_s: Float[Tensor, " frames"]
    """One time, or none where the packet had no markers."""
    position: Float[Tensor, "frames markers 3"]
    sample_s: Float[Tensor, " samples"]
    wrench: Float[Tensor, "samples plates 6"]
    arrived_s: float
    """By the monotonic clock of this machine."""


class Run:
    """Puts the packets of one connection on one clock.

    A frame is at its number by the rate. Force samples have numbers of their own, by which they are placed: they come
    in chunks, not with the frame at which they were taken (RT protocol, ``StreamFrames``). Frame one and sample one are
    taken to be of one instant, so that sample k of the n from a frame to the next is at (frame + k / n) / rate.
    """

    def __init__(self, settings: Settings, labels: tuple[str, ...], after_s: float | None) -> None:
        """Wait for the first packet.

        Args:
            labels: in the order that is asked for; those that the run lacks are missing.
            after_s: time of the newest frame of the run before; None where there was none.
        """
        self._settings, self._after_s = settings, after_s
        known = {label: k for k, label in enumerate(settings.labels)}
        self._columns = torch.tensor([known.get(label, -1) for label in labels])
        self._first: tuple[int, int] | None = None
        self._frame, self._shift, self._late_s = 0, 0, None
        self._number, self._waiting = dict[int, int](), dict[int, dict[int, Tensor]]()
        self._said = set[str]()

    @property
    def begun(self) -> bool:
        """Whether a frame has come."""
        return self._first is not None

    @property
    def newest_s(self) -> float | None:
        """Time of the newest frame, of the run before as long as there is none."""
        return self._after_s if self._first is None else (self._frame + self._shift) / self._settings.rate_hz

    def take(self, packet: QRTPacket) -> Arrival:
        """Return what is in a packet, and the samples that it completes.

        Raises:
            InputError: ``live.qualisys`` where it contradicts the run or its settings.
        """
        arrived_s, markers, forces = time.monotonic(), packet.get_3d_markers(), packet.get_force()
        time_s, position = torch.zeros(0).double(), torch.zeros(0, len(self._columns), 3).double()
        if markers is not None:
            self._advance(packet.framenumber, packet.timestamp)
            time_s, seen = torch.tensor([self.newest_s], dtype=torch.float64), self._settings.positions(markers[1])
            position = torch.cat([seen, seen.new_full((1, 3), torch.nan)])[self._columns][None]
        if forces is not None and self._first is not None:  # before a frame no time is known
            for plate, samples in forces[1]:
                self._keep(plate.id, plate.force_number, torch.tensor(samples, dtype=torch.float64).reshape(-1, 9))
        return Arrival(time_s, position, *self._complete(), arrived_s)

    def _advance(self, frame: int, stamp_us: int) -> None:
        rate_hz, source = self._settings.rate_hz, self._settings.source
        if self._first is None:
            self._first = (frame, stamp_us)
            self._shift = 0 if self._after_s is None else round((self._after_s + PAUSE_S) * rate_hz) - frame
        elif frame <= self._frame:
            raise fault(source, "counts its frames anew", f"{frame} after {self._frame}", "Nothing needs to be done")
        self._frame = frame
        frames, seconds = frame - self._first[0], 1e-6 * (stamp_us - self._first[1])
        if frames >= CHECKED and abs(seconds * rate_hz / frames - 1.0) > PACE:
            raise fault(source, "sends frames at another rate than it states", f"{frames} in {seconds:.4g} s, stated "
                        f"{rate_hz:g} Hz", "Set the capture rate in QTM to that of the external clock")  # fmt: skip

    def _keep(self, identity: int, number: int, samples: Float[Tensor, "samples 9"]) -> None:
        """Keep samples of a plate until the other plates have theirs."""
        if not len(samples):
            return
        if identity not in self._settings.ids:
            raise fault(self._settings.source, "sends a plate that its parameters lack", f"plate {identity}",
                        "Look whether plates were added in QTM while it streams")  # fmt: skip
        if number <= self._number.get(identity, number - 1):
            raise fault(self._settings.source, "counts its forces anew", f"{number} after {self._number[identity]}",
                        "Nothing needs to be done")  # fmt: skip
        self._number[identity] = number + len(samples) - 1
        if self._late_s is None:
            self._late_s = self._offset(number, len(samples))
        plate = self._settings.ids.index(identity)
        self._say(self._settings.doubt(plate, samples))
        wrench = self._settings.wrench(plate, samples)
        for k in wrench.isfinite().all(dim=1).nonzero()[:, 0].tolist():  # where QTM has a force at all
            self._waiting.setdefault(number + k, {})[plate] = wrench[k]

    def _offset(self, number: int, count: int) -> float:
        """How much later samples are than their numbers say: nothing, unless the numbers cannot be those of frames."""
        rate_hz, force_rate_hz = self._settings.rate_hz, self._settings.force_rate_hz
        last_s, frame_s = (number + count - 1) / force_rate_hz, self._frame / rate_hz
        if abs(last_s - frame_s) < LAG_S:
            return 0.0
        self._say(f"force sample {number} comes with frame {self._frame}: they do not count from the same instant, and "
                  "forces are taken to be as old as the frame with which they came; they may be late")  # fmt: skip
        return frame_s - last_s

    def _complete(self) -> tuple[Float[Tensor, " samples"], Float[Tensor, "samples plates 6"]]:
        """Samples that all plates have; those that one plate still lacks after a while are dropped."""
        plates, force_rate_hz = range(len(self._settings.ids)), self._settings.force_rate_hz
        whole = sorted(number for number, parts in self._waiting.items() if len(parts) == len(plates))
        rows = [torch.stack([parts[plate] for plate in plates]) for parts in map(self._waiting.pop, whole)]
        newest = max((*whole[-1:], *self._waiting), default=0)
        for number in [one for one in self._waiting if one < newest - JUMP_S * force_rate_hz]:
            lacking = [self._settings.plates[plate].name for plate in plates if plate not in self._waiting[number]]
            self._say(f"no forces of {', '.join(lacking)}, without which those of other plates do not count")
            del self._waiting[number]
        start_s = (self._shift + 1) / self._settings.rate_hz + (self._late_s or 0.0)
        sample_s = start_s + (torch.tensor(whole, dtype=torch.float64) - 1.0) / force_rate_hz
        return sample_s, torch.stack(rows) if rows else torch.zeros(0, len(plates), 6, dtype=torch.float64)

    def _say(self, text: str) -> None:
        """Say something once."""
        if text and text not in self._said:
            self._said.add(text)
            log.warning("%s: %s", self._settings.source, text)
