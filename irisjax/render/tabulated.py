"""Irides whose response is tabulated: each texel's exact response at the price of a polynomial.

Texels differ in a few numbers: the pigment of their ABL, the thickness of their stroma, perhaps
their concentrations. Their BRDF is a smooth function of these and of the directions; it is expanded
in products of Chebyshev polynomials (`polynomials`) and functions of directions (`angular`). The
error of every table is measured between its nodes.
"""

import abc
import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.chunks import pixelwise
from irisjax.numerics.quadrature import gauss_legendre
from irisjax.render.angular import AbstractAngularFunctions, LightMoments
from irisjax.render.bands import Bands
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.polynomials import (
    check_points,
    evaluate_products,
    product_basis,
    product_coefficients,
    scale_nodes,
    scale_polynomials,
    scales_from_unit,
    scales_to_unit,
    varying_degrees,
)
from irisjax.render.project import IrisPixels
from irisjax.render.shading import IrisModel, sample_textures, scale_textures
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import Scales, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.light import Light
from irisjax.transport.process import Ilit
from irisjax.transport.solution import RESULTS, worst
from irisjax.transport.solver import AbstractSolver

_QUADRATURE_NODES = 48  # exit cosines over which an albedo is integrated
_CHUNK = 24  # texels solved at a time


TabulatedTexels = tuple[
    tuple[Float[Array, " pixels"], ...], Float[Array, "functions pixels"] | None
]
"""Coordinates in [−1, 1] of the scales that vary, at pixels, and functions of the exit direction
(`None` where they come with the light). The polynomials of the coordinates are many times larger,
and are evaluated where they are used.
"""


class AbstractTabulated(AbstractIntegrator):
    """An integrator that tabulates the response in pigment, thickness and directions.

    Attributes:
        degrees: Degrees of the polynomials in ABL pigment, stroma thickness, eumelanin and
            pheomelanin.
        solver: Solver of the texels; `None` where `prepare` chooses it.
    """

    degrees: eqx.AbstractVar[tuple[int, ...]]
    solver: eqx.AbstractVar[AbstractSolver | None]

    @abc.abstractmethod
    def directions(self, iris: Iris, aqueous_index: Scalar) -> AbstractAngularFunctions:
        """Return the functions of directions in which the response is expanded."""

    def texels(self, pixels: IrisPixels, model: IrisModel, ranges: Scales) -> TabulatedTexels:
        directions = self.directions(model.iris, model.eye.aqueous_index)
        textures = model.textures
        if textures is None:
            textures = scale_textures(model.maps, model.iris)
        return _look_up_texels(pixels, textures, model.eye, ranges, directions)

    def response(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "TabulatedResponse":
        directions = self.directions(iris, aqueous_index)
        degrees = varying_degrees(ranges, self.degrees)
        nodes, checks = scale_nodes(degrees)[0], check_points(degrees)
        # One loop over nodes and check points, so that the solver is compiled once.
        chunks = [
            (jnp.asarray(chunk, bands.weights.dtype), *directions_at)
            for grid, directions_at in zip((nodes, checks), directions.nodes(), strict=True)
            for chunk in _chunks(grid, min(_CHUNK, max(len(nodes), len(checks))))
        ]
        solve = self._texel_solver(iris, aqueous_index, bands, ranges)
        brdf, status = jax.lax.map(solve, jax.tree.map(lambda *x: jnp.stack(x), *chunks))
        values = brdf[:-1].reshape(-1, *brdf.shape[2:])[: len(nodes)]
        response = TabulatedResponse(
            coefficients=product_coefficients(directions.coefficients(values), degrees),
            directions=directions,
            ranges=ranges,
            error=jnp.zeros((), bands.weights.dtype),
            status=self._status(status),
            degrees=degrees,
        )
        error = _largest_error(response, checks, brdf[-1, : len(checks)])
        return dataclasses.replace(response, error=error)

    def coefficients(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> tuple[Float[Array, "products functions channels"], RESULTS | None]:
        """Compute the coefficients and the status of `response` without the check of its error,
        for loops over many irides.
        """
        directions = self.directions(iris, aqueous_index)
        degrees = varying_degrees(ranges, self.degrees)
        solve = self._texel_solver(iris, aqueous_index, bands, ranges)
        unit = jnp.asarray(scale_nodes(degrees)[0], bands.weights.dtype)
        values, status = solve((unit, *directions.nodes()[0]))
        return product_coefficients(directions.coefficients(values), degrees), self._status(status)

    def _texel_solver(self, iris: Iris, aqueous_index, bands: Bands, ranges: Scales):
        """Return a function of coordinates in `ranges`, incidences and exits, which computes BRDFs
        (texels, incidences, exits, channels) and their status.
        """
        table = extinction(np.asarray(bands.wavelengths))
        prepared: Any = self.prepare(iris, aqueous_index, bands, ranges)

        def solve(chunk):
            unit, incidences, exits = chunk

            def solve_texel(x):
                scales = scales_from_unit(x, ranges)
                layers = texel_layers(iris, aqueous_index, table, scales)

                def solve_incidence(mu):
                    solution = prepared.solver.solve(layers, Light(mu, exits))
                    return (bands.weights @ solution.brdf).T, solution.status

                return jax.vmap(solve_incidence)(incidences)

            return jax.vmap(solve_texel)(unit)

        return solve

    def _status(self, status: RESULTS) -> RESULTS | None:
        return None if isinstance(self.process, Ilit) else worst(status)


class TabulatedResponse(AbstractResponse):
    """The BRDF of every texel of an iris, expanded in products of the scales' `polynomials` and in
    functions of directions.

    Attributes:
        coefficients: Coefficients of each product of scales and function of directions, in each
            channel of the picture.
        directions: The functions of directions.
        ranges: Smallest and largest value of each scale that varies.
        error: Largest difference from the solver at points between the nodes, relative to the
            brightest of them.
        status: Status of the solver; `None` for ILIT.
        degrees: Degree of the polynomials of each scale that varies.
    """

    coefficients: Float[Array, "products functions channels"]
    directions: AbstractAngularFunctions
    ranges: Scales
    error: Float[Array, ""]
    status: RESULTS | None
    degrees: tuple[int, ...] = eqx.field(static=True)

    def brdf(
        self, scales: Scales, cos_incidence: Array, cos_exit: Array, azimuth: Array
    ) -> Float[Array, "channels pixels"]:
        """Compute the BRDF (1/sr, times the picture's white) of pixels, each for a pair of
        directions in the aqueous humour; `azimuth` 0 is forward.
        """
        sines = [jnp.sqrt(jnp.maximum(1 - c * c, 0.0)) for c in (cos_incidence, cos_exit)]
        across = sines[0] * sines[1] * jnp.cos(azimuth)
        functions = self.directions.functions(cos_incidence, cos_exit, across)
        return evaluate_products(self.coefficients, self._polynomials(scales), functions[None])

    def hemispherical(
        self, scales: Scales, cos_incidence: ArrayLike
    ) -> Float[Array, "channels pixels"]:
        """Compute the directional–hemispherical reflectance of pixels for one incidence, without
        the mirror of the first surface and without unscattered light. Where no scale varies there
        is one pixel.
        """
        rule = gauss_legendre(_QUADRATURE_NODES)
        cosine, weights = (jnp.asarray(v, self.error.dtype) for v in rule)
        functions = self.directions.functions(jnp.full_like(cosine, cos_incidence), cosine, None)
        # The functions are integrated once, in place of a sum over directions for each pixel.
        moments = functions @ (2 * jnp.pi * weights * cosine)
        integrated = jnp.tensordot(self.coefficients[:, : len(moments)], moments, (1, 0))
        polynomials = self._polynomials(scales)
        like = polynomials[0][0] if polynomials else jnp.ones(1, self.error.dtype)
        return integrated.T @ product_basis(polynomials, like)

    def shade(
        self, pixels: IrisPixels, texels: TabulatedTexels, light: LightMoments
    ) -> Float[Array, "channels pixels"]:
        return _shade_pixels((texels, light[0]), self.coefficients, light[1], self.degrees)

    def _polynomials(self, scales: Scales):
        return scale_polynomials(scales_to_unit(scales, self.ranges), self.degrees)


@pixelwise
def _look_up_texels(
    pixels: IrisPixels,
    textures: Scales,
    eye: Eye,
    ranges: Scales,
    directions: AbstractAngularFunctions,
) -> TabulatedTexels:
    coordinates = scales_to_unit(sample_textures(pixels, eye, textures), ranges)
    return coordinates, directions.exit_functions(pixels.cosine)


@pixelwise
def _shade_pixels(
    pixels: tuple[TabulatedTexels, Float[Array, "tints parts pixels"]],
    coefficients: Float[Array, "products functions channels"],
    mixtures: Float[Array, "functions mixtures"] | None,
    degrees: tuple[int, ...],
) -> Float[Array, "shown pixels"]:
    (coordinates, exit_functions), light = pixels
    if mixtures is not None:
        coefficients = jnp.einsum("pkc,kr->prc", coefficients, mixtures)
    if exit_functions is not None:
        light = light * exit_functions
    return evaluate_products(coefficients, scale_polynomials(coordinates, degrees), light)


def _chunks(points: np.ndarray, size: int) -> list[np.ndarray]:
    """Split points into chunks of equal size, the last one padded."""
    padded = np.pad(points, ((0, -len(points) % size), (0, 0)), mode="edge")
    return np.split(padded, len(padded) // size)


def _largest_error(response: TabulatedResponse, checks: np.ndarray, exact):
    """Compare a table with the solver's BRDFs `exact` at the check points: the largest difference,
    relative to the largest BRDF.
    """
    incidences, exits = response.directions.nodes()[1]
    pairs = [jnp.tile(x, incidences.size) for x in (exits.cosine, exits.azimuth)]
    pairs = [jnp.tile(x, len(checks)) for x in (jnp.repeat(incidences, exits.cosine.size), *pairs)]
    unit = jnp.repeat(jnp.asarray(checks, exact.dtype), exact[0, ..., 0].size, 0)
    interpolated = response.brdf(scales_from_unit(unit, response.ranges), *pairs).T
    return jnp.abs(interpolated - exact.reshape(interpolated.shape)).max() / jnp.abs(exact).max()
