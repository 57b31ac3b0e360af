"""Compare the radiance of the iris with that of the white in a picture, as irisjax draws it and by
rays traced through conicoids and Fresnel's equations of this file's own.

A matt iris in aqueous humour sends back, in the direction of a camera, its reflectance times the
mean of what the directions above it show; those that the cornea reflects back inside, or that meet
the wall of the chamber, show nothing.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np

from experiments.common import RESULTS, start, write
from irisjax.anatomy.eye import Eye
from irisjax.grow.presets import preset
from irisjax.render.camera import Camera
from irisjax.render.environment import LUMINANCE, Environment
from irisjax.render.lights import Lights
from irisjax.render.picture import illuminate, respond, shade, texture
from irisjax.render.project import project_visible
from irisjax.render.scene import Scene

ABOUT = (
    "simulated; radiance of the ciliary zone and of the white, straight ahead, over that of a "
    "white sheet which faces the camera in the same light",
    "for an iris and a white of reflectance 1, but white_drawn with the white's own",
    "traced: matt, by Monte Carlo; drawn: by irisjax, ILIT, without maps; ratio: iris over white; "
    "escaping: share of the directions above the iris that show the outside",
)
COLUMNS = "light", "escaping", "iris_traced", "iris_drawn", "white_traced", "white_drawn", "ratio"
HAZE = 10 ** (-2 * (0.016 + 21e8 / 560.0**4))
"""Share that the cornea's haze leaves of light on both ways, at 560 nm  [F09 Eq. 16]."""
EYE = Eye(limbus_width=jnp.asarray(0.1))
WIDTH = 12.6  # of the picture, mm
CILIARY = 0.4, 0.9
"""The ring looked at, between pupil (0) and root (1)."""


def main(key, quick=False, out=RESULTS):
    """Write a CSV (quick: fewer rays, one light)."""
    rng, count = np.random.default_rng(0), 300 if quick else 3000
    studio, even = Environment.studio(), Environment.uniform()
    lights = {"uniform sky": even, "studio": studio}
    lights |= {f"lamp {angle} degrees aside": np.radians(angle) for angle in (0, 35, 60)}
    iris, _ = preset("green", shape=(16, 8), key=key)
    rows = []
    for name in list(lights)[: 1 if quick else None]:
        light = lights[name]
        escaping, sheet, *found = traced(light, count, rng)
        pair = [value / sheet for value in found]
        drawn = [value / sheet for value in pictured(light, iris, 40 if quick else 120)]
        both = (v for pair_of in zip(pair, drawn, strict=True) for v in pair_of)
        rows.append((name, escaping, *both, pair[0] / pair[1]))
    write(out / "iris_over_white.csv", ABOUT, COLUMNS, rows)


def traced(light, count, rng):
    """Share of directions that escape, and radiances of a white sheet, the iris and the white."""
    radius, turn = 5.5 * np.sqrt(rng.random(8 * count)), rng.uniform(0, 2 * np.pi, 8 * count)
    place = np.stack([radius * np.cos(turn), radius * np.sin(turn), -np.ones_like(radius)], 1)
    way, passed = np.tile([0.0, 0.0, 1.0], (len(place), 1)), np.ones(len(place))
    for surface, indices in zip(_surfaces(), _indices(), strict=True):
        place, way, share = _crossed(place, way, surface, *indices, -1)
        passed = passed * share
    place = place + ((float(EYE.iris_depth) - place[:, 2]) / way[:, 2])[:, None] * way
    zone = np.asarray(EYE.relative_radius(np.hypot(*place[:, :2].T)))
    seen = (zone > CILIARY[0]) & (zone < CILIARY[1]) & (passed > 0)
    place, passed = (np.repeat(v[seen][:count], 100, 0) for v in (place, passed))
    way, out = _cosines(len(place), rng), np.ones(len(place))
    for surface, indices in zip(_surfaces()[::-1], _indices()[::-1], strict=True):
        place, way, share = _crossed(place, way, surface, *indices[::-1], 1)
        out = out * share
    out = np.where(np.hypot(*place[:, :2].T) < float(EYE.limbus_radius), out, 0)
    iris = HAZE * (passed * out * _radiance(light, way)).mean()
    return (
        (out > 0).mean(),
        _radiance(light, _cosines(200_000, rng)).mean(),
        iris,
        _white(light, rng),
    )


def pictured(light, iris, side):
    """The same radiances of the iris and the white by irisjax, over their reflectances."""
    lamps, around = (None, light) if isinstance(light, Environment) else (None, None)
    if around is None:
        lamps = Lights.distant(float(light), 2.0)
    camera = Camera(size=(side, side), width=WIDTH, images=0.0)
    parts = {"camera": camera, "eye": EYE, "lights": lamps, "environment": around}
    scene = Scene(iris, None, **parts)
    view = project_visible(EYE, camera)
    texels = texture(view, scene)
    lit = illuminate(view, texels, scene)
    whole, white = shade(view, texels, lit, respond(scene)), np.asarray(lit.surroundings)
    own = np.asarray(whole).reshape(-1, 3).T - white
    # Without a cornea, lit and seen along the axis, a pixel shows the reflectance of the tissue.
    bare = dataclasses.replace(scene, eye=EYE.replace(cornea=None, sclera=None))
    bare = bare.replace(lights=Lights.distant(0.0, 0.0), environment=None)
    seen = project_visible(bare.eye, camera)
    flat = texture(seen, bare)
    sheet = shade(seen, flat, illuminate(seen, flat, bare), respond(bare))
    place = np.asarray(EYE.relative_radius(np.hypot(*map(np.asarray, view.iris.point[:2]))))
    where = np.asarray(view.iris.index)[(place > CILIARY[0]) & (place < CILIARY[1])]
    middle = np.asarray(sheet)[side // 2, round(0.75 * side)]
    of_white = np.asarray(view.sclera.index)[np.asarray(view.sclera.share) > 0.99]
    return _luminance(own[:, where[where >= 0]]) / _luminance(middle[:, None]), _luminance(
        white[:, of_white]
    )


def _luminance(light):
    return float((np.asarray(LUMINANCE) @ light).mean())


def _surfaces():
    """Anterior and posterior surface: radius, shape and apex."""
    both = EYE.cornea.anterior, EYE.cornea.posterior
    return [(float(s.radius), float(s.shape), float(s.apex)) for s in both]


def _indices():
    cornea, aqueous = float(EYE.cornea.index), float(EYE.aqueous_index)
    return [(1.0, cornea), (cornea, aqueous)]


def _crossed(place, way, surface, before, after, side):
    """Places on a conicoid, directions behind it by Snell's law and shares by Fresnel's equations;
    `side` is 1 for rays from inside.
    """
    radius, shape, apex = surface
    z = place[:, 2] - apex
    (x, y, _), (u, v, w) = place.T, way.T
    a = u * u + v * v + shape * w * w
    b = x * u + y * v + shape * z * w - radius * w
    square = b * b - a * (x * x + y * y + shape * z * z - 2 * radius * z)
    place = place + ((-b + side * np.sqrt(np.maximum(square, 0))) / a)[:, None] * way
    normal = np.stack([*place[:, :2].T, shape * (place[:, 2] - apex) - radius], 1)
    normal *= side / np.linalg.norm(normal, axis=1)[:, None]
    cosine = (way * normal).sum(1)
    inside = 1 - (before / after) ** 2 * (1 - cosine**2)
    bent = np.sqrt(np.maximum(inside, 1e-12))
    s = (before * cosine - after * bent) / (before * cosine + after * bent)
    p = (before * bent - after * cosine) / (before * bent + after * cosine)
    way = before / after * way + (bent - before / after * cosine)[:, None] * normal
    return place, way, np.where((square > 0) & (inside > 0), 1 - (s * s + p * p) / 2, 0)


def _cosines(count, rng):
    """Directions out of the eye, as often as their cosine."""
    u, turn = rng.random(count), rng.uniform(0, 2 * np.pi, count)
    return np.stack([*(np.sqrt(u) * np.stack([np.cos(turn), np.sin(turn)])), -np.sqrt(1 - u)], 1)


def _radiance(light, way):
    if isinstance(light, Environment):
        return np.asarray(light.lookup(way)) @ np.asarray(LUMINANCE)
    half = np.cos(0.15)
    towards = np.sin(light) * np.cos(2.0), np.sin(light) * np.sin(2.0), -np.cos(light)
    return np.where(way @ np.array(towards) > half, 0.5 / (1 - half), 0)


def _white(light, rng):
    """Mean over the white of the picture: a matt sphere through the limbus."""
    globe, rim = float(EYE.sclera.radius), float(EYE.limbus_radius)
    x, y = rng.uniform(-WIDTH / 2, WIDTH / 2, (2, 2000))
    x, y = (v[np.hypot(x, y) > rim + 0.1] for v in (x, y))
    normal = np.stack([x, y, -np.sqrt(globe**2 - x * x - y * y)], 1) / globe
    way = rng.normal(size=(40_000, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    return 4 * float((np.maximum(way @ normal.T, 0).mean(1) * _radiance(light, way)).mean())


if __name__ == "__main__":
    start(main, __doc__)
