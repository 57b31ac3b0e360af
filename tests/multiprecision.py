"""ILIT with Rayleigh's phase function in 25 digits: another language's twin of the solver, sharing
no code with it.
"""

import itertools
from functools import partial

from mpmath import exp, fsum, lu_solve, matrix, mp, mpf, pi, sin, sqrt
from mpmath.calculus.quadrature import GaussLegendre

_RULE = GaussLegendre(mp)


def ilit_rayleigh(abl_absorption, stroma_absorption, stroma_scattering):
    """Reflectance at normal incidence, first surface left out, from the layers' optical depths."""
    with mp.workdps(25):
        f = pi / (4 * sin(pi / 3))
        n_water, n_a, n_s, n_ipe = (
            mpf("1.336"),
            mpf("1.42") / 3 + 1,
            mpf("1.47") * f + mpf("1.5") * (1 - f),
            mpf("1.5"),
        )
        a = mpf(abl_absorption)
        tau = mpf(stroma_absorption) + mpf(stroma_scattering)
        albedo = mpf(stroma_scattering) / tau
        return float(_reflectance(a, tau, albedo, n_water, n_a, n_s, n_ipe))


def _fresnel(mu, n, m):
    square = 1 - (n / m) ** 2 * (1 - mu * mu)
    if square <= 0:
        return mpf(1)
    out = sqrt(square)
    return (
        ((n * mu - m * out) / (n * mu + m * out)) ** 2
        + ((m * mu - n * out) / (m * mu + n * out)) ** 2
    ) / 2


def _reflectance(a, tau, albedo, n_water, n_a, n_s, n_ipe):
    bottom, top = sqrt(1 - (n_s / n_a) ** 2), sqrt(1 - (n_water / n_a) ** 2)

    def abl(low, v):
        """Integrate over v = √(μ² − low²), in which a critical angle makes no kink."""
        mu = sqrt(low * low + v * v)
        f0, f1, t = _fresnel(mu, n_a, n_water), _fresnel(mu, n_a, n_s), exp(-a / mu)
        passes = 2 * v * t / (1 - t * t * f0 * f1)
        return [passes * x for x in (t * f1 * (1 - f0), 1 - f1, 1 - f0, t * f0 * (1 - f1))]

    down_back, down_through, up_through, up_back = map(
        fsum,
        zip(
            *(
                _integrals(partial(abl, low), sqrt(high * high - low * low))
                for low, high in ((bottom, top), (top, mpf(1)))
            ),
            strict=True,
        ),
    )

    def stroma(mu):
        f1, f2, t = _fresnel(mu, n_s, n_a), _fresnel(mu, n_s, n_ipe), exp(-tau / mu)
        passes, p = 1 / (1 - f1 * f2 * t * t), (3 * mu * mu - 1) / 2
        first = passes * 2 * mu * (1 - t) * (1 + f2 * t)
        again = passes * (1 - t) * (f1 * (1 + f2 * t) + f2 * (1 + f1 * t))
        out = passes * (1 - f1) * (1 + f2 * t)
        straight = passes * (1 - f1) * 2 * mu * t * t * f2
        return first, first * p, again, again * p, again * p * p, straight, out, out * p

    first0, first1, b00, b01, b11, straight, out0, out1 = _integrals(stroma, mpf(1))
    s0, s1 = albedo / 2, albedo / 4
    system = matrix([[1 - b00 * s0, -b01 * s1], [-b01 * s0, 1 - b11 * s1]])
    moment0, moment1 = lu_solve(system, matrix([first0, first1]))
    back = straight + s0 * moment0 * out0 + s1 * moment1 * out1
    entered = 1 - _fresnel(mpf(1), n_water, n_a)
    return entered * (down_back + down_through * back * up_through / (1 - up_back * back))


def _integrals(functions, end):
    """Integrate several functions from 0 to `end` at the same nodes of Gauss and Legendre."""
    cuts = [end * mpf(x) for x in ("0", "0.001", "0.01", "0.03", "0.1", "0.2", "0.5", "1")]
    total = None
    for low, high in itertools.pairwise(cuts):
        for x, weight in _RULE.get_nodes(low, high, 5, mp.prec):
            values = [weight * y for y in functions(x)]
            total = values if total is None else [s + y for s, y in zip(total, values, strict=True)]
    return total
