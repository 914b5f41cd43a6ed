"""This module says how far skin that slides with joints' angles may have led geometry and marker places astray.

Frames do not average it out: it comes back with every step. A marker's place on its segment is taken to move in
proportion to each angle of the joints at both ends of the segment (Barre et al., J Biomech 62:21 (2017): slides of
thighs correlate highly with the knee's flexion). Most of that looks like motion or like another joint centre, and only
what is left of it can be seen; how far skin slides is what makes this as large as it is.

Slides c move scores by C'W(C - J (J'WJ)^-1 J'W C) c = Q c, with motion and xi eliminated, whose noise has covariance Q.
Their prior is s^2 L. They move xi by P^-1 U' c, where U are the scores of xi by slides and P the posterior's precision.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.model.tree import Tree

IN_COMMON = 0.5
"""Part of the variance of slides that all markers of a segment have in common; chosen: a cluster's rigid and non-rigid
motion are of similar size (Grimpampi et al., IEEE Trans Biomed Eng 61:362 (2014))."""
RATIOS = tuple(2.0 ** (k / 2.0) for k in range(-30, 31))
"""Resolution. Variances of slides that are tried, over that of noise where the median direction tells both alike."""
SEEN = 1e-9
"""Resolution. Information on slides, over the largest, below which nothing is seen of a direction."""
LIKELIER = 1e-6
"""Resolution. Log likelihood by which a larger slide has to be better: where all directions tell alike none is."""


@dataclass(frozen=True)
class Slides:
    """One unknown for each marker, axis of its segment and angle of a joint near it."""

    marker: Int[Tensor, " slides"]
    row: Int[Tensor, " slides"]
    """Three times the marker, plus the axis of its segment along which it slides."""
    angle: Int[Tensor, " slides"]
    """The row in ``angles`` of the angle with which it goes."""
    angles: Float[Tensor, "angles frames"]
    """The angles with which anything slides, from their means [rad]."""
    group: Int[Tensor, " slides"]
    """Equal where segment, axis and angle are."""
    loose: Float[Tensor, " slides"]
    """Each marker's slide beside those of others, one in the root mean square."""

    def root(self) -> Float[Tensor, "slides slides"]:
        """Return the Cholesky factor of L, the covariance of slides of unit variance."""
        same = (self.group[:, None] == self.group).to(self.loose)
        alike = IN_COMMON * same + (1.0 - IN_COMMON) * torch.eye(len(self.loose)).to(self.loose)
        return self.loose[:, None] * torch.linalg.cholesky(alike)

    def moment(
        self,
        R_BW: Float[Tensor, "markers 3 3 frames"],
        weight: Float[Tensor, "markers frames"],
        residual: Float[Tensor, "markers 3 frames"],
    ) -> Float[Tensor, " slides"]:
        """Return the scores of slides.

        Args:
            R_BW: orientations of the world in the markers' segments.
            weight: of the markers [1/m^2].
            residual: of the markers, along axes of the world [m].
        """
        along = torch.einsum("maxt,mxt->mat", R_BW, residual) * weight[:, None]
        return (self.angles @ along.flatten(0, 1).mT)[self.angle, self.row]


def slides_of(tree: Tree, body: list[int], q: Float[Tensor, "dofs frames"], loose: Float[Tensor, " markers"]) -> Slides:
    """Return the slides of markers.

    Args:
        tree: of the model.
        body: index of each marker's segment in it.
        q: coordinates [rad].
        loose: how far each marker slides beside others.
    """
    at = [[turn.row for turn in one.turns if turn.moving] for one in tree.bodies]
    near = [at[k] + [a for c, one in enumerate(tree.bodies) if one.parent == k for a in at[c]] for k in range(len(at))]
    every = [(m, 3 * m + axis, a, (k, axis, a)) for m, k in enumerate(body) for axis in range(3) for a in near[k]]
    groups = {name: n for n, name in enumerate(dict.fromkeys(one[3] for one in every))}
    marker, row, angle = (torch.tensor([one[n] for one in every], device=q.device).long() for n in range(3))
    group = torch.tensor([groups[one[3]] for one in every], device=q.device).long()
    used, angle = angle.unique(return_inverse=True)
    angles = tree.axes(q)[used]
    own = loose.to(q) / loose.to(q).square().mean().sqrt()
    return Slides(marker, row, angle, angles - angles.mean(1, keepdim=True), group, own[marker])


@dataclass
class SlideSums:
    """The sums of what frames say of slides."""

    slides: Slides
    scores: Float[Tensor, "slides xi"]
    """The scores U of slides by xi, with motion eliminated."""
    information: Float[Tensor, "slides slides"]
    """The information on slides, with motion eliminated."""

    @staticmethod
    def nothing(slides: Slides, xi: int) -> "SlideSums":
        """Return sums of no frame."""
        n = len(slides.row)
        return SlideSums(slides, slides.angles.new_zeros(n, xi), slides.angles.new_zeros(n, n))

    def add(
        self,
        frames: Int[Tensor, " frames"],
        R_BW: Float[Tensor, "frames markers 3 3"],
        weight: Float[Tensor, "frames markers"],
        motion: Float[Tensor, "frames dofs rows"],
        score: Float[Tensor, "frames rows xi"],
    ) -> None:
        """Add frames.

        Args:
            frames: their indices.
            R_BW: orientations of the world in the markers' segments.
            weight: of the markers [1/m^2].
            motion: V with V'V what motion takes from the weights, rows along axes of the world.
            score: of xi by residuals, with motion eliminated, rows along axes of the world.
        """
        own, few, markers = self.slides, len(frames), R_BW.shape[1]
        angles = own.angles[:, frames]
        turned = (R_BW @ score.view(few, markers, 3, -1)).view(few, 3 * markers, -1)
        self.scores += (angles @ turned.flatten(1)).view(len(angles), *turned.shape[1:])[own.angle, own.row]
        taken = (motion.view(few, -1, markers, 3)[..., None, :] @ R_BW.mT[:, None])[..., 0, :].flatten(2)
        told = torch.diag_embed(weight.repeat_interleave(3, dim=1)) - taken.mT @ taken
        for angle in range(len(angles)):  # with one, few rows move: a tenth of the products of all with all
            mine = torch.nonzero(own.angle == angle)[:, 0]
            pairs = (angles * angles[angle]) @ told[:, own.row[mine]].flatten(1)
            self.information[mine] += pairs.view(len(angles), len(mine), -1)[own.angle, :, own.row].mT

    def scaled(self, factor: float) -> "SlideSums":
        """Return the sums of so many times as many frames.

        Args:
            factor: how many.
        """
        return SlideSums(self.slides, factor * self.scores, factor * self.information)


def slid_covariance(
    sums: SlideSums, moment: Float[Tensor, " slides"], covariance: Float[Tensor, "xi xi"]
) -> tuple[Float[Tensor, "xi xi"], float]:
    """Return what sliding skin adds to the covariance of xi, and how far it slides along an axis of a segment [m/rad].

    How far is the likeliest of the moments, whose noise has a size of its own (its maximum given the ratio is known).
    Where nothing tells, skin adds nothing.

    Args:
        sums: of all frames.
        moment: scores of the slides at the solution.
        covariance: of xi without skin.
    """
    root = sums.slides.root()
    left = sums.information - sums.scores @ covariance @ sums.scores.mT
    d, Q = torch.linalg.eigh(root.mT @ left @ root)
    some = d > SEEN * d.clamp(min=0.0).amax() if d.numel() else d > 0.0
    d, y = d[some], Q[:, some].mT @ (root.mT @ moment)
    if not bool(y.any()):
        return torch.zeros_like(covariance), 0.0
    best, variance, typical = -math.inf, 0.0, float(d.median())
    for ratio in (0.0, *(one / typical for one in RATIOS)):
        spread = d + ratio * d.square()
        noise = float((y.square() / spread).mean())
        nats = -0.5 * (len(d) * math.log(noise) + float(spread.log().sum()))
        if nats > best + LIKELIER:
            best, variance = nats, ratio * noise
    way = covariance @ sums.scores.mT @ root
    return variance * way @ way.mT, math.sqrt(variance)
