"""The iris by radiative transfer: each texel's BRDF, all orders of scattering, for every light by
itself.

What depends on directions alone (`angular`) is summed over the lights once; its coefficients are
smooth functions of what texels differ in, held as `Separable` holds ILIT's.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.portions import pixelwise
from irisjax.optics.fresnel import fresnel, refract
from irisjax.render.angular import AZIMUTHS, AngularFunctions, AngularLight, light_of, mixed
from irisjax.render.bands import Bands
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.polynomials import (
    basis,
    between,
    degrees_of,
    grid,
    of_products,
    polynomials_of,
    scales_at_unit,
    summed,
)
from irisjax.render.project import IrisPixels
from irisjax.render.shading import fluxes_of, scales_at, slopes_of, textures_of
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.maps import IrisMaps, Scales, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.defaults import shipped_table
from irisjax.transport.light import Directions, Light
from irisjax.transport.process import DEPTH_RESOLVED, AbstractProcess, RadiativeTransfer
from irisjax.transport.radiative.exact import RadiativeExact
from irisjax.transport.radiative.tabulated import RadiativeTabulated
from irisjax.transport.solution import RESULTS, worst
from irisjax.transport.solver import AbstractSolver

_COSINES = 48
_OFF = 0.4, 1.9, 2.8
_PORTION = 24  # texels solved at a time


class RadiativeIntegrator(AbstractIntegrator):
    """Integrator: radiative transfer in the layers of every texel, tabulated in pigment, thickness
    and directions.

    As with `Separable` a relief tilts the surface towards the light, and directions within the
    layers are those of the iris without it.

    Attributes:
        degrees: Degrees of the polynomials in ABL pigment, stroma thickness, eumelanin and
            pheomelanin.
        angular: Degrees of those in each cosine, for the azimuthal orders 0, 1 and 2.
        solver: Solver of the texels; `None` takes the table that comes with the package, or for
            other refractive indices `RadiativeExact`.
    """

    degrees: tuple[int, int, int, int] = eqx.field(static=True, default=(6, 4, 4, 4))
    angular: tuple[int, int, int] = eqx.field(static=True, default=(4, 3, 2))
    solver: AbstractSolver | None = None

    process: AbstractProcess = eqx.field(init=False)

    def __post_init__(self):
        self.process = DEPTH_RESOLVED if self.solver is None else self.solver.process

    def __check_init__(self):
        if not isinstance(self.process, RadiativeTransfer):
            raise ValueError("the radiative integrator needs radiative transfer, not ILIT")

    def prepare(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "RadiativeIntegrator":
        """With the solver chosen, where none was: the table that comes with the package if it holds
        the indices and the layers of all texels, else `RadiativeExact`.
        """
        parts = iris, aqueous_index, bands, ranges
        table = shipped_table(iris.indices(aqueous_index)) if self.solver is None else None
        if table is not None:
            held = _holds(table, *parts)
            if not isinstance(held, Tracer) and held:
                return dataclasses.replace(self, solver=table)
        solver = RadiativeExact(16, 8) if self.solver is None else self.solver
        solver = solver.prepare(_deepest(*parts), Light(1.0))
        return dataclasses.replace(self, solver=solver)

    def texels(
        self,
        pixels: IrisPixels,
        eye: Eye,
        iris: Iris,
        maps: IrisMaps | None,
        ranges: Scales,
    ) -> tuple[Float[Array, "_ pixels"], ...]:
        """Polynomials of the scales that vary; see `AbstractIntegrator`."""
        degrees = degrees_of(ranges, self.degrees)
        return _terms(pixels, textures_of(maps, iris), eye, ranges, degrees)

    def illuminate(
        self,
        pixels: IrisPixels,
        lights: Lights,
        eye: Eye,
        iris: Iris,
        maps: IrisMaps | None,
        tables: Illumination | None,
    ) -> AngularLight:
        """Sum the lights in the functions of directions. The directions of one scene need a few
        mixtures of these functions; all of them are kept where something is traced, for
        derivatives.
        """
        angles = AngularFunctions(self.angular)
        flux = fluxes_of(lights, eye, tables)
        slopes = slopes_of(None if maps is None else maps.relief, eye)
        light = light_of(pixels, flux, lights.tint, eye, slopes, iris, angles)
        if isinstance(light, Tracer):
            return AngularLight(light)
        return AngularLight(*mixed(light, angles))

    def response(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> "RadiativeResponse":
        """Tabulate `iris` for the channels of `bands`; `ranges` from `Scales.ranges`."""
        dtype, angles = bands.weights.dtype, AngularFunctions(self.angular)
        most = degrees_of(ranges, self.degrees)
        indices = _front(iris, aqueous_index, dtype)
        inside = angles.nodes(indices, dtype)
        outside = refract(inside, *indices[::-1])
        others = jnp.asarray(np.linspace(0.2, 0.95, inside.size), dtype)
        nodes, checks = grid(most), between(most)
        # One loop over both: the solver is compiled once.
        portions = [
            (jnp.asarray(unit, dtype), cosines, _pairs_of(cosines, turns))
            for points, cosines, turns in (
                (nodes, outside, AZIMUTHS),
                (checks, others, _OFF),
            )
            for unit in _portions(points)
        ]
        radiance = self._solver_of_texels(iris, aqueous_index, bands, ranges)
        found, status = jax.lax.map(radiance, jax.tree.map(lambda *x: jnp.stack(x), *portions))
        found = found.reshape(len(portions), _PORTION, inside.size, 3, inside.size, -1)
        values = found[:-1].reshape(-1, *found.shape[2:])[: len(nodes)]
        out = RadiativeResponse(
            coefficients=_coefficients(values, angles, indices, most),
            indices=indices,
            ranges=ranges,
            error=jnp.zeros((), dtype),
            degrees=most,
            angular=self.angular,
            status=worst(status),
        )
        return dataclasses.replace(out, error=_error(out, checks, others, found[-1]))

    def coefficients(
        self, iris: Iris, aqueous_index: Scalar, bands: Bands, ranges: Scales
    ) -> tuple[Float[Array, "products functions channels"], RESULTS]:
        """Those of the response and its status, without its error: for many irides alike."""
        dtype, angles = bands.weights.dtype, AngularFunctions(self.angular)
        most = degrees_of(ranges, self.degrees)
        indices = _front(iris, aqueous_index, dtype)
        inside = angles.nodes(indices, dtype)
        outside = refract(inside, *indices[::-1])
        radiance = self._solver_of_texels(iris, aqueous_index, bands, ranges)
        unit = jnp.asarray(grid(most), dtype)
        found, status = radiance((unit, outside, _pairs_of(outside, AZIMUTHS)))
        values = found.reshape(len(unit), inside.size, 3, inside.size, -1)
        return _coefficients(values, angles, indices, most), worst(status)

    def _solver_of_texels(self, iris: Iris, aqueous_index, bands: Bands, ranges: Scales):
        """Function of places of texels within `ranges`, incidences, and exits with their azimuths:
        radiances (texels, in, out, channels), and status.
        """
        table = extinction(np.asarray(bands.wavelengths))
        solver = self.prepare(iris, aqueous_index, bands, ranges).solver
        assert solver is not None

        def radiance(one):
            unit, into, (exits, azimuths) = one

            def texel(x):
                layers = texel_layers(iris, aqueous_index, table, scales_at_unit(x, ranges))

                def each(mu):
                    found = solver.solve(layers, Light(mu, Directions(exits, azimuths)))
                    assert found.brdf is not None
                    return (bands.weights @ found.brdf).T, found.status

                return jax.vmap(each)(into)

            return jax.vmap(texel)(unit)

        return radiance


class RadiativeResponse(AbstractResponse):
    """The BRDF of every texel of an iris: coefficients of the products of scales (`texels`), of the
    functions of directions, and of the channels.

    Attributes:
        coefficients: The coefficients.
        indices: Refractive indices before and behind the surface of the iris.
        ranges: Smallest and largest value of each scale that varies.
        error: Largest difference from the solver at points off the nodes, relative to the
            brightest of them.
        status: Status of the solver.
        degrees: Degree of the polynomials of each scale that varies.
        angular: Degrees of the polynomials of the cosines.
    """

    coefficients: Float[Array, "products functions channels"]
    indices: tuple[Float[Array, ""], Float[Array, ""]]
    ranges: Scales
    error: Float[Array, ""]
    status: RESULTS
    degrees: tuple[int, ...] = eqx.field(static=True)
    angular: tuple[int, int, int] = eqx.field(static=True)

    def brdf(
        self, scales: Scales, cos_incidence: Array, cos_exit: Array, azimuth: Array
    ) -> Float[Array, "channels pixels"]:
        """BRDF (1/sr, times the picture's white) of pixels, each for a pair of directions in the
        aqueous humour; `azimuth` 0 is straight on.
        """
        angles = AngularFunctions(self.angular)
        sines = [jnp.sqrt(jnp.maximum(1 - c * c, 0.0)) for c in (cos_incidence, cos_exit)]
        across = sines[0] * sines[1] * jnp.cos(azimuth)
        light = angles.functions(cos_incidence, cos_exit, across, self.indices)
        return summed(self.coefficients, self._polynomials(scales), light[None])

    def hemispherical(
        self, scales: Scales, cos_incidence: ArrayLike
    ) -> Float[Array, "channels pixels"]:
        """Directional–hemispherical reflectance of pixels for one incidence, without the first
        surface's mirror and without light that is never scattered. Where nothing varies there is
        one pixel.
        """
        x, w = (jnp.asarray(v, self.error.dtype) for v in np.polynomial.legendre.leggauss(_COSINES))
        cosine = (x + 1) / 2
        angles = AngularFunctions(self.angular)
        into = jnp.full_like(cosine, cos_incidence)
        # Of the azimuthal orders the mean over azimuth has the first alone.
        functions = angles.functions(into, cosine, jnp.zeros_like(cosine), self.indices)
        first = angles.count(1)
        moments = functions[:first] @ (jnp.pi * w * cosine)
        whole = jnp.tensordot(self.coefficients[:, :first], moments, (1, 0))
        terms = self._polynomials(scales)
        one = terms[0][0] if terms else jnp.ones(1, self.error.dtype)
        return whole.T @ basis(terms, one)

    def _polynomials(self, scales: Scales):
        return polynomials_of(scales, self.ranges, self.degrees)

    def shade(
        self,
        pixels: IrisPixels,
        texels: tuple[Float[Array, "_ pixels"], ...],
        light: AngularLight,
    ) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        return _shaded((texels, light.light), self.coefficients, light.mixtures)


@pixelwise
def _terms(
    pixels: IrisPixels, textures: Scales, eye: Eye, ranges: Scales, degrees: tuple[int, ...]
) -> tuple[Float[Array, "_ pixels"], ...]:
    return polynomials_of(scales_at(pixels, eye, textures), ranges, degrees)


@pixelwise
def _shaded(
    pixels: tuple[tuple[Float[Array, "_ pixels"], ...], Float[Array, "tints parts pixels"]],
    coefficients: Float[Array, "products functions channels"],
    mixtures: Float[Array, "functions mixtures"] | None,
) -> Float[Array, "channels pixels"]:
    terms, light = pixels
    if mixtures is not None:
        coefficients = jnp.einsum("pkc,kr->prc", coefficients, mixtures)
    return summed(coefficients, terms, light)


def _front(iris: Iris, aqueous_index, dtype):
    """Indices before and behind the iris's surface."""
    n = iris.indices(aqueous_index)
    return jnp.asarray(n.aqueous, dtype), jnp.asarray(n.abl, dtype)


def _coefficients(values, angles: AngularFunctions, indices, most: tuple[int, ...]):
    """Of the products of scales and the functions of directions, from radiances at the nodes
    (texels, in, azimuths, out, channels).
    """
    inside = angles.nodes(indices, values.dtype)
    passed = fresnel(refract(inside, *indices[::-1]), inside, *indices)[1]
    values = values / (passed[:, None, None, None] * passed[:, None])
    return of_products(angles.coefficients(values, inside), most)


def _deepest(iris: Iris, aqueous_index, bands: Bands, ranges: Scales) -> Layers:
    """Layers of the texel that has most of everything."""
    most = Scales(*(None if r is None else r[1] for r in ranges))
    return texel_layers(iris, aqueous_index, extinction(np.asarray(bands.wavelengths)), most)


@eqx.filter_jit
def _holds(table: RadiativeTabulated, iris: Iris, aqueous_index, bands: Bands, ranges: Scales):
    return table.holds(_deepest(iris, aqueous_index, bands, ranges))


def _portions(points: np.ndarray) -> list[np.ndarray]:
    """Points in equal portions, the last one filled up."""
    padded = np.pad(points, ((0, -len(points) % _PORTION), (0, 0)), mode="edge")
    return np.split(padded, len(padded) // _PORTION)


def _pairs_of(cosines, azimuths):
    """Each azimuth with each of some exits."""
    turns = jnp.asarray(azimuths, cosines.dtype)
    return jnp.tile(cosines, len(azimuths)), jnp.repeat(turns, cosines.size)


def _error(response: RadiativeResponse, checks: np.ndarray, cosines, true):
    """Largest difference from the solver off the nodes, relative to the brightest of them."""
    dtype, n = response.error.dtype, cosines.size
    exits, azimuths = _pairs_of(cosines, _OFF)
    into = jnp.repeat(cosines, exits.size)
    pairs = [jnp.tile(x, len(checks)) for x in (into, jnp.tile(exits, n), jnp.tile(azimuths, n))]
    unit = jnp.repeat(jnp.asarray(checks, dtype), into.size, 0)
    found = response.brdf(scales_at_unit(unit, response.ranges), *pairs).T
    true = true[: len(checks)].reshape(found.shape)
    return jnp.abs(found - true).max() / jnp.abs(true).max()
