import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.anatomy import media as eye


def test_normal_incidence():
    total, cosine = eye.inward_transmittance(jnp.asarray(1.0))
    media = (1.0, 1.337, 1.3771, 1.336)
    expected = np.prod([1 - ((a - b) / (a + b)) ** 2 for a, b in itertools.pairwise(media)])
    assert total == pytest.approx(expected, rel=1e-14)
    assert total == pytest.approx(0.979, abs=5e-4)
    assert cosine == 1


def test_oblique_incidence_follows_snell():
    total, cosine = eye.inward_transmittance(jnp.asarray(0.5))
    assert np.sqrt(1 - cosine**2) == pytest.approx(np.sqrt(0.75) / 1.336, rel=1e-13)
    assert 0.9 < total < 0.979
    assert eye.inward_transmittance(jnp.asarray(0.0))[0] == 0
