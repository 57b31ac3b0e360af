import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mpmath import mp, mpf

from irisjax.numerics.roots import safe_sqrt
from irisjax.optics import fresnel as laws
from irisjax.optics.fresnel import critical_cosine_squared

coherence, fresnel_at, refract = map(jax.jit, (laws.coherence, laws.fresnel_at, laws.refract))
slopes = jax.jit(jax.grad(lambda *x: laws.fresnel_at(*x)[0], argnums=(0, 1, 2)))
slopes_of_passed = jax.jit(jax.grad(lambda *x: laws.fresnel_at(*x)[1], argnums=(0, 1, 2)))
indices = st.floats(1.0, 3.0)
cosines = st.floats(0.0, 1.0)


def array(x):
    return jnp.asarray(x, float)


def test_all_is_reflected_at_grazing_and_beyond_the_critical_angle():
    critical = np.sqrt(1 - (1.336 / 1.4733) ** 2)
    for mu, n, m in (
        *((x * critical, 1.4733, 1.336) for x in (0.0, 0.5, 0.999999)),
        *((0.0, 1.0, 1.5), (0.0, 1.5, 1.0), (0.0, 1.4, 1.4 * (1 + 1e-14))),
    ):
        f, t = fresnel_at(array(mu), array(n), array(m))
        assert (f, t) == (1, 0)
        assert mu == 0 or refract(array(mu), array(n), array(m)) == 0


def test_critical_cosine():
    assert critical_cosine_squared(array(1.4733), array(1.336)) == pytest.approx(
        1 - (1.336 / 1.4733) ** 2, rel=1e-13
    )
    assert critical_cosine_squared(array(1.336), array(1.4733)) < 0
    # 65.07 degrees at the top of the ABL, 88.4 at its bottom (ilit.md, section 4).
    for n_out, angle, places in ((1.336, 65.07, 0.005), (1.472793, 88.4, 0.06)):
        c = np.sqrt(critical_cosine_squared(array(1.4733333), array(n_out)))
        assert np.degrees(np.arccos(c)) == pytest.approx(angle, abs=places)


def test_matched_media_do_not_reflect(bits):
    mu = array([0.0, 1e-12, 1e-6, 0.3, 1.0])
    f, t = fresnel_at(mu, array(1.4), array(1.4))
    np.testing.assert_array_equal(f, 0)
    np.testing.assert_allclose(t, 1, rtol=4 * np.finfo(f.dtype).eps)
    assert f.dtype == (np.float64 if bits == 64 else np.float32)


@example(1e-200, 1.4, 1.4)
@example(1e-170, 1.0, 1.5)
@given(cosines, indices, indices)
def test_energy(mu, n, m):
    f, t = fresnel_at(array(mu), array(n), array(m))
    assert 0 <= f <= 1 + 1e-15
    assert 0 <= t <= 1 + 1e-15
    assert f + t == pytest.approx(1, abs=1e-15 * 8)


@pytest.mark.parametrize(
    ("n", "m"), [(1.336, 1.4733), (1.4733, 1.4728), (1.0, 2.5), (1.5, 1.5 * (1 + 1e-9))]
)
@pytest.mark.parametrize("mu", [1e-9, 1e-4, 0.05, 0.7, 1.0])
def test_relative_precision_of_transmittance(mu, n, m):
    with mp.workdps(40):
        a, p, q = mpf(mu), mpf(n), mpf(m)
        s = 1 - (p / q) ** 2 * (1 - a * a)
        if s <= 0:
            expected = mpf(0)
        else:
            b = mp.sqrt(s)
            expected = 2 * p * q * a * b * (1 / (p * a + q * b) ** 2 + 1 / (q * a + p * b) ** 2)
        _, t = fresnel_at(array(mu), array(n), array(m))
        assert float(t) == pytest.approx(float(expected), rel=1e-12, abs=0)


@pytest.mark.parametrize(
    ("mu", "n", "m"),
    [
        (0.0, 1.0, 1.5),
        (0.0, 1.5, 1.0),
        (0.0, 1.4, 1.4),
        (1.0, 1.4, 1.4),
        (0.2, 1.5, 1.2),
        (1e-12, 1.2, 1.5),
        (None, 1.5, 1.2),  # the critical angle
    ],
)
def test_gradients_are_finite_at_edges(mu, n, m, bits):
    media = array(n), array(m)
    mu = jnp.sqrt(critical_cosine_squared(*media)) if mu is None else array(mu)
    for g in (slopes, slopes_of_passed):
        assert np.isfinite(g(mu, *media)).all()


@pytest.mark.parametrize("x", [(0.4, 1.0, 1.5), (0.9, 1.5, 1.2), (0.05, 1.336, 1.4733)])
def test_gradients_against_finite_differences(x):
    g = slopes(*map(array, x))
    for i in range(3):
        h = 1e-6
        ends = [
            fresnel_at(*(array(v + s * h * (k == i)) for k, v in enumerate(x)))[0] for s in (1, -1)
        ]
        assert g[i] == pytest.approx(float(ends[0] - ends[1]) / (2 * h), rel=1e-7)


def test_safe_sqrt():
    np.testing.assert_array_equal(safe_sqrt(array([-1.0, 0.0, 4.0])), [0, 0, 2])
    np.testing.assert_array_equal(
        jax.vmap(jax.grad(safe_sqrt))(array([-1.0, 0.0, 4.0])), [0, 0, 0.25]
    )


@pytest.mark.parametrize(("n_in", "n_out"), [(1.5, 1.0), (1.0, 1.5), (1.4, 1.336)])
def test_coherence_is_the_product_of_fresnels_amplitudes(n_in, n_out):
    """r_p r_s* of complex amplitudes, total reflection included, field as e^{−iωt}: beyond an
    interface that mirrors totally it dies away, so that the cosine there is positive imaginary.
    [Born & Wolf 1999, Section 1.5.4]
    """
    cosine = np.linspace(0.02, 1.0, 50)
    beyond = np.sqrt((1 - (n_in / n_out) ** 2 * (1 - cosine**2)).astype(complex))
    s = (n_in * cosine - n_out * beyond) / (n_in * cosine + n_out * beyond)
    p = (n_out * cosine - n_in * beyond) / (n_out * cosine + n_in * beyond)
    refracted = refract(jnp.asarray(cosine), n_in, n_out)
    found = coherence(jnp.asarray(cosine), refracted, n_in, n_out)
    np.testing.assert_allclose(found.reflected, p * s.conj(), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found.lost, 1 - p * s.conj(), rtol=1e-9, atol=1e-13)
