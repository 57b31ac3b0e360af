"""Milliseconds a frame of 800 × 600 pixels in single precision, for every kind of change and
without each part.

Warm: everything is compiled and the parts that do not change are kept, as in an interactive
session.
"""

import dataclasses
import os
import statistics
import time

import jax
import jax.numpy as jnp
import numpy as np

from experiments.common import RESULTS, start, write
from irisjax.grow.presets import preset
from irisjax.grow.vessels import veins
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import (
    draw_on_cores,
    illuminate,
    iris_model,
    lit_model,
    prepare_scene,
    respond,
    shade,
    texture,
)
from irisjax.render.project import project_visible
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import Scene
from irisjax.render.single_scattering import SingleScattering
from irisjax.transport.process import DEPTH_RESOLVED

TARGETS = {"pigments": 30, "thickness": 30, "2 lights": 10, "25 lights": 3, "camera, 2 lights": 10}
"""Frames per second that are wanted."""
RADIATIVE = {"pigments": 20, "thickness": 15}
"""The same by radiative transfer."""


def main(key, quick=False, out=RESULTS):
    """Write the table (quick: 80 × 60 pixels, one repetition)."""
    before = jax.config.read("jax_enable_x64")
    jax.config.update("jax_enable_x64", False)
    try:
        rows = list(frames(key, (80, 60) if quick else (800, 600), 1 if quick else 5))
    finally:
        jax.config.update("jax_enable_x64", before)
    device = jax.devices()[0]
    header = (
        f"{device.platform}, {os.cpu_count()} processor cores, load {os.getloadavg()[0]:.1f} at "
        f"the end of the run",
        "float32, warm, median; a frame takes all that must be computed anew after the change",
    )
    write(
        out / "bench_render.csv",
        header,
        ("change", "scene", "ms", "frames_per_s", "wanted_frames_per_s"),
        rows,
    )


def frames(key, size, repeats):
    """Yield the rows of the table one after the other: each change of each scene."""
    iris, maps = preset("hazel", key=key)
    full = Scene(iris, maps, lights=_lamps(2, 0.0))
    full = full.replace(
        camera=dataclasses.replace(full.camera, size=size),
        veins=veins(full.eye, key=key),
        environment=Environment.studio(),
        environment_lights=2,
    )
    two = full.replace(environment=None)

    def row(change, scene, f):
        ms, _ = _milliseconds(f, repeats)
        wanted = (RADIATIVE if "radiative" in scene else TARGETS).get(change, "")
        return change, scene, ms, 1e3 / ms, 1 if "single" in scene else wanted

    def of(change, name, scene, tables):
        """Yield the rows of one kind of change of a scene."""
        scene = prepare_scene(scene)
        view = project_visible(scene.eye, scene.camera)
        texels = texture(view, scene)
        light = illuminate(view, texels, scene, tables)
        response = respond(scene)

        iris = scene.iris
        if change == "pigments":

            def pigmented(i):
                changed = scene.replace(iris=iris.replace(eumelanin=0.4 + 1e-3 * i))
                return shade(view, texels, light, respond(changed))

            yield row(change, name, pigmented)
        elif change == "thickness":

            def thicker(i):
                thick = scene.maps.stroma_depth * (1 + 1e-3 * i)
                changed = scene.replace(maps=scene.maps.replace(stroma_depth=thick))
                model = iris_model(changed)
                iris = changed.integrator.texels(view.iris, model, model.ranges)
                mapped = dataclasses.replace(texels, iris=iris, facing=model.facing(view.iris))
                return shade(view, mapped, light, respond(changed))

            def uniformly_thicker(i):
                thick = iris.stroma_thickness * (1 + 1e-3 * i)
                maps = scene.maps.replace(stroma_depth=scene.maps.stroma_depth * (1 + 1e-3 * i))
                changed = scene.replace(iris=iris.replace(stroma_thickness=thick), maps=maps)
                return shade(view, texels, light, respond(changed))

            yield row(change, f"{name}, another map", thicker)
            yield row(change, name, uniformly_thicker)
        elif change.startswith("camera"):
            model = lit_model(scene, tables)

            def moved(i):
                turned = dataclasses.replace(scene.camera, polar=0.01 * i)
                return draw_on_cores(scene.replace(camera=turned), tables, response, model)

            yield row(change, name, moved)
        else:
            number = int(change.split()[0])

            def lit(i):
                changed = scene.replace(lights=_lamps(number, 0.01 * i))
                lit = illuminate(view, texels, changed, tables)
                return shade(view, texels, lit, response)

            yield row(change, name, lit)

    eye = full.eye
    ms, first = _milliseconds(
        lambda i: Illumination.build(eye, caustics=False).flux, max(1, repeats // 2)
    )
    yield "tables", "refraction", ms, 1e3 / ms, ""
    yield "tables, with compiling", "refraction", first, 1e3 / first, ""
    tables = Illumination.build(eye, caustics=False)
    for change in ("pigments", "thickness", "2 lights", "25 lights", "camera, 2 lights"):
        yield from of(change, "all but environment", two, tables)
    marched = two.replace(integrator=SingleScattering())
    yield from of("2 lights", "all but environment, single scattering", marched, tables)
    transfer = two.replace(
        iris=preset("hazel", key=key, process=DEPTH_RESOLVED)[0], integrator=RadiativeIntegrator()
    )
    for change in ("pigments", "thickness", "2 lights", "25 lights", "camera, 2 lights"):
        yield from of(change, "all but environment, radiative transfer", transfer, tables)
    plain = transfer.replace(maps=transfer.maps.replace(eumelanin=None))
    for change in ("pigments", "thickness"):
        yield from of(change, "no pigment maps, radiative transfer", plain, tables)
    without = {
        "no maps": two.replace(maps=None),
        "no relief": two.replace(maps=maps.replace(relief=None)),
        "no freckles": two.replace(maps=maps.replace(freckles=None)),
        "no pigment maps": two.replace(maps=maps.replace(eumelanin=None)),
        "no veins": two.replace(veins=None),
        "no sclera": two.replace(veins=None, eye=eye.replace(sclera=None)),
        "no cornea": two.replace(veins=None, eye=eye.replace(sclera=None, cornea=None)),
        "with environment": full,
    }
    for name, scene in without.items():
        for change in ("pigments", "2 lights", "camera, 2 lights"):
            yield from of(change, name, scene, None if scene.eye.cornea is None else tables)
    ms, first = _milliseconds(lambda i: Illumination.build(eye).flux, 1)
    yield "tables", "refraction and caustics", ms, 1e3 / ms, ""
    yield "tables, with compiling", "refraction and caustics", first, 1e3 / first, ""


def _lamps(number, turned):
    i = np.arange(number)
    return Lights.distant(
        0.3 + 0.9 * (i + 0.5) / number, 2.4 * i + 1.0 + turned, jnp.pi / number * np.ones(number)
    )


def _milliseconds(f, repeats):
    """Median of `f(1)`, `f(2)` … and the first call, compiling included."""
    times = []
    for i in range(repeats + 1):
        begin = time.perf_counter()
        jax.block_until_ready(f(i))
        times.append(1e3 * (time.perf_counter() - begin))
    return statistics.median(times[1:]), times[0]


if __name__ == "__main__":
    start(main, __doc__)
