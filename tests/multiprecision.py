"""ILIT with Rayleigh's phase function in 25 digits: another language's twin of the solver, sharing
no code with it.
"""

from mpmath import exp, lu_solve, matrix, mp, mpf, pi, quad, sin, sqrt


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

    def abl(share):
        def integrand(mu):
            f0, f1, t = _fresnel(mu, n_a, n_water), _fresnel(mu, n_a, n_s), exp(-a / mu)
            return 2 * mu * share(f0, f1, t) / (1 - t * t * f0 * f1)

        total = mpf(0)
        for low, high in ((bottom, top), (top, mpf(1))):
            span = sqrt(high * high - low * low)

            def in_v(v, low=low):
                mu = sqrt(low * low + v * v)
                return integrand(mu) * v / mu

            total += quad(
                in_v,
                [
                    span * x
                    for x in (0, mpf("0.001"), mpf("0.01"), mpf("0.05"), mpf("0.2"), mpf("0.5"), 1)
                ],
            )
        return total

    down_back = abl(lambda f0, f1, t: t * t * f1 * (1 - f0))
    down_through = abl(lambda f0, f1, t: t * (1 - f1))
    up_through = abl(lambda f0, f1, t: t * (1 - f0))
    up_back = abl(lambda f0, f1, t: t * t * f0 * (1 - f1))

    cuts = [mpf(x) for x in ("0", "0.001", "0.01", "0.03", "0.1", "0.2", "0.5", "1")]

    def stroma(share):
        def integrand(mu):
            if mu <= 0:
                return mpf(0)
            f1, f2, t = _fresnel(mu, n_s, n_a), _fresnel(mu, n_s, n_ipe), exp(-tau / mu)
            return share(mu, f1, f2, t) / (1 - f1 * f2 * t * t)

        return quad(integrand, cuts)

    moments = (lambda mu: mpf(1), lambda mu: (3 * mu * mu - 1) / 2)
    strengths = (mpf(1) / 2, mpf(1) / 4)
    first = [
        stroma(lambda mu, f1, f2, t, p=p: 2 * mu * (1 - t) * (1 + f2 * t) * p(mu)) for p in moments
    ]
    again = [
        [
            stroma(
                lambda mu, f1, f2, t, p=p, q=q: (
                    (1 - t) * (f1 * (1 + f2 * t) + f2 * (1 + f1 * t)) * p(mu) * q(mu)
                )
            )
            for q in moments
        ]
        for p in moments
    ]
    system = matrix(
        [[int(i == j) - albedo * again[i][j] * strengths[j] for j in range(2)] for i in range(2)]
    )
    solved = lu_solve(system, matrix(first))
    source = [albedo * strengths[i] * solved[i] for i in range(2)]
    back = stroma(
        lambda mu, f1, f2, t: (
            (1 - f1)
            * (2 * mu * t * t * f2 + (1 + f2 * t) * (source[0] + source[1] * moments[1](mu)))
        )
    )
    entered = 1 - _fresnel(mpf(1), n_water, n_a)
    return entered * (down_back + down_through * back * up_through / (1 - up_back * back))
