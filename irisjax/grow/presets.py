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

PHOTOGRAPHED_COLOURS: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {
    "blue": ((36, 1, -6), (9, 3, 7)),
    "grey": ((40, -1, 0), (8, 3, 4)),
    "green": ((43, -7, 23), (10, 5, 12)),
    "hazel": ((33, 8, 18), (2, 3, 3)),
    "amber": ((42, 11, 29), (5, 6, 8)),
    "brown": ((35, 16, 17), (8, 8, 10)),
    "dark-brown": ((27, 8, 7), (8, 8, 10)),
}
"""Means and standard deviations of L*, a*, b* (D65, ciliary zone) that the presets aim at.

Those of blue, green, hazel, amber and brown are of photographed irides (iori, 39 irides,
uncalibrated cameras). Two are decided: grey is a pale iris of little chroma, as is one in a
photograph (46, −2, 2 by its white), and dark brown is one standard deviation of brown below
brown's mean.
"""
_FIELDS = "eumelanin", "pheomelanin", "abl_fraction", "hemoglobin", "scattering_scale"
_SATURATION = 0.95
_IRIDES = {  # for ILIT, and for radiative transfer, found by experiments/eye_colours.py
    "blue": ((0.208, 0.0204, 0.509, 0.002, 3.01), (0.492, 0.0174, 0.156, 0.00186, 6.86)),
    "grey": ((0.283, 0.037, 0.642, 0.097, 9.77), (0.296, 0.046, 0.657, 0.097, 18.2)),
    "green": ((0.009, 0.823, 0.98, 0.019, 16.7), (0.027, 1.08, 0.98, 0.022, 35.6)),
    "hazel": ((1.2, 0.46, 0.857, 0.3, 28.6), (0.515, 1.31, 0.713, 0.177, 29.0)),
    "amber": ((0.221, 2.34, 0.567, 0.104, 40.0), (0.115, 1.44, 0.808, 0.189, 40.0)),
    "brown": ((1.0, 0.515, 0.971, 0.3, 40.0), (0.636, 1.26, 0.883, 0.208, 40.0)),
    "dark-brown": ((1.63, 0.497, 0.557, 0.092, 11.3), (1.36, 0.935, 0.6, 0.095, 18.9)),
}
_FEATURES: dict[str, dict[str, Any]] = {
    "blue": {"patches": 0.8, "furrows": 2},
    "grey": {"fibres": 0.6, "patches": 0.8, "crypts": 22, "collarette": 1.4},
    "green": {"fibres": 0.6, "amber": 1.5, "heterochromia": 2.0, "patches": 0.8, "crypts": 18},
    "hazel": {"heterochromia": 2.5, "patches": 0.6, "abl": 0.5, "freckles": 4, "crypts": 10},
    "amber": {"heterochromia": 0.5, "patches": 0.5, "abl": 0.4, "crypts": 8},
    "brown": {"abl": 1.0, "patches": 0.5, "crypts": 10, "furrows": 6},
    "dark-brown": {"abl": 1.0, "patches": 0.5, "crypts": 10, "furrows": 6},
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
    """Grow an invented eye of a colour: `"blue"`, `"grey"`, `"green"`, `"hazel"`, `"amber"`,
    `"brown"` or `"dark-brown"`.

    Pigments and the strength of scattering are not measured: `experiments/eye_colours.py` finds
    them for each process so that the ciliary zone, with the preset's maps, has the colour of
    photographed irides within one standard deviation (`PHOTOGRAPHED_COLOURS`), and but for dark
    brown a tenth of the luminance of the white or more, by their reflectances. Among those that do
    it takes the pigments nearest to usual ones and the weakest scattering: 3 to 40 times LB06's by
    ILIT and 7 to 40 times by radiative transfer, where LB06's own makes every iris too dark. Blue
    irides have little melanin, green and amber ones mostly pheomelanin [Prota et al. 1998, Exp. Eye
    Res. 67, 293]. The redness of photographed irides takes more blood than LB06's 0.084 mmol/l, at
    most 0.3, an eighth of pure blood; its saturation is 0.95, as in the choroid, where 0.5 would
    take twice as much. Blue irides have next to none: their thick cords, which scatter most, would
    be pink with it. Fibrils have LB06's radius, whose effect is that of the strength. Hazel and
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
    iris = Iris().replace(saturation=_SATURATION, **chosen).replace(**dict(pigments or {}))
    wanted = _FEATURES.get(colour, {}) | dict(features or {})
    return iris, procedural(iris, eye, shape=shape, **wanted, key=key)


PRESETS = {colour: partial(preset, colour) for colour in _IRIDES}
"""Eye colours: functions of `process`, `shape` and `key` that make an iris and its maps."""
