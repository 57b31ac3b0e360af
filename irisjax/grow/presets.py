"""Eye colours: made-up irides with their maps."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax

from irisjax._types import PRNGKey
from irisjax.anatomy.eye import Eye
from irisjax.grow.procedural import procedural
from irisjax.numerics.checks import check_known
from irisjax.numerics.streams import one_key
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

Those of blue, green, hazel, amber and brown are measured from photographs (iori, 39 irides,
uncalibrated cameras). Two are set by hand: grey is a pale iris of little chroma, as in one
photograph ((46, −2, 2) relative to the eye's white), and dark brown is one standard deviation of
brown below brown's mean.
"""
_FIELDS = "eumelanin", "pheomelanin", "abl_fraction", "hemoglobin", "scattering_scale"
_SATURATION = 0.95
# Thickness of the stroma, mm, where LB06's is too thin for so bright and red an iris.
_THICKNESS = {"hazel": 0.35, "amber": 0.55, "brown": 0.35}
# Refractive index of both layers, as of watery soft tissue, where LB06's 1.47 keeps so much light
# inside that a thin stroma is greener than in photographs.
_INDEX = {"blue": 1.38}
_PIGMENTS = {  # for ILIT, and for radiative transfer, found by experiments/eye_colours.py
    "blue": ((0.0789, 0.0199, 0.498, 0.002, 3.17), (0.143, 0.00541, 0.387, 0.00174, 7.01)),
    "grey": ((0.1, 0.03, 0.5, 0.002, 20.1), (0.3, 0.09, 0.304, 0.0163, 33.5)),
    "green": ((0.00485, 0.558, 0.98, 0.00789, 13.7), (0.0187, 0.742, 0.98, 0.0183, 26.2)),
    "hazel": ((0.536, 0.736, 0.616, 0.192, 30.7), (0.143, 0.891, 0.603, 0.157, 28.5)),
    "amber": ((0.0915, 0.9, 0.476, 0.114, 30.9), (0.0599, 0.859, 0.677, 0.0483, 31.5)),
    "brown": ((0.389, 1.42, 0.732, 0.235, 34.8), (0.401, 0.823, 0.736, 0.204, 31.4)),
    "dark-brown": ((1.16, 0.415, 0.487, 0.217, 27.1), (0.693, 0.515, 0.642, 0.162, 33.4)),
}
# Thicker stroma is darker in brown irides, so that their fibres show less.
_BROWN = {"fibres": 0.9, "clouds": 0.5, "collarette": 0.5}
_FEATURES: dict[str, dict[str, Any]] = {
    "blue": {"crypts": 9, "patches": 0.7, "furrows": 2, "looseness": 0.3, "clouds": 0.5}
    | {"margins": 0.2},
    "grey": {"crypts": 13, "patches": 0.8, "looseness": 0.6, "clouds": 0.4},
    "green": {"crypts": 10, "patches": 0.4, "amber": 2.0, "heterochromia": 3.0, "abl": 0.2},
    "hazel": {"crypts": 10, "patches": 0.5, "heterochromia": 6.0, "abl": 0.4, "freckles": 2},
    "amber": {"crypts": 8, "patches": 1.2, "amber": 1.0, "heterochromia": 1.5, "abl": 0.3}
    | {"clouds": 0.6},
    "brown": {"crypts": 7, "patches": 0.9, "amber": 0.3, "furrows": 6} | _BROWN,
    "dark-brown": {"crypts": 5, "patches": 0.4, "abl": 0.5, "furrows": 7} | _BROWN,
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
    """Grow an invented iris of a colour: `"blue"`, `"grey"`, `"green"`, `"hazel"`, `"amber"`,
    `"brown"` or `"dark-brown"`.

    Pigments and the strength of scattering are not measured: `experiments/eye_colours.py` finds
    them for each process so that a picture in the studio shows the visible iris, through the cornea
    and with the preset's maps, in the colour of photographed irides within one standard deviation
    (`PHOTOGRAPHED_COLOURS`), and with a tenth to a third of the luminance of the white. Of all such
    values it chooses the pigments nearest to usual ones and the weakest scattering: 3 times LB06's
    (ILIT) and 7 times (radiative transfer) in blue irides, 14 to 35 times in others, up to 9 mm⁻¹
    at 500 nm, more than other soft tissues have. Hazel, brown and amber also need a stroma of 0.35,
    0.35 and 0.55 mm, blue a refractive index of 1.38 in place of LB06's 1.47.
    Blue irides have little melanin, green and amber ones mostly pheomelanin [Prota et al. 1998,
    Exp. Eye Res. 67, 293]. The redness of photographed hazel and brown irides requires more blood
    than LB06's 0.084 mmol/l, at most 0.24, a tenth of pure blood's; its saturation is 0.95, as in
    the choroid, since a saturation of 0.5 would require twice as much blood. Blue and grey irides
    have nearly none, which would show pink in their thick cords. Fibrils have LB06's
    radius, which has the same effect as the strength. Hazel and green eyes are browner near the
    pupil, where their maps add eumelanin.

    Args:
        colour: Name of the colour.
        eye: The eye, with the ring from pupil to root (default: `Eye()`).
        process: Process for which the pigments are chosen.
        shape: Numbers of angles and radii of the maps.
        pigments: Fields of the iris that replace the preset's.
        features: Arguments of `procedural` that replace the preset's.
        key: Random key.

    Returns:
        The iris and its maps.

    Raises:
        ValueError: The colour is unknown.
    """
    check_known("eye colour", colour, sorted(_PIGMENTS))
    ilit, radiative = _PIGMENTS[colour]
    fields = dict(zip(_FIELDS, ilit if isinstance(process, Ilit) else radiative, strict=True))
    usual = float(Iris().stroma_thickness)
    thickness = _THICKNESS.get(colour, usual)
    fields |= {"saturation": _SATURATION, "stroma_thickness": thickness}
    if colour in _INDEX:
        fields |= dict.fromkeys(("abl_index", "stroma_index"), _INDEX[colour])
    iris = Iris().replace(**fields).replace(**dict(pigments or {}))
    # A share of the thickness, so that the relief is as high in a thicker stroma.
    arguments: dict[str, Any] = {"relief": 0.13 * usual / thickness, "margins": 0.4}
    arguments |= _FEATURES.get(colour, {}) | dict(features or {})
    # Presets of one key have patterns of their own.
    key = jax.random.fold_in(one_key(key), list(_PIGMENTS).index(colour))
    return iris, procedural(iris, eye, shape=shape, **arguments, key=key)


PRESETS = {colour: partial(preset, colour) for colour in _PIGMENTS}
"""Eye colours: functions of `process`, `shape` and `key` that make an iris and its maps."""
