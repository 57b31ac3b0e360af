"""Windows of the iris whose colours are compared, spread round it and across it  [F09 Section
5.2]."""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from irisjax.anatomy.eye import Eye
from irisjax.photo.pose import Pose
from irisjax.photo.unrefracted import LUMINANCE
from irisjax.render.environment import Environment
from irisjax.render.outside import room_at
from irisjax.render.project import (
    IRIS,
    SCLERA,
    IrisPixels,
    View,
    onto_picture,
    pixel_numbers,
    seen_parts,
)

ANGLES = 16
"""Windows round the iris."""
RINGS = 4
"""Windows across the iris."""
MARGIN = 0.35
"""Kept off the pupil's edge, mm."""
OUTER_MARGIN = 0.7
"""Kept off root and limbus, mm: the soft edge of the white, which is not modelled but by a blend,
shades what lies under it.
"""
SHADED = 0.7
"""Light of a window over the median of its ring, below which it is left out: the shadow of the
limbus or of a lid falls on it, whose edge no model of the eye knows well.
"""
COUNT = ANGLES * RINGS
"""All windows."""
_MOST, _LEAST = 96, 24  # pixels of a window: so many are taken of it, or it is left out


class WindowPixels(NamedTuple):
    """Pixels of the windows of one photograph, and the windows' mean colours.

    Every photograph has the same shapes: windows with too few pixels stand empty, and pixels that
    are missing have the number of no window, `COUNT`.

    - `seen`: some of their pixels; `window`: the number of each one's window.
    - `present`: windows with enough pixels, and not in the shade. `colour`: mean linear values of
        all of a window's pixels in the photograph, (windows, 3).
    - `veil`: share of a uniform room's radiance that the tear film mirrors; `mirrored`: radiance
        that it mirrors of the environment.
    - `angle` (radians), `radius` (mm): of their middles.
    """

    seen: IrisPixels
    window: Int[np.ndarray, " pixels"]
    present: Bool[np.ndarray, " windows"]
    colour: Float[np.ndarray, "windows 3"]
    veil: Float[np.ndarray, " windows"]
    mirrored: Float[np.ndarray, "windows 3"]
    angle: Float[np.ndarray, " windows"]
    radius: Float[np.ndarray, " windows"]


def choose_pixels(
    pixels: Float[np.ndarray, "rows columns 3"],
    clear: Bool[np.ndarray, "rows columns"],
    view: View,
    eye: Eye,
    environment: Environment | None = None,
    light: Float[np.ndarray, "rows columns"] | None = None,
) -> WindowPixels:
    """Choose the pixels of all windows.

    Args:
        pixels: Linear, of the part of the photograph that the camera shows.
        clear: Pixels that show the iris alone: no highlight, lash, lid or freckle, none of the
            white.
        view: What the camera sees.
        eye: That it sees.
        environment: That the tear film mirrors, if any.
        light: On the iris at each pixel, by the model, where nothing but the eye itself throws
            shadows on it. Without it the photograph's own brightness tells windows in the shade,
            which leaves out those that are dark of themselves, too.

    Raises:
        ValueError: If hardly any window is free.
    """
    seen = view.iris
    if seen is None:
        raise ValueError("the camera does not see the iris")
    every, around, r = _windows_of_pixels(seen, clear, eye)
    index, window = _sampled(every)
    some = dataclasses.replace(seen, index=None)
    some = jax.tree.map(lambda leaf: jnp.asarray(np.asarray(leaf)[index]), some)
    inside = every < COUNT
    every, around, r = (v[inside] for v in (every, around, r))
    at = pixel_numbers(seen)[inside]
    number = np.bincount(every, minlength=COUNT)

    def mean(values):
        """Of values (pixels, channels) in each window."""
        sums = [np.bincount(every, v, COUNT) for v in np.asarray(values, float).T]
        return np.stack(sums, -1) / np.maximum(number, 1)[:, None]

    colour = mean(pixels.reshape(-1, 3)[at])
    brightness = colour @ LUMINANCE if light is None else mean(light.reshape(-1, 1)[at])[:, 0]
    present = (number > 0) & ~_shaded(brightness, number > 0)
    if present.sum() < 6:
        raise ValueError(
            f"only {present.sum()} windows of the iris are free of highlights, lashes, lids and "
            "their shadows; 6 are the least that pigments can be told from"
        )
    veil, mirrored = _tear_film(view, clear.shape, environment)
    cos, sin, radius = mean(np.stack([np.cos(around), np.sin(around), r], -1)).T
    return WindowPixels(
        some,
        window,
        present,
        colour,
        mean(veil[at][:, None])[:, 0],
        mean(mirrored[at]),
        np.arctan2(sin, cos),
        radius,
    )


def _shaded(light, present) -> Bool[np.ndarray, " windows"]:
    """Windows that are much darker than most at their distance from the pupil."""
    rings = np.where(present, light, np.nan).reshape(RINGS, ANGLES)
    seen = [ring[~np.isnan(ring)] for ring in rings]
    usual = [np.median(ring) if len(ring) else np.nan for ring in seen]
    return (rings < SHADED * np.array(usual)[:, None]).ravel()


def iris_alone(pose: Pose) -> Bool[np.ndarray, "rows columns"]:
    """Pixels of the camera's picture that see the iris and none of the white, which shines through
    at the limbus.
    """
    rows, columns = pose.camera.shape
    every = np.arange(rows * columns, dtype=np.int32)
    seen = np.asarray(seen_parts(every, pose.eye, pose.camera))
    return (seen & (IRIS | SCLERA) == IRIS).reshape(rows, columns)


def _tear_film(view: View, shape: tuple[int, int], environment: Environment | None):
    """Reflectance of every pixel of the picture, and what it mirrors of an environment."""
    count = shape[0] * shape[1]
    mirror = view.mirror
    if mirror is None:
        return np.zeros(count), np.zeros((count, 3))
    reflectance = np.asarray(mirror.reflectance)
    room = np.zeros((len(reflectance), 3))
    if environment is not None:
        room = reflectance[:, None] * np.asarray(room_at(mirror, environment)).T
    return (
        onto_picture(mirror, reflectance, shape).reshape(count),
        onto_picture(mirror, room, shape).reshape(count, 3),
    )


def _windows_of_pixels(seen: IrisPixels, clear, eye: Eye):
    """The number of each pixel's window, `COUNT` for none; its angle and radius."""
    number = pixel_numbers(seen)
    x, y = (np.asarray(c) for c in seen.point[:2])
    r, around = np.hypot(x, y), np.arctan2(y, x) % (2 * np.pi)
    inner = float(eye.pupil_radius) + MARGIN
    outer = min(float(eye.iris_radius), float(eye.limbus_radius)) - OUTER_MARGIN
    usable = (number >= 0) & (r > inner) & (r < outer) & clear.reshape(-1)[number]
    ring = np.minimum((r - inner) / (outer - inner) * RINGS, RINGS - 1).astype(int)
    sector = np.minimum(around / (2 * np.pi) * ANGLES, ANGLES - 1).astype(int)
    window = np.where(usable, ring * ANGLES + sector, COUNT)
    enough = np.bincount(window, minlength=COUNT + 1) >= _LEAST
    return np.where(enough[window], window, COUNT), around, r


def _sampled(window):
    """Places of some pixels of each window, and the numbers of their windows."""
    # As many of each, those that are missing under the number of no window: one program for all.
    index, name = np.zeros((COUNT, _MOST), int), np.full((COUNT, _MOST), COUNT)
    for w in range(COUNT):
        of = np.flatnonzero(window == w)
        if len(of) == 0:
            continue
        taken = of[np.linspace(0, len(of) - 1, min(_MOST, len(of))).astype(int)]
        index[w, : len(taken)], name[w, : len(taken)] = taken, w
    # Padding repeats a pixel that is seen.
    index[name == COUNT] = index[name < COUNT][0] if (name < COUNT).any() else 0
    return index.ravel(), name.ravel()
