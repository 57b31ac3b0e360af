"""Polarised radiative transfer as an integral equation, solved as the scalar one is.

Every order in azimuth of Rayleigh's phase matrix is a sum of one or two products, and what mirrors
do is diagonal in I_l, I_r and W = (U + iV)/√2: each of these along a direction is what a direction
is in scalar theory.
"""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from irisjax.numerics import linear
from irisjax.numerics.sharding import laid_out
from irisjax.optics.mueller import stokes
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light, beams_of
from irisjax.transport.radiative.balance import energy_balance, solve_balanced
from irisjax.transport.radiative.directions import from_outside, quadrature_nodes, roof_of, split
from irisjax.transport.radiative.fates import before
from irisjax.transport.radiative.polarised.interfaces import (
    Met,
    Rays,
    both,
    meet,
    rays,
    turning_roof,
    unscattered,
)
from irisjax.transport.radiative.polarised.modes import RAYLEIGH, PolarisedMode
from irisjax.transport.radiative.resolution import seen_depth, status_of, steepness
from irisjax.transport.radiative.slab import Slab
from irisjax.transport.solution import Absorbed, Polarisation, Solution

_ROOT_HALF = math.sqrt(0.5)


class Shares(NamedTuple):
    """Where the unpolarised light of one wavelength goes."""

    reflectance: jax.Array
    mirrored: jax.Array
    abl: jax.Array
    stroma: jax.Array
    ipe: jax.Array


class Matrices(NamedTuple):
    """The fields of `Polarisation`, of one wavelength."""

    reflected: jax.Array
    mirrored: jax.Array
    brdf: jax.Array | None


class Lit(NamedTuple):
    """The light on the iris: its directions, their cosines in the aqueous humour and shares."""

    beams: Rays
    outside: jax.Array
    power: jax.Array


class Looked(NamedTuple):
    """Exits, and their azimuths."""

    exits: Rays
    azimuth: jax.Array


def solve(
    layers: Layers,
    light: Light,
    *,
    n_angles: int,
    n_depths: int,
    n_panels: int,
    modes: tuple[PolarisedMode, ...] = RAYLEIGH,
) -> Solution:
    """`AbstractSolver.solve` of polarised light; `modes` are those of the phase matrix, the first
    that of the whole intensity.
    """
    dtype = layers.extinction.dtype
    nodes = rays(quadrature_nodes, layers, n_angles)
    outside, power = beams_of(light, 2 * n_angles, layers.indices, dtype)
    lit = Lit(rays(from_outside, layers, outside), outside, power)
    looked = None
    if light.exits is not None:
        exits = rays(from_outside, layers, light.exits.cosine)
        looked = Looked(exits, light.exits.azimuth)
    wanted = light.matrices or looked is not None
    one = partial(_one_wavelength, how=(n_depths, n_panels), modes=modes, matrices=wanted)
    shares, matrices = laid_out(
        jax.vmap(one, in_axes=(0, 0, 0, 0, *(None,) * 4)),
        layers.extinction,
        *(layers.abl_absorption, layers.extinction, layers.albedo, layers.coalbedo),
        *(layers.indices, nodes, lit, looked),
    )
    return Solution(
        reflectance=shares.reflectance,
        mirrored=shares.mirrored,
        absorbed=Absorbed(abl=shares.abl, stroma=shares.stroma, ipe=shares.ipe),
        standard_error=None,
        total_error=None,
        brdf=None if looked is None else matrices.brdf[..., 0, 0],
        brdf_error=None,
        status=status_of(layers, n_depths, n_panels, steepness(layers, light)),
        polarisation=Polarisation(*matrices) if wanted else None,
    )


def _one_wavelength(abl, depth, albedo, coalbedo, n, nodes, lit, looked, *, how, modes, matrices):
    depth = seen_depth(depth, coalbedo)
    slab, beams = Slab(depth, *how), lit.beams
    sets = [nodes, beams] if looked is None else [nodes, beams, looked.exits]
    everywhere = jax.tree.map(lambda *x: jnp.concatenate(x, axis=-1), *sets)
    parts = split(meet(slab, abl, everywhere), [d.p for d in sets])
    angle, beam, *exit_ = (Met(both(*x[:2]), *x[2:]) for x in parts)
    first = [before(abl, depth, d) for d in (beams.p, beams.s)]
    entering = _entering(abl, lit)
    scattering = albedo, coalbedo
    shares, moments = _shares(slab, abl, scattering, modes[0], nodes, lit, angle, beam, first)
    if not matrices:
        return shares, None

    found = [(modes[0], jnp.pad(moments, ((0, 0), (0, 0), (0, 2))))]
    turned = turning_roof(abl, beams.w).passed
    for mode in modes[1:]:
        system = _system(slab, mode, _strength(mode, albedo), angle, nodes)
        right = _driving(slab, mode, beam, beams, entering, turned)
        solution = linear.solve(system, right.reshape(system.shape[0], 4))
        found.append((mode, solution.reshape(right.shape)))

    at_surface, back = unscattered(abl, depth, beams, lit.outside, n)
    reflected = _mirror([b.reflected[0] for b in first], back[0])
    for mode, x in found:
        if mode.order != 1:
            leaving = _leaving(slab, mode, _strength(mode, albedo), abl, angle, nodes, x)
            reflected += _collected(mode, nodes.p.weight * nodes.p.cosine, leaving)
    mirrored = _mirror([b.mirrored[0] for b in first], at_surface[0])
    brdf = None
    if looked is not None:
        exits, total = looked.exits, jnp.zeros((looked.azimuth.size, 4, 4), depth.dtype)
        for mode, x in found:
            leaving = _leaving(slab, mode, _strength(mode, albedo), abl, exit_[0], exits, x)
            total += leaving * _azimuthal(mode.order, looked.azimuth)
        brdf = stokes(total) * ((n.aqueous / n.stroma) ** 2 / (2 * jnp.pi))
    return shares, Matrices(stokes(reflected), stokes(mirrored), brdf)


def _shares(slab, abl, scattering, mode: PolarisedMode, nodes: Rays, lit: Lit, angle, beam, first):
    """`Shares`, and the moments of light that is all I_l, and all I_r: (terms, moments, 2)."""
    albedo, coalbedo = scattering
    assert mode.linear is not None
    of_nodes, strength = both(nodes.p, nodes.s), _strength(mode, albedo)
    system = _system(slab, mode, strength, angle, nodes)
    right = _driving(slab, mode, beam, lit.beams, _entering(abl, lit), None)
    roof = roof_of(abl, of_nodes, from_stroma=True)
    f = mode.linear(nodes.p.cosine).reshape(strength.size, -1)
    balance = energy_balance(slab, strength, f, angle.linear, of_nodes, roof, coalbedo)
    lost = jnp.stack([lit.power @ b.lost for b in first])
    moments = solve_balanced(slab, system, right.reshape(system.shape[0], 2), balance, lost)
    moments = moments.reshape(right.shape)
    # Of unpolarised light either is one half.
    mean = moments.mean(-1)
    up_top, down_bottom = slab.leaving(angle.linear, (strength[:, None] * f).T @ mean, 1)
    flux = of_nodes.weight * of_nodes.cosine
    straight = jax.tree.map(lambda *x: lit.power @ (0.5 * sum(x)), *first)
    inside = mean[0].reshape(slab.n_panels, slab.n_depths)[:, 0]
    shares = Shares(
        reflectance=straight.reflected + flux @ (up_top * roof.passed),
        mirrored=straight.mirrored,
        abl=straight.abl + flux @ (up_top * roof.absorbed),
        stroma=coalbedo * (slab.widths @ inside),
        ipe=straight.passed + flux @ (down_bottom * of_nodes.bottom[1]),
    )
    return shares, moments


def _strength(mode: PolarisedMode, albedo):
    return albedo * jnp.asarray(mode.strength, albedo.dtype)


def _entering(abl, lit: Lit):
    """Flux of I_l and of I_r at the stroma's top, (2, beams)."""
    passed = (roof_of(abl, d, from_stroma=False).passed for d in (lit.beams.p, lit.beams.s))
    return jnp.stack([lit.power * p for p in passed])


def _system(slab, mode: PolarisedMode, strength, angle: Met, nodes: Rays):
    """I − K of the moments of every term, (terms·moments, terms·moments)."""
    terms, n = strength.size, slab.n_panels * slab.n_depths
    operator = jnp.zeros((terms, n, terms, n), strength.dtype)
    mu, weight = nodes.p.cosine, nodes.p.weight
    if mode.linear is not None:
        f = mode.linear(mu)
        rank = f.shape[0]
        f = f.reshape(rank, -1)
        own = slab.moments(angle.linear, jnp.tile(weight, 2), f, mode.signs(mu))
        operator = operator.at[:rank, :, :rank].add(own.reshape(rank, n, rank, n))
    if mode.turning is not None:
        f, sign = mode.turning(mu)[None], mode.parity[2]
        kept = slab.moments(angle.real, weight, f, sign)
        for term in (mode.u, mode.v):
            if term is not None:
                operator = operator.at[term, :, term].add(kept)
        if mode.u is not None and mode.v is not None:
            turned = slab.moments_of_images(angle.imaginary, weight, f, sign)
            operator = operator.at[mode.u, :, mode.v].add(-turned)
            operator = operator.at[mode.v, :, mode.u].add(turned)
    size = terms * n
    each = jnp.repeat(strength, n)
    return jnp.eye(size, dtype=strength.dtype) - operator.reshape(size, size) * each[None, :]


def _driving(slab, mode: PolarisedMode, beam: Met, beams: Rays, entering, turned):
    """Moments that light of I_l, I_r, U and V on the iris drives, (terms, moments, 4); of the first
    two alone where `turned`, what passes of W, is not given.
    """
    mu, n = beams.p.cosine, slab.n_panels * slab.n_depths
    right = jnp.zeros((len(mode.strength), n, 2 if turned is None else 4), mu.dtype)
    if mode.linear is not None:
        f = mode.linear(mu) * (entering / mu[None, :])[None]
        each = slab.driving_each(beam.linear, mode.signs(mu)).reshape(n, 2, -1)
        right = right.at[: f.shape[0], :, :2].add(jnp.einsum("rcb,ncb->rnc", f, each))
    if mode.turning is not None and turned is not None:
        sign, radiance = mode.parity[2], mode.turning(mu) / mu
        re, im = (slab.driving_each(x, sign) for x in (beam.real, beam.imaginary))
        a, b = (part(turned) * radiance for part in (jnp.real, jnp.imag))
        # Of light with U = 1, then V = 1: W = −1/√2, −i/√2 in the sign of `PolarisedMode`.
        of_u, of_v = _ROOT_HALF * (re @ a - im @ b), _ROOT_HALF * (re @ b + im @ a)
        if mode.u is not None:
            right = right.at[mode.u, :, 2:].add(jnp.stack([-of_u, of_v], -1))
        if mode.v is not None:
            right = right.at[mode.v, :, 2:].add(jnp.stack([-of_v, -of_u], -1))
    return right


def _leaving(slab, mode: PolarisedMode, strength, abl, met: Met, d: Rays, x):
    """I_l, I_r, U and V of radiance at the stroma's top, less what the ABL keeps of it, of light as
    in `_driving`, (directions, 4, 4).
    """
    mu, source = d.p.cosine, strength[:, None, None] * x
    out = jnp.zeros((mu.size, 4, 4), mu.dtype)
    if mode.linear is not None:
        f = mode.linear(mu)
        top = slab.leaving_each(met.linear, mode.signs(mu))[0].reshape(-1, 2, mu.size)
        passed = jnp.stack([roof_of(abl, y, from_stroma=True).passed for y in (d.p, d.s)])
        radiance = jnp.einsum("rca,nca,rni->aci", f * passed[None], top, source[: f.shape[0]])
        out = out.at[:, :2].add(radiance)
    if mode.turning is not None:
        sign, passed = mode.parity[2], turning_roof(abl, d.w).passed
        re = slab.leaving_each(met.real, sign)[0]
        im = slab.leaving_of_images_each(met.imaginary, sign)[0]
        nothing = jnp.zeros_like(source[0])
        u, v = (nothing if k is None else source[k] for k in (mode.u, mode.v))
        f = 2 * _ROOT_HALF * mode.turning(mu)[:, None]
        u, v = f * (re.T @ u - im.T @ v), f * (re.T @ v + im.T @ u)
        a, b = jnp.real(passed)[:, None], jnp.imag(passed)[:, None]
        out = out.at[:, 2].add(a * u - b * v).at[:, 3].add(a * v + b * u)
    return out


def _azimuthal(order: int, azimuth):
    """Factors of `_leaving` at azimuths, (exits, 4, 4)."""
    even, odd = jnp.cos(order * azimuth), jnp.sin(order * azimuth)
    blocks = jnp.stack([jnp.stack([even, odd], -1), jnp.stack([odd, -even], -1)], -2)
    return (1 if order == 0 else 2) * jnp.repeat(jnp.repeat(blocks, 2, -2), 2, -1)


def _collected(mode: PolarisedMode, flux, leaving):
    """What a lens collects over the hemisphere, seen in its plane: I_l, I_r, U and V along and
    across the plane of incidence. Orders 0 and 2 alone outlast the average over azimuth.
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


def _mirror(shares, turned):
    """Matrix of I_l, I_r, U and V of a mirror."""
    a, b = jnp.real(turned), jnp.imag(turned)
    zero = jnp.zeros_like(a)
    rows = (shares[0], zero, zero, zero), (zero, shares[1], zero, zero)
    return jnp.stack([jnp.stack(x) for x in (*rows, (zero, zero, a, -b), (zero, zero, b, a))])
