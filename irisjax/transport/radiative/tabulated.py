"""Radiative transfer by table: what follows the first scattering, computed once, then looked up.

With fixed indices the stroma under its ABL depends on three numbers: the optical depths τ_A of the
ABL and τ of the stroma, and the stroma's albedo ω. A beam up to its first scattering is exact;
the fates of what it scatters are tabulated over the depths, the albedo and the beam's cosine in the
stroma. Of a BRDF light scattered once is exact too, and the rest a table of the azimuthal orders 0,
1 and 2, all that Rayleigh's law has.

The tables' coordinates run over [−1, 1]. Depths by ln(1 + τ/k): fates go as τ ln τ near nothing.
Albedos by ln(1 + (1 − ω)/ε), ε = 2/(1 + τ)²: the sum over orders of scattering has poles where
1 − ω = −O(1/τ²), which a logarithm of this origin keeps away from the table at every depth.
"""

import dataclasses
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from irisjax._types import PRNGKey
from irisjax.numerics.interpolation import chebyshev_nodes
from irisjax.numerics.portions import by_rows
from irisjax.numerics.precision import full_precision
from irisjax.numerics.roots import safe_sqrt
from irisjax.numerics.sharding import laid_out
from irisjax.numerics.tucker import Tucker, grid_points
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

_NODES = 24, 40, 12, 8  # along τ_A, τ, 1 − ω and the cosine
_BRDF_NODES = 12, 24, 8, 6, 6  # along τ_A, τ, 1 − ω and the cosines in and out
# Compression leaves out these shares of the weights of reflectance, of other fates and of BRDFs.
_LEFT_OUT = 1e-6, 4e-6, 1e-5
_ANGLES = 32  # of the exact solution at the nodes
_THIN = (
    3.0,
    (8, 3),
    (8, 5),
)  # depth up to which the first polynomials and panels do, else the others
_CHECKS = 4  # chunks of points, off the nodes
_CHUNK = 1024  # points a program takes at once
_DEEPEST_ABL, _DEEPEST = 20.0, 25.0
_ABSORBING = 0.1  # 1 − ω from which a stroma deeper than that is like one as deep, to 5e-6
_KNEE = 3e-4


class RadiativeTabulated(AbstractSolver):
    """Solver of radiative transfer for many spectra of irides that share their refractive indices.

    Make one with `RadiativeTabulated.build`. Every depth, albedo and incidence is traced; an iris
    with other indices, or with a stroma deeper than 25 optical depths whose albedo is above 0.9,
    gives the status `outside_table`. Gradients flow to depths, pigments and incidence, not to
    indices.

    - `error`: largest relative error of the reflectance, or to 1e-4 of the light, found at build
        time off the nodes.
    - `dense_outside`: whether the aqueous humour is denser than a layer.
    """

    process: RadiativeTransfer = eqx.field(default=DEPTH_RESOLVED, init=False)
    out: Tucker
    ends: Tucker
    multiple: Tucker
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
        fates, dtype = _table(indices), jnp.result_type(float)
        # `out` by itself: who wants no more pays for no more.
        each = fates[..., :1], fates[..., 1:], _brdf_table(indices)
        out, ends, multiple = (
            Tucker.of(x, left, dtype) for x, left in zip(each, _LEFT_OUT, strict=True)
        )
        dense = bool(indices.aqueous > min(indices.abl, indices.stroma, indices.ipe))
        table = cls(out, ends, multiple, indices, 0.0, dense)
        error = table._measure()
        if error > tolerance:
            raise ValueError(
                f"the fates are tabulated to {error:.1e} only, not to {tolerance:.1e}; use "
                "RadiativeExact, or a larger tolerance"
            )
        return dataclasses.replace(table, error=error)

    @full_precision
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
        depth = layers.extinction * (1 - 8 * jnp.finfo(layers.extinction.dtype).eps)
        held = (depth <= _DEEPEST) | (layers.coalbedo >= _ABSORBING)
        return self.indices.same(layers.indices) & held.all()

    def _flux(self, abl, depth, albedo, coalbedo, lit: BeamsAndExits) -> Flux:
        """Shares of the light, one value a wavelength."""
        power = lit.power
        beam = jax.vmap(orders.before, (0, 0, None))(abl, depth, lit.beams)
        after = self._after(abl, depth, coalbedo, lit.beams.cosine)
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
            brdf=None if lit.exits is None else self._brdf(abl, depth, albedo, coalbedo, lit),
        )

    def _after(self, abl, depth, coalbedo, cosine) -> orders.ScatteredFates:
        """Fates after the first scattering, shape (wavelengths, beams); `cosine`: in the stroma."""
        at, across = _coordinates(abl, depth, coalbedo), _of_cosine(cosine, self.indices)
        (out,) = _read(self.out, at, across)
        absorbed, ipe, collisions = _read(self.ends, at, across)
        return orders.ScatteredFates(
            out=out * (jnp.exp(-abl) / (1 + abl))[:, None],
            abl=absorbed * -jnp.expm1(-abl)[:, None],
            ipe=ipe,
            collisions=collisions,
        )

    def _brdf(self, abl, depth, albedo, coalbedo, lit: BeamsAndExits):
        """BRDF, shape (wavelengths, exits), of light from one direction."""
        at, table, exits = _coordinates(abl, depth, coalbedo), self.multiple, lit.exits
        core = jnp.einsum(
            "abziof,i,oe->efabz",
            table.core,
            table.basis(3, _of_cosine(lit.beams.cosine, self.indices))[:, 0],
            table.basis(4, _of_cosine(exits.cosine, self.indices)),
        )
        along = table.basis(0, at.abl)[:, None] * table.basis(2, at.coalbedo)[None]
        found = jnp.einsum("efabz,bw,azw->wef", core, table.basis(1, at.depth), along)

        def one(abl, depth, albedo, found):
            lost = orders.before(abl, depth, lit.beams).lost[0]
            angular = orders.azimuthal(lit.beams, exits, lit.azimuth)
            taken = orders.taken_of(abl, depth, exits)
            once = orders.single_scattering(abl, depth, albedo, lit.beams, exits, lit.azimuth)
            more = albedo**2 * lost * taken * (found.T * angular).sum(0)
            passed = orders.course(abl, depth, exits).roof.passed
            return passed * lit.to_brdf * (once + more)

        return jax.vmap(one)(abl, depth, albedo, found)

    def _measure(self) -> float:
        """Largest error of the reflectance between the nodes."""
        rng = np.random.default_rng(0)
        error = 0.0
        for _ in range(_CHECKS):
            points, outside = _off_nodes(rng, _CHUNK), rng.random(_NODES[3])
            expected = _in_double(_reflectance, points, outside, self.indices)
            dtype = self.out.core.dtype
            found = _looked_up(self, *(jnp.asarray(x, dtype) for x in (points, outside)))
            lit = expected > 0  # light that is mirrored totally does not come in
            off = np.abs(np.asarray(found)[lit] / expected[lit] - 1)
            error = float(np.maximum(error, off.max(initial=0.0)))
        return error


class _Coordinates(NamedTuple):
    """Of layers in the tables, shape (wavelengths,)."""

    abl: jax.Array
    depth: jax.Array
    coalbedo: jax.Array


def _coordinates(abl, depth, coalbedo) -> _Coordinates:
    """Beyond the deepest, layers of equal albedo are alike."""
    shallow = jnp.minimum(depth, _DEEPEST)
    return _Coordinates(
        _to_unit(jnp.minimum(abl, _DEEPEST_ABL), _DEEPEST_ABL),
        _to_unit(shallow, _DEEPEST),
        _to_unit(coalbedo, 1.0, _knee_of_coalbedo(shallow)),
    )


def _to_unit(x, largest: float, knee: jax.Array | float = _KNEE):
    return jnp.log1p(x / knee) * (2 / jnp.log1p(largest / knee)) - 1


def _from_unit(unit, largest: float, knee: np.ndarray | float = _KNEE) -> np.ndarray:
    return knee * np.expm1((unit + 1) / 2 * np.log1p(largest / knee))


def _knee_of_coalbedo(depth):
    return 2 / (1 + depth) ** 2


def _of_cosine(cosine, indices: RefractiveIndices):
    """Coordinate of cosines in the stroma, of directions that come from outside."""
    low = safe_sqrt(1 - (indices.aqueous / indices.stroma) ** 2)
    return 2 * (cosine - low) / (1 - low) - 1


def _read(table: Tucker, at: _Coordinates, cosine):
    """A table's functions, each of shape (wavelengths, beams)."""
    core = jnp.einsum("abzmf,mk->fkbaz", table.core, table.basis(3, cosine))
    core = core.reshape(*core.shape[:3], -1)
    # The products of two short axes first: what is written out between is as short as the third.
    along = table.basis(0, at.abl)[:, None] * table.basis(2, at.coalbedo)[None]
    along, across = along.reshape(-1, at.abl.size), table.basis(1, at.depth)
    return [((function @ along) * across[None]).sum(1).T for function in core]


def _table(indices: RefractiveIndices) -> np.ndarray:
    """Fates at the nodes, over their leading dependence on the ABL."""
    points, outside = _nodes(*_NODES[:3]), _outside_nodes(_NODES[3], indices)
    found = _in_double(_fates, points, outside, indices)
    abl = points[:, :1]
    scaled = found._replace(
        out=found.out * (np.exp(abl) * (1 + abl)), abl=found.abl / -np.expm1(-abl)
    )
    return np.stack(scaled, -1).reshape(*_NODES, 4)


def _brdf_table(indices: RefractiveIndices) -> np.ndarray:
    """Compute the BRDF of light that is scattered more than once, at the nodes."""
    points, outside = _nodes(*_BRDF_NODES[:3]), _outside_nodes(_BRDF_NODES[3], indices)
    found = _in_double(partial(_exactly, orders.multiple_scattering), points, outside, indices)
    return found.reshape(*_BRDF_NODES, 3)


def _nodes(n_abl: int, n_depth: int, n_coalbedo: int) -> np.ndarray:
    """Depths of layers at the Chebyshev nodes, shape (points, 3), the albedo's fastest."""
    points = grid_points([chebyshev_nodes(n) for n in (n_abl, n_depth, n_coalbedo)])
    abl = _from_unit(points[:, 0], _DEEPEST_ABL)
    depth = _from_unit(points[:, 1], _DEEPEST)
    coalbedo = _from_unit(points[:, 2], 1.0, _knee_of_coalbedo(depth))
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
    depth = np.exp(rng.uniform(np.log(1e-3), np.log(_DEEPEST), count))
    near_one = np.exp(rng.uniform(np.log(1e-4), 0.0, count))
    coalbedo = np.where(rng.random(count) < 0.5, near_one, rng.random(count))
    return _depths_of(abl, depth, coalbedo)


def _in_double(function, points: np.ndarray, outside: np.ndarray, indices: RefractiveIndices):
    """`function` of chunks of layers' depths, of cosines in the aqueous humour and of the indices,
    in double precision: a program for thin stromas and one for others.
    """
    limit, *each = _THIN
    thin = points[:, 1] + points[:, 2] <= limit
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda n: jnp.asarray(np.asarray(n, np.float64)), indices)
        parts = [
            by_rows(partial(function, outside=outside, indices=wide, how=how), points[at], _CHUNK)
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
    angles, beams = quadrature_nodes(layers, _ANGLES), from_outside(layers, outside)
    each = layers.abl_absorption, layers.extinction, layers.albedo
    return jax.lax.map(lambda one: function(*one, angles, beams, how), each, batch_size=32)


_fates = partial(_exactly, orders.after)


@eqx.filter_jit
def _first(points, outside, indices: RefractiveIndices) -> orders.Beam:
    layers = _layers_at(points, indices)
    beams = from_outside(layers, outside)
    return jax.vmap(orders.before, (0, 0, None))(layers.abl_absorption, layers.extinction, beams)


def _reflectance(points, outside, indices: RefractiveIndices, how: tuple[int, int]):
    beam = _first(points, outside, indices)
    found = _fates(points, outside=outside, indices=indices, how=how)
    albedo = points[:, 2:] / points[:, 1:].sum(1, keepdims=True)
    return beam.reflected + beam.lost * albedo * found.out


@eqx.filter_jit
def _looked_up(table: RadiativeTabulated, points, outside):
    layers = _layers_at(points, table.indices)
    return jax.vmap(lambda mu: table.solve(layers, Light(mu)).reflectance)(outside).T
