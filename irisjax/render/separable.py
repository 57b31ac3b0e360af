"""The iris seen by ILIT: each texel's exact response, all orders of scattering, at the price of a
polynomial.

ILIT's BRDF is separable: f(μ_i, μ_o, λ) = (1 − F(μ_i)) g(μ_o, λ). Texels differ in a few numbers,
the pigment of their ABL, the thickness of their stroma, perhaps their concentrations: g is a smooth
function of these and of μ_o, which products of Chebyshev polynomials hold; those of high degree in
several numbers at once hold nothing and are left out. The error is measured off the nodes with
every table.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import chebyshev_nodes
from irisjax.numerics.portions import pixelwise
from irisjax.optics.fresnel import fresnel, fresnel_at, refract
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.polynomials import (
    along_nodes,
    basis,
    between,
    degrees_of,
    grid,
    of_products,
    polynomials,
    polynomials_of,
    scales_at_unit,
    summed,
)
from irisjax.render.project import IrisPixels
from irisjax.render.shading import field_of, irradiance_at, scales_at, slopes_of, textures_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import IrisMaps, Scales, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.ilit.exact import IlitExact
from irisjax.transport.light import Directions, Light
from irisjax.transport.process import AbstractProcess, Ilit
from irisjax.transport.solver import AbstractSolver

_COSINES = 48


class Separable(AbstractIntegrator):
    """Integrator: ILIT's separable response, tabulated in pigment and thickness  [LB06].

    Attributes:
        degrees: Degrees of the polynomials in ABL pigment, stroma thickness, eumelanin,
            pheomelanin and exit cosine.
        solver: Solver of the texels, of ILIT.
    """

    degrees: tuple[int, int, int, int, int] = eqx.field(static=True, default=(8, 5, 4, 4, 3))
    solver: AbstractSolver = eqx.field(default_factory=lambda: IlitExact(20))

    process: AbstractProcess = eqx.field(init=False)

    def __post_init__(self):
        self.process = self.solver.process

    def __check_init__(self):
        if not isinstance(self.process, Ilit):
            raise ValueError("the separable integrator needs ILIT: no other process is separable")

    def texels(
        self,
        pixels: IrisPixels,
        eye: Eye,
        iris: Iris,
        maps: IrisMaps | None,
        ranges: Scales,
    ) -> "Terms":
        """See `AbstractIntegrator`."""
        textures, degrees = textures_of(maps, iris), degrees_of(ranges, self.degrees)
        return _terms(pixels, textures, eye, iris, ranges, degrees, self.degrees[4])

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        eye: Eye,
        iris: Iris,
        maps: IrisMaps | None,
        tables: Illumination | None,
    ) -> Float[Array, "tints pixels"]:
        """Irradiance times all shares on the way out: the lights are summed, for the response does
        not depend on where light comes from.
        """
        field = field_of(lights, eye, iris, tables)
        slopes = slopes_of(None if maps is None else maps.relief, eye)
        return irradiance_at(pixels, field, eye, slopes)

    def response(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "SeparableResponse":
        """Tabulate `iris` for the channels of `bands`; `ranges` from `Scales.ranges`."""
        dtype = bands.weights.dtype
        most = degrees_of(ranges, self.degrees)
        n = iris.indices(aqueous_index)
        indices = (jnp.asarray(n.aqueous, dtype), jnp.asarray(n.abl, dtype))
        lowest = refract(jnp.zeros((), dtype), *indices)
        nodes = jnp.asarray((chebyshev_nodes(self.degrees[4] + 1) + 1) / 2, dtype)
        inside = lowest + (1 - lowest) * nodes
        cosines = refract(inside, *indices[::-1])
        table = extinction(np.asarray(bands.wavelengths))

        def radiance(
            unit, cosines
        ):  # (texels, varied) on [−1, 1], (exits,) to (texels, exits, channels)
            def one(x):
                layers = texel_layers(iris, aqueous_index, table, scales_at_unit(x, ranges))
                found = self.solver.solve(layers, Light(1.0, Directions(cosines)))
                assert found.brdf is not None
                return bands.weights @ (found.brdf / (1 - found.mirrored[:, None]))

            return jnp.moveaxis(jax.vmap(one)(unit), 1, 2)

        values = radiance(jnp.asarray(grid(most), dtype), cosines)
        values = values / fresnel(cosines, inside, *indices)[1][:, None]
        out = SeparableResponse(
            coefficients=of_products(along_nodes(values, 1), most),
            indices=indices,
            ranges=ranges,
            error=jnp.zeros((), dtype),
            degrees=most,
        )
        unit = jnp.asarray(between(most), dtype)
        exits = jnp.asarray([0.15, 0.6, 0.95], dtype)
        true = radiance(unit, exits)
        scales = scales_at_unit(jnp.repeat(unit, exits.size, 0), ranges)
        found = out(scales, jnp.tile(exits, len(unit))).T.reshape(true.shape)
        error = jnp.abs(found - true).max() / jnp.abs(true).max()
        return dataclasses.replace(out, error=error)

    def coefficients(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> tuple[Float[Array, "products cosine channels"], None]:
        """Those of the response, and its status: nothing can fail. A program that asks for them
        alone does not compute the error.
        """
        return self.response(iris, aqueous_index, bands, ranges).coefficients, None


class Terms(eqx.Module):
    """The polynomials of each pixel: of the scales that vary, and of the exit cosine, the share 1 −
    F that leaves the tissue included."""

    scales: tuple[Float[Array, "_ pixels"], ...]
    angular: Float[Array, "cosine pixels"]


class SeparableResponse(AbstractResponse):
    """g of every texel of an iris: Chebyshev coefficients of the products of the scales that vary,
    of the cosine and of the channels.

    Attributes:
        coefficients: The coefficients.
        indices: Refractive indices before and behind the surface of the iris.
        ranges: Smallest and largest value of each scale that varies.
        error: Largest difference from the solver at points off the nodes, relative to the
            brightest of them.
        degrees: Degree of the polynomials of each scale that varies.
    """

    coefficients: Float[Array, "products cosine channels"]
    indices: tuple[Float[Array, ""], Float[Array, ""]]
    ranges: Scales
    error: Float[Array, ""]
    degrees: tuple[int, ...] = eqx.field(static=True)
    status: None = None

    def __call__(
        self, scales: Scales, cosine: Float[Array, " pixels"]
    ) -> Float[Array, "channels pixels"]:
        """Radiance per irradiance (1/sr, times the picture's white) of pixels."""
        exits = _exits(cosine, self.indices, self.coefficients.shape[1] - 1)
        return self.at(Terms(self._polynomials(scales), exits))

    def _polynomials(self, scales: Scales):
        return polynomials_of(scales, self.ranges, self.degrees)

    def brdf(
        self, scales: Scales, cos_incidence: Array, cos_exit: Array, azimuth: Array
    ) -> Float[Array, "channels pixels"]:
        """BRDF (1/sr, times the picture's white) of pixels, each for a pair of directions."""
        del azimuth
        return fresnel_at(cos_incidence, *self.indices)[1] * self(scales, cos_exit)

    def hemispherical(self, scales: Scales, entering: Array) -> Float[Array, "channels pixels"]:
        """Directional–hemispherical reflectance without the first surface's mirror, 2π (1 − F) ∫ g
        μ dμ, of pixels; `entering`: 1 − F of the incidence. Where nothing varies there is one
        pixel.
        """
        x, w = (jnp.asarray(v, self.error.dtype) for v in np.polynomial.legendre.leggauss(_COSINES))
        cosine = (x + 1) / 2
        inside = refract(cosine, *self.indices)
        weight = jnp.pi * w * cosine * fresnel(cosine, inside, *self.indices)[1]
        # Linear in the polynomials of the cosine: their integrals once, not a sum over directions a
        # pixel.
        moments = (
            polynomials(_inside_to_unit(inside, *self.indices), self.coefficients.shape[1]) @ weight
        )
        one = jnp.ones_like(
            next((s for s in scales if s is not None), jnp.ones(1, self.error.dtype))
        )
        whole = jnp.tensordot(self.coefficients, moments, (1, 0))
        return entering * (whole.T @ basis(self._polynomials(scales), one))

    def shade(
        self,
        pixels: IrisPixels,
        texels: Terms,
        light: Float[Array, "tints pixels"],
    ) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        return _shaded((texels, light), self)

    def at(self, terms: Terms) -> Float[Array, "channels pixels"]:
        """Radiance per irradiance of pixels, from their polynomials."""
        return summed(self.coefficients, terms.scales, terms.angular[None])


@pixelwise
def _terms(
    pixels: IrisPixels,
    textures: Scales,
    eye: Eye,
    iris: Iris,
    ranges: Scales,
    degrees: tuple[int, ...],
    degree: int,
) -> Terms:
    n = iris.indices(eye.aqueous_index)
    return Terms(
        polynomials_of(scales_at(pixels, eye, textures), ranges, degrees),
        _exits(pixels.cosine, (n.aqueous, n.abl), degree),
    )


@pixelwise
def _shaded(
    pixels: tuple[Terms, Float[Array, "tints pixels"]], response: SeparableResponse
) -> Float[Array, "channels pixels"]:
    # Channels apart within a chunk: three numbers a pixel leave the processor's vectors half empty.
    terms, light = pixels
    return response.at(terms) * light


def _exits(cosine, indices, degree: int):
    """Polynomials of the exit cosine, times the share that leaves the tissue."""
    inside = refract(cosine, *indices)
    return (
        polynomials(_inside_to_unit(inside, *indices), degree + 1)
        * fresnel(cosine, inside, *indices)[1]
    )


def _inside_to_unit(inside, n_in, n_out):
    """The cosine within the ABL, from grazing exit to normal, on [−1, 1]: g is smooth in it, not in
    μ_o.
    """
    lowest = refract(jnp.zeros_like(inside), n_in, n_out)
    return 2 * (inside - lowest) / (1 - lowest) - 1
