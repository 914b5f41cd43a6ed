"""Response of the fitted motion to displaced markers, and what they leave in the residuals of the fit.

Postures are free in every frame. A displacement D of the markers therefore moves the fitted coordinates by K D, with K
the weighted pseudo-inverse of the markers' Jacobian J, and shows among the residuals as (1 - J K) D. The bodies that
the dynamics sees move along; the wrench that they then need follows from nine numbers a frame, the vectors A, B and C
of ``effects.displacement``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.displacement import carriage, levers, wrench_of
from torchid.effects.marker_scene import Sight
from torchid.effects.scene import Scene
from torchid.observation.marker_bands import MarkerBands
from torchid.observation.marker_noise import marker_scatter
from torchid.observation.row_response import RowResponse

COARSE_HZ = 10.0
"""Resolution. Rate to which residuals are averaged [Hz]: postures and effects change slowly against it."""
CHUNK = 256
"""Resolution. Number of frames whose Jacobians are made together."""


@dataclass(frozen=True)
class MarkerResponse:
    """Markers of one trial, how far they are from the fitted model, and how that model yields to displacements."""

    sight: Sight
    """Markers where the fitted model carries them."""
    weight: Float[Tensor, "markers frames"]
    """1 / sigma^2 [1/m^2], zero where nothing was seen."""
    error: Float[Tensor, "markers 3 frames"]
    """Measured minus modelled place [m] in W, zero where nothing was seen."""
    precision: Float[Tensor, " dofs"]
    """Precision of the posture prior of each coordinate [1/rad^2, 1/m^2]."""
    _answers: dict[tuple[int, ...], Float[Tensor, "frames 9 some"]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    """Responses of the momenta to markers that were asked for (``_against``): the same segments are, draw by draw."""

    def frames(self, part: slice, scene: Scene) -> "MarkerResponse":
        """Return the response in some of the frames; momenta are in each what they are among all frames.

        Args:
            part: the frames to keep.
            scene: motion and inertia in these frames.
        """
        sight = replace(self.sight, scene=scene)
        found = replace(self, sight=sight, weight=self.weight[:, part], error=self.error[..., part])
        # Kept as its ``cached_property`` would keep it: making it again takes as long as two draws.
        found.__dict__["answer"] = self.answer[part]
        return found

    def forget(self) -> None:
        """Drop what will be asked for once more at most, which is half of what a trial holds.

        The next trial's is made in the memory that becomes free: fresh memory is slow to touch.
        """
        self._answers.clear()
        for name in ("carriage", "mean_factor", "levers", "carried"):
            self.__dict__.pop(name, None)

    @cached_property
    def arm(self) -> Float[Tensor, "markers 3 frames"]:
        """Vector from the origin of each marker's body to the marker [m], in W."""
        return self.sight.p - self.sight.scene.state.at.p[self.sight.body]

    @cached_property
    def carriage(self) -> Float[Tensor, "frames bodies dofs"]:
        """Displacement [m] and rotation [rad] of the bodies per unit of each coordinate, six rows a body."""
        return carriage(self.sight.scene)

    @cached_property
    def levers(self) -> Float[Tensor, "frames 9 bodies"]:
        """Vectors A, B and C per displacement and rotation of the bodies, six columns each
        (``displacement.levers``)."""
        return levers(self.sight.scene)

    def jacobian(self, which: slice | Tensor) -> Float[Tensor, "frames rows dofs"]:
        """Return the Jacobian of the markers' places [m/rad, m/m] in some frames, rows x, y, z marker by marker."""
        own = self.carriage[which].unflatten(1, (-1, 6))[:, self.sight.body]
        arm = self.arm.permute(2, 0, 1)[which]
        turned = torch.linalg.cross(own[:, :, 3:], arm[..., None].expand_as(own[:, :, 3:]), dim=2)
        return (own[:, :, :3] + turned).flatten(1, 2)

    def factor(
        self, J: Float[Tensor, "frames rows dofs"], w: Float[Tensor, "frames rows"]
    ) -> Float[Tensor, "frames dofs dofs"]:
        """Return the lower Cholesky factor of J' w J plus the precision of the posture prior.

        Args:
            J: Jacobian of the markers.
            w: weights of its rows [1/m^2].
        """
        H = J.mT @ (w[:, :, None] * J)
        scale = torch.diagonal(H, dim1=1, dim2=2).amax(1, keepdim=True)
        torch.diagonal(H, dim1=1, dim2=2).add_(self.precision + 1e-9 * scale + 1e-9)
        return torch.linalg.cholesky(H)

    @cached_property
    def mean_weight(self) -> Float[Tensor, " markers"]:
        """Mean of the weight over the frames [1/m^2]: weights that change at the edges of gaps would make steps in the
        motion."""
        return self.weight.mean(1)

    @cached_property
    def mean_factor(self) -> Float[Tensor, "frames dofs dofs"]:
        """Factor (``MarkerResponse.factor``) under the mean weights, frame by frame."""
        w, frames = self.mean_weight.repeat_interleave(3), self.weight.shape[1]
        some = (self.jacobian(slice(start, start + CHUNK)) for start in range(0, frames, CHUNK))
        return torch.cat([self.factor(J, w.expand(len(J), -1)) for J in some])

    @cached_property
    def answer(self) -> Float[Tensor, "frames 9 rows"]:
        """Vectors A, B and C of the motion that follows displaced markers [per m]: levers times carriage times K,
        without J."""
        found = torch.cholesky_solve((self.levers @ self.carriage).mT, self.mean_factor).mT @ self.carriage.mT
        own = found.unflatten(2, (-1, 6))[:, :, self.sight.body]
        arm = self.arm.permute(2, 0, 1)[:, None].expand_as(own[..., 3:])
        own = own[..., :3] + torch.linalg.cross(own[..., 3:], arm, dim=3)
        return own.mul_(self.mean_weight[:, None]).flatten(2)

    def followed(self, by: Float[Tensor, "frames rows draws"]) -> Float[Tensor, "frames dofs draws"]:
        """Return the change of the fitted coordinates [rad, m] that displaced markers bring about.

        Args:
            by: displacements of the markers' coordinates in W [m], in several draws.
        """
        pull = by.unflatten(1, (-1, 3)) * self.mean_weight[:, None, None]
        arm = self.arm.permute(2, 0, 1)[..., None].expand_as(pull)
        both = torch.cat([pull, torch.linalg.cross(arm, pull, dim=2)], 2)
        bodies = both.new_zeros(len(by), len(self.sight.scene.tree.names), 6, by.shape[2])
        right = self.carriage.mT @ bodies.index_add_(1, self.sight.body, both).flatten(1, 2)
        return torch.cholesky_solve(right, self.mean_factor)

    @cached_property
    def scatter(self) -> Float[Tensor, "2 markers"]:
        """Noise of each marker's coordinates, low (first row) and high (second row), see ``marker_scatter`` [m]."""
        kept = self.bands.kept.view(-1, 3).mean(1)
        return marker_scatter(self.error, self.weight > 0.0, kept, self.sight.scene.rate)

    @cached_property
    def least(self) -> float:
        """Variance of the white noise against the rows' weights (dimensionless), averaged over what is seen."""
        energy = (self.weight * self.scatter[0].square()[:, None]).sum()
        return max(1e-6, float(energy / (self.weight > 0.0).sum().clamp(min=1)))

    @cached_property
    def bands(self) -> "MarkerBands":
        """Averages of the rows over a few frames, against which postures and effects change slowly."""
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

    def respond(self, which: Sequence[int], by: Float[Tensor, "columns some 3 frames"]) -> RowResponse:
        """Return the response to markers that cameras see elsewhere than the bodies carry them.

        Args:
            by: their displacement in W per unit of each parameter [m].
        """
        rows = self._rows(tuple(which))

        def shown() -> Float[Tensor, "columns bins rows"]:
            shift = by.new_zeros(len(by), *self.bands.error.shape)
            shift[:, :, rows] = by[..., self.bands.middle].permute(0, 3, 1, 2).flatten(2)
            return shift

        def momenta() -> Float[Tensor, "columns 9 frames"]:
            return (self._against(tuple(which)) @ by.permute(3, 1, 2, 0).flatten(1, 2)).permute(2, 1, 0)

        return RowResponse(momenta, shown)

    def _rows(self, which: tuple[int, ...]) -> slice | Tensor:
        """Return the rows of some markers."""
        if which == tuple(range(len(self.sight.labels))):
            return slice(None)
        return torch.tensor([3 * k + i for k in which for i in range(3)], dtype=torch.long)

    def _against(self, which: tuple[int, ...]) -> Float[Tensor, "frames 9 some"]:
        """Return the vectors A, B and C of bodies that seem to go where markers went, which is minus ``answer``."""
        if which not in self._answers:
            self._answers[which] = -self.answer[:, :, self._rows(which)]
        return self._answers[which]

    @cached_property
    def carried(self) -> Float[Tensor, "frames 9 bodies"]:
        """Vectors A, B and C of displaced bodies, six columns each in plan order, less those of ``answer`` to their
        markers."""
        own = self.answer.unflatten(2, (-1, 3))
        turned = torch.linalg.cross(self.arm.permute(2, 0, 1)[:, None].expand_as(own), own, dim=3)
        found = self.levers.unflatten(2, (-1, 6)).clone()
        return found.index_add_(2, self.sight.body, torch.cat([own, turned], 3), alpha=-1.0).flatten(2)

    def moved(self, bodies: Sequence[Float[Tensor, "bodies 6 frames"]]) -> RowResponse:
        """Return the response to bodies that are displaced together with their markers, in several ways.

        Args:
            bodies: for each way, displacement [m] and rotation [rad] of every body in W, plan order.
        """

        def momenta() -> Float[Tensor, "columns 9 frames"]:
            reach = torch.stack([torch.linalg.vector_norm(one, dim=(1, 2)) for one in bodies])
            which = reach.amax(0).nonzero()[:, 0]
            own = self.carried.unflatten(2, (-1, 6))[:, :, which].flatten(2)
            # With columns side by side in memory, the product takes a third of the time.
            found = own @ torch.stack([one[which].flatten(0, 1) for one in bodies], 2).permute(1, 0, 2)
            return found.permute(2, 1, 0)

        return RowResponse(momenta, lambda: self.shown(torch.stack([one[..., self.bands.middle] for one in bodies])))

    def shown(self, bodies: Float[Tensor, "columns bodies 6 bins"]) -> Float[Tensor, "columns bins rows"]:
        """Return how far displaced bodies take their markers [m].

        Args:
            bodies: displacement [m] and rotation [rad] in W at the middle of each average, plan order.
        """
        own, arm = bodies[:, self.sight.body], self.arm[..., self.bands.middle]
        shift = own[:, :, :3] + torch.linalg.cross(own[:, :, 3:], arm.expand_as(own[:, :, 3:]), dim=2)
        return shift.permute(0, 3, 1, 2).flatten(2)

    def wrench(self, answers: Sequence[RowResponse]) -> Float[Tensor, "6 columns frames"]:
        """Return the wrench about the origin of W that the motion needs because of displacements [N, N m].

        Args:
            answers: responses to them; their columns follow one another.
        """
        return wrench_of(torch.cat([a.nine for a in answers]), self.sight.scene.rate).transpose(0, 1)
