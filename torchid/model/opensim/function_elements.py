"""Elements that state functions, read into functions."""

import itertools
import math
from collections.abc import Callable
from functools import partial

import torch

from torchid.model.markup import Element
from torchid.model.opensim.functions import (
    Constant,
    Function,
    LinearFunction,
    Multinomial,
    PiecewiseCubic,
    Polynomial,
    ScaledFunction,
    Sine,
    broken_line,
    simm_spline,
)
from torchid.model.opensim.words import OsimDocument

MOST_ARGUMENTS = 6
"""Cited. Most arguments of a polynomial of several (OpenSim, MultivariatePolynomialFunction.h)."""


def function_in(parent: Element, document: OsimDocument, tag: str = "function") -> Function | None:
    """Return the function of a property, or None where it is absent.

    OpenSim 4 names the function's own element after the property, or leaves the name out; older files put it into an
    element of that name.

    Raises:
        InputError: ``osim.function`` for one that is not known or has not what it needs; it names the line.
    """
    holder = parent.find(tag)
    found = list(holder) if holder is not None else [child for child in parent if child.get("name") == tag]
    found = found or [child for child in parent if not child.get("name") and child.tag in READERS]
    return read_function(found[0], document) if found else None


def read_function(element: Element, document: OsimDocument) -> Function:
    """Return the function that an element states; raises as ``function_in``."""
    kind = str(element.tag)
    if kind not in READERS:
        remedy = f"Known: {', '.join(READERS)}. Put one of these through the same points."
        raise document.fault(element, "osim.function", "a function that cannot be read", kind, remedy=remedy)
    return READERS[kind](element, document)


def _constant(element: Element, document: OsimDocument) -> Function:
    return Constant(document.number(element, "value", 0.0))


def _linear(element: Element, document: OsimDocument) -> Function:
    coefficients = document.series(element, "coefficients")
    if element.find("coefficients") is None:
        coefficients = torch.tensor([1.0, 0.0], dtype=torch.float64)
    if len(coefficients) < 2:
        raise _lacking(element, document, "a slope for every argument and a constant")
    return LinearFunction(coefficients[:-1], float(coefficients[-1]))


def _polynomial(element: Element, document: OsimDocument) -> Function:
    coefficients = document.series(element, "coefficients")
    if not len(coefficients):
        raise _lacking(element, document, "coefficients")
    return Polynomial(coefficients)


def _multinomial(element: Element, document: OsimDocument) -> Function:
    """Return a polynomial whose terms stand in ascending order of the powers of the last argument, then of the one
    before it (OpenSim's MultivariatePolynomialFunction)."""
    arguments, order = (int(document.number(element, tag, 0.0)) for tag in ("dimension", "order"))
    coefficients = document.series(element, "coefficients")
    if not 1 <= arguments <= MOST_ARGUMENTS or order < 0 or len(coefficients) != math.comb(arguments + order, order):
        raise _lacking(element, document, "a dimension, an order, and a coefficient for every term of them")
    powers = itertools.product(range(order + 1), repeat=arguments)
    return Multinomial(coefficients, tuple(term for term in powers if sum(term) <= order))


def _scaled(element: Element, document: OsimDocument) -> Function:
    inner = function_in(element, document)
    if inner is None:
        raise _lacking(element, document, "a function to multiply")
    return ScaledFunction(inner, document.number(element, "scale", 1.0))


def _sine(element: Element, document: OsimDocument) -> Function:
    words = (("amplitude", 1.0), ("omega", 1.0), ("phase", 0.0), ("offset", 0.0))
    return Sine(*(document.number(element, tag, default) for tag, default in words))


def _points(
    element: Element, document: OsimDocument, through: Callable[[torch.Tensor, torch.Tensor], PiecewiseCubic]
) -> Function:
    x, y = (document.series(element, tag) for tag in ("x", "y"))
    if len(x) != len(y) or len(x) < 2:
        raise _lacking(element, document, "as many x as y, two at least")
    if not bool((x.diff() > 0.0).all()):
        raise _lacking(element, document, "x that increase")
    return through(x, y)


def _lacking(element: Element, document: OsimDocument, what: str) -> Exception:
    remedy = "Correct the element, or save the model again with OpenSim."
    return document.fault(element, "osim.function", f"needs {what}", remedy=remedy)


READERS: dict[str, Callable[[Element, OsimDocument], Function]] = {
    "Constant": _constant,
    "LinearFunction": _linear,
    "PolynomialFunction": _polynomial,
    "MultivariatePolynomialFunction": _multinomial,
    "MultiplierFunction": _scaled,
    **dict.fromkeys(("SimmSpline", "NaturalCubicSpline", "natCubicSpline"), partial(_points, through=simm_spline)),
    "PiecewiseLinearFunction": partial(_points, through=broken_line),
    "Sine": _sine,
}
"""Cited. Elements of OpenSim's Common library; OpenSim itself renames NaturalCubicSpline and natCubicSpline to
SimmSpline when it reads an old file."""
