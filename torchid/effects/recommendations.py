"""Advice on recordings that tell effects apart."""

from torchid.effects.catalogue import effect


def tell_apart(a: str, b: str) -> str:
    """Return what to record so that effects ``a`` and ``b``, or two places of one, can be told apart.

    Without a recipe for the pair, that is what shows each for itself.

    Raises:
        ConfigError: one of the names is no effect.
    """
    one, other = effect(a), effect(b)
    known = one.apart.get(b) or other.apart.get(a)
    return known or " and ".join(effect(name).advice for name in sorted({a, b}))
