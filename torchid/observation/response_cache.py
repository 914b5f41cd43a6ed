"""How the cameras' rows answer to displacements in fixed ways, of which those that come and go are multiples.

Most of a catalogue's columns on markers are: skin that slides as any joint bends, a centre that glides, a joint that
lacks an axis. Each frame answers by itself, so that 1300 columns are made of answers to 300 ways: 1.0 instead of 1.6 s
for a trial of 25 s.
"""

from collections.abc import Callable, Hashable
from dataclasses import replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.marker_scene import Along, Carried, Sway
from torchid.observation.marker_response import MarkerResponse, Response


class ResponseCache:
    """Answers of one trial, worked out as they are asked for."""

    def __init__(self, response: MarkerResponse) -> None:
        self.response = response
        self._made: dict[tuple[str, Hashable], Tensor] = {}

    def swayed(self, sway: Sway) -> Response:
        """To unit parameters."""
        way, course = ([pair[k] for pair in sway.pairs] for k in range(2))
        now, middle = sway.courses[course][:, None], self.response.bands.middle
        return Response(
            lambda: _each(self.momenta(sway.ways), way) * now,
            lambda: _each(self.shown(sway.ways), way) * now[..., middle].mT,
            lambda: self._spectrum(sway),
        )

    def momenta(self, ways: Along | Carried) -> Float[Tensor, "ways 9 frames"]:
        """See ``Answer.nine``."""
        if isinstance(ways, Along):
            return _along(self._momenta, ways)
        return self._once("momenta", ways, lambda: self._nine(ways.bodies()))

    def _nine(self, bodies: Float[Tensor, "ways bodies 6 frames"]) -> Float[Tensor, "ways 9 frames"]:
        return self.response.moved(bodies.unbind()).nine.contiguous()

    def shown(self, ways: Along | Carried) -> Float[Tensor, "ways bins rows"]:
        """See ``Answer.shift``."""
        middle = self.response.bands.middle
        if isinstance(ways, Carried):
            return self._once("shown", ways, lambda: self.response.shown(ways.bodies()[..., middle]))
        n, own = len(ways.which), self._axes(ways.which)[..., middle]
        rows = own.new_zeros(n, 3, len(middle), len(self.response.sight.labels), 3)
        rows[range(n), :, :, list(ways.which)] = own.mT
        each = rows.flatten(3)
        return each.flatten(0, 1) if ways.ways is None else _along(each, replace(ways, which=tuple(range(n))))

    def _spectrum(self, sway: Sway) -> Float[Tensor, "params kept rows"]:
        """See ``Answer.spectrum``."""
        left, bands = self._left_of(sway.ways), self.response.bands
        found = [bands.spectrum(left, course) for course in sway.courses[:, bands.middle]]
        if len(found) == 1:
            return _each(found[0], [way for way, _ in sway.pairs])
        return torch.stack([found[course][way] for way, course in sway.pairs])

    def _left_of(self, ways: Along | Carried) -> Float[Tensor, "ways bins rows"]:
        """What postures leave."""
        if isinstance(ways, Along):
            return _along(self._left, ways)
        return self._once("left", ways, lambda: self.response.bands.left(self.shown(ways)).contiguous())

    def _once(self, what: str, ways: Carried, found: Callable[[], Tensor]) -> Tensor:
        """Kept: a centre glides along the same ways whatever it follows."""
        if (what, ways.key) not in self._made:
            self._made[what, ways.key] = found()
        return self._made[what, ways.key]

    def _axes(self, which: tuple[int, ...]) -> Float[Tensor, "some 3 3 frames"]:
        """Of the segments that carry some markers, one after the other."""
        sight = self.response.sight
        return sight.scene.state.at.R[sight.body[list(which)]]

    @cached_property
    def _every(self) -> tuple[int, ...]:
        return tuple(range(len(self.response.sight.labels)))

    @cached_property
    def _momenta(self) -> Float[Tensor, "markers 3 9 frames"]:
        """Of every marker along each axis of its segment: bodies seem to go where these went."""
        own = self.response.answer.unflatten(2, (-1, 3))
        return -torch.einsum("fimr,mcrf->mcif", own, self._axes(self._every)).contiguous()

    @cached_property
    def _left(self) -> Float[Tensor, "markers 3 bins rows"]:
        """What postures leave of each."""
        return self.response.bands.left(self.shown(Along(self._every))).contiguous().unflatten(0, (-1, 3))


def _along(every: Float[Tensor, "markers 3 *rows"], ways: Along) -> Float[Tensor, "ways *rows"]:
    """Of the ways of some markers, of each along each axis."""
    own = every[list(ways.which)].flatten(0, 1)
    return own if ways.ways is None else torch.tensordot(ways.ways.flatten(1), own, 1)


def _each(found: Float[Tensor, "ways *rows"], way: list[int]) -> Float[Tensor, "params *rows"]:
    """Of the way of each parameter."""
    return found if way == list(range(len(found))) else found[way]
