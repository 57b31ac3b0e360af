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

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from irisjax._types import PRNGKey
from irisjax.numerics.precision import full_precision
from irisjax.numerics.roots import safe_sqrt
from irisjax.numerics.sharding import call_with_layout
from irisjax.numerics.tucker import Tucker
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.process import DEPTH_RESOLVED, RadiativeTransfer
from irisjax.transport.radiative import orders
from irisjax.transport.radiative.directions import BeamsAndExits, beams_and_exits
from irisjax.transport.solution import RESULTS, Flux, Solution, outcome
from irisjax.transport.solver import AbstractSolver, check_layers

DEEPEST_ABL, DEEPEST = 20.0, 25.0
"""Optical depths of ABL and stroma to which the table reaches."""
_ABSORBING = 0.1  # 1 − ω from which a stroma deeper than that is like one as deep, to 5e-6
KNEE = 3e-4
"""Optical depth below which the tables' coordinate is linear in it."""


class RadiativeTabulated(AbstractSolver):
    """Solver of radiative transfer for many spectra of irides that share their refractive indices.

    `table_for` of `irisjax.transport.defaults` reads the package's, of LB06's indices, which
    `experiments.radiative_table` makes. Every depth, albedo and incidence is traced; an iris with
    other indices, or with a stroma deeper than 25 optical depths whose albedo is above 0.9,
    gives the status `outside_table`. Gradients flow to depths, pigments and incidence, not to
    indices.

    Attributes:
        error: Largest relative error of the reflectance, or to 1e-4 of the light, found off the
            nodes when the table was made.
    """

    process: RadiativeTransfer = eqx.field(default=DEPTH_RESOLVED, init=False)
    out: Tucker
    ends: Tucker
    multiple: Tucker
    indices: RefractiveIndices
    error: float = eqx.field(static=True)

    @full_precision
    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        check_layers(self, layers, black=True)
        # More than 16 take XLA at least four times as long.
        rays = beams_and_exits(layers, light, 16, interfaces=0)
        flux = call_with_layout(
            RadiativeTabulated._flux,
            layers.extinction,
            *(self, layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo, rays),
        )
        check = (self.holds(layers), RESULTS.outside_table)
        return flux.solution(outcome(layers.valid(), check))

    def holds(self, layers: Layers) -> Bool[Array, ""]:
        """Whether the table has these layers' indices, depths and albedos."""
        depth = layers.extinction * (1 - 8 * jnp.finfo(layers.extinction.dtype).eps)
        covered = (depth <= DEEPEST) | (layers.coalbedo >= _ABSORBING)
        return self.indices.same(layers.indices) & covered.all()

    def _flux(self, abl, depth, albedo, coalbedo, rays: BeamsAndExits) -> Flux:
        """Shares of the light, one value a wavelength."""
        power = rays.power
        beam = jax.vmap(orders.unscattered_beam, (0, 0, None))(abl, depth, rays.beams)
        fates = self._scattered_fates(abl, depth, coalbedo, rays.beams.cosine)
        scattered = beam.lost * albedo[:, None]
        # The fates are shares of one: what little the tables miss is shared out among the rest.
        sinks = fates.abl, fates.ipe, coalbedo[:, None] * fates.collisions
        scale = (1 - fates.out) / sum(sinks)
        in_abl, in_ipe, in_stroma = (x * scale for x in sinks)
        return Flux(
            reflectance=(beam.reflected + scattered * fates.out) @ power,
            mirrored=(beam.mirrored * jnp.ones_like(scattered)) @ power,
            abl=(beam.abl + scattered * in_abl) @ power,
            stroma=(beam.lost * coalbedo[:, None] + scattered * in_stroma) @ power,
            ipe=(beam.passed + scattered * in_ipe) @ power,
            brdf=None if rays.exits is None else self._brdf(abl, depth, albedo, coalbedo, rays),
        )

    def _scattered_fates(self, abl, depth, coalbedo, cosine) -> orders.ScatteredFates:
        """Fates after the first scattering, shape (wavelengths, beams); `cosine`: in the stroma."""
        place, angle = _coordinates(abl, depth, coalbedo), _of_cosine(cosine, self.indices)
        (out,) = _read(self.out, *place, angle)
        absorbed, ipe, collisions = _read(self.ends, *place, angle)
        return orders.ScatteredFates(
            out=out * (jnp.exp(-abl) / (1 + abl))[:, None],
            abl=absorbed * -jnp.expm1(-abl)[:, None],
            ipe=ipe,
            collisions=collisions,
        )

    def _brdf(self, abl, depth, albedo, coalbedo, rays: BeamsAndExits):
        """BRDF, shape (wavelengths, exits), of light from one direction."""
        place, table, exits = _coordinates(abl, depth, coalbedo), self.multiple, rays.exits
        core = jnp.einsum(
            "abziof,i,oe->efabz",
            table.core,
            table.basis(3, _of_cosine(rays.beams.cosine, self.indices))[:, 0],
            table.basis(4, _of_cosine(exits.cosine, self.indices)),
        )
        weights = table.basis(0, place.abl)[:, None] * table.basis(2, place.coalbedo)[None]
        multiple = jnp.einsum("efabz,bw,azw->wef", core, table.basis(1, place.depth), weights)

        def brdf_of(abl, depth, albedo, multiple):
            lost = orders.unscattered_beam(abl, depth, rays.beams).lost[0]
            angular = orders.azimuthal(rays.beams, exits, rays.azimuth)
            share = orders.collided_share(abl, depth, exits)
            single = orders.single_scattering(abl, depth, albedo, rays.beams, exits, rays.azimuth)
            further = albedo**2 * lost * share * (multiple.T * angular).sum(0)
            passed = orders.angular_profile(abl, depth, exits).abl.passed
            return passed * rays.to_brdf * (single + further)

        return jax.vmap(brdf_of)(abl, depth, albedo, multiple)


class _Coordinates(NamedTuple):
    """Coordinates of layers in the tables, shape (wavelengths,)."""

    abl: jax.Array
    depth: jax.Array
    coalbedo: jax.Array


def _coordinates(abl, depth, coalbedo) -> _Coordinates:
    """Beyond the deepest, layers of equal albedo are alike."""
    shallow = jnp.minimum(depth, DEEPEST)
    return _Coordinates(
        _to_unit(jnp.minimum(abl, DEEPEST_ABL), DEEPEST_ABL),
        _to_unit(shallow, DEEPEST),
        _to_unit(coalbedo, 1.0, knee_of_coalbedo(shallow)),
    )


def _to_unit(x, largest: float, knee: jax.Array | float = KNEE):
    return jnp.log1p(x / knee) * (2 / jnp.log1p(largest / knee)) - 1


def knee_of_coalbedo(depth: Any) -> Any:
    """Return the value of 1 − ω below which the coordinate is linear in it."""
    return 2 / (1 + depth) ** 2


def _of_cosine(cosine, indices: RefractiveIndices):
    """Coordinate of cosines in the stroma, of directions that come from outside."""
    low = safe_sqrt(1 - (indices.aqueous / indices.stroma) ** 2)
    return 2 * (cosine - low) / (1 - low) - 1


@full_precision  # of its own: the rule of its derivatives is traced after `solve` has returned
def _functions(table: Tucker, abl, depth, coalbedo, cosine):
    """A table's functions at coordinates, each of shape (wavelengths, beams)."""
    core = jnp.einsum("abzmf,mk->fkbaz", table.core, table.basis(3, cosine))
    core = core.reshape(*core.shape[:3], -1)
    # The products of two short axes first: what is written out between is as short as the third.
    products = table.basis(0, abl)[:, None] * table.basis(2, coalbedo)[None]
    products, depths = products.reshape(-1, abl.size), table.basis(1, depth)
    return [((function @ products) * depths[None]).sum(1).T for function in core]


_read = eqx.filter_custom_jvp(_functions)


@_read.def_jvp
def _read_jvp(primals, tangents):
    """Derivatives by one coordinate after the other, each from its own axis, serve all tangents."""
    (table, *places), (of_table, *slopes) = primals, tangents
    # Without this the rule would leave derivatives by the table out, and they would be wrong.
    if jax.tree.leaves(of_table):
        raise NotImplementedError("tables are constants; derivatives by them do not exist")
    values = _functions(table, *places)
    changes = [jnp.zeros_like(value) for value in values]
    for axis, slope in enumerate(slopes):
        if slope is None:
            continue

        def along(x, axis=axis):
            moved = [x if i == axis else place for i, place in enumerate(places)]
            return _functions(table, *moved)

        _, derivatives = jax.jvp(along, (places[axis],), (jnp.ones_like(places[axis]),))
        slope = slope[None] if axis == 3 else slope[:, None]
        changes = [c + d * slope for c, d in zip(changes, derivatives, strict=True)]
    return values, changes
