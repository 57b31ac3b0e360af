"""General scattering beside two codes of other people: iadpython and CDISORT (nanodisort).

No tolerance is chosen. From a coarse to a fine size each code's error falls to less than half, so
that its change bounds what is left: two codes may differ by the sum of their changes, the largest
relative ones over the numbers of a slab.
"""

import dataclasses
import itertools

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special

import irisjax as ij
from common import layers, quick_jit
from irisjax.optics.mixture import PhaseMixture

pytestmark = pytest.mark.peer

MATCHED, UNDER_GLASS = (1.0, 1.0, 1.0, 1.0), (1.0, 1.5, 1.4, 1.0)
GLASS = 0.05  # its optical depth
SIZES = ij.AddingDoubling(16, 8), ij.AddingDoubling(32, 10)
SLABS = list(itertools.product((0.6, 1.0), (0.1, 1.0, 8.0)))  # albedo, optical depth


def _layers(cases, indices, glass=0.0):
    """Layers of rows of albedo, optical depth, Rayleigh's share and g."""
    albedo, depth, rayleigh, g = np.asarray(cases, float).T
    made = layers(glass, depth * (1 - albedo), depth * albedo, indices)
    phase = PhaseMixture(jnp.asarray(rayleigh), jnp.asarray(g))
    return dataclasses.replace(made, phase=phase)


def _agree(ours, theirs):
    """Pairs of a coarse and a fine size, slabs along the first axis, by their logarithms."""
    ours, theirs = np.log(ours), np.log(theirs)
    allowed = sum(np.abs(fine - coarse).max(1) for coarse, fine in (ours, theirs))
    apart = np.abs(ours[1] - theirs[1]).max(1)
    assert (apart <= allowed).all(), (apart, allowed)


def _radau(count, low, high):
    """Radau's rule that holds the upper end; iadpython's own loses digits from 20 points on, and
    all of them from 32 (pull request 2 of its repository).
    """
    x, w = scipy.special.roots_jacobi(count - 1, 1.0, 0.0)
    x, w = np.append(x, 1.0), np.append(w / (1 - x), 2 / count**2)
    return low + (x + 1) / 2 * (high - low), w * (high - low) / 2


def _iadpython(iad, g, points):
    """Light back and through of a beam along the normal and of diffuse light: (slabs, 4)."""
    _, above, n, _ = UNDER_GLASS
    made = iad.Sample(g=g, n=n, n_above=above, n_below=n, quad_pts=points)  # none below
    made.b_above = GLASS
    parts = (
        iad.quadrature.gauss(points // 2, 0.0, made.nu_c()),
        _radau(points // 2, made.nu_c(), 1.0),
    )
    x, w = np.concatenate(parts, axis=1)
    made.nu, made.twonuw = x, 2 * x * w
    made.hp, made.hm = iad.hg_legendre(made)
    albedo, depth = np.transpose(SLABS)
    made.a, made.b = albedo, depth
    return np.stack(made.rt(), -1)


def test_shares_of_light():
    """Slabs with Fresnel's interfaces under a glass that absorbs; bare ones are compared below."""
    iad = pytest.importorskip("iadpython")
    peaks = (-0.5, 0.0, 0.5, 0.9)
    seen = _layers([(*slab, 0.0, g) for g in peaks for slab in SLABS], UNDER_GLASS, GLASS)

    def run(made, solver):
        found = [solver.solve(made, ij.Light(light)) for light in (1.0, None)]
        shares = [x for y in found for x in (y.reflectance + y.mirrored, y.absorbed.ipe)]
        return jnp.stack(shares, -1)

    ours = [np.asarray(quick_jit(run, static_argnums=1)(seen, size)) for size in SIZES]
    for k, g in enumerate(peaks):
        of_g = slice(k * len(SLABS), (k + 1) * len(SLABS))
        theirs = [_iadpython(iad, g, points) for points in (32, 64)]
        _agree([x[of_g] for x in ours], theirs)


EXITS, AZIMUTH = np.array([0.25, 0.6, 0.95]), np.array([0.0, 40.0, 110.0, 180.0])


def _disort(nd, case, cosine, streams):
    """Light back and through, and the BRDF at exits and azimuths."""
    albedo, depth, rayleigh, g = case
    made, moments = nd.DisortState(), 300
    made.nstr, made.nlyr, made.nmom, made.ntau = streams, 1, moments, 2
    made.numu, made.nphi, made.nphase = len(EXITS), len(AZIMUTH), 1
    made.usrtau = made.usrang = made.lamber = made.quiet = True
    made.onlyfl = False
    made.intensity_correction = made.old_intensity_correction = True
    made.allocate()
    made.dtauc, made.ssalb = np.array([depth]), np.array([albedo])
    order = np.arange(moments + 1)
    of_rayleigh = np.where(order == 0, 1.0, np.where(order == 2, 0.1, 0.0))
    made.pmom = (rayleigh * of_rayleigh + (1 - rayleigh) * g**order)[:, None]
    made.utau, made.umu, made.phi = np.array([0.0, depth]), EXITS, AZIMUTH
    made.fbeam, made.umu0, made.phi0, made.albedo, made.fisot = 1.0, cosine, 0.0, 0.0, 0.0
    made.solve()
    back, through = made.flup[0], made.rfldir[1] + made.rfldn[1]
    return np.array([back, through, *np.asarray(made.uu)[:, 0].ravel()]) / cosine


def test_radiance_of_oblique_light():
    """Shares and BRDF, also with a share of Rayleigh's law, of slabs without interfaces."""
    nd = pytest.importorskip("nanodisort")
    cosine = 0.61
    kinds = ((0.0, -0.5), (0.3, 0.5), (0.3, 0.9), (0.0, 0.95))  # Rayleigh's share, g
    slabs = ((0.9, 1.0), (0.999999, 5.0), (0.8, 0.1), (0.999999, 0.01))
    cases = [(*slab, *kind) for kind in kinds for slab in slabs]
    exits, azimuth = np.meshgrid(EXITS, np.radians(AZIMUTH), indexing="ij")

    def run(made, solver):
        directions = ij.Directions(exits.ravel(), azimuth.ravel())
        found = solver.solve(made, ij.Light(cosine, directions))
        shares = jnp.stack([found.reflectance, found.absorbed.ipe], -1)
        return jnp.concatenate([shares, found.brdf], -1)

    seen = _layers(cases, MATCHED)
    ours = [np.asarray(quick_jit(run, static_argnums=1)(seen, size)) for size in SIZES]  # fmt: skip
    theirs = [np.array([_disort(nd, x, cosine, n) for x in cases]) for n in (32, 64)]
    for k in range(len(kinds)):
        of_kind = slice(k * len(slabs), (k + 1) * len(slabs))
        _agree([x[of_kind] for x in ours], [x[of_kind] for x in theirs])
