"""The invented eye colours by ILIT and by radiative transfer: pigments with which a picture shows
the iris, through the cornea and beside the white, in the colours of photographs; all simulated.

The light is a studio; colours are those of the whole visible iris, without what the tear film
mirrors, at the exposure that shows the white of the eye, in the mean, at its reflectance.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares

from experiments.common import RESULTS, start, write
from irisjax.anatomy.eye import Eye, LimbalRing
from irisjax.grow.presets import PHOTOGRAPHED_COLOURS, PRESETS
from irisjax.io import write_png
from irisjax.io.scenes import LIMBUS_WIDTH
from irisjax.measure.colour import XYZ_TO_SRGB, lab_of, srgb_encode
from irisjax.render.albedo import Matt
from irisjax.render.bands import colour_bands
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.integrators import INTEGRATORS
from irisjax.render.picture import (
    exposure_of_white,
    illuminate,
    respond,
    shade,
    surroundings,
    texture,
)
from irisjax.render.project import project_visible, scatter_to_picture
from irisjax.render.scene import Scene
from irisjax.tissue.maps import cell_centres

MODELS = "separable", "radiative-transfer"
LB06_SCATTERING = 0.26  # coefficient of LB06's stroma at 500 nm, 1/mm: Rayleigh's, so reduced
WHITE = 0.6
"""Reflectance of the white: at the exposure that shows it so, a white sheet beside it has 1."""
FREE = {  # usual value, how far off costs as much as one standard deviation, bounds
    "eumelanin": (None, 1.5, (1e-3, 10.0)),
    "pheomelanin": (None, 1.5, (1e-3, 20.0)),
    "abl_fraction": (0.5, 0.3, (0.02, 0.98)),
    "hemoglobin": (0.084, 0.5, (5e-4, 0.45)),
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
BLOODLESS = {"blue": 0.002, "grey": 0.002}
"""Usual haemoglobin, mmol/l, of colours whose thick cords would be pink with more."""
INSIDE = ((-0.75, 0.75), (-0.85, 0.85), (-0.85, 0.85))
"""Standard deviations of L*, a* and b* within which a colour is as good as the mean."""
OWN = {  # the same, of those that would else look alike, and of one whose spread is small
    "blue": ((-0.85, 0.75), (-0.93, 0.85), (-0.94, 0.6)),
    "grey": ((-0.75, 0.75), (-0.85, 0.5), (-0.4, 0.5)),
    "green": ((-0.75, 0.75), (-0.85, 0.91), (-0.93, 0.85)),
    "hazel": ((-0.75, 0.4), (-0.7, 0.7), (-0.85, 0.5)),
    "brown": ((-0.75, 0.75), (-0.85, 0.85), (0.1, 0.85)),
    "dark-brown": ((-0.75, 0.75), (-0.4, 0.85), (0.0, 0.85)),
}
OVER_WHITE = 0.1005, 0.33
"""Luminance over the white's within which the same holds."""
STIFF = 60.0  # weight of a standard deviation, or of a fifth of that luminance, beyond these
STARTS = (1.4, -1.5), (3.2, 0.0), (3.2, -3.0)  # ln of scattering, of eumelanin's excess
WIDTH = 12.6  # of the picture, mm
_LOG = np.array([name != "abl_fraction" for name in FREE])
_TO_XYZ = np.linalg.inv(XYZ_TO_SRGB)
_TO_WHITE = _TO_XYZ / _TO_XYZ.sum(1, keepdims=True)  # relative to D65's white


class Seen(NamedTuple):
    """Colour of the visible iris in a picture, and its luminance over the white's mean."""

    lab: tuple[float, ...]
    over_white: float


class Pictured(NamedTuple):
    """An eye as a picture shows it, for many pigments of its iris.

    Attributes:
        scene: The scene; `view`, `texels` and `light` as of `render.picture`.
        share: Of each pixel's light in the mean over the iris: what white covers does not count.
        white: Luminance of the visible white, mean.
    """

    scene: Scene
    view: Any
    texels: Any
    light: Any
    share: np.ndarray
    white: float

    @classmethod
    def of(cls, iris, maps, model, side, environment=None):
        """See an eye that is grown for one of `MODELS`; by default in the studio."""
        eye = Eye(limbal_ring=LimbalRing(), limbus_width=jnp.asarray(LIMBUS_WIDTH))
        camera = Camera(size=(side, side), width=WIDTH)
        parts = {"eye": eye, "lights": None, "integrator": INTEGRATORS[model]()}
        parts["environment"] = Environment.studio() if environment is None else environment
        scene = Scene(iris, maps, camera=camera, **parts)
        view = project_visible(eye, camera)
        texels = texture(view, scene)
        light = illuminate(view, texels, scene)
        blend = scatter_to_picture(view.sclera, np.asarray(view.sclera.share), (side, side)).ravel()
        index = np.asarray(view.iris.index)
        place = np.asarray(eye.relative_radius(np.hypot(*map(np.asarray, view.iris.point[:2]))))
        seen = (index >= 0) & (place > 0) & (np.asarray(view.iris.share) > 0)
        unmirrored = scene.replace(camera=Camera(size=(side, side), width=WIDTH, images=0.0))
        white = np.asarray(surroundings(view, texels, unmirrored))[:, blend > 0.99]
        share = seen / (seen @ (1 - blend[index]))
        return cls(scene, view, texels, light, share, float(_TO_WHITE[1] @ white.mean(1)))

    def seen(self, iris) -> Seen:
        """Colour of the iris with these pigments."""
        response = respond(self.scene.replace(iris=iris))
        radiance = response.shade(self.view.iris, self.texels.iris, self.light.iris)
        xyz = _TO_WHITE @ (np.asarray(radiance) @ self.share) / self.white
        return Seen(tuple(map(float, lab_of(jnp.asarray(WHITE * xyz)))), float(xyz[1]))

    def drawn(self, iris):
        """The picture, whose brightest fifth of the white is shown at 0.6."""
        response = respond(self.scene.replace(iris=iris))
        picture = shade(self.view, self.texels, self.light, response)
        return exposure_of_white(self.scene) * np.asarray(picture)


def main(key, quick=False, out=RESULTS):
    """Write pigments, colours and pictures (a row a model, a column a colour; quick: small)."""
    shape = (96, 32) if quick else (768, 256)
    colours = list(PRESETS)[:1] if quick else list(PRESETS)
    found, rows, sheet = [], [], []
    for model in MODELS[:1] if quick else MODELS:
        row = []
        for colour in colours:
            process = INTEGRATORS[model]().process
            iris, maps = PRESETS[colour](Eye(), process=process, shape=shape, key=key)
            sides = (24, 24) if quick else (96, 240)
            small, eye = (Pictured.of(iris, maps, model, side) for side in sides)
            pigments = search(colour, iris, small, quick)
            iris = iris.replace(**pigments)
            row.append(eye.drawn(iris))
            lab, over_white = eye.seen(iris)
            scattering = float(iris.scattering_scale) * LB06_SCATTERING
            found.append((colour, model, *pigments.values(), round(scattering, 2)))
            off = off_class(colour, lab)
            tissue = reflectance(iris, maps, model)
            rows.append((colour, model, *lab, *off, over_white, tissue))
            print(*found[-1], "off", *(f"{v:.2f}" for v in off), f"{over_white:.3f}", flush=True)
        sheet.append(np.concatenate(row, axis=1))
    out.mkdir(parents=True, exist_ok=True)
    encoded = np.asarray(srgb_encode(np.clip(np.concatenate(sheet), 0, 1)))
    remark = f"simulated by irisjax; rows: {', '.join(MODELS)}; columns: {', '.join(colours)}"
    write_png(out / "eye_colours.png", encoded, remark=remark)
    write(
        out / "eye_colours.csv",
        (
            "simulated by irisjax; L*, a*, b* (D65, CIE 1931 2 degree) of the presets in a picture "
            "in the studio: mean of the visible iris without what the tear film mirrors, exposed "
            f"so that the mean of the visible white has a luminance of {WHITE:g}",
            "off_*: from the mean of the photographed class, in its standard deviations",
            "over_white: luminance of the iris over that of the white, means; reflectance: "
            "luminance of the tissue relative to white paper, normal incidence, area mean",
        ),
        ("colour", "integrator", "L", "a", "b", "off_L", "off_a", "off_b", "over_white",
         "reflectance"),
        rows,
    )  # fmt: skip
    write(
        out / "eye_colours_pigments.csv",
        (
            "pigments of the presets, found for their maps and photographed colours: nearest to "
            "usual values inside the spread of the class; mg/ml, mmol/l",
            "scattering: reduced coefficient of the stroma at 500 nm, 1/mm",
        ),
        ("colour", "integrator", *FREE, "scattering"),
        found,
    )


def search(colour, base, eye, quick=False):
    """Find the pigments and the strength of scattering of a preset.

    Args:
        colour: Name of the preset.
        base: Its iris; all but `FREE` is kept.
        eye: The eye in which it is seen.
        quick: Few steps.

    Returns:
        The values of `FREE`, to three digits.
    """
    others = {name: given[0] for name, given in FREE.items() if given[0] is not None}
    others["hemoglobin"] = BLOODLESS.get(colour, others["hemoglobin"])
    usual = np.array([*USUAL[colour], *others.values()])
    width = np.array([given[1] for given in FREE.values()])
    bounds = np.array([given[2] for given in FREE.values()]).T
    bounds[1, :2] = 3 * usual[:2]
    to_log = functools.partial(_where, np.log)
    allowed = np.array(OWN.get(colour, INSIDE)).T

    @functools.lru_cache(maxsize=4)
    def seen(values):
        named = dict(zip(FREE, _where(np.exp, np.array(values)), strict=True))
        lab, over_white = eye.seen(base.replace(**named))
        return *off_class(colour, lab), over_white

    def cost(values):
        *off, over_white = seen(tuple(values))
        beyond = 5 * (np.log(over_white) - np.clip(np.log(over_white), *np.log(OVER_WHITE)))
        off = np.append(off - np.clip(off, *allowed), beyond)
        return np.concatenate([STIFF * off, (values - to_log(usual)) / width])

    fits = []
    for scattering, eumelanin in STARTS[:1] if quick else STARTS:
        begin = to_log(usual)
        begin[0] += eumelanin
        begin[-1] = scattering
        most = 3 if quick else 30
        fits.append(
            least_squares(cost, begin, bounds=to_log(bounds), diff_step=1e-3, max_nfev=most)
        )
    best = min(fits, key=lambda fit: fit.cost).x
    return {name: float(f"{v:.3g}") for name, v in zip(FREE, _where(np.exp, best), strict=True)}


def reflectance(iris, maps, model):
    """Luminance of the texels' reflectance, mean by area."""
    eye = Eye()
    albedo = np.asarray(Matt.build(iris, maps, eye, colour_bands(), INTEGRATORS[model]()).albedo())
    weight = np.asarray(eye.from_axis(cell_centres(maps.shape)[1]))
    return float(_TO_WHITE[1] @ (albedo.mean(0).T @ weight / weight.sum()))


def _where(function, values):
    """The function of those values that are searched by their logarithms."""
    return np.where(_LOG, function(np.where(_LOG, values, 1.0)), values)


def off_class(colour, lab):
    """How far a colour is from the mean of its class, in standard deviations."""
    mean, sd = PHOTOGRAPHED_COLOURS[colour]
    return tuple(float(v) for v in (np.array(lab) - mean) / np.array(sd))


if __name__ == "__main__":
    start(main, __doc__)
