"""What was made before, for those who draw one scene many times: viewer, animation, large pictures.

The functions that make a picture know nothing of it. A light that moves leaves maps and camera
alone.
"""

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.numerics.portions import Pixelwise
from irisjax.render.camera import Camera
from irisjax.render.compose import Stage, prepare, respond
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractResponse
from irisjax.render.project import (
    IRIS,
    MIRROR,
    SCLERA,
    View,
    iris_pixels,
    mirror_pixels,
    sclera_pixels,
    seen_parts,
)
from irisjax.render.scene import Scene
from irisjax.render.steps import Once, simply

_PAD = 2048  # and an eighth of the pixels at most


class Memory:
    """One result a named step of a picture, as long as its inputs are the same arrays (the same
    objects, not equal ones).

    Replacing a part of a module keeps its other arrays, so `scene.replace(lights=...)` has the old
    scene's maps. Nothing that is being traced is kept. With several `threads` pixels are shared out
    among them; they end with the memory.
    """

    def __init__(self, threads: int = 1):
        self._kept: dict[str, tuple[Any, list[Any], Any]] = {}
        self._threads = threads
        self._pool = None if threads == 1 else ThreadPoolExecutor(threads, "irisjax-pixels")

    def once(self, name: str, make: Any, *inputs: Any) -> Any:
        """`make(*inputs)`, or what it gave last time."""
        leaves, structure = jax.tree.flatten(inputs)
        if name in self._kept:
            form, before, made = self._kept[name]
            if form == structure and all(a is b for a, b in zip(before, leaves, strict=True)):
                return made
        if isinstance(make, Pixelwise) and self._pool is not None:
            made = make.on_threads(self._pool, self._threads, *inputs)
        else:
            made = make(*inputs)
        if not any(isinstance(x, Tracer) for x in jax.tree.leaves((leaves, made))):
            self._kept[name] = structure, leaves, made
        return made

    def render(
        self, scene: Scene, tables: Illumination | None = None
    ) -> Float[Array, "height width 3"]:
        """As `compose.render`: only what has changed since the last picture is done."""
        stage = self.prepare(scene, tables)
        parts = stage.integrator, scene.iris, stage.aqueous_index, stage.bands, stage.ranges
        return self.shown(stage, self.once("response", respond, *parts))

    def prepare(
        self,
        scene: Scene,
        tables: Illumination | None = None,
        view: View | None = None,
        wavelengths=None,
    ) -> Stage:
        """As `compose.prepare`: only what has changed since the last time is done, and only for
        pixels that see it; `view` from `look` if eye and camera are the same.
        """
        if view is None:
            view = self.look(scene.eye, scene.camera)
        if tables is None:
            tables = self.once("tables", _tables, scene.eye, scene.grazing())
        return prepare(scene, tables, view, wavelengths, self.once)

    def look(self, eye: Eye, camera: Camera) -> View:
        """`look` of the same eye and camera."""
        return self.once("view", lambda e, c: look(e, c, self.once), eye, camera)

    def shown(
        self, stage: Stage, response: AbstractResponse
    ) -> Float[Array, "height width channels"]:
        """The picture of a stage with a response."""
        return stage.shown(response, self.once)


def _tables(eye: Eye, caustics: bool) -> Illumination | None:
    return None if eye.cornea is None else Illumination.build(eye, caustics=caustics)


def look(eye: Eye, camera: Camera, once: Once = simply) -> View:
    """As `project`, each part with the pixels that see it and no others.

    Runs on the host: the number of pixels decides the shapes.
    """
    rows, columns = camera.shape
    count = rows * columns
    every = np.arange(count, dtype=np.int32)
    sees = np.asarray(once("seen parts", seen_parts, every, eye, camera))

    def of(part: int, name: str, pixels):
        index = np.flatnonzero(sees & part)
        if not index.size:
            return None
        if index.size == count and camera.rows is None:
            return dataclasses.replace(once(name, pixels, every, eye, camera), index=None)
        # Few different lengths, few compiled programs: a camera that turns must not wait for XLA.
        # Parts of a picture see anything from nothing to iris all over: programs for one length
        # cost less than padding.
        length = count if camera.rows is not None else index.size
        block = max(_PAD, 1 << max(length.bit_length() - 4, 0)) if count >= _PAD else count
        padded = np.pad(
            index.astype(np.int32), (0, -(-length // block) * block - index.size), mode="edge"
        )
        found = once(name, pixels, padded, eye, camera)
        padded = padded.copy()
        padded[index.size :] = -1
        return dataclasses.replace(found, index=jnp.asarray(padded))

    return View(
        of(IRIS, "iris pixels", iris_pixels),
        of(SCLERA, "white pixels", sclera_pixels),
        of(MIRROR, "mirror pixels", mirror_pixels),
        size=(columns, rows),
    )
