"""Eye colours: made-up irides with their maps."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax.numpy as jnp

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import Eye
from irisjax.grow.procedural import procedural
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps

# Pigments (eumelanin and pheomelanin, mg/ml), share in the ABL, fibril radius (nm); features.
_COLOURS: dict[str, tuple[tuple[float, float, float, float], dict[str, Any]]] = {
    "brown": ((2.4, 0.5, 0.72, 72.0), {"abl": 1.0, "crypts": 10, "furrows": 6}),
    "hazel": ((0.4, 0.9, 0.5, 57.0), {"heterochromia": 2.5, "abl": 0.5, "freckles": 4}),
    "green": ((0.1, 0.8, 0.6, 51.5), {"heterochromia": 2.0, "freckles": 6}),
    "blue": ((0.015, 0.01, 0.5, 45.0), {}),
    "grey": ((0.4, 0.05, 0.3, 65.0), {}),
}


def preset(
    colour: str,
    eye: Eye | None = None,
    *,
    shape: tuple[int, int] = (768, 256),
    pigments: Mapping[str, Any] | None = None,
    features: Mapping[str, Any] | None = None,
    key: PRNGKey,
) -> tuple[Iris, IrisMaps]:
    """A made-up eye of a colour: `"brown"`, `"hazel"`, `"green"`, `"blue"` or `"grey"`.

    The pigments are chosen by eye, not measured. So is the fibrils' radius: at LB06's 30 nm the
    stroma sends back too little for any of these colours. `colour(iris)`, 8-bit sRGB under D65
    against a perfect white: brown (57, 36, 12), hazel (80, 77, 59), green (76, 78, 65), blue (65,
    87, 99), grey (99, 112, 112). Brown takes 2.4 times the eumelanin of LB06's high level, and the
    model knows no neutral grey: a* stays near −5. Hazel and green eyes are browner than that near
    the pupil, where their maps add eumelanin. `pigments` changes fields of the iris, `features`
    arguments of `procedural`.

    **Returns:** the iris and maps of `shape` (angles, radii). **Raises:** `ValueError` for an
    unknown colour.
    """
    if colour not in _COLOURS:
        raise ValueError(f"unknown eye colour {colour!r}; known: {', '.join(sorted(_COLOURS))}")
    (eumelanin, pheomelanin, share, radius), usual = _COLOURS[colour]
    iris = Iris(
        eumelanin=jnp.asarray(eumelanin),
        pheomelanin=jnp.asarray(pheomelanin),
        abl_fraction=jnp.asarray(share),
        fibril_radius=jnp.asarray(radius),
    )
    iris = iris.replace(**pigments) if pigments else iris
    return iris, procedural(iris, eye, shape=shape, **{**usual, **(features or {})}, key=key)


PRESETS = {colour: partial(preset, colour) for colour in _COLOURS}
"""Eye colours: functions of `shape` and `key` that make an iris and its maps."""
