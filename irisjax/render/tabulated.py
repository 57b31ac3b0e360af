"""Irides whose response is tabulated: each texel's exact response at the price of a polynomial.

Texels differ in a few numbers, the pigment of their ABL, the thickness of their stroma, perhaps
their concentrations. Their BRDF is a smooth function of these and of the directions, which products
of Chebyshev polynomials (`polynomials`) and functions of directions (`angular`) hold. The error is
measured off the nodes with every table.
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
from irisjax.render import polynomials as products
from irisjax.render.angular import AbstractAngular, AngularLight
from irisjax.render.bands import Bands
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Front, scales_at, textures_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import Scales, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.light import Light
from irisjax.transport.process import Ilit
from irisjax.transport.solution import RESULTS, worst
from irisjax.transport.solver import AbstractSolver

_COSINES = 48
_CHUNK = 24  # texels solved at a time


Terms = tuple[tuple[Float[Array, " pixels"], ...], Float[Array, "functions pixels"] | None]
"""The scales that vary, at pixels, within [−1, 1], and functions of the line of sight, `None` where
they come with the light. Their polynomials, of which there are many, are made where they are used.
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
    def directions(self, iris: Iris, aqueous_index: Scalar) -> AbstractAngular:
        """The functions of directions in which the response is written."""

    def texels(self, pixels: IrisPixels, front: Front, ranges: Scales) -> Terms:
        directions = self.directions(front.iris, front.eye.aqueous_index)
        textures = textures_of(front.maps, front.iris)
        return _terms(pixels, textures, front.eye, ranges, directions)

    def response(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "TabulatedResponse":
        directions = self.directions(iris, aqueous_index)
        degrees = products.degrees_of(ranges, self.degrees)
        nodes, checks = products.scale_nodes(degrees)[0], products.between(degrees)
        # One loop over both: the solver is compiled once.
        chunks = [
            (jnp.asarray(points, bands.weights.dtype), *at)
            for every, at in zip((nodes, checks), directions.nodes(), strict=True)
            for points in _chunks(every, min(_CHUNK, max(len(nodes), len(checks))))
        ]
        solve = self._solving(iris, aqueous_index, bands, ranges)
        found, status = jax.lax.map(solve, jax.tree.map(lambda *x: jnp.stack(x), *chunks))
        values = found[:-1].reshape(-1, *found.shape[2:])[: len(nodes)]
        out = TabulatedResponse(
            coefficients=products.of_products(directions.coefficients(values), degrees),
            directions=directions,
            ranges=ranges,
            error=jnp.zeros((), bands.weights.dtype),
            status=self._status(status),
            degrees=degrees,
        )
        return dataclasses.replace(out, error=_error(out, checks, found[-1, : len(checks)]))

    def coefficients(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> tuple[Float[Array, "products functions channels"], RESULTS | None]:
        """Those of the response and its status, without its error: for many irides alike."""
        directions = self.directions(iris, aqueous_index)
        degrees = products.degrees_of(ranges, self.degrees)
        solve = self._solving(iris, aqueous_index, bands, ranges)
        unit = jnp.asarray(products.scale_nodes(degrees)[0], bands.weights.dtype)
        values, status = solve((unit, *directions.nodes()[0]))
        return products.of_products(directions.coefficients(values), degrees), self._status(status)

    def _solving(self, iris: Iris, aqueous_index, bands: Bands, ranges: Scales):
        """From places in `ranges` and directions to BRDFs (texels, in, out, channels), status."""
        table = extinction(np.asarray(bands.wavelengths))
        made: Any = self.prepare(iris, aqueous_index, bands, ranges)

        def solve(chunk):
            unit, into, exits = chunk

            def texel(x):
                scales = products.scales_at_unit(x, ranges)
                layers = texel_layers(iris, aqueous_index, table, scales)

                def each(mu):
                    found = made.solver.solve(layers, Light(mu, exits))
                    return (bands.weights @ found.brdf).T, found.status

                return jax.vmap(each)(into)

            return jax.vmap(texel)(unit)

        return solve

    def _status(self, status: RESULTS) -> RESULTS | None:
        return None if isinstance(self.process, Ilit) else worst(status)


class TabulatedResponse(AbstractResponse):
    """The BRDF of every texel of an iris: coefficients of the products of scales (`polynomials`),
    of the functions of directions, and of the channels.

    Attributes:
        coefficients: The coefficients.
        directions: The functions of directions.
        ranges: Smallest and largest value of each scale that varies.
        error: Largest difference from the solver at points off the nodes, relative to the
            brightest of them.
        status: Status of the solver; `None` of ILIT.
        degrees: Degree of the polynomials of each scale that varies.
    """

    coefficients: Float[Array, "products functions channels"]
    directions: AbstractAngular
    ranges: Scales
    error: Float[Array, ""]
    status: RESULTS | None
    degrees: tuple[int, ...] = eqx.field(static=True)

    def brdf(
        self, scales: Scales, cos_incidence: Array, cos_exit: Array, azimuth: Array
    ) -> Float[Array, "channels pixels"]:
        """BRDF (1/sr, times the picture's white) of pixels, each for a pair of directions in the
        aqueous humour; `azimuth` 0 is straight on.
        """
        sines = [jnp.sqrt(jnp.maximum(1 - c * c, 0.0)) for c in (cos_incidence, cos_exit)]
        across = sines[0] * sines[1] * jnp.cos(azimuth)
        functions = self.directions.functions(cos_incidence, cos_exit, across)
        return products.summed(self.coefficients, self._polynomials(scales), functions[None])

    def hemispherical(
        self, scales: Scales, cos_incidence: ArrayLike
    ) -> Float[Array, "channels pixels"]:
        """Directional–hemispherical reflectance of pixels for one incidence, without the first
        surface's mirror and without light that is never scattered. Where nothing varies there is
        one pixel.
        """
        cosine, w = (jnp.asarray(v, self.error.dtype) for v in gauss_legendre(_COSINES))
        functions = self.directions.functions(jnp.full_like(cosine, cos_incidence), cosine, None)
        # Integrals of the functions once, not a sum over directions a pixel.
        moments = functions @ (2 * jnp.pi * w * cosine)
        whole = jnp.tensordot(self.coefficients[:, : len(moments)], moments, (1, 0))
        terms = self._polynomials(scales)
        one = terms[0][0] if terms else jnp.ones(1, self.error.dtype)
        return whole.T @ products.basis(terms, one)

    def shade(
        self, pixels: IrisPixels, texels: Terms, light: AngularLight
    ) -> Float[Array, "channels pixels"]:
        return _shaded((texels, light[0]), self.coefficients, light[1], self.degrees)

    def _polynomials(self, scales: Scales):
        return products.polynomials_of(products.scale_places(scales, self.ranges), self.degrees)


@pixelwise
def _terms(
    pixels: IrisPixels,
    textures: Scales,
    eye: Eye,
    ranges: Scales,
    directions: AbstractAngular,
) -> Terms:
    units = products.scale_places(scales_at(pixels, eye, textures), ranges)
    return units, directions.exits(pixels.cosine)


@pixelwise
def _shaded(
    pixels: tuple[Terms, Float[Array, "tints parts pixels"]],
    coefficients: Float[Array, "products functions channels"],
    mixtures: Float[Array, "functions mixtures"] | None,
    degrees: tuple[int, ...],
) -> Float[Array, "shown pixels"]:
    (units, exits), light = pixels
    if mixtures is not None:
        coefficients = jnp.einsum("pkc,kr->prc", coefficients, mixtures)
    scales = products.polynomials_of(units, degrees)
    return products.summed(coefficients, scales, light if exits is None else light * exits)


def _chunks(points: np.ndarray, size: int) -> list[np.ndarray]:
    """Points in equal chunks, the last one filled up."""
    padded = np.pad(points, ((0, -len(points) % size), (0, 0)), mode="edge")
    return np.split(padded, len(padded) // size)


def _error(response: TabulatedResponse, checks: np.ndarray, true):
    """Largest difference from the solver off the nodes, relative to the brightest of them."""
    into, exits = response.directions.nodes()[1]
    pairs = [jnp.tile(x, into.size) for x in (exits.cosine, exits.azimuth)]
    pairs = [jnp.tile(x, len(checks)) for x in (jnp.repeat(into, exits.cosine.size), *pairs)]
    unit = jnp.repeat(jnp.asarray(checks, true.dtype), true[0, ..., 0].size, 0)
    found = response.brdf(products.scales_at_unit(unit, response.ranges), *pairs).T
    return jnp.abs(found - true.reshape(found.shape)).max() / jnp.abs(true).max()
