"""Chains that teach others, and single precision."""

import numpy as np
import pytest
from test_posterior import KEY, rows, stated

from common import slowly
from irisjax.infer import posterior
from irisjax.infer.fit import fit
from irisjax.infer.noise import Noise
from irisjax.infer.posterior import sample


@pytest.mark.heavy
@pytest.mark.parametrize("when", [slowly(250), 251, slowly(700)])
def test_a_chain_that_is_too_slow_teaches_another(tmp_path, monkeypatch, when):
    """What is kept has the same distribution, and is the same if the work is interrupted."""
    problem, paths = stated(), [tmp_path / f"{name}.h5" for name in ("one", "whole", "mine")]
    options = {"walkers": 16, "key": KEY}
    one = sample(problem, paths[0], **options)
    monkeypatch.setattr(posterior, "TAUS", 300)
    reported = []
    chains = sample(problem, paths[1], progress=lambda n, _: reported.append(n), **options)
    assert chains.converged
    assert max(reported) > chains.steps > 500
    error = chains.z.std(axis=(0, 1)) * np.sqrt(1 / chains.ess_bulk + 1 / one.ess_bulk)
    assert (np.abs(one.z.mean(axis=(0, 1)) - chains.z.mean(axis=(0, 1))) < 4 * error).all()

    def stop(n, _):
        if n == when:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sample(problem, paths[2], progress=stop, **options)
    sample(problem, paths[2], resume=True, **options)
    for a, b in zip(*(rows(path) for path in paths[1:]), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.usefixtures("float32")
def test_single_precision_samples_without_a_warning(tmp_path):
    """Rounding leaves the fit's covariance symmetric; as sharp a measurement as any."""
    free = ["melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "noise"]
    problem = stated(free=free, noise=Noise(1e-3, 1e-5))
    best = fit(problem, key=KEY)
    assert best.covariance.dtype == np.float32
    np.testing.assert_array_equal(best.covariance, best.covariance.T)
    chains = sample(problem, tmp_path / "chain.h5", walkers=16, start=best, key=KEY, max_steps=600)
    assert chains.converged
