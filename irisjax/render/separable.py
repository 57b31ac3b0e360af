"""The iris seen by ILIT: each texel's exact response, all orders of scattering, at the price of a polynomial.

ILIT's BRDF is separable: f(μ_i, μ_o, λ) = (1 − F(μ_i)) g(μ_o, λ). Texels differ in a few numbers, the pigment of
their ABL, the thickness of their stroma, perhaps their concentrations: g is a smooth function of these and of
μ_o, which products of Chebyshev polynomials hold; those of high degree in several numbers at once hold nothing
and are left out. The error is measured off the nodes with every table.
"""

import dataclasses
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
from irisjax.render.memory import Memory
from irisjax.render.shading import Texels, field_of, irradiance_at, scales_at
from irisjax.tissue.anatomy import Eye
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.maps import IrisMaps, Scales
from irisjax.tissue.pigments import Extinction, extinction
from irisjax.transport.exact import Exact
from irisjax.transport.process import ILIT_2006, Process
from irisjax.transport.solver import AbstractSolver

_CHECKS = 24
_DEGREE = 1.2  # of a product, each factor's relative to the most of its number: a third of all stay, error +1e-4


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
        memory: Memory,
    ) -> tuple[Texels, None]:
        """See `AbstractIntegrator`: the lights are summed, for the response does not ask where light comes from."""
        field = memory.once("field", field_of, lights, eye, iris, tables)
        relief = None if maps is None else maps.relief
        light = memory.once("irradiance", irradiance_at, pixels, field, eye, relief)
        return Texels(pixels.index, scales_at(pixels, eye, iris, maps, memory), pixels.cosine, light), None

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
        most = tuple(self.degrees[i] for i in varied)
        kept = [term for terms in _products(most) for term in terms]
        picked = values[tuple(np.array(kept, int).reshape(len(kept), len(most)).T)]
        values = picked.reshape(len(kept), *values.shape[-2:])
        out = Response(coefficients=values, indices=indices, ranges=ranges, error=jnp.zeros((), dtype), degrees=most)
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
        return dataclasses.replace(out, error=error)


class Response(AbstractResponse):
    """g of every texel of an iris: Chebyshev coefficients of products over the scales that vary, (products, degrees of
    the cosine, channels).

    - `error`: largest difference from the solver at points off the nodes, relative to the brightest of them.
    - `degrees`: the most of each scale that varies.
    """

    coefficients: Float[Array, "products cosine channels"]
    indices: tuple[Float[Array, ""], Float[Array, ""]]
    ranges: Scales
    error: Float[Array, ""]
    degrees: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, scales: Scales, cosine: Float[Array, " pixels"]) -> Float[Array, "channels pixels"]:
        """Radiance per irradiance (1/sr, times the picture's white) of pixels."""
        inside = refract(cosine, *self.indices)
        places = [_to_unit(r, s) for s, r in zip(scales, self.ranges, strict=True) if r is not None]
        each = [_polynomials(place, most + 1) for place, most in zip(places, self.degrees, strict=True)]
        products = []
        for terms in _products(self.degrees):
            rest = [t[k] for t, k in zip(each[1:], terms[0][1:], strict=True)]
            first = each[0][: len(terms)] if each else jnp.ones_like(cosine)[None]
            products.append(first * functools.reduce(jnp.multiply, rest) if rest else first)
        _, last, channels = self.coefficients.shape
        # One matrix product: 50 times as fast as polynomial by polynomial.
        values = self.coefficients.reshape(-1, last * channels).T @ jnp.concatenate(products)
        angular = _polynomials(_inside_to_unit(inside, *self.indices), last)
        values = (values.reshape(last, channels, -1) * angular[:, None]).sum(axis=0)
        return values * fresnel(cosine, inside, *self.indices)[1]

    def shade(self, texels: Texels, ground: None) -> Float[Array, "channels pixels"]:
        """See `AbstractResponse`."""
        del ground
        return self(texels.scales, texels.cosine) * texels.light


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


def _products(degrees: tuple[int, ...]) -> list[list[tuple[int, ...]]]:
    """Degrees of the factors of all products that are kept, in runs over the first factor."""
    runs = []
    for rest in itertools.product(*(range(d + 1) for d in degrees[1:])):
        left = _DEGREE - sum(k / d for k, d in zip(rest, degrees[1:], strict=True))
        if left > -1e-9:
            most = min(degrees[0], int(left * degrees[0] + 1e-9)) if degrees else 0
            runs.append([(k, *rest)[: len(degrees)] for k in range(most + 1)])
    return runs


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


# The response changes fast where a layer is thin and tends to that of an opaque one.
_BEND = 2.0


def _from_unit(span, x):
    low, high = (s / (s + _BEND) for s in span)
    bent = low + (x + 1) * ((high - low) / 2)
    return _BEND * bent / (1 - bent)


def _to_unit(span, scale):
    low, high = (s / (s + _BEND) for s in span)
    return jnp.clip((scale / (scale + _BEND) - low) * (2 / (high - low)) - 1, -1, 1)
