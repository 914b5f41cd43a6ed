"""Responses to displacements in fixed ways, of which displacements that come and go are multiples.

Most of a catalogue's columns on markers are such: skin that slides as any joint bends, a centre that glides, a joint
that lacks an axis. Each frame responds by itself, so that the response to a way is made once and multiplied by the
course of every column that shares it.
"""

from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.marker_scene import Along, CarriedMarkers, Sway
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.row_response import RowResponse


class ResponseCache:
    """Responses of one trial's markers to displacements in fixed ways, made when they are first asked for and kept."""

    def __init__(self, response: MarkerResponse) -> None:
        """Keep the markers of the trial."""
        self.response = response
        self._made: dict[tuple[str, Hashable], Tensor] = {}

    def swayed(self, sway: Sway) -> RowResponse:
        """Return the response to unit parameters of a displacement in fixed ways.

        Args:
            sway: ways, courses in time, and the pair of them that belongs to each parameter.
        """
        way, course = ([pair[k] for pair in sway.pairs] for k in range(2))
        now, middle = sway.courses[course][:, None], self.response.bands.middle
        return RowResponse(
            lambda: _each(self.momenta(sway.ways), way) * now,
            lambda: _each(self.shown(sway.ways), way) * now[..., middle].mT,
            lambda: self._spectrum(sway),
        )

    def momenta(self, ways: Along | CarriedMarkers) -> Float[Tensor, "ways 9 frames"]:
        """Return the vectors A, B and C (``RowResponse.nine``) of every way.

        Args:
            ways: displacements of markers or of bodies.
        """
        if isinstance(ways, Along):
            return _along(self._momenta, ways)
        return self._once("momenta", ways, lambda: self._nine(ways.bodies()))

    def _nine(self, bodies: Float[Tensor, "ways bodies 6 frames"]) -> Float[Tensor, "ways 9 frames"]:
        """Return the vectors A, B and C of bodies displaced with their markers."""
        return self.response.moved(bodies.unbind()).nine.contiguous()

    def shown(self, ways: Along | CarriedMarkers) -> Float[Tensor, "ways bins rows"]:
        """Return the displacement of the markers (``RowResponse.shift``) in every way [m]."""
        middle = self.response.bands.middle
        if isinstance(ways, CarriedMarkers):
            return self._once("shown", ways, lambda: self.response.shown(ways.bodies()[..., middle]))
        n, own = len(ways.which), self._axes(ways.which)[..., middle]
        rows = own.new_zeros(n, 3, len(middle), len(self.response.sight.labels), 3)
        rows[range(n), :, :, list(ways.which)] = own.mT
        each = rows.flatten(3)
        return each.flatten(0, 1) if ways.ways is None else _along(each, replace(ways, which=tuple(range(n))))

    def _spectrum(self, sway: Sway) -> Float[Tensor, "params kept rows"]:
        """Return the coefficients (``RowResponse.spectrum``) of every parameter."""
        left, bands = self._left_of(sway.ways), self.response.bands
        found = [bands.spectrum(left, course) for course in sway.courses[:, bands.middle]]
        if len(found) == 1:
            return _each(found[0], [way for way, _ in sway.pairs])
        return torch.stack([found[course][way] for way, course in sway.pairs])

    def _left_of(self, ways: Along | CarriedMarkers) -> Float[Tensor, "ways bins rows"]:
        """Return what postures leave of every way, as ``MarkerBands.left`` does."""
        if isinstance(ways, Along):
            return _along(self._left, ways)
        return self._once("left", ways, lambda: self.response.bands.left(self.shown(ways)).contiguous())

    def _once(self, what: str, ways: CarriedMarkers, found: Callable[[], Tensor]) -> Tensor:
        """Return what is kept under a name for these ways, made if it is not there: ways are shared whatever they
        follow."""
        if (what, ways.key) not in self._made:
            self._made[what, ways.key] = found()
        return self._made[what, ways.key]

    def _axes(self, which: tuple[int, ...]) -> Float[Tensor, "some 3 3 frames"]:
        """Return the axes in W of the segments that carry some markers, one after the other."""
        sight = self.response.sight
        return sight.scene.state.at.R[sight.body[list(which)]]

    @cached_property
    def _every(self) -> tuple[int, ...]:
        """Numbers of all markers."""
        return tuple(range(len(self.response.sight.labels)))

    @cached_property
    def _momenta(self) -> Float[Tensor, "markers 3 9 frames"]:
        """Vectors A, B and C of every marker along each axis of its segment: bodies seem to go where markers went."""
        own = self.response.answer.unflatten(2, (-1, 3))
        return -torch.einsum("fimr,mcrf->mcif", own, self._axes(self._every)).contiguous()

    @cached_property
    def _left(self) -> Float[Tensor, "markers 3 bins rows"]:
        """Rows that postures leave of every marker along each axis of its segment."""
        return self.response.bands.left(self.shown(Along(self._every))).contiguous().unflatten(0, (-1, 3))


def _along(every: Float[Tensor, "markers 3 *rows"], ways: Along) -> Float[Tensor, "ways *rows"]:
    """Return the rows of ways of some markers, from the rows of every marker along each axis."""
    own = every[list(ways.which)].flatten(0, 1)
    return own if ways.ways is None else torch.tensordot(ways.ways.flatten(1), own, 1)


def _each(found: Float[Tensor, "ways *rows"], way: list[int]) -> Float[Tensor, "params *rows"]:
    """Return the rows of the way of each parameter."""
    return found if way == list(range(len(found))) else found[way]
