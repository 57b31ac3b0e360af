"""README.txt of a hand-over: what its files are, how to use them, and how far they are from the
model.
"""

import numpy as np

from irisjax.anatomy.media import TEAR
from irisjax.export.mitsuba import WIDEST
from irisjax.render.albedo import CONE, LambertError
from irisjax.render.scene import Scene
from irisjax.transport.process import AbstractProcess

_WHAT = {
    "anterior.ply": "front of the cornea (also .obj)",
    "posterior.ply": "back of the cornea (also .obj)",
    "iris.ply": "iris with uv: u = angle / 2 pi, v = 0 at the pupil, 1 at the root "
    "(also .obj, with iris.mtl)",
    "sclera.ply": "white of the eye (also .obj)",
    "albedo.exr": "base colour of the iris, linear sRGB, in that uv (bottom row: the pupil's edge)",
    "albedo.png": "the same, 8-bit sRGB",
    "reflectance.exr": "the same, a layer a wavelength (T.400,0nm ...)",
    "relief.exr": "height of the iris towards the viewer, mm, for bump or displacement "
    "(non-colour data)",
    "maps.exr": "the maps the iris was made from, rows angles, columns radii; irisjax "
    "reads them ([maps] file)",
    "brdf.csv": "BRDF of the uniform iris over angles, 1/sr",
    "environment.exr": "panorama that lights the eye, linear sRGB",
    "scene.xml": "all of it for Mitsuba 3: mitsuba -m scalar_rgb scene.xml (-D "
    "spp=1024: less noise)",
}


def readme(
    scene: Scene,
    names: list[str],
    error: LambertError,
    table: float,
    clipped: int,
    process: AbstractProcess,
) -> str:
    """The text for the files `names`; `table` is the error of the albedos' table, relative to the
    brightest texel, `clipped` how many texels are out of sRGB's range, `process` of light in the
    iris.
    """
    cornea = scene.eye.cornea
    lines = ["An eye simulated by irisjax; nothing here was measured.", ""]
    lines += [
        "Units: mm. Axes: x right, y up as the viewer sees them, z out of the eye; the origin is "
        "the corneal apex.",
        "",
    ]
    lines += [f"{name:<16}{what}" for name, what in _WHAT.items() if name in names]
    lines += ["", *_blender(scene, names), "", "Approximations"]
    lines += [
        f"- The iris's light is by {process}.",
        "- The iris is matt here. The model's is not: see brdf.csv. albedo is the share of",
        "  light that comes back from normal incidence, without the mirrored first surface. Used "
        "as a Lambertian base",
        f"  colour it is off, for directions within {CONE:g} degrees of the normal, by (red, "
        f"green, blue)",
        f"  {_percent(error.rms)} r.m.s. and at most {_percent(error.most)} (minus: too dark) in "
        f"the mean over the",
        f"  iris, {_percent(error.texels)} of that mean r.m.s. texel by texel (dark ones, as round "
        f"the pupil, are",
        "  further off relative to themselves); over the whole hemisphere the mean",
        f"  is off by {_percent(error.hemisphere)} of the mean BRDF, r.m.s.",
        f"- Albedos come from a table, off by at most {100 * table:.1g} % of the brightest texel "
        f"where it was tried.",
        "- relief tilts the shading; nothing casts shadows on the iris, nor does it light itself: "
        "as displacement,",
        "  relief.exr makes a preset 5 % brighter round the pupil for an albedo of 0.2.",
        "- The limbus is sharp here; irisjax blends iris and white over "
        f"{float(scene.eye.limbus_width):.2g} mm, and fades it at the pupil over "
        f"{float(scene.eye.pupil_margin):.2g}.",
    ]
    if scene.eye.sclera is not None:
        lines += [
            "- The white is matt, of one colour (the mean over its vessels) and mirrors nothing. "
            "It is some 5 %",
            "  brighter than irisjax draws it, 10 % seen at 60 degrees: there the tear film "
            "mirrors, and light bleeds",
            "  past the terminator.",
        ]
    if clipped:
        lines.append(
            f"- {clipped} texels lie outside sRGB: clipped in albedo.exr and albedo.png, not in "
            f"reflectance.exr."
        )
    if cornea is not None:
        inside = scene.eye.aqueous_index if cornea.posterior is None else cornea.index
        lines += [
            f"- Indices: air 1, cornea {float(inside):g}, aqueous humour "
            f"{float(scene.eye.aqueous_index):g}.",
            f"  The front of the cornea mirrors here, in irisjax the tear film of index {TEAR:g}, "
            f"which changes mirror",
            f"  images of lights by {100 * (_mirrored(float(inside)) / _mirrored(TEAR) - 1):+.2g} "
            f"%.",
            "  The cornea's haze is a colour on its front surface, right for the mean of this "
            "iris.",
            "- Path tracers cannot aim at a lamp through a refracting surface; they meet it by "
            "chance. Take many",
            f"  samples. Lamps in scene.xml are widened to {np.degrees(WIDEST):g} degrees' radius, "
            f"irradiance kept.",
        ]
    if scene.eye.attenuation is not None:
        lines.append("- The attenuation of the aqueous humour is left out.")
    return "\n".join(lines) + "\n"


def _percent(values) -> str:
    return ", ".join(f"{100 * v:.2g}" for v in values) + " %"


def _blender(scene: Scene, names: list[str]) -> list[str]:
    """A recipe that was tried: iris, pupil and mirror images lie where irisjax draws them."""
    lines = [
        "Blender (tried with 5.0 and Cycles)",
        "- Import the .obj files with their default axes (forward -Z, up Y). The iris comes with "
        "albedo.png; give it a",
        "  Diffuse BSDF, its colour from albedo.exr (Linear Rec.709).",
    ]
    if "relief.exr" in names:
        lines.append("- relief.exr: Non-Color, through a Bump node of distance 1.")
    cornea = scene.eye.cornea
    if cornea is not None:
        aqueous = float(scene.eye.aqueous_index)
        within = aqueous if cornea.posterior is None else float(cornea.index)
        lines.append(f"- anterior.obj: Glass BSDF, roughness 0, IOR {within:.5g}.")
        if cornea.posterior is not None:
            lines.append(
                f"  posterior.obj: the same with IOR {aqueous / within:.5g}, that of the humour "
                f"over the cornea's."
            )
    if "environment.exr" in names:
        lines.append(
            "- environment.exr: an Environment Texture turned by 90 degrees about Z (Mapping node, "
            "type Point)."
        )
    return lines


def _mirrored(index: float) -> float:
    return ((index - 1) / (index + 1)) ** 2
