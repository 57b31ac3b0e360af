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
_IRIDES = {  # for ILIT, and for radiative transfer, found by experiments/eye_colours.py
    "blue": ((0.044, 0.018, 0.491, 0.454, 5.81), (0.051, 0.02, 0.503, 0.302, 11.1)),
    "grey": ((0.292, 0.037, 0.609, 0.217, 11.9), (0.136, 0.034, 0.533, 0.189, 18.6)),
    "green": ((0.012, 0.808, 0.98, 0.03, 16.1), (0.041, 1.13, 0.856, 0.035, 32.6)),
    "hazel": ((0.466, 1.11, 0.673, 0.457, 21.3), (0.387, 1.11, 0.746, 0.31, 30.4)),
    "amber": ((0.164, 2.24, 0.59, 0.15, 40.0), (0.013, 1.28, 0.98, 0.24, 40.0)),
    "brown": ((0.89, 0.72, 0.86, 0.5, 40.0), (0.353, 1.5, 0.9, 0.292, 40.0)),
    "dark-brown": ((1.53, 0.625, 0.544, 0.09, 10.5), (1.62, 0.7, 0.56, 0.096, 19.8)),
}
_FEATURES: dict[str, dict[str, Any]] = {
    "blue": {"patches": 0.8, "furrows": 2},
    "grey": {"patches": 0.5, "crypts": 22, "collarette": 1.4},
    "green": {"amber": 1.5, "heterochromia": 2.0, "patches": 0.6, "crypts": 18},
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
    photographed irides within one standard deviation (`PHOTOGRAPHED_COLOURS`). Among those that do
    it takes the pigments nearest to usual ones, and the weakest scattering: LB06's times 6 to 40 by
    ILIT and 12 to 40 by radiative transfer, where LB06's own makes every iris too dark. Blue irides
    have next to no melanin, green and amber ones mostly pheomelanin [Prota et al. 1998, Exp. Eye
    Res. 67, 293]. The redness of photographed irides takes more blood than LB06's 0.084 mmol/l: up
    to 0.5, a fifth of pure blood. Fibrils have LB06's radius, whose effect is that of the strength.
    Hazel and green eyes are browner near the pupil, where their maps add eumelanin.

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
