"""Agreement of measurements that were made twice: intraclass correlation, limits of agreement."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats

from irisjax.infer.model_comparison import Interval

_TAIL = 0.975  # of 95 % intervals


class IntraclassCorrelation(NamedTuple):
    """Share of the variance that is the subjects' own.

    Attributes:
        agreement: ICC(2,1): of one measurement, where a shift between raters counts as error.
        consistency: ICC(3,1): the same where it does not.
    """

    agreement: Interval
    consistency: Interval


class Agreement(NamedTuple):
    """Bland and Altman's comparison of two measurements: the mean of the differences second − first
    and the limits between which 95 % of these lie, each with its 95 % interval.
    """

    bias: Interval
    lower: Interval
    upper: Interval


def intraclass_correlation(x: Float[np.ndarray, "subjects raters"]) -> IntraclassCorrelation:
    """Compute ICC(2,1) and ICC(3,1) with 95 % intervals  [Shrout & Fleiss 1979, pp. 423-425];
    `ValueError` for measurements that repeat without any difference.
    """
    n, k = x.shape
    total = ((x - x.mean()) ** 2).sum()
    between = k * ((x.mean(axis=1) - x.mean()) ** 2).sum()
    judges = n * ((x.mean(axis=0) - x.mean()) ** 2).sum()
    bms, jms = between / (n - 1), judges / (k - 1)
    ems = (total - between - judges) / ((n - 1) * (k - 1))
    if not ems > 1e-20 * total / n:
        raise ValueError("the measurements repeat exactly, so they say nothing about their error")
    degrees = (n - 1) * (k - 1)
    ratio = bms / ems
    low = ratio / stats.f.ppf(_TAIL, n - 1, degrees)
    high = ratio * stats.f.ppf(_TAIL, degrees, n - 1)
    consistency = Interval(*(float((f - 1) / (f + k - 1)) for f in (ratio, low, high)))
    icc = (bms - ems) / (bms + (k - 1) * ems + k * (jms - ems) / n)
    f = jms / ems
    # Satterthwaite's degrees of freedom of the denominator.
    part = n * (1 + (k - 1) * icc) - k * icc
    v = degrees * (k * icc * f + part) ** 2 / ((n - 1) * k**2 * icc**2 * f**2 + part**2)
    f_high, f_low = stats.f.ppf(_TAIL, n - 1, v), stats.f.ppf(_TAIL, v, n - 1)
    remainder = k * jms + (k * n - k - n) * ems
    low = n * (bms - f_high * ems) / (f_high * remainder + n * bms)
    high = n * (f_low * bms - ems) / (remainder + n * f_low * bms)
    return IntraclassCorrelation(Interval(float(icc), float(low), float(high)), consistency)


def agreement(first: Float[np.ndarray, " n"], second: Float[np.ndarray, " n"]) -> Agreement:
    """Compute bias and limits of agreement with 95 % intervals  [Bland & Altman 1986]."""
    difference = second - first
    n, sd = difference.size, float(difference.std(ddof=1))
    bias = float(difference.mean())
    t = float(stats.t.ppf(_TAIL, n - 1))
    of_bias, of_limits = sd / np.sqrt(n), sd * np.sqrt(3 / n)  # standard errors
    estimates = (bias, of_bias), (bias - 1.96 * sd, of_limits), (bias + 1.96 * sd, of_limits)
    return Agreement(*(Interval(x, x - t * error, x + t * error) for x, error in estimates))
