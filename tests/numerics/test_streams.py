import jax
import jax.numpy as jnp
import numpy as np
import pytest

from irisjax.numerics.streams import check_key, fold_in_words, key_of, scales, uniform


@pytest.mark.parametrize("seed", [0, 1, 2**31 - 1, 123456789])
def test_words_are_those_of_fold_in(seed):
    key = jax.random.key(seed)
    counts = np.concatenate([np.arange(50), [2**16, 2**31 - 1, 2**31]]).astype(np.uint32)
    found, expected = _words(key, jnp.asarray(counts))
    np.testing.assert_array_equal(found, expected)


@jax.jit
def _words(key, counts):
    expected = jax.vmap(lambda c: jax.random.key_data(jax.random.fold_in(key, c)))(counts)
    k0, k1 = jax.random.key_data(key)
    return jnp.stack(fold_in_words(k0, k1, counts), -1), expected


def test_a_seed_is_the_same_key_whatever_the_environment_prefers():
    usual = key_of(7)
    with jax.default_prng_impl("rbg"):
        assert key_of(7) == usual


def test_uniform_is_never_an_end():
    ends = jax.jit(uniform)(jnp.asarray([0, 2**23 - 1], jnp.uint32), scales()[0])
    assert ends.dtype == jnp.float32
    assert 0 < ends[0] < ends[1] < 1


@pytest.mark.parametrize(
    ("key", "message"),
    [
        (None, "needs a key"),
        (0, "new-style"),
        (jax.random.PRNGKey(0), "new-style"),
        (jax.random.split(jax.random.key(0)), "one new-style key"),
        (jax.random.key(0, impl="rbg"), "threefry"),
    ],
)
def test_wrong_keys_are_named(key, message):
    with pytest.raises(ValueError, match=message):
        check_key(key)
