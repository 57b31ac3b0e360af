"""Pictures after LB06 Fig. 9 and F09 Figs. 1 and 14 to 18, and the light of Figs. 15 and 16; all
simulated.
"""

import dataclasses
import io
import math

import jax
import jax.numpy as jnp
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start
from irisjax.anatomy.eye import Cornea, Eye, Sclera
from irisjax.grow.presets import preset
from irisjax.grow.procedural import procedural
from irisjax.grow.vessels import veins
from irisjax.io import write_atomically, write_png
from irisjax.measure.colour import agx_encode, srgb_encode
from irisjax.render.camera import Camera
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import draw, exposure_of_white, illuminate, respond, shade, texture
from irisjax.render.project import project
from irisjax.render.scene import Scene
from irisjax.render.single_scattering import SingleScattering
from irisjax.tissue import FRACTIONS

MELANIN = (("high", 1.008, 0.2674), ("moderate", 0.8138, 0.2054), ("low", 0.1201, 0.0194))
STOPS = 3
"""LB06's irides, which send back 1 to 5 % of the light, are exposed by so many stops more than the
white of the eye.
"""
GRAZING = 1.7
"""Polar angle of the light of a caustic, radians."""
CONCENTRATIONS = dict(zip(FRACTIONS, (7.56, 5.84, 4.61, 2.11), strict=True))
"""Melanins of F09's Fig. 1, in per cent of volume."""
SMOOTH = {"crypts": 0, "furrows": 0, "relief": 0.08}
"""Features of irides on which a caustic is the brightest thing."""


def main(key, quick=False, out=RESULTS):
    """Write PNGs of equal panels and the light on the iris (quick: small, coarse tables)."""
    side = 24 if quick else 240
    shape = (96, 32) if quick else (768, 256)
    table = {"size": 33, "n_rays": 4096} if quick else {}
    camera = Camera(size=(side, side), width=13.6)
    close = Eye(cornea=Cornea(scatter=None))
    smooth = Illumination.build(close, caustics=False, size=table.get("size", 129))
    lights = Lights.distant([0.6, 0.9], [2.2, 0.6], [2.2, 0.9])

    def seed(i):
        return jax.random.fold_in(key, i)

    def save(name, panels, exposure, encode=lambda x: srgb_encode(np.clip(x, 0, 1))):
        encoded = np.asarray(encode(exposure * np.concatenate(panels, axis=1)))
        out.mkdir(parents=True, exist_ok=True)
        write_png(
            out / f"{name}.png", encoded, remark=f"simulated by irisjax, exposure {exposure:.3g}"
        )

    def exposure(scene):
        """The exposure for the white of the eye, also of a scene that does not show it."""
        return exposure_of_white(scene.replace(eye=close))

    # LB06 Fig. 9: rows 20, 50 and 80 % of the melanin in the ABL, columns from high to low.
    base = ij.Iris.of_level("moderate")
    scene = Scene(base, procedural(base, shape=shape, key=seed(0)), close, lights, camera=camera)
    view = project(scene.eye, scene.camera)
    texels = texture(view, scene)
    lit = illuminate(view, texels, scene, smooth)

    def pigmented(eu, pheo, fraction):
        iris = base.replace(eumelanin=eu, pheomelanin=pheo, abl_fraction=fraction)
        return shade(view, texels, lit, respond(scene.replace(iris=iris)))

    rows = [
        np.concatenate(
            [pigmented(eu, pheo, f) for _, eu, pheo in MELANIN],
            axis=1,
        )
        for f in (0.2, 0.5, 0.8)
    ]
    save("render_lb06_fig9", [np.concatenate(rows)], 2**STOPS * exposure(scene), agx_encode)

    # F09 Fig. 14: from the side, where refraction lifts the iris towards the viewer.
    iris, maps = preset("blue", shape=shape, key=seed(1))
    side_on = dataclasses.replace(camera, polar=jnp.asarray(math.radians(60)))
    alone = close.replace(sclera=None)
    eyes = alone, alone.replace(cornea=None)
    scenes = [Scene(iris, maps, eye, lights, camera=side_on) for eye in eyes]
    views = [draw(scene, t) for scene, t in zip(scenes, (smooth, None), strict=True)]
    save("render_f09_fig14", views, exposure(scenes[0]))

    # Figs. 15, 16: what reaches the iris, and how it looks on two irides.
    full = Illumination.build(close, caustics=True, **table)
    line = np.linspace(-5.5, 5.5, 49 if quick else 161)
    at = jnp.stack(jnp.meshgrid(jnp.asarray(line), jnp.asarray(line)), axis=-1)
    angles = (0.0, 1.0, GRAZING)
    flux = [full.at(at, jnp.asarray([math.sin(a), 0.0, -math.cos(a)]))[..., 2] for a in angles]
    irradiance = np.asarray(flux).astype(np.float16)
    _npz(
        out / "render_f09_fig15.npz",
        polar=np.asarray(angles),
        line=line.astype(np.float32),
        irradiance=irradiance,
    )
    lamp = Lights.distant([GRAZING, 0.4], [math.pi, 2.0], [2 * math.pi, 0.8])
    caustic = []
    for i, colour in enumerate(("brown", "blue")):
        iris, maps = preset(colour, shape=shape, features=SMOOTH, key=seed(2 + i))
        caustic.append(draw(Scene(iris, maps, alone, lamp, camera=camera), full))
    save("render_f09_fig16", caustic, 3.0)

    # Fig. 1: F09's concentrations, cornea and renderer, in the same lights.
    eye = Eye(sclera=None, cornea=Cornea.f09(), aqueous_index=jnp.asarray(1.376))
    tables = Illumination.build(eye, caustics=True, **table)
    first = []
    for light in (lights, lamp):
        alike = {"features": {"heterochromia": 0, "freckles": 0}, "pigments": CONCENTRATIONS}
        iris, maps = preset("green", eye, shape=shape, **alike, key=seed(4))
        iris = iris.replace(scattering_scale=1.0, hemoglobin=0.084)
        parts = {"camera": camera, "integrator": SingleScattering()}
        first.append(draw(Scene(iris, maps, eye, light, **parts), tables))
    save("render_f09_fig1", first, 40.0)

    # Fig. 17: the same iris without and with freckles.
    freckled = []
    for number in (0, 60):
        iris, maps = preset("green", shape=shape, features={"freckles": number}, key=seed(4))
        scene = Scene(iris, maps, close, lights, camera=camera)
        freckled.append(draw(scene, smooth))
    save("render_f09_fig17", freckled, exposure(scene))

    # Fig. 18: the white, turned aside.
    iris, maps = preset("hazel", shape=shape, key=seed(5))
    aside = Camera(polar=math.radians(40), size=(side, side), width=14.0)
    white = []
    for density in (0.0, 1.0, 2.0):
        eye = Eye(sclera=Sclera(veins=jnp.asarray(density)))
        drawn = veins(eye, shape=(256, 128) if quick else (1024, 512), key=seed(6))
        lit = Lights.distant([0.5, 0.9], [0.8, 2.4], [1.8, 0.9])
        white.append(draw(Scene(iris, maps, eye, lit, camera=aside, veins=drawn), smooth))
    save("render_f09_fig18", white, 1.0)


def _npz(path, **arrays):
    data = io.BytesIO()
    np.savez_compressed(data, **arrays)
    write_atomically(path, data.getvalue())


if __name__ == "__main__":
    start(main, __doc__)
