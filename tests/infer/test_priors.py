"""Priors: against scipy, and within the bounds of their parameters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import irisjax as ij
from irisjax.infer.parameters import PARAMETERS, derived, iris_of, of_iris
from irisjax.infer.priors import LogitNormal, LogNormal, LogUniform, Normal, Uniform, prior_of

SCIPY = [
    (LogNormal(0.15, 1.2), stats.lognorm(1.2, scale=0.15)),
    (Uniform(-1.0, 3.0), stats.uniform(-1, 4)),
    (LogUniform(0.1, 30.0), stats.loguniform(0.1, 30)),
    (Normal(0.5, 0.3, 0.0, 1.0), stats.truncnorm(-0.5 / 0.3, 0.5 / 0.3, 0.5, 0.3)),
    (Normal(5.0, 2.0), stats.truncnorm(-2.5, np.inf, 5, 2)),
]


@pytest.mark.parametrize(("prior", "reference"), SCIPY, ids=lambda x: repr(x)[:12])
def test_priors_are_the_distributions_they_say(prior, reference):
    z = np.linspace(-4, 4, 33)
    np.testing.assert_allclose(
        reference.cdf(np.asarray(prior.value(z))), stats.norm.cdf(z), rtol=1e-9, atol=1e-14
    )
    np.testing.assert_allclose(prior.standard(prior.value(z)), z, atol=1e-6)


def test_logit_normal():
    z = np.linspace(-6, 6, 33)
    value = np.asarray(LogitNormal(0.2, 0.8).value(z))
    np.testing.assert_allclose(
        np.log(value / (1 - value)), np.log(0.25) + 0.8 * z, rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("name", PARAMETERS)
def test_prior_draws_stay_inside_the_bounds(name):
    p = PARAMETERS[name]
    value = np.asarray(p.prior.value(np.linspace(-8, 8, 33)))
    assert np.isfinite(value).all()
    assert (np.diff(value) >= 0).all()
    low, high = p.support
    assert low <= value.min() <= value.max() <= high


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lognormal", "no prior"),
        ("cauchy(0, 1)", "no prior"),
        ("lognormal(1)", "no prior"),
        ("lognormal(0, 1)", "no distribution"),
        ("uniform(0.6, 0.2)", "no distribution"),
        ("uniform(0, nan)", "no distribution"),
        ("lognormal(0.5, 1)", "reaches outside"),
        ("uniform(0, 1.5)", "reaches outside"),
        ("normal(3, 0.1)", "lies outside"),
    ],
)
def test_bad_priors_are_named(text, message):
    with pytest.raises(ValueError, match=message):
        prior_of(text, 0, 1)
    assert repr(prior_of("Normal( 0.5 , 0.1 )", 0, 1)) == "normal(0.5, 0.1)"


RANGES = {
    "melanin_load": (1e-3, 5), "abl_fraction": (0, 1), "pheomelanin_share": (0, 1),
    "hemoglobin": (1e-3, 1), "saturation": (0, 1), "stroma_thickness": (0.05, 1),
    "abl_thickness": (0.01, 0.2), "scattering_scale": (1.3, 1.3),
}  # fmt: skip


@settings(max_examples=15)
@given(st.fixed_dictionaries({name: st.floats(*ends) for name, ends in RANGES.items()}))
def test_parameters_make_the_iris_they_describe(values):
    iris = iris_of(values, ij.Iris())
    back = of_iris(iris)
    for name, value in values.items():
        assert float(back[name]) == pytest.approx(value, rel=1e-12, abs=1e-12)
    made = {n: pytest.approx(float(v), abs=1e-12) for n, v in derived(values).items()}
    assert float(iris.melanin_load * iris.abl_fraction) == made["abl_melanin"]
    assert float(iris.eumelanin) == made["eumelanin"]


@pytest.mark.parametrize("name", ["melanin_load", "hemoglobin", "stroma_thickness", "gain"])
def test_a_prior_may_have_a_tail_beyond_what_may_be_stated(name):
    known = PARAMETERS[name]
    assert prior_of("lognormal(0.1, 0.3)", *known.support).median == 0.1
    assert np.isfinite(known.allowed.high)
