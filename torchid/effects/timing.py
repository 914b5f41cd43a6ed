"""Forces that come late, by a clock or by the body, and markers that were filtered before anybody saw them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np
import scipy.interpolate
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.clocks import USUAL_LAG_S
from torchid.effects.kinds import ReadingEffect, SlidingMarkers
from torchid.effects.marker_scene import Sight, Slid, View
from torchid.effects.parameter import Parameter, value_of
from torchid.effects.place import SESSION, Place, covers
from torchid.effects.quantities import NamedEffect, of, size
from torchid.effects.scene import Reading
from torchid.effects.traits import Correction, Origin, Proof, Response, Site
from torchid.filters import Smoother
from torchid.wording import stated


def delayed(
    time: Float[Tensor, " frames"], signal: Float[Tensor, "frames channels"], lags_s: Sequence[float]
) -> Float[Tensor, "lags frames channels"]:
    """Return a signal as it was some lags ago, by a cubic spline; what comes beyond an end is the sample there.

    Args:
        time: of the samples [s].
        signal: what is read of it.
        lags_s: by how much each comes late [s]; negative: early.
    """
    clock = time.cpu().numpy()
    spline = scipy.interpolate.make_interp_spline(clock, signal.cpu().numpy(), k=3)
    late = np.stack([spline(np.clip(clock - lag_s, clock[0], clock[-1])) for lag_s in lags_s])
    return torch.as_tensor(late, dtype=signal.dtype, device=signal.device)


class LateReading(ReadingEffect):
    """Forces come late by a lag."""

    response = Response.TIME_SHIFT

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """Readings as they were a lag ago (``delayed``)."""
        if not covers(place, reading.trial):
            return reading
        wrench, zeroed = reading.wrench.flatten(1), reading.zeroed
        both = wrench if zeroed is None else torch.cat([wrench, zeroed], 1)
        (late,) = delayed(reading.time, both, (float(theta[0]),))
        wrench, zeroed = late[:, : wrench.shape[1]], None if zeroed is None else late[:, wrench.shape[1] :]
        return replace(reading, wrench=wrench.reshape(reading.wrench.shape), unborne=None, zeroed=zeroed)

    def _told(self, finding: NamedEffect) -> str:
        lag, sd = of(finding, "lag_s")
        late = f"{stated(lag.abs()[0], sd[0], 'ms', 1e3)} {'late' if lag[0] > 0 else 'early'}"
        return f"forces come {late} in {self.located(finding.where)}"


@final
class TimeOffset(LateReading):
    """Cameras and plates disagree about when: forces come late by a lag, in all trials or in one."""

    name = "time_offset"
    mistaken = 0.11
    site = Site.TRIAL
    parameters = (
        Parameter("lag_s", 0.01, source="Lemaire & Kuo, bioRxiv 2024.06.24.600392 (2024): latencies within standard "
                  "equipment put forces and motion of the order of ten milliseconds apart"),
    )  # fmt: skip
    noun = "a clock that is off"
    advice = "a jump or a stamp, which marks one instant in markers and forces alike"
    apart = {
        "time_offset": "a stamp in every trial",
        "drag": "a jump or a stamp: a wrong clock shows at the impact, a drag does not",
        "filter_lag": "a jump or a stamp: a filter blunts the impact, a wrong clock only shifts it",
        "body_lag": "something hard dropped on a plate with a marker on it: no soft part comes between",
    }

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """The session, or single trials: cables and triggers seldom change, so that all of these together are a fifth
        as likely."""
        single = tuple(Place((view.scene.trial,), odds=0.2 / len(views)) for view in views)
        return (SESSION, *single) if len(views) > 1 else (SESSION,)

    def source(self, place: Place) -> tuple[Place, tuple[str, ...] | None]:
        return SESSION, None if place.where == SESSION.where else place.where

    def sentence(self, finding: NamedEffect) -> str:
        return self._told(finding)


@final
class BodyLag(LateReading):
    """The soft parts of a body follow its bones late, never early, and with them the forces on the ground."""

    name = "body_lag"
    origin = Origin.BODY
    parameters = (
        Parameter("lag_s", math.hypot(*USUAL_LAG_S.values()), positive=True, source="root mean square over seven "
                  "sessions of four laboratories, of vertical and horizontal together (`USUAL_LAG_S`)"),
    )  # fmt: skip
    noun = "a body that follows its bones late"
    advice = "something hard dropped on a plate with a marker on it, which no soft part delays"

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (SESSION,)

    def sentence(self, finding: NamedEffect) -> str:
        return f"{self._told(finding)}, as where the soft parts of a body follow its bones"


TRUSTED = 0.6
"""Estimator. Part of the cut-off up to which motion is restored: there, 0.9 of an amplitude came through. Faster, what
markers show that slide on the skin would be restored as well, which no force has."""


@final
class FilterLag(SlidingMarkers):
    """The markers were low-passed before anybody saw them: accelerations come out too small, the more the faster.

    The filter is a second-order Butterworth run both ways. Internal is its cut-off to the power of -4 [1/Hz^4]: what it
    took away of the markers as they are read is that times the fourth derivative, exactly. Columns explain markers as
    they were read; a simulation filters true ones.
    """

    name = "filter_lag"
    mistaken = 0.08
    proof = Proof.SMOOTHNESS
    correction = Correction.WRENCH
    """No marker gives back what a filter took away."""
    site = Site.TRIAL
    parameters = (
        Parameter("slowness", 5e-4, positive=True, source="a choice: one standard deviation is a cut-off of 6.7 Hz, "
                  "about what is usual for gait (Winter, Sidwall & Hobson, J Biomech 7 (1974))"),
    )  # fmt: skip
    noun = "markers that were low-passed"
    advice = "a quick motion (a stamp, a shaken arm) with the cameras' own filter switched off"
    apart = {
        "wobbling_mass": "a stamp with a heavy rigid tool: it has no soft mass, but passes the filter",
        "drag": "slow and quick motion: a drag shows at low speed too",
        "skin_lag": "a stamp with markers on something rigid: it has no soft tissue, but passes the filter",
    }

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (SESSION,)

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        """The filter as (1 + theta D^4)^-1, with D^4 a stencil of five frames, places and slopes at the ends held.

        The stencil is local, so that ends matter near the ends only.
        """
        p = sight.p
        flat, n = p.flatten(0, 1).T.cpu().numpy(), p.shape[2]
        weight = float(theta[0]) * (sight.scene.rate / (2.0 * math.pi)) ** 4
        band = weight * np.repeat(np.array([1.0, -4.0, 6.0, -4.0, 1.0])[:, None], n, 1)
        # Column j of a row is the matrix' entry (j + row - 2, j): the two rows at either end are those of the identity.
        for row in range(5):
            at = np.arange(n) + row - 2
            band[row, (at < 2) | (at > n - 3)] = 0.0
        band[2] += 1.0
        slid = torch.as_tensor(scipy.linalg.solve_banded((2, 2), band, flat) - flat).to(p)
        return Slid(tuple(range(len(p))), slid.T.reshape(p.shape))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"cutoff_hz": theta[0].clamp(min=1e-12) ** -0.25}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "cutoff_hz", 1) ** -4

    def trusted(
        self, added: Float[Tensor, "frames 6"], rate_hz: float, place: Place, theta: Float[Tensor, " params"]
    ) -> Float[Tensor, "frames 6"]:
        """The wrench up to ``TRUSTED`` times the cut-off."""
        return Smoother(TRUSTED * float(self.named(place, theta)["cutoff_hz"]), rate_hz)(added)

    def sentence(self, finding: NamedEffect) -> str:
        return (
            f"the markers had been low-passed at {size(finding, 'cutoff_hz', 'Hz')} before anybody read them, "
            "so that quick accelerations come out too small"
        )
