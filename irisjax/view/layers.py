"""The coats of a painted eye in the viewer, and the changes that its controls make."""

from typing import Any, NamedTuple

from irisjax.numerics.checks import check_range
from irisjax.ocularist.coats import OPACITY
from irisjax.ocularist.mixing import linear_colour


class Layer(NamedTuple):
    """A coat as it is set.

    Attributes:
        name: Its name in the `Painting`.
        on: Whether it is painted.
        colour: Colour picked by hand, `#rrggbb`; `None` for its recipe's mixture of paints.
        opacity: Factor on the map of its component, 0 to 1.
        height: Height above the base, mm.
    """

    name: str
    on: bool
    colour: str | None
    opacity: float
    height: float


Layers = tuple[Layer, ...]
"""The bottom coat first."""


def switched(layers: Layers, name: str, on: bool) -> Layers:
    """Switch a coat on or off. These functions raise `ValueError` for an unknown coat."""
    return _with(layers, name, on=on)


def recoloured(layers: Layers, name: str, colour: str | None) -> Layers:
    """Give a coat a colour, `#rrggbb`, or that of its recipe's mixture (`None`)."""
    if colour is not None:
        linear_colour(f"of coat {name}", colour)
    return _with(layers, name, colour=colour)


def covering(layers: Layers, name: str, opacity: float) -> Layers:
    """Change the opacity of a coat, 0 to 1."""
    check_range(f"opacity of coat {name!r}", opacity, OPACITY)
    return _with(layers, name, opacity=opacity)


def moved(layers: Layers, name: str, up: bool) -> Layers:
    """Exchange a coat with the next above, or below it, in place and height; a coat at the end
    does not move.
    """
    at = place_of(layers, name)
    low, high = (at, at + 1) if up else (at - 1, at)
    if low < 0 or high == len(layers):
        return layers
    below, above = layers[low], layers[high]
    pair = above._replace(height=below.height), below._replace(height=above.height)
    return layers[:low] + pair + layers[high + 1 :]


def place_of(layers: Layers, name: str) -> int:
    """Place of a coat, from 0 at the bottom.

    Raises:
        ValueError: There is no such coat.
    """
    names = [layer.name for layer in layers]
    if name not in names:
        raise ValueError(f"no coat {name!r}; there are {', '.join(names)}")
    return names.index(name)


def _with(layers: Layers, name: str, **fields: Any) -> Layers:
    at = place_of(layers, name)
    return (*layers[:at], layers[at]._replace(**fields), *layers[at + 1 :])
