"""Analogue Monte Carlo of polarised light: photons as fields, Mueller matrices and their errors."""

import math
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from irisjax._types import PRNGKey
from irisjax.numerics.checks import Range, check_range, check_whole
from irisjax.numerics.streams import checked_key
from irisjax.optics.mueller import reflection
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Directions, Light
from irisjax.transport.process import POLARISED, RadiativeTransfer, sample_entry
from irisjax.transport.radiative.polarised import photon
from irisjax.transport.solution import Polarisation, Solution, counted, outcome
from irisjax.transport.solver import AbstractSolver, check_black, check_rayleigh

_BATCH = 4096  # photons under way at once; results depend on it by rounding
APERTURE = Range(1e-3, 0.5, "rad", above=False)
"""Allowed half-angles of the cones about exits."""


class Tally(NamedTuple):
    """Sums over photons: by fate (5,), of the Mueller matrix (16,) and its products (16, 16), of
    all that are reflected, and of those scattered into the cone about each exit.
    """

    fates: jax.Array
    whole: tuple[jax.Array, jax.Array] | None
    cones: tuple[jax.Array, jax.Array] | None


class PolarisedMonteCarlo(AbstractSolver):
    """Analogue sampling of polarised radiative transfer; needs a `key`, and has no derivatives.

    Photons are followed by their fields, in the precision of the iris; their paths are those of
    unpolarised light, whatever the polarisation of interest. Every wavelength has the same number
    of photons. The first surface's own matrix is Fresnel's.

    Attributes:
        n_photons: Photons a wavelength.
        aperture: Half-angle (radians) of the cone about each exit over which its BRDF is averaged.
        process: `POLARISED`.
    """

    process: RadiativeTransfer = eqx.field(default=POLARISED, init=False)
    n_photons: int = eqx.field(static=True)
    aperture: float = eqx.field(static=True, default=0.1)

    def __check_init__(self) -> None:
        check_whole("n_photons", self.n_photons, 1, 2**31 - 2**20)
        check_range("aperture", self.aperture, APERTURE)

    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        check_rayleigh(self, layers)
        check_black(self, layers)
        key = checked_key(key)
        dtype = layers.extinction.dtype
        exits = None if light.exits is None else _exits(light.exits, self.aperture)
        waves = jnp.arange(layers.extinction.size)
        keys = jax.vmap(partial(jax.random.fold_in, key))(waves)
        diffuse, whole = light.cosine is None, light.matrices or exits is not None
        one = partial(_one_wavelength, solver=self, diffuse=diffuse, whole=whole)
        incidence = jnp.ones((), dtype) if light.cosine is None else light.cosine
        # Photons in invalid layers would never end: none are sent.
        ok = layers.valid()
        depths = (layers.abl_absorption, layers.extinction, layers.albedo)

        def at(x):
            key, abl, depth, albedo = x
            medium = photon.PhotonLayers(abl, depth, albedo, layers.indices)
            return one(key, medium, incidence, exits, ok)

        tally = jax.lax.map(at, (keys, *(jnp.where(ok, x, 0.0) for x in depths)))
        polarisation = brdf = brdf_error = None
        if tally.whole is not None:
            polarisation = self._matrices(tally, layers, light, exits)
            if polarisation.brdf is not None and polarisation.brdf_covariance is not None:
                brdf = polarisation.brdf[..., 0, 0]
                brdf_error = jnp.sqrt(polarisation.brdf_covariance[..., 0, 0])
        errors = {"brdf_error": brdf_error, "polarisation": polarisation}
        return counted(tally.fates.astype(dtype), self.n_photons, outcome(ok), brdf, **errors)

    def _matrices(self, tally: Tally, layers: Layers, light: Light, exits) -> Polarisation:
        n, indices = self.n_photons, layers.indices
        assert light.cosine is not None
        shape = (layers.extinction.size, 4, 4)
        of_first = reflection(light.cosine, indices.aqueous, indices.abl)
        whole, covariance = _estimate(tally.whole, n)
        cones = of_cones = None
        if tally.cones is not None:
            power = jnp.pi * math.sin(self.aperture) ** 2 * exits[:, 2]
            cones, of_cones = _estimate(tally.cones, n)
            cones = (cones / power[None, :, None]).reshape(*cones.shape[:-1], 4, 4)
            of_cones = of_cones / (power * power)[None, :, None, None]
        return Polarisation(
            reflected=whole.reshape(shape),
            mirrored=jnp.broadcast_to(of_first[None], shape),
            brdf=cones,
            reflected_covariance=covariance,
            brdf_covariance=of_cones,
        )


def _exits(exits: Directions, aperture: float):
    """Directions (exits, 3); their cones must lie above the surface."""
    cosine, azimuth = exits.cosine, exits.azimuth
    if not isinstance(cosine, Tracer) and (np.asarray(cosine) < np.sin(aperture)).any():
        raise ValueError(
            f"a cone of half-angle {aperture:g} rad about cos_exit = "
            f"{float(np.asarray(cosine).min()):g} reaches below the surface"
        )
    sine = jnp.sqrt(jnp.maximum(1 - cosine * cosine, 0))
    return jnp.stack([sine * jnp.cos(azimuth), sine * jnp.sin(azimuth), cosine], -1)


@partial(jax.jit, static_argnames=("solver", "diffuse", "whole"))
def _one_wavelength(key, medium, incidence, exits, ok, *, solver, diffuse, whole) -> Tally:
    n = solver.n_photons

    def one(index):
        own = jax.random.fold_in(key, index)
        cosine = incidence
        if diffuse:
            start = jax.random.uniform(jax.random.fold_in(own, -1), (), incidence.dtype)
            cosine = sample_entry(start)
        return photon.follow(own, medium, cosine)

    def batch(first):
        index = first * _BATCH + jnp.arange(_BATCH, dtype=jnp.int32)
        p = jax.vmap(one)(index)
        alive = (index < n) & ok
        fates = ((p.fate[:, None] == jnp.arange(1, 6)[None]) & alive[:, None]).sum(0)
        out = alive & (p.fate == photon.REFLECTED)

        def matrices(p):
            matrix = photon.jones(p.field, p.ray)
            return photon.mueller(photon.seen_through_lens(matrix, p.ray))

        lens = _sums(jax.vmap(matrices)(p), out) if whole else None
        cones = None
        if exits is not None:
            near = np.cos(solver.aperture)

            def cone(exit):
                x = jax.vmap(lambda f: photon.mueller(photon.jones(f, exit)))(p.field)
                return _sums(x, out & p.scattered & (p.ray @ exit >= near))

            cones = jax.lax.map(cone, exits)
        return Tally(fates.astype(jnp.int32), lens, cones)

    tallies = jax.lax.map(batch, jnp.arange(-(-n // _BATCH), dtype=jnp.int32))
    return jax.tree.map(lambda x: x.sum(0), tallies)


def _sums(x, counted):
    x = jnp.where(counted[:, None], x, 0.0)
    return x.sum(0), x.T @ x


def _estimate(sums, n: int):
    """Mean, and covariance of the mean."""
    total, products = sums
    mean = total / n
    spread = products / n - mean[..., :, None] * mean[..., None, :]
    return mean, spread / n
