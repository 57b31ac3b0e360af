"""The coats of a painted eye as the viewer has them, and what its controls do to them."""

from typing import NamedTuple

from irisjax.numerics.checks import check_range
from irisjax.ocularist.coats import OPACITY
from irisjax.ocularist.palette import linear_colour


class Layer(NamedTuple):
    """A coat as it is set.

    - `name`: as in the `Painting`; `on`: whether it is painted.
    - `colour`: picked by hand, `#rrggbb`; `None` for its recipe's mixture of paints.
    - `opacity`: factor on the map of its component, 0 to 1. `height`: above the base, mm.
    """

    name: str
    on: bool
    colour: str | None
    opacity: float
    height: float


Layers = tuple[Layer, ...]
"""The bottom coat first."""


def switched(layers: Layers, name: str, on: bool) -> Layers:
    """With a coat on or off. **Raises:** `ValueError` for an unknown coat, as the others do."""
    return _with(layers, name, on=on)


def recoloured(layers: Layers, name: str, colour: str | None) -> Layers:
    """With a coat of this colour, `#rrggbb`, or of its recipe's mixture (`None`)."""
    if colour is not None:
        linear_colour(f"of coat {name}", colour)
    return _with(layers, name, colour=colour)


def covering(layers: Layers, name: str, opacity: float) -> Layers:
    """With another opacity of a coat, 0 to 1."""
    check_range(f"opacity of coat {name!r}", opacity, OPACITY)
    return _with(layers, name, opacity=opacity)


def moved(layers: Layers, name: str, up: bool) -> Layers:
    """With a coat and the next above, or below it, in each other's place and at each other's
    height; the last one stays where it is.
    """
    at = place_of(layers, name)
    low, high = (at, at + 1) if up else (at - 1, at)
    if low < 0 or high == len(layers):
        return layers
    below, above = layers[low], layers[high]
    pair = above._replace(height=below.height), below._replace(height=above.height)
    return layers[:low] + pair + layers[high + 1 :]


def place_of(layers: Layers, name: str) -> int:
    """Place of a coat, from 0 at the bottom. **Raises:** `ValueError` for an unknown one."""
    names = [layer.name for layer in layers]
    if name not in names:
        raise ValueError(f"no coat {name!r}; there are {', '.join(names)}")
    return names.index(name)


def _with(layers: Layers, name: str, **fields) -> Layers:
    at = place_of(layers, name)
    return (*layers[:at], layers[at]._replace(**fields), *layers[at + 1 :])
