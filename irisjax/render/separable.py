"""The iris seen by ILIT: each texel's exact response, all orders of scattering, at the price of a polynomial.

ILIT's BRDF is separable: f(μ_i, μ_o, λ) = (1 − F(μ_i)) g(μ_o, λ). Texels differ in a few numbers, the pigment of
their ABL, the thickness of their stroma, perhaps their concentrations: g is a smooth function of these and of
μ_o, which a product of Chebyshev polynomials holds. Its error is measured off the nodes with every table.
"""

import functools
import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.optics.fresnel import fresnel, refract
from irisjax.render.bands import Bands
from irisjax.render.camera import IrisPixels
from irisjax.render.illumination import Illumination
from irisjax.render.integrator import AbstractIntegrator, AbstractResponse
from irisjax.render.lights import Lights
from irisjax.render.shading import Texels, field_of, texels_of
from irisjax.tissue.anatomy import Eye
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.maps import IrisMaps, Scales
from irisjax.tissue.pigments import Extinction, extinction
from irisjax.transport.exact import Exact
from irisjax.transport.process import ILIT_2006, Process
from irisjax.transport.solver import AbstractSolver

_CHECKS = 24
_COSINES = 48


class Separable(AbstractIntegrator):
    """Integrator: ILIT's separable response, tabulated in pigment and thickness  [LB06; `ilit.md` Section 4].

    - `degrees`: of the polynomials in ABL pigment, stroma thickness, eumelanin, pheomelanin and exit cosine.
    - `solver`: of the texels; any whole-layer process.
    """

    process: Process = eqx.field(static=True, default=ILIT_2006)
    degrees: tuple[int, int, int, int, int] = eqx.field(static=True, default=(10, 5, 4, 4, 3))
    solver: AbstractSolver = eqx.field(default_factory=lambda: Exact(20))

    def __check_init__(self):
        if self.process.depth_resolved:
            raise ValueError("the separable integrator needs a whole-layer process, not a depth-resolved one")

    def place(
        self,
        pixels: IrisPixels,
        lights: Lights,
        eye: Eye,
        iris: Iris,
        maps: IrisMaps | None,
        tables: Illumination | None,
    ) -> tuple[Texels, None]:
        """See `AbstractIntegrator`: the lights are summed, for the response does not ask where light comes from."""
        return texels_of(pixels, field_of(lights, eye, iris, tables), eye, iris, maps), None

    def response(self, iris: Iris, bands: Bands, ranges: Scales) -> "Response":
        """Tabulate `iris` for the channels of `bands`; `ranges` from `Scales.ranges`."""
        dtype = bands.weights.dtype
        varied = [i for i, r in enumerate(ranges) if r is not None]
        nodes = [_chebyshev(self.degrees[i] + 1) for i in (*varied, 4)]
        n = iris.indices()
        indices = (jnp.asarray(n.aqueous, dtype), jnp.asarray(n.abl, dtype))
        lowest = refract(jnp.zeros((), dtype), *indices)
        inside = lowest + (1 - lowest) * jnp.asarray((nodes[-1] + 1) / 2, dtype)
        cosines = refract(inside, *indices[::-1])
        table = extinction(np.asarray(bands.wavelengths))

        def radiance(unit, cosines):  # (texels, varied) on [−1, 1], (exits,) to (texels, exits, channels)
            def one(x):
                scales: list[Any] = [None] * 4
                for k, i in enumerate(varied):
                    scales[i] = _from_unit(ranges[i], x[k])
                layers = texel_layers(iris, table, Scales(*scales), self.process)
                found = self.solver.solve(layers, self.process, 1.0, cos_exit=cosines)
                assert found.brdf is not None
                return bands.weights @ (found.brdf / (1 - found.mirrored[:, None]))

            return jnp.moveaxis(jax.vmap(one)(unit), 1, 2)

        grid = np.array(list(itertools.product(*nodes[:-1])))  # a uniform iris: one texel of no coordinates
        values = radiance(jnp.asarray(grid, dtype), cosines) / fresnel(cosines, inside, *indices)[1][:, None]
        values = values.reshape(*(x.size for x in nodes), -1)
        for axis, x in enumerate(nodes):
            inverse = jnp.asarray(np.linalg.inv(np.polynomial.chebyshev.chebvander(x, x.size - 1)), dtype)
            values = jnp.moveaxis(jnp.tensordot(inverse, values, (1, axis)), 0, axis)
        out = Response(coefficients=values, indices=indices, ranges=ranges, error=jnp.zeros((), dtype))
        # Off the nodes: points that fill the box evenly.
        steps = np.asarray([0.7548, 0.5698, 0.8192, 0.3249])[: len(varied)]
        unit = jnp.asarray(2 * ((np.arange(_CHECKS)[:, None] + 0.5) * steps % 1) - 1, dtype)
        exits = jnp.asarray([0.15, 0.6, 0.95], dtype)
        true = radiance(unit, exits)
        scales: list[Any] = [None] * 4
        for k, i in enumerate(varied):
            scales[i] = jnp.repeat(_from_unit(ranges[i], unit[:, k]), 3)
        found = out(Scales(*scales), jnp.tile(exits, _CHECKS)).T.reshape(true.shape)
        error = jnp.abs(found - true).max() / jnp.abs(true).max()
        return Response(coefficients=values, indices=indices, ranges=ranges, error=error)


class Response(AbstractResponse):
    """g of every texel of an iris: Chebyshev coefficients, one axis for each scale that varies, then the cosine, then
    the channels.

    - `error`: largest difference from the solver at points off the nodes, relative to the brightest of them.
    """

    coefficients: Float[Array, "..."]
    indices: tuple[Float[Array, ""], Float[Array, ""]]
    ranges: Scales
    error: Float[Array, ""]

    def __call__(self, scales: Scales, cosine: Float[Array, " pixels"]) -> Float[Array, "channels pixels"]:
        """Radiance per irradiance (1/sr, times the picture's white) of pixels."""
        inside = refract(cosine, *self.indices)
        places = [_to_unit(r, s) for s, r in zip(scales, self.ranges, strict=True) if r is not None]
        places.append(_inside_to_unit(inside, *self.indices))
        return _evaluated(self.coefficients, places) * fresnel(cosine, inside, *self.indices)[1]

    def hemispherical(self, scales: Scales) -> Float[Array, "channels pixels"]:
        """Flux into the whole hemisphere per irradiance that entered the tissue, 2π ∫ g μ dμ, of pixels.

        Times 1 − F of the incidence it is the directional–hemispherical reflectance without the first surface's
        mirror. Where nothing varies there is one pixel.
        """
        x, w = (jnp.asarray(v, self.error.dtype) for v in np.polynomial.legendre.leggauss(_COSINES))
        cosine = (x + 1) / 2
        inside = refract(cosine, *self.indices)
        weight = jnp.pi * w * cosine * fresnel(cosine, inside, *self.indices)[1]
        # Linear in the polynomials of the cosine: their integrals once, not a sum over directions a pixel.
        moments = _polynomials(_inside_to_unit(inside, *self.indices), self.coefficients.shape[-2]) @ weight
        places = [_to_unit(r, s) for s, r in zip(scales, self.ranges, strict=True) if r is not None]
        whole = jnp.tensordot(self.coefficients, moments, (-2, 0))
        return _evaluated(whole, places) if places else whole[:, None]

    def shade(self, texels: Texels, ground: None) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        del ground
        return self(texels.scales, texels.cosine) * texels.light


def _evaluated(coefficients: Float[Array, "..."], places: list[Float[Array, " pixels"]]):
    """A product of Chebyshev polynomials, one axis for each of `places`, then the channels: (channels, pixels).

    One axis after the other, the first as a matrix product: 50 times as fast as products of all polynomials.
    """
    first, *rest = coefficients.shape[:-1]
    values = coefficients.reshape(first, -1).T @ _polynomials(places[0], first)
    for place, n in zip(places[1:], rest, strict=True):
        values = values.reshape(n, -1, place.size)
        terms = [t * v for t, v in zip(_polynomials(place, n), values, strict=True)]
        values = functools.reduce(jnp.add, terms)
    return values


def texel_layers(iris: Iris, table: Extinction, scales: Scales, process: Process) -> Layers:
    """Layers of a texel, its scales numbers or `None`."""
    if scales.eumelanin is not None:
        iris = eqx.tree_at(lambda i: i.eumelanin, iris, iris.eumelanin * scales.eumelanin)
    if scales.pheomelanin is not None:
        iris = eqx.tree_at(lambda i: i.pheomelanin, iris, iris.pheomelanin * scales.pheomelanin)
    layers = iris.layers(table, process.scattering)
    abl = 1.0 if scales.abl is None else scales.abl
    stroma = 1.0 if scales.stroma is None else scales.stroma
    return Layers(
        layers.abl_absorption * abl,
        layers.stroma_absorption * stroma,
        layers.stroma_scattering * stroma,
        layers.indices,
        layers.order,
    )


def _chebyshev(n: int) -> np.ndarray:
    return np.cos(np.pi * (np.arange(n) + 0.5) / n)


def _polynomials(x: Float[Array, " pixels"], count: int) -> Float[Array, "count pixels"]:
    """T₀ … of x in [−1, 1]."""
    t = [jnp.ones_like(x), x]
    while len(t) < count:
        t.append(2 * x * t[-1] - t[-2])
    return jnp.stack(t[:count])


def _inside_to_unit(inside, n_in, n_out):
    """The cosine within the ABL, from grazing exit to normal, on [−1, 1]: g is smooth in it, not in μ_o."""
    lowest = refract(jnp.zeros_like(inside), n_in, n_out)
    return 2 * (inside - lowest) / (1 - lowest) - 1


# The response changes fast where a layer is thin: equal steps in the logarithm of one plus a few times the scale.
_BEND = 3.0


def _from_unit(span, x):
    low, high = (jnp.log1p(_BEND * s) for s in span)
    return jnp.expm1(low + (x + 1) * ((high - low) / 2)) / _BEND


def _to_unit(span, scale):
    low, high = (jnp.log1p(_BEND * s) for s in span)
    return jnp.clip((jnp.log1p(_BEND * scale) - low) * (2 / (high - low)) - 1, -1, 1)
