"""Eyes drawn from the priors of `photo.pigments` and `photo.white`, and their photographs, by the
package's own renderer: what experiments on clones begin with.
"""

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from experiments.simulated_photographs import outline, sensed
from irisjax.anatomy.eye import Eye, Sclera
from irisjax.grow.procedural import procedural
from irisjax.io.images import write_png
from irisjax.io.photographs import read_photograph
from irisjax.measure.colour import srgb_encode
from irisjax.photo.clone import usual_iris
from irisjax.photo.photograph import Ellipse, Photograph
from irisjax.photo.pigments import FREE_NAMES, PRIORS, iris_of_concentrations
from irisjax.photo.white import whites_of_people
from irisjax.photo.windows import average_thickness
from irisjax.render.bands import BAND_GRID, colour_bands
from irisjax.render.camera import Camera
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.outside import bulk_reflectance
from irisjax.render.picture import draw
from irisjax.render.scene import Scene
from irisjax.tissue.maps import IrisMaps

WHITE = 0.3, 0.97
"""Linear values between which the brightest tenth of the white begins: not burnt out, not dark."""
SIZE, WIDTH, DISTANCE = 640, 15.0, 250.0
"""Of the picture (px), and of the field at the pupil and the camera's distance, mm: irides of 470
pixels."""
PUPIL = 1.5, 2.6
"""Radii, mm."""
LAMP_POLAR, LAMP_RADIUS = np.radians((20.0, 50.0)), np.radians(2.0)
"""Angles off the eye's axis between which lamps stand, even by solid angle; half their width."""
PEOPLE = 0.12
"""Spread of the thickness of people's irides, of its logarithm; assumed."""
STEEPEST = np.radians(30.0)
"""Tilt of the camera, even by solid angle up to it."""


class Truth(NamedTuple):
    """A drawn eye: values by name, its scene, and outlines in pixels."""

    values: dict[str, float]
    scene: Scene
    limbus: Ellipse
    pupil: Ellipse


def photographed(
    random: np.random.Generator,
    tables: Callable[[Scene], Illumination | None] = Scene.tables,
    grow: Callable[..., IrisMaps] = procedural,
) -> tuple[Truth, Photograph]:
    """An eye of the priors, and its photograph as it is read from a file of 8 bits: the first whose
    white is well exposed. Posteriors stay right under any choice that the picture itself decides.
    """
    while True:
        values = {n: float(PRIORS[n].value(random.standard_normal())) for n in FREE_NAMES}
        scene = _scene(values, random, grow)
        light = np.maximum(np.asarray(draw(scene, tables(scene)), np.float64), 0)
        gains = np.array([values["red_gain"], 1.0, values["blue_gain"]])
        linear = values["exposure"] * gains * light ** values["contrast"]
        photograph = read_back(sensed(linear, random))
        limbus, pupil = outlines_of(scene)
        row, column = np.ogrid[:SIZE, :SIZE]
        white = photograph.pixels[limbus.relative_radius(column, row) > 1.15].max(-1)
        if WHITE[0] < np.quantile(white, 0.9) < WHITE[1]:
            return Truth(values, scene, limbus, pupil), photograph


def outlines_of(scene: Scene) -> tuple[Ellipse, Ellipse]:
    """Limbus and pupil as a scene's camera sees them, in pixels."""
    limbus, _ = outline(scene, float(scene.eye.limbus_radius), pupil=False)
    pupil, _ = outline(scene, float(scene.eye.pupil_radius), pupil=True)
    return limbus, pupil


def read_back(linear: np.ndarray) -> Photograph:
    """Return a linear picture as it is read from an sRGB file of 8 bits."""
    encoded = np.asarray(srgb_encode(jnp.asarray(np.clip(linear, 0, 1))))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "eye.png"
        write_png(path, encoded)
        return read_photograph(path)


def tables_of(scene: Scene) -> Illumination:
    """Of all eyes: what decides them, cornea and depth, is the same."""
    del scene
    return _built()


@cache
def _built() -> Illumination:
    return Illumination.build(Eye())


@cache
def _white_of_package() -> np.ndarray:
    """The white of `Sclera`, linear sRGB."""
    weights = colour_bands(all_wavelengths=True).weights
    return np.asarray(weights @ bulk_reflectance(Sclera(), BAND_GRID))


def _scene(
    values: dict[str, float], random: np.random.Generator, grow: Callable[..., IrisMaps]
) -> Scene:
    """An iris of these values, its structure, lamp and camera drawn."""
    eye = Eye(pupil_radius=jnp.asarray(random.uniform(*PUPIL)))
    height = average_thickness(eye) * np.exp(PEOPLE * random.standard_normal())
    base = usual_iris(height)
    maps = grow(base, eye, key=jax.random.key(int(random.integers(2**31))))
    iris = iris_of_concentrations({n: jnp.asarray(v) for n, v in values.items()}, base)
    white = whites_of_people(random.standard_normal((1, 3)))[0] / _white_of_package()
    eye = eye.replace(sclera=Sclera(tint=jnp.asarray(white)))
    tilt, lamp = (
        float(np.arccos(random.uniform(np.cos(high), np.cos(low))))
        for low, high in ((0.0, STEEPEST), LAMP_POLAR)
    )
    sides = random.uniform(0, 2 * np.pi, 2)
    numbers = (jnp.asarray(v) for v in (tilt, sides[0], DISTANCE, WIDTH))
    camera = Camera(*numbers, size=(SIZE, SIZE))
    lights = Lights.distant(lamp, sides[1], radius=LAMP_RADIUS)
    return Scene(iris, maps, eye, lights, Environment.uniform(values["room"]), camera)
