"""Polarised radiative transfer: published Stokes vectors, limits, symmetries, ends of ranges."""

import collections
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import common
import irisjax as ij
from common import any_order, layers, quick_jit, reference, slowly
from edges import grazes
from irisjax.optics.mueller import rotation
from irisjax.transport.radiative.directions import MODES
from irisjax.transport.radiative.polarised.exact import solve_polarised
from irisjax.transport.radiative.polarised.modes import PolarisedMode

IRIS = (1.336, 1.4733333333, 1.4727930095, 1.5)
TURNING = (1.0, 1.3, 1.6, 1.2)  # total reflection at every interface
EXITS = np.array([1.0, 0.8, 0.8, 0.6, 0.4, 0.15])
AZIMUTH = np.array([0.0, 0.3, 2.0, np.pi / 2, np.pi - 0.2, 1.0])
SOLVER = ij.RadiativeExact(40, 12, 1, process=ij.POLARISED)


def solve(made, cosine=1.0, exits=EXITS, azimuth=AZIMUTH, solver=SOLVER):
    """One program for nearly everything here."""
    return common.solve(solver, any_order(made), cosine, exits, azimuth)


def test_check_slab():
    """The slab of tests/transport/test_depth_resolved.py, of which scalar theory says 1.7 % less; full
    Stokes theory by Monte Carlo.
    """
    made = layers(0.0, 0.18 * 0.2, 0.18 * 0.8, (1.0, 1.0, 1.473 / 1.336, 1.473 / 1.336))
    found = solve(made)
    assert float((found.reflectance + found.mirrored)[0]) == pytest.approx(0.049944, abs=2e-5)


def test_reference_table():
    """Natraj, Li and Yung 2009: the Stokes vector at every direction, to 1e-5 (2e-6 found)."""
    rows = reference("rayleigh_polarised_tau05_mu02.csv")
    assert len(rows) > 100
    columns = {n: np.array([float(r[n]) for r in rows]) for n in rows[0]}
    azimuth = np.radians(columns["phi_deg"])
    made = layers(0.0, 0.0, 0.5, (1.0, 1.0, 1.0, 1.0))
    parts = np.split(np.stack([columns["mu"], azimuth]), range(6, len(rows), 6), axis=1)
    found = [np.asarray(solve(made, 0.2, *p).polarisation.brdf)[0] for p in parts]
    found = 0.2 * np.pi * np.concatenate(found)[:, :, 0]
    # Their axes turn the other way round.
    for sign, name, k in ((1, "I", 0), (-1, "Q", 1), (1, "U", 2)):
        np.testing.assert_allclose(sign * found[:, k], columns[name], rtol=0, atol=2e-6)
    np.testing.assert_allclose(found[:, 3], 0, atol=1e-15)


# Level, nm; reflectance and its error; π L/E along the normal and its error; share of it that is
# cross-polarised, of linearly polarised light. An independent Monte Carlo of 4e6 photons.
IRIDES = [
    ("low", 450, 0.02030, 2e-5, 0.01920, 1e-5, 0.014),
    ("low", 620, 0.01187, 3e-5, 0.00920, 1e-5, 0.013),
    ("moderate", 450, 0.00835, 1e-5, 0.00743, 1e-5, 0.009),
    ("high", 450, 0.00679, 1e-5, 0.00571, 1e-5, 0.008),
]


_layers_of = quick_jit(ij.Iris.layers)


@pytest.mark.parametrize("row", IRIDES, ids=lambda r: f"{r[0]}-{r[1]}")
def test_irides(row):
    level, nm, reflectance, error, radiance, radiance_error, crossed = row
    iris = ij.Iris.of_level(level).replace(abl_fraction=0.5)
    found = solve(_layers_of(iris, ij.extinction([float(nm)])))
    whole = float((found.reflectance + found.mirrored)[0])
    assert whole == pytest.approx(reflectance, abs=3 * error)
    matrix = np.pi * np.asarray(found.polarisation.brdf)[0, 0]
    assert matrix[0, 0] == pytest.approx(radiance, abs=3 * radiance_error)
    assert 0.5 * (1 - matrix[1, 1] / matrix[0, 0]) == pytest.approx(crossed, abs=1e-3)


HARD = (np.array([0.02, 0.3, 1.0]), np.array([0.05, 0.0, 0.8]), np.array([0.2, 0.8, 0.3]))


@pytest.mark.parametrize("media", [IRIS, TURNING, (1.5, 1.45, 1.4, 1.336)])
@pytest.mark.parametrize("cosine", [1.0, 0.2])
def test_energy(media, cosine):
    # Panels are for exits that do not graze, which media without a denser stroma have.
    found = solve(layers(*HARD, media), cosine, EXITS[EXITS > 0.5], AZIMUTH[EXITS > 0.5])
    np.testing.assert_allclose(found.energy, 1, rtol=0, atol=1e-12)
    assert bool(found.status == ij.RESULTS.successful)
    whole = found.polarisation.reflected[:, 0, 0]
    np.testing.assert_allclose(whole, found.reflectance, rtol=1e-12)


def test_diffuse_light():
    """The mean over directions, energy and all; matrices are of light from one direction."""
    made = layers(*HARD, IRIS)
    found = common.solve(SOLVER, any_order(made), "diffuse")
    np.testing.assert_allclose(found.energy, 1, rtol=0, atol=1e-12)
    assert found.polarisation is None  # no one asked for it
    x, w = np.polynomial.legendre.leggauss(12)
    mu, w = (x + 1) / 2, w / 2
    each = np.array([solve(made, m).reflectance for m in mu])
    np.testing.assert_allclose(found.reflectance, 2 * (w * mu) @ each, rtol=2e-4)


def _dipole(cosine, exits, azimuth):
    """Rayleigh's matrix between frames of directions down and up, from fields (1 − kk)·E."""
    sine = np.sqrt(1 - cosine**2)
    inward = np.array([[-cosine, 0, -sine], [0, 1, 0]])
    out = []
    for mu, phi in zip(exits, azimuth, strict=True):
        c, s, across = np.cos(phi), np.sin(phi), np.sqrt(1 - mu**2)
        jones = np.array([[mu * c, mu * s, -across], [-s, c, 0]]) @ inward.T
        (ll, lr), (rl, rr) = jones
        matrix = [
            [ll * ll, lr * lr, ll * lr, 0],
            [rl * rl, rr * rr, rl * rr, 0],
            [2 * ll * rl, 2 * lr * rr, ll * rr + lr * rl, 0],
            [0, 0, 0, ll * rr - lr * rl],
        ]
        out.append(ij.optics.stokes(jnp.asarray(1.5 * np.array(matrix))))
    return np.array(out)


def test_single_scattering_is_the_rotated_phase_matrix():
    """The sum of the azimuthal orders, every element of it, as the albedo goes to nothing."""
    depth, albedo, cosine = 0.5, 1e-7, 0.6
    made = layers(0.0, depth * (1 - albedo), depth * albedo, (1.0,) * 4)
    found = solve(made, cosine).polarisation.brdf[0]
    path = 1 / cosine + 1 / EXITS
    law = albedo / (4 * np.pi) * (1 - np.exp(-depth * path)) / (cosine + EXITS)
    wanted = law[:, None, None] * _dipole(cosine, EXITS, AZIMUTH)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=3e-7 * np.abs(wanted).max())


@pytest.mark.parametrize("media", [IRIS, TURNING])
def test_reciprocity(media):
    """Light sent back the way it came: the matrix transposed, U and V by a mirror."""
    made, pair = layers(*HARD, media), np.array([0.9, 0.35])
    there, back = (
        np.asarray(solve(made, mu, pair, np.full(2, azimuth)).polarisation.brdf)
        for mu, azimuth in zip(pair, (1.1, -1.1), strict=True)
    )
    flip = np.diag([1.0, 1, -1, 1])
    wanted = flip @ np.swapaxes(back[:, 0], -1, -2) @ flip
    np.testing.assert_allclose(there[:, 1], wanted, rtol=0, atol=2e-7 * there[..., 0, 0].max())


def test_along_the_normal_no_direction_is_preferred():
    """Light along the normal: the matrix of the normal exit is the same from every azimuth."""
    azimuth = np.linspace(0, 3, 6)
    found = solve(layers(*HARD, TURNING), 1.0, np.ones(6), azimuth)
    matrix = np.asarray(found.polarisation.brdf)[0]
    turned = np.asarray(rotation(-jnp.asarray(azimuth))) @ matrix
    np.testing.assert_allclose(turned, np.broadcast_to(matrix[:1], matrix.shape), atol=1e-14)
    np.testing.assert_allclose(matrix[:, 1, 0], 0, atol=1e-15)


def test_scalar_limit():
    """The polarised solver gives scalar theory's fates if the phase matrix has its first element
    alone (half of it for either wave) and all media have one refractive index.
    """
    made, lit = layers(*HARD, (1.4, 1.4, 1.4, 1.4)), common.light(0.6)
    halves = tuple(0.5 * x for x in MODES[0].strength)

    def linear(mu):
        return jnp.stack([MODES[0].functions(mu)] * 2, 1)

    mode = PolarisedMode(0, halves, (1, 1, 1), linear, None, None, None)
    found = quick_jit(lambda x: solve_polarised(x, lit, 12, (4, 1), (mode,))[0])(made)
    scalar = quick_jit(lambda x: ij.RadiativeExact(12, 4, 1).solve(x, lit))(made)
    np.testing.assert_allclose(found.reflectance, scalar.reflectance, rtol=1e-12)
    np.testing.assert_allclose(found.ipe, scalar.absorbed.ipe, rtol=1e-12)


@pytest.mark.parametrize("media", [IRIS, (1.2, 1.5, 1.3, 1.6), TURNING])
@pytest.mark.parametrize("cosine", [0.7, 1.0, 0.1])
def test_without_scattering_fresnel_alone(media, cosine):
    """Waves bounced to and fro one by one, their complex amplitudes multiplied."""
    abl, stroma = 0.3, 0.2
    found = solve(layers(abl, stroma, 0.0, media), cosine)
    sine = media[0] * np.sqrt(1 - cosine**2)
    mu = [np.sqrt(complex(1 - (sine / n) ** 2)) for n in media]

    def amplitudes(i, j, p):
        a, b = (media[j], media[i]) if p else (media[i], media[j])
        share = np.sqrt(media[j] * mu[j].real / (media[i] * mu[i].real)) if mu[i].real else 0.0
        total = a * mu[i] + b * mu[j]
        return (a * mu[i] - b * mu[j]) / total, 2 * media[i] * mu[i] / total * share

    def sent(*kinds):
        """Of a pair of waves the product of amplitudes that comes back, bounce by bounce."""
        t = [amplitudes(0, 1, p)[1] for p in kinds]
        states, out = {(1, 1): t[0] * np.conj(t[1])}, 0.0
        for _ in range(400):
            following = collections.defaultdict(complex)
            for (layer, way), pair in states.items():
                fade = np.exp(-(abl, stroma)[layer - 1] / mu[layer].real) if mu[layer].real else 0.0
                ahead = layer + way
                r, t = np.transpose([amplitudes(layer, ahead, p) for p in kinds])
                following[layer, -way] += pair * fade * r[0] * np.conj(r[1])
                on = pair * fade * t[0] * np.conj(t[1]) if mu[ahead].real else 0.0
                if ahead == 0:
                    out += on
                elif ahead < 3:
                    following[ahead, way] += on
            states = following
        return out

    p, s, w = sent(True, True), sent(False, False), sent(True, False)
    wanted = 0.5 * np.array(
        [
            [p.real + s.real, p.real - s.real, 0, 0],
            [p.real - s.real, p.real + s.real, 0, 0],
            [0, 0, 2 * w.real, -2 * w.imag],
            [0, 0, 2 * w.imag, 2 * w.real],
        ]
    )
    np.testing.assert_allclose(found.polarisation.reflected[0], wanted, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.polarisation.brdf, 0, atol=1e-300)
    assert float(found.reflectance[0]) == pytest.approx(wanted[0, 0], rel=1e-12, abs=1e-15)


DEPTHS = (0.0, 1e-12, 1e-3, 0.5, 1e3, 1e6)


@pytest.mark.parametrize(
    ("media", "deepest", "bits"),
    [(IRIS, 0.5, 64), slowly(TURNING, 1e6, 64), slowly(IRIS, 1e6, 32)],
)
def test_extremes(media, deepest, bits):
    """Finite and physical, or a status that says why not; at grazing incidence and exits too.

    Layers of an optical depth of a million take 24 panels, each of which is compiled.
    """
    ends, exits = [x for x in DEPTHS if x <= deepest], np.array([1.0, 0.5, 0.1, 1e-3, 1e-6, 0.0])
    depths = np.array([x.ravel() for x in np.meshgrid(ends, ends)])
    depths = depths[:, depths.sum(0) <= 1.01 * deepest]
    whole, abl = depths.sum(0), np.resize([0.0, 1e-12, 0.3, 1e6], depths.shape[1])
    # Scattered more often than single precision can count: refused as ill-conditioned.
    held = depths[0] / np.maximum(whole, 1e-300) + 1 / np.maximum(whole, 1) ** 2
    depths = np.stack([abl, *depths])[:, held > (1e-5 if bits == 32 else 0)]
    solver = ij.RadiativeExact(16, 8, 24, process=ij.POLARISED) if deepest > 1 else SOLVER
    slack = 1e-9 if bits == 64 else 2e-3
    # Four wavelengths at a time share the program of the tests above.
    fours = range(0, depths.shape[1], 4)
    for cosine, first in itertools.product((1.0, 1e-3, 0.0), fours):
        made = layers(*depths[:, first : first + 4], media)
        found = solve(made, cosine, exits, solver=solver)
        for leaf in jax.tree.leaves((found.reflectance, found.absorbed, found.polarisation)):
            assert np.isfinite(leaf).all()
        few = any(grazes(media, c) for c in (cosine, *exits))
        few = few and bool(found.status == ij.RESULTS.under_resolved)
        assert few or bool(found.status == ij.RESULTS.successful)
        shares = np.array([found.reflectance, found.mirrored, found.absorbed.ipe])
        assert (shares > -slack).all() and (shares < 1 + slack).all()
        matrices = np.concatenate(
            [np.asarray(found.polarisation.brdf).reshape(-1, 4, 4), found.polarisation.reflected]
        )
        # No light is sent out more than wholly polarised, whatever light comes in.
        for light in ([1, 0, 0, 0], [1, 1, 0, 0], [1, -1, 0, 0], [1, 0, 1, 0], [1, 0, 0, 1]):
            i, *rest = np.moveaxis(matrices @ np.array(light, float), -1, 0)
            excess = np.linalg.norm(rest, axis=0) - i
            assert (excess < slack * (1e-6 + np.abs(matrices).max())).all()


def _seen_by(meter):
    """Return the solution that a polarimeter or analyser reads, and its factor on light."""
    factor, lit = meter.incident()
    made = _layers_of(ij.Iris.of_level("low"), meter.pigments, 1.336)
    exits = lit.exits and (np.asarray(x) for x in (lit.exits.cosine, lit.exits.azimuth))
    return solve(made, float(lit.cosine), *(exits or ([1.0], [0.0]))), factor


@quick_jit
def _read(instrument, solution, factor):
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        return instrument.reading(solution, factor)


@pytest.mark.parametrize("where", [1.0, 0.6, "hemisphere"])
def test_both_analysers_make_the_whole(where):
    """The readings of crossed and parallel analysers add up to that without an analyser, in the mean
    over two polarisers at right angles, which make the light unpolarised.
    """
    settings = {"cos_exit": where, "cos_incidence": 0.8, "azimuth": 0.7}
    total = 0.0
    for setting, polariser in itertools.product(("crossed", "parallel"), (0.3, 0.3 + np.pi / 2)):
        analyser = ij.Analyser([450.0, 620.0], setting, polariser=polariser, **settings)
        solution, factor = _seen_by(analyser)
        values = np.asarray(_read(analyser, solution, factor).values)
        assert (values > 0).all()
        total = total + 0.5 * values
    whole = np.asarray(solution.reflectance) + np.asarray(solution.mirrored)
    wanted = whole if where == "hemisphere" else np.pi * np.asarray(solution.brdf)[:, 0]
    np.testing.assert_allclose(total, wanted, rtol=1e-10)


def test_far_from_the_normal_light_is_polarised_across_the_plane():
    meter = ij.Polarimeter([450.0, 620.0], cos_exit=0.5)
    seen = _read(meter, *_seen_by(meter))
    assert (np.asarray(seen.values) > 0.3).all()
    np.testing.assert_allclose(np.abs(seen.angle), np.pi / 2, atol=1e-6)
    assert seen.stokes.shape == (2, 4)


@pytest.mark.slow
@pytest.mark.usefixtures("float32")
def test_single_precision():
    made = layers(*HARD, IRIS)
    found = solve(made, 0.6)
    assert found.polarisation.brdf.dtype == jnp.float32
    with jax.enable_x64(True):
        made = jax.tree.map(lambda x: jnp.asarray(np.asarray(x, np.float64)), made)
        double = solve(made, 0.6)
        wanted = np.asarray(double.polarisation.brdf), np.asarray(double.reflectance)
    np.testing.assert_allclose(found.reflectance, wanted[1], rtol=2e-5)
    np.testing.assert_allclose(
        found.polarisation.brdf, wanted[0], rtol=0, atol=2e-5 * wanted[0].max()
    )


@pytest.mark.slow  # a minute and a half of compiling
def test_gradients():
    """By every depth and index, of numbers that depend on every order, against differences."""

    def value(x):
        made = layers(0.0, 0.0, 0.0, TURNING)
        indices = ij.RefractiveIndices(*x[3:7])
        made = type(made)(x[:1], x[1:2], x[2:3], indices, type(made.order)())
        found = ij.RadiativeExact(24, 8, 1, process=ij.POLARISED).solve(
            made, ij.Light(x[7], ij.Directions(EXITS[:5], AZIMUTH[:5]))
        )
        weight = np.cos(np.arange(80.0)).reshape(5, 4, 4)
        light = found.polarisation
        return (light.brdf[0] * weight).sum() + (light.reflected[0] * weight[0]).sum()

    x = jnp.array([0.1, 0.2, 0.7, *TURNING, 0.8])
    gradient = np.asarray(quick_jit(jax.grad(value))(x))
    # Rounding decides on which side of a critical angle a node falls, where each of the 80 numbers
    # jumps by up to 5e-10: hence the long step, and what is allowed beside it.
    run, step = quick_jit(value), 1e-4
    differences = [
        float(run(x.at[k].add(step)) - run(x.at[k].add(-step))) / (2 * step) for k in range(x.size)
    ]
    np.testing.assert_allclose(gradient, differences, rtol=2e-5, atol=1e-4)


def test_refusals():
    with pytest.raises(ValueError, match="MonteCarlo does not treat polarised light"):
        ij.MonteCarlo(10, process=ij.POLARISED)
    with pytest.raises(ValueError, match="not of diffuse light"):
        ij.Light(None, ij.Directions(0.5))
    with pytest.raises(ValueError, match="not of diffuse light"):
        ij.Light(None, matrices=True)
    assert ij.RadiativeTransfer() == ij.DEPTH_RESOLVED != ij.POLARISED
    assert hash(ij.RadiativeTransfer(polarised=False)) == hash(ij.DEPTH_RESOLVED)
