"""Radiative transfer by table: what follows the first scattering, computed once, then looked up.

With fixed indices the stroma under its ABL depends on three numbers: the optical depths τ_A of the
ABL and τ of the stroma, and the stroma's albedo ω. A beam up to its first scattering is exact;
the fates of what it scatters are smooth in ln(1 + τ_A/k), ln(1 + τ/k), ω and the beam's cosine in
the stroma, once the leading pole 1/(1 − ω λ(τ)) of the sum over orders of scattering is taken out.
Of a BRDF light scattered once is exact too, and the rest a table of the azimuthal orders 0, 1 and
2, all that Rayleigh's law has.

The tables' coordinates run over [−1, 1]. Depths by ln(1 + τ/k): fates go as τ ln τ near nothing.
Albedos from 0 to what the table holds at a depth, `_most`: all there are where τ_s ≤ 2, and up to
7.5/τ in the deep.
"""

import dataclasses
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from irisjax._types import PRNGKey
from irisjax.numerics.interpolation import chebyshev_nodes, chebyshev_series
from irisjax.numerics.portions import by_rows
from irisjax.numerics.roots import safe_sqrt
from irisjax.numerics.sharding import laid_out
from irisjax.numerics.tucker import Tucker, coefficients, grid_points
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.process import DEPTH_RESOLVED, RadiativeTransfer
from irisjax.transport.radiative import orders
from irisjax.transport.radiative.directions import (
    BeamsAndExits,
    beams_and_exits,
    from_outside,
    quadrature_nodes,
)
from irisjax.transport.solution import RESULTS, Flux, Solution, outcome
from irisjax.transport.solver import AbstractSolver, check_black, check_rayleigh

_NODES = 24, 48, 10, 8  # along τ_A, τ, ω and the cosine
_BRDF_NODES = 12, 24, 8, 6, 6  # along τ_A, τ, ω and the cosines in and out
_LEFT_OUT, _BRDF_LEFT_OUT = 1e-6, 1e-5  # of the polynomials' weights, where they are compressed
_ANGLES, _HOW = 32, (10, 3)  # of the exact solution at the nodes: angles; polynomials and panels
_CHECKS = 4  # chunks of points, off the nodes
_CHUNK = 1024  # points a program takes at once
_DEEPEST_ABL, _DEEPEST = 20.0, 15.0  # exp(−2·15) is below rounding: deeper is all alike
_KNEE = 3e-4
_ALBEDO, _BEND = 1.25, 8.0


class RadiativeTabulated(AbstractSolver):
    """Solver of radiative transfer for many spectra of irides that share their refractive indices.

    Make one with `RadiativeTabulated.build`. Every depth, albedo and incidence is traced; an iris
    with other indices, or one that scatters more than the table holds (scattering depths above 2
    in a stroma that hardly absorbs, albedos above 7.5/τ in a deep one), gives the status
    `outside_table`. Gradients flow to depths, pigments and incidence, not to indices.

    - `error`: largest relative error of the reflectance, or to 1e-4 of the light, found at build
        time off the nodes.
    - `dense_outside`: whether the aqueous humour is denser than a layer.
    """

    process: RadiativeTransfer = eqx.field(default=DEPTH_RESOLVED, init=False)
    out: Tucker
    ends: Tucker
    multiple: Tucker
    pole: Float[Array, " polynomials"]
    indices: RefractiveIndices
    error: float = eqx.field(static=True)
    dense_outside: bool = eqx.field(static=True, default=False)

    @classmethod
    def build(
        cls, indices: RefractiveIndices | None = None, *, tolerance: float = 1e-4
    ) -> "RadiativeTabulated":
        """Tabulate for some refractive indices (default: LB06's; `iris.indices()` has an iris's)
        and check the table.

        **Raises:** `ValueError` if the error found exceeds `tolerance`.
        """
        indices = Iris().indices() if indices is None else indices
        fates, pole = _table(indices)
        dtype = jnp.result_type(float)
        # `out` by itself: who wants no more pays for no more.
        out, ends = (Tucker.of(f, _LEFT_OUT, dtype) for f in (fates[..., :1], fates[..., 1:]))
        multiple = Tucker.of(_brdf_table(indices, pole), _BRDF_LEFT_OUT, dtype)
        dense = bool(indices.aqueous > min(indices.abl, indices.stroma, indices.ipe))
        table = cls(out, ends, multiple, jnp.asarray(pole, dtype), indices, 0.0, dense)
        error = table._measure()
        if error > tolerance:
            raise ValueError(
                f"the fates are tabulated to {error:.1e} only, not to {tolerance:.1e}; use "
                "RadiativeExact, or a larger tolerance"
            )
        return dataclasses.replace(table, error=error)

    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        check_rayleigh(self, layers)
        check_black(self, layers)
        # More than 16 take XLA at least four times as long.
        beams, interfaces = (60, 3) if self.dense_outside else (16, 0)
        lit = beams_and_exits(layers, light, beams, interfaces)
        flux = laid_out(
            RadiativeTabulated._flux,
            layers.extinction,
            *(self, layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo, lit),
        )
        held = (self.holds(layers), RESULTS.outside_table)
        return flux.solution(outcome(layers.valid(), held))

    def holds(self, layers: Layers) -> Bool[Array, ""]:
        """Whether the table has these layers' indices, depths and albedos."""
        depth = jnp.minimum(layers.extinction, _DEEPEST)
        rounding = 1 + 8 * jnp.finfo(depth.dtype).eps
        return self.indices.same(layers.indices) & (layers.albedo <= rounding * _most(depth)).all()

    def _flux(self, abl, depth, albedo, coalbedo, lit: BeamsAndExits) -> Flux:
        """Shares of the light, one value a wavelength."""
        power = lit.power
        beam = jax.vmap(orders.before, (0, 0, None))(abl, depth, lit.beams)
        after = self._after(abl, depth, albedo, lit.beams.cosine)
        first = beam.lost * albedo[:, None]
        # The fates are shares of one: what little the tables miss is shared out among the rest.
        ends = after.abl, after.ipe, coalbedo[:, None] * after.collisions
        rest = (1 - after.out) / sum(ends)
        in_abl, in_ipe, in_stroma = (x * rest for x in ends)
        return Flux(
            reflectance=(beam.reflected + first * after.out) @ power,
            mirrored=(beam.mirrored * jnp.ones_like(first)) @ power,
            abl=(beam.abl + first * in_abl) @ power,
            stroma=(beam.lost * coalbedo[:, None] + first * in_stroma) @ power,
            ipe=(beam.passed + first * in_ipe) @ power,
            brdf=None if lit.exits is None else self._brdf(abl, depth, albedo, lit),
        )

    def _after(self, abl, depth, albedo, cosine) -> orders.ScatteredFates:
        """Fates after the first scattering, shape (wavelengths, beams); `cosine`: in the stroma."""
        at, across = _coordinates(abl, depth, albedo), _of_cosine(cosine, self.indices)
        (out,) = _read(self.out, at, across)
        absorbed, ipe, collisions = _read(self.ends, at, across)
        pole = self._resummed(at, albedo)
        return orders.ScatteredFates(
            out=out * (jnp.exp(-abl) / (1 + abl) * pole)[:, None],
            abl=absorbed * (-jnp.expm1(-abl) * pole)[:, None],
            ipe=ipe * pole[:, None],
            collisions=collisions * pole[:, None],
        )

    def _brdf(self, abl, depth, albedo, lit: BeamsAndExits):
        """BRDF, shape (wavelengths, exits), of light from one direction."""
        at, table, exits = _coordinates(abl, depth, albedo), self.multiple, lit.exits
        core = jnp.einsum(
            "abziof,i,oe->efabz",
            table.core,
            table.basis(3, _of_cosine(lit.beams.cosine, self.indices))[:, 0],
            table.basis(4, _of_cosine(exits.cosine, self.indices)),
        )
        along = table.basis(0, at.abl)[:, None] * table.basis(2, at.albedo)[None]
        found = jnp.einsum("efabz,bw,azw->wef", core, table.basis(1, at.depth), along)
        found = found.at[..., 0].multiply(self._resummed(at, albedo)[:, None])

        def one(abl, depth, albedo, found):
            lost = orders.before(abl, depth, lit.beams).lost[0]
            angular = orders.azimuthal(lit.beams, exits, lit.azimuth)
            taken = orders.taken_of(abl, depth, exits)
            once = orders.single_scattering(abl, depth, albedo, lit.beams, exits, lit.azimuth)
            more = albedo**2 * lost * taken * (found.T * angular).sum(0)
            passed = orders.course(abl, depth, exits).roof.passed
            return passed * lit.to_brdf * (once + more)

        return jax.vmap(one)(abl, depth, albedo, found)

    def _resummed(self, at: "_Coordinates", albedo):
        """The leading pole of the sum over orders of scattering, 1/(1 − ω λ)."""
        return 1 / (1 - albedo * chebyshev_series(self.pole[:, None], at.depth)[0])

    def _measure(self) -> float:
        """Largest error of the reflectance between the nodes."""
        rng = np.random.default_rng(0)
        error = 0.0
        for _ in range(_CHECKS):
            points, outside = _off_nodes(rng, _CHUNK), rng.random(_NODES[3])
            expected = _in_double(_reflectance, points, outside, self.indices)
            found = _looked_up(self, *(jnp.asarray(x, self.pole.dtype) for x in (points, outside)))
            lit = expected > 0  # light that is mirrored totally does not come in
            off = np.abs(np.asarray(found)[lit] / expected[lit] - 1)
            error = float(np.maximum(error, off.max(initial=0.0)))
        return error


class _Coordinates(NamedTuple):
    """Of layers in the tables, shape (wavelengths,)."""

    abl: jax.Array
    depth: jax.Array
    albedo: jax.Array


def _coordinates(abl, depth, albedo) -> _Coordinates:
    """Beyond the deepest, layers of equal albedo are alike."""
    shallow = jnp.minimum(depth, _DEEPEST)
    return _Coordinates(
        _to_unit(jnp.minimum(abl, _DEEPEST_ABL), _DEEPEST_ABL),
        _to_unit(shallow, _DEEPEST),
        2 * albedo / _most(shallow) - 1,
    )


def _to_unit(depth, deepest: float):
    return jnp.log1p(depth / _KNEE) * (2 / np.log1p(deepest / _KNEE)) - 1


def _depths(n: int, deepest: float) -> np.ndarray:
    return _KNEE * np.expm1((chebyshev_nodes(n) + 1) / 2 * np.log1p(deepest / _KNEE))


def _most(depth):
    """Largest albedo of the tables at an optical depth."""
    return _ALBEDO / (1 + depth / _BEND)


def _of_cosine(cosine, indices: RefractiveIndices):
    """Coordinate of cosines in the stroma, of directions that come from outside."""
    low = safe_sqrt(1 - (indices.aqueous / indices.stroma) ** 2)
    return 2 * (cosine - low) / (1 - low) - 1


def _read(table: Tucker, at: _Coordinates, cosine):
    """A table's functions, each of shape (wavelengths, beams)."""
    core = jnp.einsum("abzmf,mk->fkbaz", table.core, table.basis(3, cosine))
    core = core.reshape(*core.shape[:3], -1)
    # The products of two short axes first: what is written out between is as short as the third.
    along = table.basis(0, at.abl)[:, None] * table.basis(2, at.albedo)[None]
    along, across = along.reshape(-1, at.abl.size), table.basis(1, at.depth)
    return [((function @ along) * across[None]).sum(1).T for function in core]


def _table(indices: RefractiveIndices) -> tuple[np.ndarray, np.ndarray]:
    """Fates at the nodes, with what they share taken out, and the pole λ's polynomials."""
    points, outside = _nodes(*_NODES[:3]), _outside_nodes(_NODES[3], indices)
    found = _in_double(_fates, points, outside, indices)
    # Of a sum c/(1 − ω λ) over orders of scattering two values tell λ.
    shape = _NODES[:3]
    most, least = (found.collisions.reshape(*shape, -1)[-1, :, k, 0] for k in (0, -1))
    high, few = (points[:, 2].reshape(shape)[-1, :, k] for k in (0, -1))
    pole = (most - least) / (high * most - few * least)
    factor = (1 - points[:, 2].reshape(shape) * pole[None, :, None]).ravel()
    abl = points[:, 0]
    scale = factor * np.exp(abl) * (1 + abl), factor / -np.expm1(-abl), factor, factor
    values = [f * s[:, None] for f, s in zip(found, scale, strict=True)]
    return np.stack(values, -1).reshape(*_NODES, 4), coefficients(shape[1]) @ pole


def _brdf_table(indices: RefractiveIndices, pole: np.ndarray) -> np.ndarray:
    """What light scattered oftener than once adds, the pole 1/(1 − ω λ) taken out of order 0;
    `pole`: polynomials of λ.
    """
    points, outside = _nodes(*_BRDF_NODES[:3]), _outside_nodes(_BRDF_NODES[3], indices)
    found = _in_double(partial(_exactly, orders.multiple_scattering), points, outside, indices)
    depth = np.asarray(_coordinates(*points.T).depth, np.float64)
    eigenvalue = np.polynomial.chebyshev.chebval(depth, pole)
    found[..., 0] *= (1 - points[:, 2] * eigenvalue)[:, None, None]
    return found.reshape(*_BRDF_NODES, 3)


def _nodes(n_abl: int, n_depth: int, n_albedo: int) -> np.ndarray:
    """Chebyshev nodes as (τ_A, τ, ω), shape (points, 3), the albedo's fastest."""
    albedos = (chebyshev_nodes(n_albedo) + 1) / 2
    points = grid_points([_depths(n_abl, _DEEPEST_ABL), _depths(n_depth, _DEEPEST), albedos])
    points[:, 2] *= _most(points[:, 1])
    return points


def _outside_nodes(n: int, indices: RefractiveIndices) -> np.ndarray:
    """Chebyshev nodes of the stroma's cosines, as cosines in the aqueous humour."""
    ratio = float(indices.aqueous) / float(indices.stroma)
    low = np.sqrt(max(1 - ratio**2, 0.0))
    inside = low + (1 - low) * (chebyshev_nodes(n) + 1) / 2
    return np.sqrt(1 - (1 - inside**2) / ratio**2)


def _off_nodes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points (τ_A, τ, ω) off the nodes, where tissue may be and beyond."""
    abl = np.exp(rng.uniform(np.log(1e-4), np.log(5.0), count))
    depth = np.exp(rng.uniform(np.log(1e-3), np.log(_DEEPEST), count))
    return np.stack([abl, depth, rng.random(count) * np.minimum(1, _most(depth))], -1)


def _in_double(function, points: np.ndarray, outside: np.ndarray, indices: RefractiveIndices):
    """`function` of chunks of points (τ_A, τ, ω), of cosines in the aqueous humour and of the
    indices: one program for all, in double precision.
    """
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda n: jnp.asarray(np.asarray(n, np.float64)), indices)
        return by_rows(lambda some: function(some, outside, wide), points, _CHUNK)


def _layers_at(points, indices: RefractiveIndices) -> Layers:
    """Layers of points (τ_A, τ, ω), one a wavelength."""
    abl, depth, albedo = points.T
    return Layers(abl, depth * (1 - albedo), depth * albedo, indices, indices.order())


@eqx.filter_jit
def _exactly(function, points, outside, indices: RefractiveIndices):
    """`after` or `multiple_scattering` of `orders` at points (τ_A, τ, ω), the first axis, for beams
    of cosines in the aqueous humour.
    """
    layers = _layers_at(points, indices)
    angles, beams = quadrature_nodes(layers, _ANGLES), from_outside(layers, outside)
    return jax.lax.map(lambda p: function(*p, angles, beams, _HOW), points, batch_size=32)


_fates = partial(_exactly, orders.after)


@eqx.filter_jit
def _first(points, outside, indices: RefractiveIndices) -> orders.Beam:
    abl, depth, _ = points.T
    beams = from_outside(_layers_at(points, indices), outside)
    return jax.vmap(orders.before, (0, 0, None))(abl, depth, beams)


def _reflectance(points, outside, indices: RefractiveIndices):
    beam, found = _first(points, outside, indices), _fates(points, outside, indices)
    return beam.reflected + beam.lost * points[:, 2:] * found.out


@eqx.filter_jit
def _looked_up(table: RadiativeTabulated, points, outside):
    layers = _layers_at(points, table.indices)
    return jax.vmap(lambda mu: table.solve(layers, Light(mu)).reflectance)(outside).T
