"""The iris seen by ILIT: each texel's exact response, all orders of scattering, at the price of a polynomial.

ILIT's BRDF is separable: f(μ_i, μ_o, λ) = (1 − F(μ_i)) g(μ_o, λ). Texels differ in two numbers, the pigment of
their ABL and the thickness of their stroma, both relative to the iris's: g is a smooth function of these two and
of μ_o, which a product of Chebyshev polynomials holds. Its error is measured off the nodes with every table.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.optics.fresnel import fresnel, refract
from irisjax.render.bands import Bands
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.exact import Exact
from irisjax.transport.process import ILIT_2006, Process
from irisjax.transport.solver import AbstractSolver

_CHECKS = 24


class Ranges(NamedTuple):
    """Smallest and largest relative ABL pigment and stroma thickness in the maps; `None`: it is 1 everywhere."""

    abl: tuple[float, float] | None
    stroma: tuple[float, float] | None

    @classmethod
    def of(cls, abl_scale, stroma_scale) -> "Ranges":
        """Ranges of concrete textures, a little widened."""

        def around(scale):
            if scale is None:
                return None
            low, high = float(np.min(scale)), float(np.max(scale))
            return (low * 0.95, high * 1.05 + 1e-3)

        return cls(around(abl_scale), around(stroma_scale))


class Separable(eqx.Module):
    """Integrator: ILIT's separable response, tabulated in pigment and thickness  [LB06; `ilit.md` Section 4].

    - `degrees`: of the polynomials in ABL pigment, stroma thickness and exit cosine.
    - `solver`: of the texels; any whole-layer process.
    """

    process: Process = eqx.field(static=True, default=ILIT_2006)
    degrees: tuple[int, int, int] = eqx.field(static=True, default=(10, 5, 3))
    solver: AbstractSolver = eqx.field(default_factory=lambda: Exact(20))

    def __check_init__(self):
        if self.process.depth_resolved:
            raise ValueError("the separable integrator needs a whole-layer process, not a depth-resolved one")

    def response(self, iris: Iris, bands: Bands, ranges: Ranges) -> "Response":
        """Tabulate `iris` for the channels of `bands`."""
        dtype = bands.weights.dtype
        shape = [n + 1 if r is not None else 1 for n, r in zip(self.degrees[:2], ranges, strict=True)]
        nodes = [np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in (*shape, self.degrees[2] + 1)]
        abl, stroma = (_from_unit(r, jnp.asarray(x, dtype)) for r, x in zip(ranges, nodes[:2], strict=True))
        table = extinction(np.asarray(bands.wavelengths))

        def radiance(abl, stroma, cosines):  # (texels,), (texels,), (exits,) to (texels, exits, channels)
            def one(abl, stroma):
                layers = scaled(iris.layers(table, self.process.scattering), abl, stroma)
                found = self.solver.solve(layers, self.process, 1.0, cos_exit=cosines)
                assert found.brdf is not None
                return bands.weights @ (found.brdf / (1 - found.mirrored[:, None]))

            return jnp.moveaxis(jax.vmap(one)(abl, stroma), 1, 2)

        grid = jnp.meshgrid(abl, stroma, indexing="ij")
        n = iris.indices()
        indices = (jnp.asarray(n.aqueous, dtype), jnp.asarray(n.abl, dtype))
        lowest = refract(jnp.zeros((), dtype), *indices)
        inside = lowest + (1 - lowest) * jnp.asarray((nodes[2] + 1) / 2, dtype)
        cosines = refract(inside, *indices[::-1])
        values = radiance(grid[0].ravel(), grid[1].ravel(), cosines).reshape(*shape, cosines.size, -1)
        values = values / fresnel(cosines, inside, *indices)[1][:, None]
        for axis, x in enumerate(nodes):
            inverse = jnp.asarray(np.linalg.inv(np.polynomial.chebyshev.chebvander(x, x.size - 1)), dtype)
            values = jnp.moveaxis(jnp.tensordot(inverse, values, (1, axis)), 0, axis)
        out = Response(values, indices, ranges, jnp.zeros((), dtype))
        # Off the nodes: points that fill the box evenly, one exit angle each in turn.
        i = np.arange(_CHECKS)
        at = [
            _from_unit(r, jnp.asarray(2 * ((i + 0.5) * a % 1) - 1, dtype))
            for r, a in zip(ranges, (0.755, 0.57), strict=True)
        ]
        exits = jnp.asarray([0.15, 0.6, 0.95], dtype)
        true = radiance(jnp.broadcast_to(at[0], (_CHECKS,)), jnp.broadcast_to(at[1], (_CHECKS,)), exits)
        spread = jnp.broadcast_to(exits, (_CHECKS, 3))
        scales = [jnp.broadcast_to(a[:, None], spread.shape).ravel() for a in at]
        found = out(scales[0], scales[1], spread.ravel())
        error = jnp.abs(found.T.reshape(true.shape) - true).max() / jnp.abs(true).max()
        return Response(values, indices, ranges, error)


class Response(eqx.Module):
    """g of every texel of an iris: Chebyshev coefficients of shape (abl, stroma, cosine, channels).

    - `error`: largest difference from the solver at points off the nodes, relative to the brightest of them.
    """

    coefficients: Float[Array, "abl stroma cosines channels"]
    indices: tuple[Float[Array, ""], Float[Array, ""]]
    ranges: Ranges = eqx.field(static=True)
    error: Float[Array, ""]

    def __call__(self, abl_scale, stroma_scale, cosine: Float[Array, " pixels"]) -> Float[Array, "channels pixels"]:
        """Radiance per irradiance (1/sr, times the picture's white) of pixels; scales may be `None`."""
        c = self.coefficients
        n_in, n_out = self.indices
        inside = refract(cosine, n_in, n_out)
        basis = _polynomials(_inside_to_unit(inside, n_in, n_out), c.shape[2])
        for scale, span, n in (
            (stroma_scale, self.ranges.stroma, c.shape[1]),
            (abl_scale, self.ranges.abl, c.shape[0]),
        ):
            if span is not None:
                more = _polynomials(_to_unit(span, scale), n)
                basis = (more[:, None] * basis).reshape(-1, cosine.size)
        return (c.reshape(-1, c.shape[3]).T @ basis) * fresnel(cosine, inside, n_in, n_out)[1]


def scaled(layers: Layers, abl, stroma) -> Layers:
    """Layers with `abl` times the pigment of the ABL and `stroma` times the thickness of the stroma."""
    return Layers(
        layers.abl_absorption * abl,
        layers.stroma_absorption * stroma,
        layers.stroma_scattering * stroma,
        layers.indices,
        layers.order,
    )


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
    if span is None:
        return jnp.ones(1, x.dtype)
    low, high = (float(np.log1p(_BEND * s)) for s in span)
    return jnp.expm1(low + (x + 1) * ((high - low) / 2)) / _BEND


def _to_unit(span, scale):
    low, high = (float(np.log1p(_BEND * s)) for s in span)
    return jnp.clip((jnp.log1p(_BEND * scale) - low) * (2 / (high - low)) - 1, -1, 1)
