"""The table of radiative transfer that comes with the package: LB06's indices, Rayleigh's law.

Writes irisjax/transport/radiative/tables/radiative.npz (made in double precision and
rounded to single; its error is measured in both).
"""

import dataclasses
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

import irisjax as ij
from irisjax.numerics import linear
from irisjax.numerics.chunks import map_rows
from irisjax.numerics.interpolation import chebyshev_nodes
from irisjax.numerics.tucker import Tucker, coefficients
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.radiative import orders
from irisjax.transport.radiative.directions import (
    MODES,
    Absorber,
    Mode,
    Ordinates,
    abl_shares,
    boundaries,
    from_outside,
    quadrature_nodes,
)
from irisjax.transport.radiative.orders import ScatteredFates, angular_profile, collided_share
from irisjax.transport.radiative.slab import Bounded, Slab
from irisjax.transport.radiative.tabulated import (
    DEEPEST,
    DEEPEST_ABL,
    KNEE,
    RadiativeTabulated,
    knee_of_coalbedo,
)

NODES = 24, 40, 12, 8
"""Nodes along τ_A, τ, 1 − ω and the cosine."""
BRDF_NODES = 12, 24, 8, 6, 6
"""The same along τ_A, τ, 1 − ω and the cosines in and out."""
LEFT_OUT = 1e-6, 4e-6, 1e-5
"""Shares of the weights of reflectance, of other fates and of BRDFs that compression leaves out."""
ANGLES = 32
"""Angles of the exact solution at the nodes."""
THIN = 3.0, (8, 3), (8, 5)
"""Depth up to which the first polynomials and panels do, else the others."""
CHECKS, CHUNK = 4, 1024
"""Chunks of points off the nodes, and points that a program takes at once."""


def main() -> None:
    """Make the table again; nothing in it is random."""
    with jax.enable_x64(True):
        table = build(ij.Iris().indices())
    with jax.enable_x64(False):
        single = measured_error(jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), table))
    arrays = {}
    for name in ("out", "ends", "multiple"):
        part = getattr(table, name)
        # Rounding is a hundredth of the error.
        arrays[f"{name}_core"] = np.asarray(part.core, np.float32)
        arrays |= {f"{name}_{i}": np.asarray(x, np.float32) for i, x in enumerate(part.factors)}
    path = Path(ij.__file__).parent / "transport" / "radiative" / "tables" / "radiative.npz"
    np.savez_compressed(
        path,
        indices=[float(n) for n in jax.tree.leaves(table.indices)],
        error_float64=table.error,
        error_float32=single,
        **arrays,
    )
    print(f"relative errors: {table.error:.1e}, in single precision {single:.1e}")


def build(indices: RefractiveIndices | None = None) -> RadiativeTabulated:
    """Tabulate for some refractive indices (default: LB06's) and measure the table's error."""
    indices = Iris().indices() if indices is None else indices
    fates, dtype = _table(indices), jnp.result_type(float)
    # `out` by itself: who wants no more pays for no more.
    each = fates[..., :1], fates[..., 1:], _brdf_table(indices)
    out, ends, multiple = (
        compressed(x, left, dtype) for x, left in zip(each, LEFT_OUT, strict=True)
    )
    table = RadiativeTabulated(out, ends, multiple, indices, 0.0)
    return dataclasses.replace(table, error=measured_error(table))


def compressed(values: np.ndarray, tolerance: float, dtype: DTypeLike) -> Tucker:
    """Compress values at `chebyshev_nodes` of every axis, shape (nodes of each …, functions).

    Each function is scaled by its largest value for the choice of ranks; what is left out of an
    axis is below `tolerance` in the mean square.
    """
    values = np.asarray(values, np.float64)
    *shape, _ = values.shape
    largest = np.abs(values).reshape(-1, values.shape[-1]).max(axis=0)
    scaled = values / np.where(largest > 0, largest, 1.0)
    for axis, nodes in enumerate(shape):
        scaled = _apply_along(scaled, axis, coefficients(nodes))
    factors, core = [], scaled
    size = np.sqrt(np.sum(scaled**2))
    for axis in range(len(shape)):
        unfolded = np.moveaxis(scaled, axis, 0).reshape(shape[axis], -1)
        left, weights, _ = np.linalg.svd(unfolded, full_matrices=False)
        tail = np.sqrt(np.cumsum(weights[::-1] ** 2)[::-1])
        rank = max(1, int((tail > tolerance * size).sum()))
        factors.append(left[:, :rank])
        core = _apply_along(core, axis, left[:, :rank].T)
    core = core * largest
    return Tucker(tuple(jnp.asarray(f, dtype) for f in factors), jnp.asarray(core, dtype))


def grid_points(axes: Sequence[np.ndarray]) -> np.ndarray:
    """All combinations of the axes' nodes, shape (points, axes), the last axis fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _apply_along(values: np.ndarray, axis: int, matrix: np.ndarray) -> np.ndarray:
    return np.moveaxis(np.tensordot(matrix, values, axes=(1, axis)), 0, axis)


def measured_error(table: RadiativeTabulated) -> float:
    """Largest error of the reflectance between the nodes."""
    rng = np.random.default_rng(0)
    error = 0.0
    for _ in range(CHECKS):
        points, outside = _off_nodes(rng, CHUNK), rng.random(NODES[3])
        expected = _in_double(_reflectance, points, outside, table.indices)
        dtype = table.out.core.dtype
        found = _looked_up(table, *(jnp.asarray(x, dtype) for x in (points, outside)))
        lit = expected > 0  # light that is mirrored totally does not come in
        off = np.abs(np.asarray(found)[lit] / expected[lit] - 1)
        error = float(np.maximum(error, off.max(initial=0.0)))
    return error


def _from_unit(unit, largest: float, knee: np.ndarray | float = KNEE) -> np.ndarray:
    return knee * np.expm1((unit + 1) / 2 * np.log1p(largest / knee))


def _table(indices: RefractiveIndices) -> np.ndarray:
    """Fates at the nodes, over their leading dependence on the ABL."""
    points, outside = _nodes(*NODES[:3]), _outside_nodes(NODES[3], indices)
    found = _in_double(partial(_exactly, after), points, outside, indices)
    abl = points[:, :1]
    scaled = found._replace(
        out=found.out * (np.exp(abl) * (1 + abl)), abl=found.abl / -np.expm1(-abl)
    )
    return np.stack(scaled, -1).reshape(*NODES, 4)


def _brdf_table(indices: RefractiveIndices) -> np.ndarray:
    """Compute the BRDF of light that is scattered more than once, at the nodes."""
    points, outside = _nodes(*BRDF_NODES[:3]), _outside_nodes(BRDF_NODES[3], indices)
    found = _in_double(partial(_exactly, multiple_scattering), points, outside, indices)
    return found.reshape(*BRDF_NODES, 3)


def _nodes(n_abl: int, n_depth: int, n_coalbedo: int) -> np.ndarray:
    """Depths of layers at the Chebyshev nodes, shape (points, 3), the albedo's fastest."""
    points = grid_points([chebyshev_nodes(n) for n in (n_abl, n_depth, n_coalbedo)])
    abl = _from_unit(points[:, 0], DEEPEST_ABL)
    depth = _from_unit(points[:, 1], DEEPEST)
    coalbedo = _from_unit(points[:, 2], 1.0, knee_of_coalbedo(depth))
    return _depths_of(abl, depth, coalbedo)


def _depths_of(abl, depth, coalbedo) -> np.ndarray:
    """Optical depths of layers: the ABL's, absorption and scattering of the stroma."""
    return np.stack([abl, depth * coalbedo, depth * (1 - coalbedo)], -1)


def _outside_nodes(n: int, indices: RefractiveIndices) -> np.ndarray:
    """Chebyshev nodes of the stroma's cosines, as cosines in the aqueous humour."""
    ratio = float(indices.aqueous) / float(indices.stroma)
    low = np.sqrt(max(1 - ratio**2, 0.0))
    inside = low + (1 - low) * (chebyshev_nodes(n) + 1) / 2
    return np.sqrt(1 - (1 - inside**2) / ratio**2)


def _off_nodes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Depths of layers off the nodes, where tissue may be and beyond: half of the albedos evenly
    distributed, half near 1.
    """
    abl = np.exp(rng.uniform(np.log(1e-4), np.log(5.0), count))
    depth = np.exp(rng.uniform(np.log(1e-3), np.log(DEEPEST), count))
    near_one = np.exp(rng.uniform(np.log(1e-4), 0.0, count))
    coalbedo = np.where(rng.random(count) < 0.5, near_one, rng.random(count))
    return _depths_of(abl, depth, coalbedo)


def _in_double(function, points: np.ndarray, outside: np.ndarray, indices: RefractiveIndices):
    """`function` of chunks of layers' depths, of cosines in the aqueous humour and of the indices,
    in double precision: a program for thin stromas and one for others.
    """
    limit, *each = THIN
    thin = points[:, 1] + points[:, 2] <= limit
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda n: jnp.asarray(np.asarray(n, np.float64)), indices)
        parts = [
            map_rows(partial(function, outside=outside, indices=wide, how=how), points[at], CHUNK)
            for at, how in zip((thin, ~thin), each, strict=True)
        ]
    places = np.argsort(np.concatenate([np.flatnonzero(thin), np.flatnonzero(~thin)]))
    return jax.tree.map(lambda *x: np.concatenate(x)[places], *parts)


def _layers_at(points, indices: RefractiveIndices) -> Layers:
    """Layers of these depths, one a wavelength."""
    abl, absorption, scattering = points.T
    return Layers(abl, absorption, scattering, indices, indices.order())


@eqx.filter_jit
def _exactly(function, points, outside, indices: RefractiveIndices, how: tuple[int, int]):
    """`after` or `multiple_scattering` of `orders` for layers' depths (layers, 3) and beams of
    cosines in the aqueous humour; `how`: polynomials and panels.
    """
    layers = _layers_at(points, indices)
    angles, beams = quadrature_nodes(layers, ANGLES), from_outside(layers, outside)
    each = layers.abl_absorption, layers.extinction, layers.albedo
    return jax.lax.map(lambda one: function(*one, angles, beams, how), each, batch_size=32)


@eqx.filter_jit
def _first(points, outside, indices: RefractiveIndices) -> orders.Beam:
    layers = _layers_at(points, indices)
    beams = from_outside(layers, outside)
    depths = layers.abl_absorption, layers.extinction
    return jax.vmap(orders.unscattered_beam, (0, 0, None))(*depths, beams)


def _reflectance(points, outside, indices: RefractiveIndices, how: tuple[int, int]):
    beam = _first(points, outside, indices)
    found = _exactly(after, points, outside, indices, how)
    albedo = points[:, 2:] / points[:, 1:].sum(1, keepdims=True)
    return beam.reflected + beam.lost * albedo * found.out


@eqx.filter_jit
def _looked_up(table: RadiativeTabulated, points, outside):
    layers = _layers_at(points, table.indices)
    return jax.vmap(lambda mu: table.solve(layers, Light(mu)).reflectance)(outside).T


def after(
    abl: jax.Array,
    depth: jax.Array,
    albedo: jax.Array,
    nodes: Ordinates,
    beams: Ordinates,
    how: tuple[int, int],
) -> ScatteredFates:
    """`ScatteredFates` of the light that each of some beams has scattered once, of one wavelength.

    `albedo` may exceed 1 by a little: the sum over orders of scattering goes on converging as long
    as light leaves the slab faster; `how`: polynomials and panels in depth.
    """
    slab, mode = Slab(depth, *how), MODES[0]
    first, again = _scattered(slab, mode, abl, albedo, nodes, beams, mode.functions(beams.cosine))
    upper, angle = _bounded(slab, abl, nodes)
    top, bottom = slab.leaving_each(angle, mode.parity)
    strength = jnp.asarray(mode.strength, depth.dtype)[:, None]
    flux = strength * mode.functions(nodes.cosine) * (nodes.weight * nodes.cosine)[None, :]

    def share(leaving, taken):
        return ((flux * taken[None, :]) @ leaving.T).ravel() @ first

    return ScatteredFates(
        out=share(top, upper.passed),
        abl=share(top, upper.absorbed),
        ipe=share(bottom, nodes.bottom[1]),
        collisions=slab.total(again[0]),
    )


def multiple_scattering(
    abl: jax.Array,
    depth: jax.Array,
    albedo: jax.Array,
    nodes: Ordinates,
    d: Ordinates,
    how: tuple[int, int],
) -> jax.Array:
    """Radiance at the slab's top of light scattered twice and oftener, by azimuthal order, from and
    into directions `d`: shape (beams, exits, orders), over ω², what of each beam is lost to the
    slab, and the `collided_share` of each exit.

    Of the orders 1 and 2 the factors f(μ_i) f(μ_o) are left out; `how`: polynomials and panels.
    """
    slab, found = Slab(depth, *how), []
    taken = collided_share(abl, depth, d)
    for mode in MODES:
        f = mode.functions(d.cosine) if mode.order == 0 else jnp.ones_like(d.cosine)[None]
        _, again = _scattered(slab, mode, abl, albedo, nodes, d, f)
        top, _ = slab.leaving_each(_bounded(slab, abl, d)[1], mode.parity)
        strength = jnp.asarray(mode.strength, depth.dtype)[:, None]
        sent = (strength * f)[:, None] * (top / taken[None])[None]
        found.append(jnp.einsum("lko,lki->io", sent, again))
    return jnp.stack(found, axis=-1)


def _scattered(slab: Slab, mode: Mode, abl, albedo, nodes: Ordinates, beams: Ordinates, f_beams):
    """Moments of light scattered once and oftener, over the albedo and what of each beam is lost to
    the slab, (terms·moments, beams), and the same of what scatters again, (terms, moments, beams).
    """
    angle, beam = (_bounded(slab, abl, d)[1] for d in (nodes, beams))
    strength = jnp.asarray(mode.strength, slab.depth.dtype)
    operator = slab.moments(angle, nodes.weight, mode.functions(nodes.cosine), mode.parity)
    operator = operator * jnp.repeat(strength, operator.shape[0] // strength.size)[None, :]
    lost = angular_profile(abl, slab.depth, beams).lost
    each = slab.driving_each(beam, mode.parity) / (beams.cosine * lost)[None]
    driving = (f_beams[:, None] * each[None]).reshape(-1, beams.cosine.size)
    one = jnp.eye(driving.shape[0], dtype=slab.depth.dtype)
    first = linear.solve(one - albedo * operator, driving)
    return first, (operator @ first).reshape(strength.size, -1, beams.cosine.size)


def _bounded(slab: Slab, abl, d: Ordinates) -> tuple[Absorber, Bounded]:
    """The ABL and the slab under it along directions."""
    upper = abl_shares(abl, d)
    return upper, slab.bounded(d.cosine, *boundaries(upper, d))


if __name__ == "__main__":
    main()
