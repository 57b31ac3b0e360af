"""The renderer as a matrix for windows of the iris  [F09 Section 5.2].

A picture is linear in the coefficients of the iris's response: what the lights, the cornea and the
thickness map make of them is worked out once, and a change of pigments costs a product with a small
matrix.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.photo.unrefracted import LUMINANCE
from irisjax.photo.window_pixels import COUNT, WindowPixels
from irisjax.render.bands import Bands, colour_bands
from irisjax.render.compose import respond
from irisjax.render.environment import Environment
from irisjax.render.illumination import Illumination
from irisjax.render.lights import Lights
from irisjax.render.radiative import RadiativeIntegrator
from irisjax.render.scene import ENVIRONMENT_LIGHTS
from irisjax.render.separable import Separable
from irisjax.render.shading import ranges_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales
from irisjax.transport.solution import RESULTS

_COPIES = 4  # turns at which one pixel sees maps that are turned


class Windows(eqx.Module):
    """Windows of one photograph: their mean colours, and the same of the model as a matrix.

    - `colour`, `present`: of `WindowPixels`.
    - `matrix`: from the coefficients of a response to radiance, and its derivative by the logarithm
        of the stroma's thickness, (2, windows, channels or 1, products × functions). `room`: the
        same of a uniform room of radiance 1 beside the lights, or `None` where nothing but the
        lights is thought of.
    - `veil`: share of the room's radiance that the tear film mirrors; `mirrored`: radiance that it
        mirrors of an environment among the lights.
    - `bands`, `ranges`, `integrator`, `aqueous_index`: what a response is made with.
    """

    colour: Float[np.ndarray, "windows 3"]
    present: Bool[np.ndarray, " windows"]
    matrix: Float[Array, "2 windows tints terms"]
    room: Float[Array, "2 windows shades terms"] | None
    veil: Float[np.ndarray, " windows"]
    mirrored: Float[np.ndarray, "windows 3"]
    bands: Bands
    ranges: Scales
    integrator: Separable | RadiativeIntegrator
    aqueous_index: Float[Array, ""]

    def radiance(self, iris: Iris, room: Scalar | float = 0.0) -> Float[Array, "windows 3"]:
        """Mean linear sRGB of an iris in each window, where a white sheet facing an irradiance of π
        has 1; `room`: radiance of the room beside the lights. NaN for an iris that the integrator's
        solver does not hold.
        """
        return self.radiance_and_slope(iris, room)[0]

    def radiance_and_slope(
        self, iris: Iris, room: Scalar | float = 0.0
    ) -> tuple[Float[Array, "windows 3"], Float[Array, "windows 3"]]:
        """`radiance`, and its derivative by the logarithm of the stroma's thickness."""
        parts = self.aqueous_index, self.bands, self.ranges
        found, status = self.integrator.coefficients(iris, *parts)
        terms = found.reshape(-1, 3)
        if status is not None:
            terms = jnp.where(status == RESULTS.successful, terms, jnp.nan)
        matrix = self.matrix if self.room is None else self.matrix + room * self.room
        full = (*matrix.shape[:2], 3, matrix.shape[3])
        shown, slope = jnp.einsum("dwtk,kt->dwt", jnp.broadcast_to(matrix, full), terms)
        shown += self.mirrored
        return shown if self.room is None else shown + room * self.veil[:, None], slope

    def thickness_response(self, iris: Iris) -> float:
        """d ln luminance / d ln stroma's thickness of an iris, about its mean thickness, seen and
        lit from the front.
        """
        seen = self._from_the_front(iris, self.ranges, Scales(stroma=jnp.asarray([0.9, 1.1])))
        return float(np.log(seen[1] / seen[0]) / np.log(1.1 / 0.9))

    def freckle_response(
        self, iris: Iris, shares: Float[np.ndarray, " shares"]
    ) -> Float[np.ndarray, " shares"]:
        """Luminance of an iris with shares of a freckle (as of `IrisMaps.freckles`) over its own,
        seen and lit from the front.
        """
        spots = IrisMaps(freckles=jnp.asarray([shares, shares], float))
        ranges = self.ranges._replace(abl=ranges_of(iris, spots).abl)
        dark = spots.abl_scale(iris)
        assert dark is not None
        both = Scales(abl=dark[0], stroma=jnp.ones_like(dark[0]))
        seen = self._from_the_front(iris, ranges, both)
        return seen / self._from_the_front(iris, ranges, both._replace(abl=0 * dark[0] + 1))

    def _from_the_front(self, iris: Iris, ranges: Scales, scales: Scales) -> np.ndarray:
        """Luminance of uniform irides, (irides,)."""
        found: Any = respond(self.integrator, iris, self.aqueous_index, self.bands, ranges)
        one = jnp.ones_like(scales.stroma)
        return np.asarray(LUMINANCE @ np.asarray(found.brdf(scales, one, one, 0 * one)))


def windows_of(
    chosen: WindowPixels,
    eye: Eye,
    iris: Iris,
    maps: IrisMaps,
    lights: Lights,
    integrator: Separable | RadiativeIntegrator,
    tables: Illumination | None,
    room: bool = False,
    turns: int = 1,
) -> Windows:
    """Make the matrix of windows.

    Args:
        chosen: Their pixels.
        eye: That the camera sees.
        iris: Fixes everything but the melanins.
        maps: Thickness of the stroma.
        lights: All of them but a room.
        integrator: ILIT's or that of radiative transfer.
        tables: Of the eye, `None` without a cornea. Those of a room need caustics.
        room: Whether there may be light from all round beside the lights.
        turns: Places round the eye at which the maps stand in turn, for pixels of each window; a
            window then shows what is usual at its distance from the pupil.
    """
    ranges = ranges_of(iris, maps)
    bands = colour_bands(lights.illuminant, cornea=eye.cornea)
    made: Any = integrator.prepare(iris, eye.aqueous_index, bands, ranges)
    known = eye, iris, maps, tables, ranges, bands, made

    # What a window's features owe to chance would be taken for an error of the contrast.
    copies = min(turns, _COPIES)
    seen = jax.tree.map(lambda leaf: jnp.repeat(leaf, copies, -1), chosen.seen)
    window = jnp.repeat(jnp.asarray(chosen.window), copies)
    # Neighbours in a window have different turns.
    turn = 2 * np.pi / turns * (np.arange(len(window)) % turns)
    seen = dataclasses.replace(seen, turn=jnp.asarray(turn))

    def of(lamps: Lights):
        return _matrix(seen, window, lamps, *known)

    around = Environment.uniform().to_lights(ENVIRONMENT_LIGHTS) if room else None
    return Windows(
        chosen.colour,
        chosen.present,
        of(lights),
        None if around is None else of(around),
        chosen.veil,
        chosen.mirrored,
        bands,
        ranges,
        made,
        jnp.asarray(eye.aqueous_index),
    )


@eqx.filter_jit
def _matrix(seen, window, lights, eye, iris, maps, tables, ranges, bands, integrator):
    response = integrator.response(iris, eye.aqueous_index, bands, ranges)
    one = response.coefficients[..., :1]
    share = jnp.maximum(jnp.zeros(COUNT).at[window].add(1.0, mode="drop"), 1.0)

    def placed(log_scale):
        thicker = maps.replace(stroma_depth=maps.stroma_depth * jnp.exp(log_scale))
        places = integrator.place(seen, lights, eye, iris, thicker, tables, ranges)
        return eqx.partition(places, eqx.is_inexact_array)

    none = jnp.zeros((), one.dtype)
    numbers, moved, rest = jax.jvp(placed, (none,), (jnp.ones_like(none),), has_aux=True)

    def means(numbers, coefficients):
        held = eqx.tree_at(lambda r: r.coefficients, response, coefficients.reshape(one.shape))
        shaded = held.shade(*eqx.combine(numbers, rest))
        added = jnp.zeros((COUNT, shaded.shape[0])).at[window].add(shaded.T, mode="drop")
        return added / share[:, None]

    flat = jnp.zeros(one.size, one.dtype)

    def column(direction):
        def linear(numbers):
            return jax.jvp(lambda c: means(numbers, c), (flat,), (direction,))[1]

        return jnp.stack(jax.jvp(linear, (numbers,), (moved,)))

    return jax.lax.map(column, jnp.eye(one.size)).transpose(1, 2, 3, 0)
