"""Polarised radiative transfer as an integral equation, solved as the scalar one is.

Every order in azimuth of Rayleigh's phase matrix is a sum of one or two products, and what mirrors
do is diagonal in I_l, I_r and W = (U + iV)/√2: each of these along a direction is what a direction
is in scalar theory.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp

from irisjax.numerics import linear
from irisjax.numerics.sharding import call_with_layout
from irisjax.optics.mueller import stokes
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.radiative.directions import (
    BeamsAndExits,
    beams_and_exits,
    from_outside,
    join_sets,
    quadrature_nodes,
)
from irisjax.transport.radiative.orders import conserving_order, unscattered_beam
from irisjax.transport.radiative.polarised.interfaces import (
    Passage,
    PolarisedOrdinates,
    over_polarised,
    passages,
    polarised,
    unscattered,
)
from irisjax.transport.radiative.polarised.modes import RAYLEIGH, PolarisedMode
from irisjax.transport.radiative.resolution import effective_depth
from irisjax.transport.radiative.slab import Slab
from irisjax.transport.solution import Flux, Polarisation

_ROOT_HALF = math.sqrt(0.5)


def solve_polarised(
    layers: Layers,
    light: Light,
    n_angles: int,
    grid: tuple[int, int],
    modes: tuple[PolarisedMode, ...] = RAYLEIGH,
) -> tuple[Flux, Polarisation | None]:
    """Compute the fate of unpolarised light, and Mueller matrices if they are requested.

    Args:
        layers: As in `AbstractSolver.solve`.
        light: As in `AbstractSolver.solve`.
        n_angles: Quadrature nodes over the cosine.
        grid: Polynomials and panels in depth.
        modes: Modes of the phase matrix, first that of the whole intensity.
    """
    rays = beams_and_exits(layers, light, 2 * n_angles, ordinates=partial(polarised, from_outside))
    needs_matrices = light.matrices or rays.exits is not None
    solve_one = partial(_one_wavelength, grid=grid, modes=modes, matrices=needs_matrices)
    flux, matrices = call_with_layout(
        jax.vmap(solve_one, in_axes=(0, 0, 0, 0, 0, *(None,) * 3)),
        layers.extinction,
        *(layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo),
        *(layers.ipe_absorption, layers.indices),
        *(polarised(quadrature_nodes, layers, n_angles), rays),
    )
    return flux, None if matrices is None else Polarisation(*matrices)


def _one_wavelength(
    abl, depth, albedo, coalbedo, ipe, n, nodes, rays: BeamsAndExits, *, grid, modes, matrices: bool
):
    slab = Slab(depth := effective_depth(depth, coalbedo), *grid)
    nodes, beams, exits = (over_polarised(ipe, d) for d in (nodes, rays.beams, rays.exits))
    angle, beam, *exit_ = passages(slab, abl, nodes, beams, exits)
    # Of I_l and of I_r, (2, beams).
    fates = unscattered_beam(abl, depth, join_sets(beams.p, beams.s))
    fates = jax.tree.map(lambda x: x.reshape(2, -1), fates)
    entering = rays.power[None] * fates.entered
    strengths = [albedo * jnp.asarray(mode.strength, albedo.dtype) for mode in modes]
    assert modes[0].linear is not None
    # Moments of light that is all I_l, and all I_r: of unpolarised light either is one half.
    moments, flux = conserving_order(
        slab,
        coalbedo,
        strengths[0][:, None] * modes[0].linear(nodes.p.cosine).reshape(strengths[0].size, -1),
        _system(slab, modes[0], strengths[0], angle, nodes),
        _driving(slab, modes[0], beam, beams, entering, None),
        *(angle.linear, join_sets(nodes.p, nodes.s), angle.upper, fates.total(rays.power)),
    )
    if not matrices:
        return flux, None

    solutions = [jnp.pad(moments, ((0, 0), (0, 0), (0, 2)))]
    for mode, strength in zip(modes[1:], strengths[1:], strict=True):
        system = _system(slab, mode, strength, angle, nodes)
        right = _driving(slab, mode, beam, beams, entering, beam.w_passed)
        solution = linear.solve(system, right.reshape(system.shape[0], 4))
        solutions.append(solution.reshape(right.shape))
    sources = [s[:, None, None] * x for s, x in zip(strengths, solutions, strict=True)]

    at_surface, inner = unscattered(abl, depth, beams.w, beam, rays.outside, n)
    reflected = _mirror(fates.reflected[:, 0], inner[0])
    for mode, source in zip(modes, sources, strict=True):
        if mode.order != 1:
            leaving = _leaving(slab, mode, angle, nodes, source)
            reflected += _collect(mode, nodes.p.weight * nodes.p.cosine, leaving)
    mirrored = _mirror(fates.mirrored[:, 0], at_surface[0])
    brdf = None
    if exits is not None:
        total = jnp.zeros((rays.azimuth.size, 4, 4), depth.dtype)
        for mode, source in zip(modes, sources, strict=True):
            leaving = _leaving(slab, mode, exit_[0], exits, source)
            total += leaving * _azimuthal(mode.order, rays.azimuth)
        brdf = stokes(total) * rays.to_brdf
        flux = flux._replace(brdf=brdf[:, 0, 0])
    return flux, (stokes(reflected), stokes(mirrored), brdf)


def _system(slab, mode: PolarisedMode, strength, angle: Passage, nodes: PolarisedOrdinates):
    """I − K of the moments of every term, (terms·moments, terms·moments)."""
    terms, n = strength.size, slab.n_panels * slab.n_depths
    operator = jnp.zeros((terms, n, terms, n), strength.dtype)
    mu, weight = nodes.p.cosine, nodes.p.weight
    if mode.linear is not None:
        f = mode.linear(mu)
        rank = f.shape[0]
        f = f.reshape(rank, -1)
        linear_terms = slab.moments(angle.linear, jnp.tile(weight, 2), f, mode.signs(mu))
        operator = operator.at[:rank, :, :rank].add(linear_terms.reshape(rank, n, rank, n))
    if mode.turning is not None:
        f, sign = mode.turning(mu)[None], mode.parity[2]
        real_terms = slab.moments(angle.real, weight, f, sign)
        for term in (mode.u, mode.v):
            if term is not None:
                operator = operator.at[term, :, term].add(real_terms)
        if mode.u is not None and mode.v is not None:
            imaginary_terms = slab.moments_of_images(angle.imaginary, weight, f, sign)
            operator = operator.at[mode.u, :, mode.v].add(-imaginary_terms)
            operator = operator.at[mode.v, :, mode.u].add(imaginary_terms)
    size = terms * n
    weights = jnp.repeat(strength, n)
    return jnp.eye(size, dtype=strength.dtype) - operator.reshape(size, size) * weights[None, :]


def _driving(slab, mode: PolarisedMode, beam: Passage, beams: PolarisedOrdinates, entering, w_in):
    """Moments that light of I_l, I_r, U and V on the iris drives, (terms, moments, 4); of the first
    two alone where `w_in`, what passes of W, is not given.
    """
    mu, n = beams.p.cosine, slab.n_panels * slab.n_depths
    right = jnp.zeros((len(mode.strength), n, 2 if w_in is None else 4), mu.dtype)
    if mode.linear is not None:
        f = mode.linear(mu) * (entering / mu[None, :])[None]
        moments = slab.driving_each(beam.linear, mode.signs(mu)).reshape(n, 2, -1)
        right = right.at[: f.shape[0], :, :2].add(jnp.einsum("rcb,ncb->rnc", f, moments))
    if mode.turning is not None and w_in is not None:
        sign, radiance = mode.parity[2], mode.turning(mu) / mu
        re, im = (slab.driving_each(x, sign) for x in (beam.real, beam.imaginary))
        a, b = (part(w_in) * radiance for part in (jnp.real, jnp.imag))
        # Of light with U = 1, then V = 1: W = −1/√2, −i/√2 in the sign of `PolarisedMode`.
        of_u, of_v = _ROOT_HALF * (re @ a - im @ b), _ROOT_HALF * (re @ b + im @ a)
        if mode.u is not None:
            right = right.at[mode.u, :, 2:].add(jnp.stack([-of_u, of_v], -1))
        if mode.v is not None:
            right = right.at[mode.v, :, 2:].add(jnp.stack([-of_v, -of_u], -1))
    return right


def _leaving(slab, mode: PolarisedMode, passage: Passage, d: PolarisedOrdinates, source):
    """I_l, I_r, U and V of radiance at the stroma's top, less what the ABL keeps of it, of light as
    in `_driving`, (directions, 4, 4).
    """
    mu = d.p.cosine
    radiances = jnp.zeros((mu.size, 4, 4), mu.dtype)
    if mode.linear is not None:
        f = mode.linear(mu)
        top = slab.leaving_each(passage.linear, mode.signs(mu))[0].reshape(-1, 2, mu.size)
        passed = passage.upper.passed.reshape(1, 2, -1)
        radiance = jnp.einsum("rca,nca,rni->aci", f * passed, top, source[: f.shape[0]])
        radiances = radiances.at[:, :2].add(radiance)
    if mode.turning is not None:
        sign = mode.parity[2]
        re = slab.leaving_each(passage.real, sign)[0]
        im = slab.leaving_of_images_each(passage.imaginary, sign)[0]
        zero = jnp.zeros_like(source[0])
        u, v = (zero if k is None else source[k] for k in (mode.u, mode.v))
        f = 2 * _ROOT_HALF * mode.turning(mu)[:, None]
        u, v = f * (re.T @ u - im.T @ v), f * (re.T @ v + im.T @ u)
        a, b = jnp.real(passage.w_passed)[:, None], jnp.imag(passage.w_passed)[:, None]
        radiances = radiances.at[:, 2].add(a * u - b * v).at[:, 3].add(a * v + b * u)
    return radiances


def _azimuthal(order: int, azimuth):
    """Factors of `_leaving` at azimuths, (exits, 4, 4)."""
    even, odd = jnp.cos(order * azimuth), jnp.sin(order * azimuth)
    blocks = jnp.stack([jnp.stack([even, odd], -1), jnp.stack([odd, -even], -1)], -2)
    return (1 if order == 0 else 2) * jnp.repeat(jnp.repeat(blocks, 2, -2), 2, -1)


def _collect(mode: PolarisedMode, flux, leaving):
    """Integrate over the hemisphere what a lens collects: I_l, I_r, U and V in its plane, along and
    across the plane of incidence. Only orders 0 and 2 remain after the average over azimuth.
    """
    p, s, u, v = (flux @ leaving[:, k] for k in range(4))
    nothing = jnp.zeros_like(p)
    of_linear = jnp.asarray([1, 1, 0, 0], p.dtype)
    of_turning = 1 - of_linear
    if mode.order == 0:
        half = 0.5 * (p + s) * of_linear
        return jnp.stack([half, half, nothing, -v * of_turning])
    half = 0.5 * (p - s - u)
    return jnp.stack([half * of_linear, -half * of_linear, 2 * half * of_turning, nothing])


def _mirror(shares, w_passed):
    """Matrix of I_l, I_r, U and V of a mirror."""
    a, b = jnp.real(w_passed), jnp.imag(w_passed)
    zero = jnp.zeros_like(a)
    rows = (shares[0], zero, zero, zero), (zero, shares[1], zero, zero)
    return jnp.stack([jnp.stack(x) for x in (*rows, (zero, zero, a, -b), (zero, zero, b, a))])
