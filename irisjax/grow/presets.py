"""Eye colours: made-up irides with their maps."""

from collections.abc import Mapping
from functools import partial
from typing import Any

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import Eye
from irisjax.grow.procedural import procedural
from irisjax.numerics.checks import check_known
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps
from irisjax.transport.process import ILIT_2006, AbstractProcess, Ilit

_FIELDS = "eumelanin", "pheomelanin", "abl_fraction", "fibril_radius"
_IRIDES = {  # for ILIT, and for radiative transfer
    "brown": ((2.4, 0.5, 0.72, 72.0), (1.5, 0.6, 0.7, 71.0)),
    "hazel": ((0.4, 0.9, 0.5, 57.0), (0.12, 1.7, 0.5, 71.0)),
    "green": ((0.1, 0.8, 0.6, 51.5), (0.05, 0.95, 0.85, 69.0)),
    "blue": ((0.015, 0.01, 0.5, 45.0), (0.025, 0.012, 0.5, 58.0)),
    "grey": ((0.4, 0.05, 0.3, 65.0), (0.4, 0.05, 0.2, 71.0)),
}
_FEATURES: dict[str, dict[str, Any]] = {
    "brown": {"abl": 1.0, "patches": 0.5, "crypts": 10, "furrows": 6},
    "hazel": {"heterochromia": 2.5, "patches": 0.6, "abl": 0.5, "freckles": 4},
    "green": {"amber": 1.5, "heterochromia": 2.0, "patches": 0.6},
    "blue": {"patches": 0.8},
    "grey": {"patches": 0.5},
}


def preset(
    colour: str,
    eye: Eye | None = None,
    *,
    process: AbstractProcess = ILIT_2006,
    shape: tuple[int, int] = (768, 256),
    pigments: Mapping[str, Any] | None = None,
    features: Mapping[str, Any] | None = None,
    key: PRNGKey,
) -> tuple[Iris, IrisMaps]:
    """Grow an invented eye of a colour: `"brown"`, `"hazel"`, `"green"`, `"blue"` or `"grey"`.

    The pigments are chosen by eye, not measured, for the process; so is the fibrils' radius: at
    LB06's 30 nm the stroma sends back too little for any of these colours. The 8-bit sRGB of
    `colour(iris)` by ILIT is brown (57, 36, 12), hazel (80, 77, 59), green (76, 78, 65), blue (65,
    87, 99), grey (99, 112, 112); by radiative transfer brown (62, 49, 27), hazel (82, 74, 51),
    green (83, 82, 63), blue (65, 89, 99), grey (84, 99, 101). Brown takes 2.4 times the eumelanin
    of LB06's high level under ILIT; no pigments give a neutral grey: a* stays near −5. Hazel and
    green eyes are browner near the pupil, where their maps add eumelanin.

    Args:
        colour: Name of the colour.
        eye: Gives the ring from pupil to root (default: `Eye()`).
        process: Process that the pigments are chosen for.
        shape: Numbers of angles and radii of the maps.
        pigments: Fields of the iris that differ.
        features: Arguments of `procedural` that differ.
        key: Random key.

    Returns:
        The iris and its maps.

    Raises:
        ValueError: The colour is unknown.
    """
    check_known("eye colour", colour, sorted(_IRIDES))
    ilit, radiative = _IRIDES[colour]
    chosen = dict(zip(_FIELDS, ilit if isinstance(process, Ilit) else radiative, strict=True))
    iris = Iris().replace(**chosen).replace(**dict(pigments or {}))
    wanted = _FEATURES.get(colour, {}) | dict(features or {})
    return iris, procedural(iris, eye, shape=shape, **wanted, key=key)


PRESETS = {colour: partial(preset, colour) for colour in _IRIDES}
"""Eye colours: functions of `process`, `shape` and `key` that make an iris and its maps."""
