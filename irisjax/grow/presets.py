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
"""Means and standard deviations of L*, a*, b* (D65, visible iris) that the presets aim at.

Those of blue, green, hazel, amber and brown are of photographed irides (iori, 39 irides,
uncalibrated cameras). Two are decided: grey is a pale iris of little chroma, as is one in a
photograph (46, −2, 2 by its white), and dark brown is one standard deviation of brown below
brown's mean.
"""
_FIELDS = "eumelanin", "pheomelanin", "abl_fraction", "hemoglobin", "scattering_scale"
_SATURATION = 0.95
# Thickness of the stroma, mm, where LB06's is too thin for so bright and red a class.
_THICKNESS = {"hazel": 0.35, "amber": 0.45, "brown": 0.35}
_IRIDES = {  # for ILIT, and for radiative transfer, found by experiments/eye_colours.py
    "blue": ((0.0216, 0.00742, 0.0558, 0.199, 7.33), (0.0153, 0.00516, 0.0365, 0.14, 13.7)),
    "grey": ((0.0899, 0.031, 0.51, 0.136, 9.94), (0.102, 0.0303, 0.504, 0.09, 25.4)),
    "green": ((0.00545, 0.454, 0.98, 0.0119, 18.3), (0.0221, 0.602, 0.98, 0.0256, 33.8)),
    "hazel": ((0.446, 0.611, 0.659, 0.252, 35.0), (0.184, 0.784, 0.571, 0.183, 31.8)),
    "amber": ((0.0464, 0.779, 0.582, 0.23, 39.0), (0.0241, 0.735, 0.832, 0.0875, 37.1)),
    "brown": ((0.169, 1.15, 0.731, 0.383, 38.6), (0.195, 0.597, 0.747, 0.28, 35.0)),
    "dark-brown": ((1.25, 0.262, 0.459, 0.0787, 29.2), (0.756, 0.343, 0.478, 0.104, 31.8)),
}
_FEATURES: dict[str, dict[str, Any]] = {
    "blue": {
        "fibres": 1.15,
        "crypts": 9,
        "patches": 0.5,
        "furrows": 2,
        "clouds": 1.3,
        "looseness": 0.6,
    },
    "grey": {"patches": 0.8, "crypts": 18, "collarette": 1.4, "looseness": 1.2, "clouds": 0.7},
    "green": {"amber": 1.5, "heterochromia": 2.0, "patches": 0.8, "crypts": 18, "abl": 0.5},
    "hazel": {"heterochromia": 2.5, "patches": 0.5, "abl": 0.9, "freckles": 4, "crypts": 8},
    "amber": {"heterochromia": 0.5, "patches": 0.5, "abl": 0.6, "crypts": 8, "looseness": 0.2},
    "brown": {"abl": 0.6, "patches": 0.3, "crypts": 14, "furrows": 6},
    "dark-brown": {"abl": 0.6, "patches": 0.3, "crypts": 10, "furrows": 7, "looseness": 0.2},
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
    them for each process so that a picture in the studio shows the visible iris, through the cornea
    and with the preset's maps, in the colour of photographed irides within one standard deviation
    (`PHOTOGRAPHED_COLOURS`), and with a tenth to a third of the luminance of the white. Among those
    that do it takes the pigments nearest to usual ones and the weakest scattering: 7 to 39 times
    LB06's by ILIT and 14 to 37 times by radiative transfer, up to 10 mm⁻¹ at 500 nm, more than
    other soft tissues have. Hazel, brown and amber take a stroma of 0.35, 0.35 and 0.45 mm beside
    it. Blue irides have little melanin, green and amber ones mostly pheomelanin [Prota et al. 1998,
    Exp. Eye Res. 67, 293]. The redness of photographed irides takes more blood than LB06's 0.084
    mmol/l, at most 0.383, a sixth of pure blood; its saturation is 0.95, as in the choroid, where
    0.5 would take twice as much. Fibrils have LB06's radius, whose effect is that of the strength.
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
    thickness = _THICKNESS.get(colour, 0.2855)
    chosen |= {"saturation": _SATURATION, "stroma_thickness": thickness}
    iris = Iris().replace(**chosen).replace(**dict(pigments or {}))
    # The relief is a share of the thickness: as high as of the others.
    wanted: dict[str, Any] = {"relief": 0.3 * 0.2855 / thickness}
    wanted |= _FEATURES.get(colour, {}) | dict(features or {})
    return iris, procedural(iris, eye, shape=shape, **wanted, key=key)


PRESETS = {colour: partial(preset, colour) for colour in _IRIDES}
"""Eye colours: functions of `process`, `shape` and `key` that make an iris and its maps."""
