"""The invented eye colours by ILIT and by radiative transfer: pigments found for the colours of
photographed irides, the colours of the presets, and pictures; all simulated.
"""

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from experiments.common import RESULTS, start, write
from irisjax.anatomy.eye import Eye
from irisjax.grow.presets import PHOTOGRAPHED_COLOURS, PRESETS
from irisjax.io import write_png
from irisjax.measure.colour import XYZ_TO_SRGB, lab_of, srgb_encode
from irisjax.render.albedo import Matt
from irisjax.render.bands import colour_bands
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.integrators import INTEGRATORS
from irisjax.render.picture import illuminate, respond, shade, surroundings, texture
from irisjax.render.project import project
from irisjax.render.scene import Scene
from irisjax.tissue.maps import cell_centres

MODELS = "separable", "radiative-transfer"
CILIARY = 0.4, 0.9
"""Between pupil (0) and root (1)."""
FREE = {  # usual value, how far off costs as much as one standard deviation, bounds
    "eumelanin": (None, 1.5, (1e-3, 10.0)),
    "pheomelanin": (None, 1.5, (1e-3, 20.0)),
    "abl_fraction": (0.5, 0.3, (0.02, 0.98)),
    "hemoglobin": (0.084, 0.5, (5e-4, 0.3)),
    "scattering_scale": (1.0, 1.5, (1.0, 40.0)),
}
"""All but the fraction are searched by their logarithms, in which their widths are."""
USUAL = {  # eumelanin and pheomelanin, mg/ml: the order of LB06's levels, and Prota's kinds
    "blue": (0.2, 0.02),
    "grey": (0.1, 0.03),
    "green": (0.05, 0.5),
    "hazel": (0.4, 0.8),
    "amber": (0.3, 1.5),
    "brown": (1.0, 0.5),
    "dark-brown": (2.0, 0.5),
}
BLOODLESS = {"blue": 0.002}
"""Usual haemoglobin, mmol/l, of colours whose thick cords would be pink with more. Blood could
raise their a* to the mean of the class, but no photographed blue iris has pink cords."""
BRIGHT = 41.5
"""L* of an iris that has about a tenth of the white's luminance in a picture: the cornea takes a
sixth on both ways together, and refraction more."""
INSIDE = {  # standard deviations of a* and b* within which a colour is as good as the mean
    "brown": ((-0.8, 0.65), (-0.6, 0.7)),
    "blue": ((-0.9, 0.75), (-0.95, 0.2)),
    "green": ((-0.75, 0.65), (-0.65, 0.75)),
}
WIDE = (-0.65, 0.65), (-0.6, 0.65)  # of the others
LEAST = {"blue": -0.45, "amber": -0.5, "brown": -0.3, "dark-brown": -0.3}
"""Smallest L*, in standard deviations from the class's mean, of the colours that no usual pigments
make as bright as `BRIGHT`."""
DIM, MOST = -0.3, 0.7  # smallest and largest L* of the others, in the same unit
STIFF = 20.0  # weight of a standard deviation beyond those
STARTS = (1.5, 0.0), (3.0, 0.0), (2.3, -1.0), (2.3, 1.0)  # ln of scattering, of eumelanin's excess
_LOG = np.array([name != "abl_fraction" for name in FREE])
_TO_XYZ = np.linalg.inv(XYZ_TO_SRGB)
_TO_WHITE = _TO_XYZ / _TO_XYZ.sum(1, keepdims=True)  # relative to D65's white


def main(key, quick=False, out=RESULTS):
    """Write pigments, colours and pictures (a row a model, a column a colour; quick: small)."""
    shape = (96, 32) if quick else (768, 256)
    colours = list(PRESETS)[:1] if quick else list(PRESETS)
    found, rows, sheet = [], [], []
    for model in MODELS[:1] if quick else MODELS:
        row = []
        for colour in colours:
            found.append((colour, model, *search(colour, model, key, quick)))
            integrator = INTEGRATORS[model]()
            iris, maps = PRESETS[colour](Eye(), process=integrator.process, shape=shape, key=key)
            seen, luminance = of_texels(iris, maps, integrator)
            picture, over_white = drawn(iris, maps, integrator, 24 if quick else 240)
            row.append(picture)
            rows.append((colour, model, *seen, *_off(colour, seen), luminance, over_white))
        sheet.append(np.concatenate(row, axis=1))
    out.mkdir(parents=True, exist_ok=True)
    encoded = np.asarray(srgb_encode(np.clip(np.concatenate(sheet), 0, 1)))
    remark = f"simulated by irisjax; rows: {', '.join(MODELS)}; columns: {', '.join(colours)}"
    write_png(out / "eye_colours.png", encoded, remark=remark)
    write(
        out / "eye_colours.csv",
        (
            "simulated by irisjax; L*, a*, b* (D65, CIE 1931 2 degree, relative to white paper) of "
            "the presets: area mean of the texels' reflectance over the ciliary zone, normal "
            "incidence, without the first surface's mirror",
            "off_*: from the mean of the photographed class, in its standard deviations",
            "luminance: relative to white paper; over_white: of the ciliary zone over that of the "
            "white, in a picture in the studio, without what the tear film mirrors",
        ),
        ("colour", "integrator", "L", "a", "b", "off_L", "off_a", "off_b", "luminance",
         "over_white"),
        rows,
    )  # fmt: skip
    write(
        out / "eye_colours_pigments.csv",
        (
            "pigments that the search finds for the presets' maps and photographed colours:",
            "nearest to usual values inside the spread of the class; mg/ml, mmol/l",
        ),
        ("colour", "integrator", *FREE, "off_L", "off_a", "off_b"),
        found,
    )


def search(colour, model, key, quick=False):
    """Find the pigments and the strength of scattering of a preset.

    Returns:
        The values of `FREE`, and how far off their colour is.
    """
    integrator = INTEGRATORS[model]()
    base, maps = PRESETS[colour](
        Eye(), process=integrator.process, shape=(96 if quick else 192, 64), key=key
    )
    others = {name: given[0] for name, given in FREE.items() if given[0] is not None}
    others["hemoglobin"] = BLOODLESS.get(colour, others["hemoglobin"])
    usual = np.array([*USUAL[colour], *others.values()])
    width = np.array([given[1] for given in FREE.values()])
    bounds = np.array([given[2] for given in FREE.values()]).T
    bounds[1, :2] = 3 * usual[:2]
    to_log = functools.partial(_where, np.log)

    mean, sd = (values[0] for values in PHOTOGRAPHED_COLOURS[colour])
    least = LEAST.get(colour, np.clip((BRIGHT - mean) / sd, DIM, MOST - 0.1))
    allowed = np.array([(least, MOST), *INSIDE.get(colour, WIDE)]).T

    @functools.lru_cache(maxsize=4)
    def seen(values):
        named = dict(zip(FREE, _where(np.exp, np.array(values)), strict=True))
        return _off(colour, of_texels(base.replace(**named), maps, integrator)[0])

    def cost(values):
        off = np.array(seen(tuple(values)))
        return np.concatenate(
            [STIFF * (off - np.clip(off, *allowed)), (values - to_log(usual)) / width]
        )

    fits = []
    for scattering, eumelanin in STARTS[:1] if quick else STARTS:
        begin = to_log(usual)
        begin[0] += eumelanin
        begin[-1] = scattering
        most = 3 if quick else 60
        fits.append(
            least_squares(cost, begin, bounds=to_log(bounds), diff_step=1e-3, max_nfev=most)
        )
    best = min(fits, key=lambda fit: fit.cost).x
    return *map(float, _where(np.exp, best)), *seen(tuple(best))


def of_texels(iris, maps, integrator):
    """Mean colour of the texels of the ciliary zone, by area, and their luminance."""
    eye = Eye()
    albedo = np.asarray(Matt.of(iris, maps, eye, _bands(), integrator).albedo())
    place = np.asarray(cell_centres(maps.shape)[1])
    weight = np.asarray(eye.from_axis(place)) * (place > CILIARY[0]) * (place < CILIARY[1])
    xyz = _TO_WHITE @ (albedo.mean(0).T @ weight / weight.sum())
    return tuple(map(float, lab_of(jnp.asarray(xyz)))), float(xyz[1])


def drawn(iris, maps, integrator, side):
    """A picture of the eye in the studio, and its ciliary zone's luminance over the white's."""
    eye, camera = Eye(), Camera(size=(side, side), width=12.6)
    view, environment = project(eye, camera), Environment.studio()
    parts = {"eye": eye, "lights": None, "environment": environment, "integrator": integrator}
    scene = Scene(iris, maps, camera=camera, **parts)
    texels = texture(view, scene)
    lit = illuminate(view, texels, scene)
    picture = np.asarray(shade(view, texels, lit, respond(scene)))
    own = picture.reshape(-1, 3) - np.asarray(lit.surroundings).T
    unmirrored = scene.replace(camera=dataclasses.replace(camera, images=0.0))
    white = np.asarray(surroundings(view, texels, unmirrored)).T
    place = np.asarray(eye.relative_radius(np.hypot(*map(np.asarray, view.iris.point[:2]))))
    zone = (place > CILIARY[0]) & (place < CILIARY[1]) & (np.asarray(view.iris.share) > 0)
    light = [(_TO_WHITE[1] @ part.mean(0)) for part in (own[zone], white[view.sclera.share > 0.99])]
    return picture, float(light[0] / light[1])


@functools.cache
def _bands():
    return colour_bands()


def _where(function, values):
    """The function of those values that are searched by their logarithms."""
    return np.where(_LOG, function(np.where(_LOG, values, 1.0)), values)


def _off(colour, lab):
    mean, sd = PHOTOGRAPHED_COLOURS[colour]
    return tuple(float(v) for v in (np.array(lab) - mean) / np.array(sd))


if __name__ == "__main__":
    start(main, __doc__)
