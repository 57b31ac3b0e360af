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

Those of blue, green, hazel, amber and brown are measured from photographs (iori, 39 irides,
uncalibrated cameras). Two are set by hand: grey is a pale iris of little chroma, as in one
photograph ((46, −2, 2) relative to the eye's white), and dark brown is one standard deviation of
brown below brown's mean.
"""
_FIELDS = "eumelanin", "pheomelanin", "abl_fraction", "hemoglobin", "scattering_scale"
_SATURATION = 0.95
# Thickness of the stroma, mm, where LB06's is too thin for so bright and red an iris.
_THICKNESS = {"hazel": 0.35, "amber": 0.45, "brown": 0.35}
_PIGMENTS = {  # for ILIT, and for radiative transfer, found by experiments/eye_colours.py
    "blue": ((0.0597, 0.0144, 0.253, 0.22, 8.11), (0.0474, 0.0213, 0.181, 0.155, 15.1)),
    "grey": ((0.0948, 0.032, 0.525, 0.14, 10.7), (0.103, 0.0306, 0.507, 0.0902, 27.5)),
    "green": ((0.00741, 0.494, 0.98, 0.0145, 17.3), (0.0263, 0.682, 0.969, 0.0304, 29.4)),
    "hazel": ((0.44, 0.586, 0.684, 0.264, 34.7), (0.181, 0.787, 0.57, 0.197, 32.5)),
    "amber": ((0.0603, 0.797, 0.571, 0.239, 40.0), (0.0209, 0.738, 0.836, 0.0951, 38.1)),
    "brown": ((0.203, 1.13, 0.733, 0.381, 38.3), (0.211, 0.605, 0.737, 0.289, 35.1)),
    "dark-brown": ((1.31, 0.335, 0.471, 0.0801, 28.9), (0.839, 0.299, 0.461, 0.114, 31.5)),
}
_FEATURES: dict[str, dict[str, Any]] = {
    "blue": {"crypts": 9, "patches": 0.5, "furrows": 2, "clouds": 0.4, "collarette": 1.0},
    "grey": {"patches": 0.8, "crypts": 18, "collarette": 1.4, "looseness": 0.7, "clouds": 0.4},
    "green": {"amber": 1.5, "heterochromia": 2.0, "patches": 0.8, "crypts": 18, "abl": 0.5},
    "hazel": {"heterochromia": 2.5, "patches": 0.5, "abl": 0.9, "freckles": 4, "crypts": 8},
    "amber": {"heterochromia": 0.5, "patches": 0.9, "abl": 0.6, "crypts": 5, "looseness": 0.2},
    "brown": {"abl": 0.6, "patches": 0.8, "crypts": 7, "furrows": 6},
    "dark-brown": {"abl": 0.6, "patches": 0.6, "crypts": 5, "furrows": 7, "looseness": 0.2},
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
    values it chooses the pigments nearest to usual ones and the weakest scattering: 8 to 40 times
    LB06's by ILIT and 15 to 38 times by radiative transfer, up to 10 mm⁻¹ at 500 nm, more than
    other soft tissues have. Hazel, brown and amber also need a stroma of 0.35, 0.35 and 0.45 mm.
    Blue irides have little melanin, green and amber ones mostly pheomelanin [Prota et al. 1998,
    Exp. Eye Res. 67, 293]. The redness of photographed irides requires more blood than LB06's 0.084
    mmol/l, at most 0.381, a sixth of pure blood; its saturation is 0.95, as in the choroid, since a
    saturation of 0.5 would require twice as much blood. Fibrils have LB06's radius, which has the
    same effect as the strength. Hazel and green eyes are browner near the pupil, where their maps
    add eumelanin.

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
    thickness = _THICKNESS.get(colour, 0.2855)
    fields |= {"saturation": _SATURATION, "stroma_thickness": thickness}
    iris = Iris().replace(**fields).replace(**dict(pigments or {}))
    # A share of the thickness, so that the relief is as high in a thicker stroma.
    relief = 0.1 * 0.2855 / thickness
    arguments: dict[str, Any] = {"relief": relief, "fibres": 1.5, "clouds": 0.6, "collarette": 0.6}
    arguments |= _FEATURES.get(colour, {}) | dict(features or {})
    return iris, procedural(iris, eye, shape=shape, **arguments, key=key)


PRESETS = {colour: partial(preset, colour) for colour in _PIGMENTS}
"""Eye colours: functions of `process`, `shape` and `key` that make an iris and its maps."""
