"""Eye colours: made-up irides with their maps."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax

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

Those of blue, green, hazel, amber and brown are measured from photographs (iori, 39 irides,
uncalibrated cameras). Two are set by hand: grey is a pale iris of little chroma, as in one
photograph ((46, −2, 2) relative to the eye's white), and dark brown is one standard deviation of
brown below brown's mean.
"""
_FIELDS = "eumelanin", "pheomelanin", "abl_fraction", "hemoglobin", "scattering_scale"
_SATURATION = 0.95
# Thickness of the stroma, mm, where LB06's is too thin for so bright and red an iris.
_THICKNESS = {"hazel": 0.35, "amber": 0.55, "brown": 0.35}
_PIGMENTS = {  # for ILIT, and for radiative transfer, found by experiments/eye_colours.py
    "blue": ((0.0344, 0.01, 0.106, 0.207, 7.23), (0.112, 0.00785, 0.0226, 0.142, 14)),
    "grey": ((0.0806, 0.0327, 0.499, 0.147, 8.98), (0.0395, 0.0564, 0.533, 0.11, 16.2)),
    "green": ((0.00743, 0.532, 0.98, 0.0138, 15.7), (0.0253, 0.738, 0.98, 0.0279, 25.9)),
    "hazel": ((0.517, 0.607, 0.667, 0.261, 31.7), (0.194, 1.05, 0.656, 0.133, 34.2)),
    "amber": ((0.0676, 0.838, 0.538, 0.137, 36.8), (0.047, 0.916, 0.553, 0.0595, 33.2)),
    "brown": ((0.342, 1.08, 0.809, 0.311, 38.4), (0.436, 0.725, 0.68, 0.234, 36.5)),
    "dark-brown": ((1.14, 0.23, 0.461, 0.281, 30.8), (0.614, 0.462, 0.668, 0.174, 36.1)),
}
# Thicker stroma is darker in brown irides, so that their fibres show less.
_BROWN = {"fibres": 0.6, "clouds": 0.5, "collarette": 0.5}
_FEATURES: dict[str, dict[str, Any]] = {
    "blue": {"crypts": 9, "patches": 0.7, "furrows": 2, "looseness": 0.3, "clouds": 0.8},
    "grey": {"crypts": 13, "patches": 0.8, "looseness": 0.8, "clouds": 0.7},
    "green": {"crypts": 10, "patches": 0.4, "amber": 1.5, "heterochromia": 2.0, "abl": 0.5},
    "hazel": {"crypts": 10, "patches": 0.8, "heterochromia": 2.5, "abl": 0.4, "freckles": 2},
    "amber": {"crypts": 8, "patches": 1.2, "amber": 1.0, "heterochromia": 0.5, "abl": 0.3}
    | {"fibres": 0.8, "clouds": 0.6},
    "brown": {"crypts": 7, "patches": 1.2, "amber": 0.3, "furrows": 6} | _BROWN,
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
    values it chooses the pigments nearest to usual ones and the weakest scattering: 7 to 38 times
    LB06's by ILIT and 14 to 37 times by radiative transfer, up to 10 mm⁻¹ at 500 nm, more than
    other soft tissues have. Hazel, brown and amber also need a stroma of 0.35, 0.35 and 0.55 mm.
    Blue irides have little melanin, green and amber ones mostly pheomelanin [Prota et al. 1998,
    Exp. Eye Res. 67, 293]. The redness of photographed irides requires more blood than LB06's 0.084
    mmol/l, at most 0.311, an eighth of pure blood's; its saturation is 0.95, as in the
    choroid, since a saturation of 0.5 would require twice as much blood. Fibrils have LB06's
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
    iris = Iris().replace(**fields).replace(**dict(pigments or {}))
    # A share of the thickness, so that the relief is as high in a thicker stroma.
    arguments: dict[str, Any] = {"relief": 0.12 * usual / thickness, "margins": 0.6}
    arguments |= _FEATURES.get(colour, {}) | dict(features or {})
    # Presets of one key have patterns of their own.
    key = jax.random.fold_in(key, list(_PIGMENTS).index(colour))
    return iris, procedural(iris, eye, shape=shape, **arguments, key=key)


PRESETS = {colour: partial(preset, colour) for colour in _PIGMENTS}
"""Eye colours: functions of `process`, `shape` and `key` that make an iris and its maps."""
