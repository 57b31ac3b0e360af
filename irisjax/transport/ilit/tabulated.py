"""Tabulated solver: the layer functions of one set of indices, computed once by `IlitExact`, then
looked up.

With fixed indices ILIT's ABL is a function of one number, its optical depth, and the stroma of two,
optical depth and albedo. Piecewise polynomials of degree 5 in ln(1 + τ/τ₀) and Chebyshev
polynomials in the albedo hold them over every depth and albedo there is; the error is measured at
points the tables were not made from, and reported.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import PRNGKey
from irisjax.numerics.interpolation import chebyshev_nodes
from irisjax.numerics.piecewise import piecewise
from irisjax.numerics.precision import full_precision
from irisjax.numerics.sharding import call_with_layout
from irisjax.numerics.tucker import coefficients
from irisjax.tissue.indices import Order, RefractiveIndices
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.transport.ilit.exact import combine
from irisjax.transport.ilit.layers import LayerFates, abl_responses, stroma_response
from irisjax.transport.light import Light
from irisjax.transport.process import ILIT_2006, AbstractProcess, Ilit
from irisjax.transport.solution import RESULTS, Solution
from irisjax.transport.solver import AbstractSolver, check_layers

_DEGREE = 5
_SMALLEST = 1e-7  # τ₀: below it the functions, which go as τ ln τ, are straight lines to 2e-12
_LARGEST = 40.0  # exp(−40) is below rounding: deeper layers are all alike


class IlitTabulated(AbstractSolver):
    """Solver for many spectra of irides that share their refractive indices and process.

    Make one with `IlitTabulated.build`. The tables hold for all optical depths and albedos; an iris
    with other indices gives the status `outside_table`. Gradients flow to depths and pigments, not
    to indices.

    Attributes:
        error: Largest absolute error of a layer function found at build time, off the nodes.
    """

    abl: Float[Array, "intervals powers 4"]
    stroma: Float[Array, "intervals powers albedos 2"]
    indices: RefractiveIndices
    process: Ilit = eqx.field(kw_only=True)
    error: float = eqx.field(static=True)

    @classmethod
    def build(
        cls,
        indices: RefractiveIndices | None = None,
        process: AbstractProcess = ILIT_2006,
        *,
        tolerance: float = 1e-11,
        n_intervals: int = 256,
        n_albedos: int = 7,
    ) -> "IlitTabulated":
        """Compute the tables and check them at other points.

        Args:
            indices: Refractive indices, such as `iris.indices()`; LB06's by default.
            process: The process, an `Ilit`.
            tolerance: Largest absolute error of a layer function; at least 1e-6 in float32.
            n_intervals: Intervals in optical depth.
            n_albedos: Chebyshev nodes in albedo.

        Raises:
            ValueError: If the process is depth-resolved, or the error exceeds `tolerance`.
        """
        if not isinstance(process, Ilit):
            raise ValueError(f"IlitTabulated treats Ilit processes, not {type(process).__name__}")
        indices = Iris().indices() if indices is None else indices
        order = indices.order()
        dtype = jnp.result_type(float)
        tolerance = max(tolerance, 32 * float(jnp.finfo(dtype).eps))
        local = chebyshev_nodes(_DEGREE + 1)
        albedo_nodes = chebyshev_nodes(n_albedos)
        to_local = np.linalg.inv(np.polynomial.polynomial.polyvander(local, _DEGREE))
        to_albedo = coefficients(n_albedos)
        depths = _depth((np.arange(n_intervals)[:, None] + (local + 1) / 2) / n_intervals)

        albedos = jnp.asarray((albedo_nodes + 1) / 2, dtype)
        abl, stroma = _nodes(jnp.asarray(depths.ravel(), dtype), albedos, indices, order, process)
        abl = np.asarray(abl, np.float64).reshape(n_intervals, _DEGREE + 1, -1)
        stroma = np.asarray(stroma, np.float64).reshape(n_albedos, n_intervals, _DEGREE + 1, -1)
        abl_table = np.einsum("ij,pjf->pif", to_local, abl)
        stroma_table = np.einsum("ij,ab,bpjf->piaf", to_local, to_albedo, stroma)
        abl_table, stroma_table = (jnp.asarray(x, dtype) for x in (abl_table, stroma_table))
        error = cls(abl_table, stroma_table, indices, 0.0, process=process)._measure(order)
        if error > tolerance:
            raise ValueError(
                f"the layer functions are tabulated to {error:.1e} only, not to {tolerance:.1e}; "
                "use IlitExact, or a larger tolerance, n_intervals or n_albedos"
            )
        return cls(abl_table, stroma_table, indices, error, process=process)

    @full_precision
    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        check_layers(self, layers, black=True)
        fates = call_with_layout(
            IlitTabulated._responses,
            layers.extinction,
            *(self, layers.abl_absorption, layers.extinction, layers.albedo),
        )
        check = (self.indices.same(layers.indices), RESULTS.outside_table)
        return combine(layers, light, self.process, fates, check)

    def _responses(self, abl, depth, albedo) -> tuple[LayerFates, LayerFates, LayerFates]:
        """Responses of the ABL to light from above and from below, and of the stroma."""
        interval, x = self._locate(depth)
        up, down, out, back = piecewise(self.abl, *self._locate(abl), None)
        reflected, passed = piecewise(self.stroma, interval, x, 2 * albedo - 1)
        shares = (up, down), (back, out), (reflected, passed)
        above, below, stroma = (LayerFates(a, b, 1 - a - b) for a, b in shares)
        return above, below, stroma

    def _locate(self, depth):
        n = self.abl.shape[0]
        scale = n / np.log1p(_LARGEST / _SMALLEST)
        position = jnp.log1p(jnp.minimum(depth, _LARGEST) / _SMALLEST) * scale
        interval = jnp.clip(jax.lax.stop_gradient(position).astype(jnp.int32), 0, n - 1)
        return interval, 2 * (position - interval.astype(position.dtype)) - 1

    def _measure(self, order: Order) -> float:
        """Largest error of the layer functions between the nodes, against a finer quadrature."""
        n = self.abl.shape[0]
        rng = np.random.default_rng(0)
        # The functions are least smooth beside zero depth: look there closely, and at zero itself.
        inside = (np.arange(n) + rng.random(n)) / n
        depth = np.r_[0.0, _depth(np.geomspace(1e-6, 1, 32) / n), _depth(inside), 2 * _LARGEST]
        depth = jnp.asarray(depth, self.abl.dtype)
        albedos = jnp.asarray([0.0, 0.23, 0.71, 0.97, 1.0], self.abl.dtype)
        return float(_largest_error(self, depth, albedos, order))


@eqx.filter_jit
@full_precision
def _nodes(depth, albedos, indices: RefractiveIndices, order: Order, process: Ilit):
    """Responses of the ABL (depths, 4), and of the stroma at each albedo (albedos, depths, 2)."""

    def responses(albedo):
        return _responses(depth, jnp.full_like(depth, albedo), indices, order, process)

    abl, _ = responses(jnp.zeros_like(albedos[0]))
    return abl, jax.lax.map(lambda albedo: responses(albedo)[1], albedos)


@eqx.filter_jit
def _largest_error(tables: IlitTabulated, depth, albedos, order: Order):
    def error(albedo):
        constant = jnp.full_like(depth, albedo)
        exact = _responses(depth, constant, tables.indices, order, tables.process, 64)
        stored = _as_stored(*tables._responses(depth, depth, constant))
        return jnp.stack([jnp.abs(f - e).max() for f, e in zip(stored, exact, strict=True)]).max()

    return jax.lax.map(error, albedos).max()


def _depth(fraction):
    """Optical depth at a fraction of the tables' axis."""
    return _SMALLEST * np.expm1(fraction * np.log1p(_LARGEST / _SMALLEST))


def _responses(
    depth, albedo, indices: RefractiveIndices, order: Order, process: Ilit, n_angles: int = 48
):
    abl = abl_responses(depth, indices, order, process, n_angles)
    layers = Layers(jnp.zeros_like(depth), depth * (1 - albedo), depth * albedo, indices, order)
    return _as_stored(*abl, stroma_response(layers, process, n_angles)[0])


def _as_stored(above: LayerFates, below: LayerFates, stroma: LayerFates):
    abl = jnp.stack([above.reflected, above.passed, below.passed, below.reflected], -1)
    return abl, jnp.stack([stroma.reflected, stroma.passed], -1)
