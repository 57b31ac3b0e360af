import itertools

import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij


def test_normal_incidence():
    total, cosine = ij.Media().inward(jnp.asarray(1.0))
    media = (1.0, 1.337, 1.3771, 1.336)
    expected = np.prod([1 - ((a - b) / (a + b)) ** 2 for a, b in itertools.pairwise(media)])
    assert total == pytest.approx(expected, rel=1e-14)
    assert total == pytest.approx(0.979, abs=5e-4)
    assert cosine == 1


def test_oblique_incidence_follows_snell():
    total, cosine = ij.Media().inward(jnp.asarray(0.5))
    assert np.sqrt(1 - cosine**2) == pytest.approx(np.sqrt(0.75) / 1.336, rel=1e-13)
    assert 0.9 < total < 0.979
    assert ij.Media().inward(jnp.asarray(0.0))[0] == 0


def test_an_index_that_no_medium_has_is_named():
    with pytest.raises(ValueError, match=r"^aqueous = 0\.9 is outside \[1, 3\]$"):
        ij.Media(aqueous=0.9)


def test_an_eye_has_one_chamber():
    eye = ij.Eye(cornea=ij.Cornea.f09(), aqueous_index=1.376)
    assert (float(eye.media.aqueous), float(eye.media.cornea)) == pytest.approx((1.376, 1.376))
