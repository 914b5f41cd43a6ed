"""How markers speak in the diagnosis: what they leave of the fit, and how the fitted motion yields to a displacement.

Postures are free in every frame. A displacement D of the markers therefore moves the fitted coordinates by K D, with K
the weighted pseudo-inverse of the markers' Jacobian J, and shows among the residuals as (1 - J K) D. The bodies that
the dynamics sees move along.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.displacement import carriage, levers, wrench_of
from torchid.effects.marker_scene import Sight
from torchid.effects.scene import Scene
from torchid.observation.marker_bands import MarkerBands
from torchid.regressor.rows import runs
from torchid.regressor.whitening import QUIET, cosine_matrix

COARSE_HZ = 10.0
"""Residuals are averaged to about this rate: postures and effects change slowly against it."""
NEAR_HZ = (6.0, 10.0)
"""Where noise is looked at as well: markers that were low-passed at 8 Hz showed a fiftieth of theirs at 20 Hz, and four
false causes explained the rest."""
WINDOW = 64
"""Frames whose energy is one piece of evidence on the noise."""
SEEN_LONG = 25
"""Frames in a row that tell a marker's noise: the edges of gaps are none."""
ALIKE = 1.5
"""Ratio of two estimates of a variance up to which they are of one."""
LEFT = 0.05
"""Least share of a marker's noise that postures may leave of it."""
CHUNK = 256
"""Frames whose Jacobians are made together."""


@dataclass(frozen=True)
class Response:
    """What a displacement does to the rows of a trial, per unit parameter; worked out as far as it is asked for."""

    momenta: Callable[[], Float[Tensor, "columns 9 frames"]]
    shown: Callable[[], Float[Tensor, "columns bins rows"]]
    spectral: Callable[[], Float[Tensor, "columns kept rows"]] | None = None
    """Coefficients of what postures leave, where there is a shorter way to them."""

    @property
    def nine(self) -> Float[Tensor, "columns 9 frames"]:
        """Vectors A, B, C of what the motion needs, see ``momentum``."""
        return self.momenta()

    @property
    def shift(self) -> Float[Tensor, "columns bins rows"]:
        """Of the markers, now and then."""
        return self.shown()

    def spectrum(self, bands: MarkerBands) -> Float[Tensor, "columns kept rows"]:
        """Coefficients of what postures leave of the shift."""
        return bands.spectrum(bands.left(self.shift)) if self.spectral is None else self.spectral()

    def per(self, step: Float[Tensor, " columns"]) -> "Answer":
        """To unit parameters of which these were parts."""
        return Response(lambda: self.nine / step[:, None, None], lambda: self.shift / step[:, None, None])

    def __add__(self, other: "Answer") -> "Answer":
        return Response(lambda: self.nine + other.nine, lambda: self.shift + other.shift)


def concatenate(answers: Sequence[Response]) -> Response:
    """To the parameters of all, one after the other."""
    return Response(lambda: torch.cat([a.nine for a in answers]), lambda: torch.cat([a.shift for a in answers]))


@dataclass(frozen=True)
class MarkerResponse:
    """Markers of one trial: what was seen, and how far from the fitted model."""

    sight: Sight
    weight: Float[Tensor, "markers frames"]
    """1 / sigma^2 [1/m^2], zero where nothing was seen."""
    error: Float[Tensor, "markers 3 frames"]
    """Measured minus modelled [m]; zero where nothing was seen."""
    precision: Float[Tensor, " dofs"]
    """Of the posture prior."""
    _answers: dict[tuple[int, ...], Float[Tensor, "frames 9 some"]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    """To markers that were asked for, see ``_against``: draw by draw, the same segments are."""

    def frames(self, part: slice, scene: Scene) -> "MarkerResponse":
        """Some of the frames, of which this is the scene; momenta answer in them as they do among all."""
        sight = replace(self.sight, scene=scene)
        found = replace(self, sight=sight, weight=self.weight[:, part], error=self.error[..., part])
        # As its ``cached_property`` would keep it: made again, it took as long as two draws.
        found.__dict__["answer"] = self.answer[part]
        return found

    def forget(self) -> None:
        """Let go of what is asked for once more at most, half of what a trial holds: the next one's is made in its
        memory, and to touch a new gigabyte takes a second."""
        self._answers.clear()
        for name in ("carriage", "mean_factor", "levers", "carried"):
            self.__dict__.pop(name, None)

    @cached_property
    def arm(self) -> Float[Tensor, "markers 3 frames"]:
        """From the origin of each marker's body to it, W axes [m]."""
        return self.sight.p - self.sight.scene.state.at.p[self.sight.body]

    @cached_property
    def carriage(self) -> Float[Tensor, "frames bodies dofs"]:
        """Of the bodies' displacements, six rows each."""
        return carriage(self.sight.scene)

    @cached_property
    def levers(self) -> Float[Tensor, "frames 9 bodies"]:
        """Of the momenta, see ``momentum.levers``."""
        return levers(self.sight.scene)

    def jacobian(self, which: slice | Tensor) -> Float[Tensor, "frames rows dofs"]:
        """Of the markers' places in some frames, row after row x, y, z of a marker."""
        own = self.carriage[which].unflatten(1, (-1, 6))[:, self.sight.body]
        arm = self.arm.permute(2, 0, 1)[which]
        turned = torch.linalg.cross(own[:, :, 3:], arm[..., None].expand_as(own[:, :, 3:]), dim=2)
        return (own[:, :, :3] + turned).flatten(1, 2)

    def factor(
        self, J: Float[Tensor, "frames rows dofs"], w: Float[Tensor, "frames rows"]
    ) -> Float[Tensor, "frames dofs dofs"]:
        """Of J' w J and the posture prior."""
        H = J.mT @ (w[:, :, None] * J)
        scale = torch.diagonal(H, dim1=1, dim2=2).amax(1, keepdim=True)
        torch.diagonal(H, dim1=1, dim2=2).add_(self.precision + 1e-9 * scale + 1e-9)
        return torch.linalg.cholesky(H)

    @cached_property
    def mean_weight(self) -> Float[Tensor, " markers"]:
        """Over the frames: a marker counts as much in each as it is seen of the time, for gaps would make steps."""
        return self.weight.mean(1)

    @cached_property
    def mean_factor(self) -> Float[Tensor, "frames dofs dofs"]:
        """With these weights."""
        w, frames = self.mean_weight.repeat_interleave(3), self.weight.shape[1]
        some = (self.jacobian(slice(start, start + CHUNK)) for start in range(0, frames, CHUNK))
        return torch.cat([self.factor(J, w.expand(len(J), -1)) for J in some])

    @cached_property
    def answer(self) -> Float[Tensor, "frames 9 rows"]:
        """Momenta of the fitted motion's answer to displaced markers: levers, carriage and K, without making J."""
        found = torch.cholesky_solve((self.levers @ self.carriage).mT, self.mean_factor).mT @ self.carriage.mT
        own = found.unflatten(2, (-1, 6))[:, :, self.sight.body]
        arm = self.arm.permute(2, 0, 1)[:, None].expand_as(own[..., 3:])
        own = own[..., :3] + torch.linalg.cross(own[..., 3:], arm, dim=3)
        return own.mul_(self.mean_weight[:, None]).flatten(2)

    def followed(self, by: Float[Tensor, "frames rows draws"]) -> Float[Tensor, "frames dofs draws"]:
        """The fitted coordinates' answer to displaced markers."""
        pull = by.unflatten(1, (-1, 3)) * self.mean_weight[:, None, None]
        arm = self.arm.permute(2, 0, 1)[..., None].expand_as(pull)
        both = torch.cat([pull, torch.linalg.cross(arm, pull, dim=2)], 2)
        bodies = both.new_zeros(len(by), len(self.sight.scene.tree.names), 6, by.shape[2])
        right = self.carriage.mT @ bodies.index_add_(1, self.sight.body, both).flatten(1, 2)
        return torch.cholesky_solve(right, self.mean_factor)

    @cached_property
    def scatter(self) -> Float[Tensor, "2 markers"]:
        """Noise of each marker's coordinates below ``NEAR_HZ`` and beyond, as white noise has as much of it there [m].

        From where it is seen longest; the middle one's if hardly. Skin that trembles, or a filter of the cameras' own,
        leaves less beyond: one runner's forces above 10 Hz had a ninth of what white noise would have made of them.
        """
        rate, seen = self.sight.scene.rate, self.weight > 0.0
        bands = QUIET, (min(NEAR_HZ[0] / rate, QUIET[0]), min(NEAR_HZ[1] / rate, QUIET[1]))
        found = self.error.new_full((len(seen), 2), float("nan"))
        for k, own in enumerate(seen):
            start, stop = max(runs(own), key=lambda run: run[1] - run[0], default=(0, 0))
            if stop - start >= SEEN_LONG:
                error = self.error[k, :, start:stop].T
                found[k] = found.new_tensor([_usual(error, band) for band in bands])
        quiet, near = torch.where(found.isnan(), found.nanmedian(0).values, found).nan_to_num().unbind(1)
        # Means of both where they agree: the larger of two is 8 % too large.
        alike = ~(near > ALIKE * quiet)
        both = torch.where(alike, 0.5 * (quiet + near), torch.stack([near, quiet])).sqrt()
        # Postures have taken their share of the noise: by one share for all, a foot had 20 % too little of its energy.
        return both / self.bands.kept.view(-1, 3).mean(1).clamp(min=LEFT).sqrt()

    @cached_property
    def least(self) -> float:
        """Variance of the white noise against the weights of the rows: mean over what is seen."""
        energy = (self.weight * self.scatter[0].square()[:, None]).sum()
        return max(1e-6, float(energy / (self.weight > 0.0).sum().clamp(min=1)))

    @cached_property
    def bands(self) -> "MarkerBands":
        """Averages over a few frames: postures and effects change slowly against them."""
        group = max(1, round(self.sight.scene.rate / COARSE_HZ))
        bins = self.weight.shape[1] // group
        seen = self.weight[:, : bins * group].unflatten(1, (bins, group))
        total = seen.sum(2)
        error = self.error[..., : bins * group].unflatten(2, (bins, group))
        mean = (seen[:, None] * error).sum(3) / total.clamp(min=1e-30)[:, None]
        middle = torch.arange(bins, device=total.device) * group + group // 2
        J, w = self.jacobian(middle), total.T.repeat_interleave(3, 1)
        K = torch.cholesky_solve(J.mT * w[:, None], self.factor(J, w))
        return MarkerBands(middle, self.sight.scene.rate / group, w.sqrt(), J, K, mean.permute(2, 0, 1).flatten(1))

    def respond(self, which: Sequence[int], by: Float[Tensor, "columns some 3 frames"]) -> Response:
        """To markers that are read elsewhere than the bodies carry them."""
        rows = self._rows(tuple(which))

        def shown() -> Float[Tensor, "columns bins rows"]:
            shift = by.new_zeros(len(by), *self.bands.error.shape)
            shift[:, :, rows] = by[..., self.bands.middle].permute(0, 3, 1, 2).flatten(2)
            return shift

        def momenta() -> Float[Tensor, "columns 9 frames"]:
            return (self._against(tuple(which)) @ by.permute(3, 1, 2, 0).flatten(1, 2)).permute(2, 1, 0)

        return Response(momenta, shown)

    def _rows(self, which: tuple[int, ...]) -> slice | Tensor:
        if which == tuple(range(len(self.sight.labels))):
            return slice(None)
        return torch.tensor([3 * k + i for k in which for i in range(3)], dtype=torch.long)

    def _against(self, which: tuple[int, ...]) -> Float[Tensor, "frames 9 some"]:
        """Minus the answer to some markers: bodies seem to go where these went."""
        if which not in self._answers:
            self._answers[which] = -self.answer[:, :, self._rows(which)]
        return self._answers[which]

    @cached_property
    def carried(self) -> Float[Tensor, "frames 9 bodies"]:
        """Momenta of displaced bodies, six columns each in plan order, less those of the answer to their markers."""
        own = self.answer.unflatten(2, (-1, 3))
        turned = torch.linalg.cross(self.arm.permute(2, 0, 1)[:, None].expand_as(own), own, dim=3)
        found = self.levers.unflatten(2, (-1, 6)).clone()
        return found.index_add_(2, self.sight.body, torch.cat([own, turned], 3), alpha=-1.0).flatten(2)

    def moved(self, bodies: Sequence[Float[Tensor, "bodies 6 frames"]]) -> Response:
        """To bodies that are displaced with their markers, in several ways."""

        def momenta() -> Float[Tensor, "columns 9 frames"]:
            reach = torch.stack([torch.linalg.vector_norm(one, dim=(1, 2)) for one in bodies])
            which = reach.amax(0).nonzero()[:, 0]
            own = self.carried.unflatten(2, (-1, 6))[:, :, which].flatten(2)
            # With columns side by side in memory, the product takes a third of the time.
            found = own @ torch.stack([one[which].flatten(0, 1) for one in bodies], 2).permute(1, 0, 2)
            return found.permute(2, 1, 0)

        return Response(momenta, lambda: self.shown(torch.stack([one[..., self.bands.middle] for one in bodies])))

    def shown(self, bodies: Float[Tensor, "columns bodies 6 bins"]) -> Float[Tensor, "columns bins rows"]:
        """How far bodies that are displaced in the middle of averages take their markers."""
        own, arm = bodies[:, self.sight.body], self.arm[..., self.bands.middle]
        shift = own[:, :, :3] + torch.linalg.cross(own[:, :, 3:], arm.expand_as(own[:, :, 3:]), dim=2)
        return shift.permute(0, 3, 1, 2).flatten(2)

    def wrench(self, answers: Sequence[Response]) -> Float[Tensor, "6 columns frames"]:
        """That the motion needs because of displacements, about the origin of W."""
        return wrench_of(torch.cat([a.nine for a in answers]), self.sight.scene.rate).transpose(0, 1)


def _usual(x: Float[Tensor, "frames 3"], band: tuple[float, float]) -> float:
    """Variance of white noise that has in a band (parts of the frame rate) what is there most of the time.

    Where an arm is lost for some frames, no band of the whole is quiet, and 80 mm were found.
    """
    length = min(WINDOW, len(x))
    first = round(2.0 * band[0] * length)
    # Of fast cameras, or a short run, a narrow band may hold less than one coefficient.
    last = max(first + 1, round(2.0 * band[1] * length))
    C = cosine_matrix(length, last).to(x)[first:]
    energy = (C @ x.unfold(0, length, length).mT).square().flatten(1).mean(1)
    # Median of chi-square over its mean (Wilson and Hilferty, PNAS 17 (1931)).
    return float(energy.quantile(0.5)) / (1.0 - 2.0 / (9.0 * 3.0 * (last - first))) ** 3
