"""Radiative transfer by table: what follows the first scattering, computed once, then looked up.

With fixed indices the stroma under its ABL depends on three numbers: the optical depths τ_A of the
ABL and τ of the stroma, and the stroma's albedo ω. A beam up to its first scattering is exact;
the fates of what it scatters are smooth in ln(1 + τ_A/k), ln(1 + τ/k), ω and the beam's cosine in
the stroma, once the leading pole 1/(1 − ω λ(τ)) of the sum over orders of scattering is taken out.
Of a BRDF light scattered once is exact too, and the rest a table (`brdf`).
"""

import dataclasses
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from irisjax._types import PRNGKey
from irisjax.numerics.sharding import laid_out
from irisjax.numerics.tucker import Tucker, coefficients
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light, beams_of
from irisjax.transport.process import DEPTH_RESOLVED, RadiativeTransfer
from irisjax.transport.radiative import brdf
from irisjax.transport.radiative.axes import (
    CHUNK,
    DEEPEST,
    Places,
    cosine_place,
    in_double,
    layers_at,
    most,
    nodes,
    outside_nodes,
    places,
    resummed,
    scattered,
)
from irisjax.transport.radiative.directions import Directions, from_outside, quadrature_nodes
from irisjax.transport.radiative.fates import Beam, ScatteredFates, after, before
from irisjax.transport.solution import RESULTS, Absorbed, Solution
from irisjax.transport.solver import AbstractSolver, check_rayleigh

_NODES = 24, 48, 10, 8  # along τ_A, τ, ω and the cosine
_LEFT_OUT = 1e-6  # of the polynomials' weights, where they are compressed
_ANGLES, _DEPTHS, _PANELS = 32, 10, 3  # of the exact solution at the nodes
_CHECKS = 4  # portions of points, off the nodes


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
        multiple = brdf.table(indices, pole, dtype)
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
        """See `AbstractSolver.solve`."""
        check_rayleigh(self, layers)
        dtype = layers.extinction.dtype
        # More than 16 take XLA at least four times as long.
        nodes, interfaces = (60, 3) if self.dense_outside else (16, 0)
        outside, power = beams_of(light, nodes, layers.indices, dtype, interfaces)
        beams = from_outside(layers, outside)
        values = None
        if light.exits is not None:
            exits = from_outside(layers, light.exits.cosine)
            values = laid_out(
                brdf.values,
                layers.extinction,
                *(
                    self.multiple,
                    self.pole,
                    layers.abl_absorption,
                    layers.extinction,
                    layers.albedo,
                ),
                *(beams, exits, light.exits.azimuth, self.indices),
            )
        return dataclasses.replace(self.solution(layers, beams, power), brdf=values)

    def solution(
        self,
        layers: Layers,
        beams: Directions,
        power,
        out=None,
        held: Bool[Array, ""] | bool = True,
    ) -> Solution:
        """Shares of light along some beams, of these shares of its `power`, shape (beams,).

        `out`: what of light scattered once leaves the iris, shape (wavelengths, beams), if it is
        known without the table; `held`: whether that is of these layers.
        """
        light = laid_out(
            RadiativeTabulated._light,
            layers.extinction,
            *(self, layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo),
            *(beams, power, out),
        )
        reflectance, mirrored, abl, stroma, ipe = light
        held = self.holds(layers) & held
        return Solution(
            reflectance=reflectance,
            mirrored=mirrored,
            absorbed=Absorbed(abl=abl, stroma=stroma, ipe=ipe),
            standard_error=None,
            total_error=None,
            brdf=None,
            brdf_error=None,
            status=RESULTS.where(
                layers.valid(),
                RESULTS.where(held, RESULTS.successful, RESULTS.outside_table),
                RESULTS.invalid_input,
            ),
        )

    def holds(self, layers: Layers) -> Bool[Array, ""]:
        """Whether the table has these layers' indices, depths and albedos."""
        depth = jnp.minimum(layers.extinction, DEEPEST)
        rounding = 1 + 8 * jnp.finfo(depth.dtype).eps
        return self.indices.same(layers.indices) & (layers.albedo <= rounding * most(depth)).all()

    def _light(self, abl, depth, albedo, coalbedo, beams: Directions, power, out):
        """Shares of the light, one value a wavelength."""
        beam = jax.vmap(before, (0, 0, None))(abl, depth, beams)
        after = self.after(abl, depth, albedo, beams.cosine)
        after = after if out is None else after._replace(out=out)
        first = beam.lost * albedo[:, None]
        # The fates are shares of one: what little the tables miss is shared out among the rest.
        ends = after.abl, after.ipe, coalbedo[:, None] * after.collisions
        rest = (1 - after.out) / sum(ends)
        in_abl, in_ipe, in_stroma = (x * rest for x in ends)
        reflectance = (beam.reflected + first * after.out) @ power
        mirrored = (beam.mirrored * jnp.ones_like(first)) @ power
        ipe = (beam.passed + first * in_ipe) @ power
        stroma = (beam.lost * coalbedo[:, None] + first * in_stroma) @ power
        return reflectance, mirrored, (beam.abl + first * in_abl) @ power, stroma, ipe

    def after(self, abl, depth, albedo, cosine) -> ScatteredFates:
        """Fates after the first scattering, shape (wavelengths, beams); `cosine`: in the stroma."""
        at, across = places(abl, depth, albedo), cosine_place(cosine, self.indices)
        (out,) = _read(self.out, at, across)
        absorbed, ipe, collisions = _read(self.ends, at, across)
        pole = resummed(self.pole, at, albedo)
        return ScatteredFates(
            out=out * (jnp.exp(-abl) / (1 + abl) * pole)[:, None],
            abl=absorbed * (-jnp.expm1(-abl) * pole)[:, None],
            ipe=ipe * pole[:, None],
            collisions=collisions * pole[:, None],
        )

    def _measure(self) -> float:
        """Largest error of the reflectance between the nodes."""
        rng = np.random.default_rng(0)
        error = 0.0
        for _ in range(_CHECKS):
            points, outside = scattered(rng, CHUNK), rng.random(_NODES[3])
            expected = in_double(_reflectance, points, outside, self.indices)
            found = _looked_up(self, *(jnp.asarray(x, self.pole.dtype) for x in (points, outside)))
            lit = expected > 0  # light that is mirrored totally does not come in
            off = np.abs(np.asarray(found)[lit] / expected[lit] - 1)
            error = float(np.maximum(error, off.max(initial=0.0)))
        return error


def _read(table: Tucker, at: Places, cosine):
    """A table's functions, each of shape (wavelengths, beams)."""
    core = jnp.einsum("abzmf,mk->fkbaz", table.core, table.basis(3, cosine))
    core = core.reshape(*core.shape[:3], -1)
    # The products of two short axes first: what is written out between is as short as the third.
    along = table.basis(0, at.abl)[:, None] * table.basis(2, at.albedo)[None]
    along, across = along.reshape(-1, at.abl.size), table.basis(1, at.depth)
    return [((function @ along) * across[None]).sum(1).T for function in core]


def _table(indices: RefractiveIndices) -> tuple[np.ndarray, np.ndarray]:
    """Fates at the nodes, with what they share taken out, and the pole λ's polynomials."""
    points, outside = nodes(*_NODES[:3]), outside_nodes(_NODES[3], indices)
    found = in_double(_fates, points, outside, indices)
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


@eqx.filter_jit
def _fates(points, outside, indices: RefractiveIndices) -> ScatteredFates:
    """At points (τ_A, τ, ω), for beams of cosines in the aqueous humour: shape (points, beams)."""
    layers = layers_at(points, indices)
    angles, beams = quadrature_nodes(layers, _ANGLES), from_outside(layers, outside)
    one = partial(after, nodes=angles, beams=beams, n_depths=_DEPTHS, n_panels=_PANELS)
    return jax.lax.map(lambda p: one(p[0], p[1], p[2]), points, batch_size=32)


@eqx.filter_jit
def _first(points, outside, indices: RefractiveIndices) -> Beam:
    abl, depth, _ = points.T
    beams = from_outside(layers_at(points, indices), outside)
    return jax.vmap(before, (0, 0, None))(abl, depth, beams)


def _reflectance(points, outside, indices: RefractiveIndices):
    beam, found = _first(points, outside, indices), _fates(points, outside, indices)
    return beam.reflected + beam.lost * points[:, 2:] * found.out


@eqx.filter_jit
def _looked_up(table: RadiativeTabulated, points, outside):
    layers = layers_at(points, table.indices)
    return jax.vmap(lambda mu: table.solve(layers, Light(mu)).reflectance)(outside).T
