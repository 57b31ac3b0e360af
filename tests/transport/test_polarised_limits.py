"""Polarised radiative transfer where something is absent, equal, or at the end of its range."""

import dataclasses
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import common
import irisjax as ij
from common import any_order, layers, quick_jit, slowly
from edges import grazes
from irisjax.transport.radiative.polarised.exact import solve_polarised
from irisjax.transport.radiative.polarised.modes import PolarisedMode

IRIS = (1.336, 1.4733333333, 1.4727930095, 1.5)
TURNING = (1.0, 1.3, 1.6, 1.2)  # total reflection at every interface
EXITS = np.array([1.0, 0.8, 0.8, 0.6, 0.4, 0.15])
AZIMUTH = np.array([0.0, 0.3, 2.0, np.pi / 2, np.pi - 0.2, 1.0])
FIVE_PANELS = ij.RadiativeExact(16, 8, 5)
HARD = (np.array([0.02, 0.3, 1.0]), np.array([0.05, 0.0, 1.5]), np.array([0.2, 2.5, 0.3]))


def solve(made, cosine, solver, exits=EXITS, azimuth=AZIMUTH):
    solver = dataclasses.replace(solver, process=ij.POLARISED)
    return common.solve(solver, any_order(made), cosine, exits, azimuth)


def _by_intensity_alone():
    """Rayleigh's matrix with all but its first element taken away."""
    one, half = jnp.ones_like, 0.5

    def same(*f):
        return jnp.stack([jnp.stack([x, x]) for x in f])

    def zero(mu):
        return same(one(mu), 1.5 * mu * mu - 0.5)

    def first(mu):
        return same(mu * jnp.sqrt(1 - mu * mu))

    def second(mu):
        return same(1 - mu * mu)

    return (
        PolarisedMode(0, (half * 0.5, half * 0.25), (1, 1, 1), zero, None, None, None),
        PolarisedMode(1, (half * 0.375,), (-1, -1, 1), first, None, None, None),
        PolarisedMode(2, (half * 0.09375,), (1, 1, 1), second, None, None, None),
    )


def test_scalar_limit():
    """With the phase matrix's first element in its place, between equal media: scalar theory."""
    made = layers(*HARD, (1.4, 1.4, 1.4, 1.4))
    run = quick_jit(
        lambda x: solve_polarised(
            x, ij.Light(0.6, ij.Directions(EXITS, AZIMUTH)), 40, (8, 2), _by_intensity_alone()
        )[0]
    )  # fmt: skip
    found, scalar = (
        run(made),
        common.solve(ij.RadiativeExact(n_panels=2), made, 0.6, EXITS, AZIMUTH),
    )
    for name in ("reflectance", "brdf"):
        np.testing.assert_allclose(getattr(found, name), getattr(scalar, name), rtol=1e-12)
    np.testing.assert_allclose(found.ipe, scalar.absorbed.ipe, rtol=1e-12)


@pytest.mark.parametrize("media", [IRIS, (1.2, 1.5, 1.3, 1.6), TURNING])
@pytest.mark.parametrize("cosine", [0.7, 1.0, 0.1])
def test_without_scattering_fresnel_alone(media, cosine):
    """Waves bounced to and fro one by one, their complex amplitudes multiplied."""
    abl, stroma = 0.3, 0.2
    found = solve(layers(abl, stroma, 0.0, media), cosine, FIVE_PANELS)
    sine = media[0] * np.sqrt(1 - cosine**2)
    mu = [np.sqrt(complex(1 - (sine / n) ** 2)) for n in media]

    def amplitudes(i, j, p):
        a, b = (media[j], media[i]) if p else (media[i], media[j])
        share = np.sqrt(media[j] * mu[j].real / (media[i] * mu[i].real)) if mu[i].real else 0.0
        total = a * mu[i] + b * mu[j]
        return (a * mu[i] - b * mu[j]) / total, 2 * media[i] * mu[i] / total * share

    def sent(down):
        """Of each pair of waves the products of amplitudes that come back, bounce by bounce."""
        states, out = {(1, 1): {k: np.prod(v) for k, v in down.items()}}, 0.0
        for _ in range(400):
            following = {}
            for (layer, way), pair in states.items():
                fade = np.exp(-(abl, stroma)[layer - 1] / mu[layer].real) if mu[layer].real else 0.0
                ahead = layer + way
                r, t = (np.array([amplitudes(layer, ahead, p)[k] for p in kinds]) for k in (0, 1))
                back = pair["x"] * fade * r[0] * np.conj(r[1])
                on = pair["x"] * fade * t[0] * np.conj(t[1]) if mu[ahead].real else 0.0
                following.setdefault((layer, -way), {"x": 0.0})["x"] += back
                if ahead == 0:
                    out += on
                elif ahead < 3:
                    following.setdefault((ahead, way), {"x": 0.0})["x"] += on
            states = following
        return out

    elements = {}
    for name, kinds in (("p", (True, True)), ("s", (False, False)), ("w", (True, False))):
        t = [amplitudes(0, 1, p)[1] for p in kinds]
        elements[name] = sent({"x": [t[0] * np.conj(t[1])]})
    p, s, w = (elements[k] for k in "psw")
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


MEDIA = ((1.4,) * 4, IRIS, TURNING, (1.6, 1.3, 1.2, 1.5))
DEPTHS = (0.0, 1e-12, 1e-3, 1.0, 1e3, 1e6)


@functools.cache
def _extreme(media, deepest):
    """Depths of absorption and scattering at the ends of their ranges, all pairs."""
    depths = [x for x in DEPTHS if x <= deepest]
    a, s = (x.ravel() for x in np.meshgrid(depths, depths))
    return layers(np.resize([0.0, 1e-12, 0.3, 1e6], a.size), a, s, media)


@pytest.mark.parametrize(
    ("media", "deepest", "bits"),
    [
        (IRIS, 1.0, 64),
        *(slowly(m, 1e6, bits) for m in MEDIA for bits in (64, 32)),
    ],
)
def test_extremes(media, deepest, bits):
    """Finite and physical, or a status that says why not; at grazing incidence and exits too.

    Layers of an optical depth of a million take 24 panels, each of which is compiled.
    """
    made, exits = _extreme(media, deepest), np.array([1.0, 0.5, 0.1, 1e-3, 1e-6, 0.0])
    if bits == 32:
        # Scattered more often than single precision can count: refused as ill-conditioned.
        depths = made.abl_absorption, made.stroma_absorption, made.stroma_scattering
        abl, absorbed, scattered = (np.asarray(x) for x in depths)
        whole = absorbed + scattered
        kept = absorbed / np.maximum(whole, 1e-300) + 1 / np.maximum(whole, 1) ** 2 > 1e-5
        some = (jnp.asarray(x[kept], float) for x in (abl, absorbed, scattered))
        made = type(made)(*some, made.indices, made.order)
    made = jax.tree.map(lambda x: jnp.asarray(np.asarray(x), float), made)
    solver = ij.RadiativeExact(16, 8, 24) if deepest > 1 else FIVE_PANELS
    slack = 1e-9 if bits == 64 else 2e-3
    # Four wavelengths at a time share the program of the test above.
    fours = np.array_split(np.arange(made.extinction.size), made.extinction.size // 4)
    for cosine, of in itertools.product((1.0, 1e-3, 0.0), fours):
        some = [
            x[of] for x in (made.abl_absorption, made.stroma_absorption, made.stroma_scattering)
        ]
        found = solve(layers(*some, media), cosine, solver, exits)
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
