"""Small paintings for the tests, and what they are by hand."""

import functools

import jax.numpy as jnp
import numpy as np

from irisjax.ocularist.coats import LIMBUS, Coat, Painting, profile_of, prosthesis
from irisjax.ocularist.integrator import Painted
from irisjax.render.camera import Camera
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.picture import draw
from irisjax.render.scene import Scene

EYE = prosthesis().replace(sclera=None)
CAMERA = Camera(size=(48, 36), width=13.0)
FINE = Camera(size=(160, 120), width=9.0, distance=1e4)
LAMP = Lights.distant(0.6, 2.2)
SIZE = 64
WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
RED, GREEN, BLUE = (0.7, 0.2, 0.1), (0.3, 0.6, 0.2), (0.1, 0.2, 0.8)


@functools.cache
def tables():
    return Illumination.build(EYE, caustics=False, size=33)


def coat(name, height=0.0, opacity=1.0, colour=WHITE):
    everywhere = jnp.asarray(np.broadcast_to(opacity, (SIZE, SIZE)), float)
    return Coat(name, everywhere, jnp.asarray(colour), jnp.asarray(height))


def scene(*coats, lights=LAMP, camera=CAMERA, as_printed=False):
    painted = Painted(Painting(coats, profile_of(EYE)), as_printed)
    return Scene(None, eye=EYE, lights=lights, camera=camera, integrator=painted)


def picture(*coats, **parts):
    """What paint sends back: less the cornea's mirror images, which a black iris has too."""
    drawn, mirrored = (draw(scene(*c, **parts), tables()) for c in (coats, [bare()]))
    return np.asarray(drawn - mirrored)


def bare():
    return coat("bare", colour=BLACK)


def places(camera=CAMERA):
    """Rough x and y of pixels, mm."""
    columns, rows = camera.size
    line = (np.arange(columns) + 0.5) * float(camera.width) / columns - float(camera.width) / 2
    return np.meshgrid(line, -line[:rows] - float(camera.width) / 2 * (1 - rows / columns))


def in_the_middle(drawn):
    """Pixels well inside the iris."""
    x, y = places()
    r = np.hypot(x, y)
    return drawn[(r > 3) & (r < 4.6)]


def spots(seed, count=12):
    """Soft random opacity."""
    rng = np.random.default_rng(seed)
    x, y = texels()
    at, wide = rng.uniform(-5, 5, (2, count)), rng.uniform(0.4, 1.5, count)
    clear = np.ones((SIZE, SIZE))
    for a, b, w in zip(*at, wide, strict=True):
        clear *= 1 - 0.8 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / (2 * w**2))
    return 1 - clear


def texels():
    line = ((2 * np.arange(SIZE) + 1) / SIZE - 1) * LIMBUS
    return np.meshgrid(line, -line)


def dot(x, y, wide=0.3, opacity=1.0):
    u, v = texels()
    return opacity * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * wide**2))


def by_hand(*coats):
    """Eq. 1 and Eq. 2 from the uppermost down, over a white coat's picture; (opacity, colour)."""
    light, left, seen = np.ones(3), 1.0, np.zeros(3)
    for opacity, colour in coats:
        seen = seen + left * opacity * np.asarray(colour) * light
        light = light * (1 - opacity * (1 - np.asarray(colour)))
        left *= 1 - opacity
    return seen
