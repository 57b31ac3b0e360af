"""Which further measurement breaks the ridge of load and fraction? Expected posterior widths, by
design.

Widths come from the curvature at the truth (Fisher information and priors together) for noiseless
spectra of each level, with the default parameters and the stroma's thickness free.
"""

import numpy as np

import irisjax as ij
from experiments.calibration import CENTRES, FWHM
from experiments.closed_formulas import KubelkaMunk
from experiments.common import RESULTS, start, write
from irisjax.infer.fit import fit
from irisjax.infer.noise import Noise
from irisjax.infer.observation import with_values
from irisjax.infer.parameters import DEFAULT_FREE, of_iris
from irisjax.tissue.pigments import common_range

FREE = (*DEFAULT_FREE, "stroma_thickness")


def main(key, quick=False, out=RESULTS):
    """Write relative sds of load, fraction and their product (quick: one level, two designs, a
    closed formula).
    """
    del key
    low, high = common_range()
    base = _spectra(400, 700, 10)
    noisy = Noise(0.02, 2e-4)
    designs = {
        "31 wavelengths, 400-700 nm, 2 % + 2e-4": (base, noisy, {}),
        "the same, load and fraction alone free": (
            base,
            noisy,
            {"free": ("melanin_load", "abl_fraction")},
        ),
        "colour only (XYZ, 1 % + 1e-4)": (_colour, noisy, {}),
        "stroma thickness known (ultrasound)": (base, noisy, {"fixed": ("stroma_thickness",)}),
        "noise 0.5 % + 5e-5": (base, Noise(0.005, 5e-5), {}),
        "steps of 2 nm": (_spectra(400, 700, 2), noisy, {}),
        f"{low:g}-{high:g} nm, as far as pigments are tabulated": (
            _spectra(low, high, 10),
            noisy,
            {},
        ),
        "to 780 nm": (_spectra(400, 780, 10), noisy, {}),
        "gain calibrated": (base, noisy, {"fixed": ("gain",)}),
        "radiative transfer": (base, noisy, {"process": ij.DEPTH_RESOLVED}),
        "radiative transfer, scattering by a power law": (base, noisy, {"law": True}),
        "strength of scattering free, 0.3 to 40 times": (base, noisy, {"strength": True}),
        "radiative transfer, strength of scattering free, 0.3 to 40 times": (
            base,
            noisy,
            {"process": ij.DEPTH_RESOLVED, "strength": True},
        ),
        "eight bands of 20 to 40 nm": (_bands, noisy, {}),
        **{
            f"{n} bands of {width:g} nm, {how}": (_filters(n, width, how), noisy, {})
            for n in (4, 6, 8)
            for width in (10.0, 40.0)
            for how in ("even", "in the blue")
        },
        "31 wavelengths measured twice": (_twice, noisy, {}),
        "a second spectrum at 60 degrees": (_two_angles, noisy, {}),
        "a second spot with twice the melanin": (
            _two_spots,
            noisy,
            {"separate": ("melanin_load",)},
        ),
        "three of these: 0.5 % noise, thickness and gain known": (
            base,
            Noise(0.005, 5e-5),
            {"fixed": ("stroma_thickness", "gain")},
        ),
    }
    rows = []
    for level in ("low",) if quick else ("low", "moderate", "high"):
        iris = ij.Iris.of_level(level)
        for name, (measure, noise, options) in list(designs.items())[: 2 if quick else None]:
            solver = KubelkaMunk() if quick else None
            rows.append((level, name, *_widths(iris, measure, noise, solver, **options)))
    write(
        out / "design_study.csv",
        (
            "expected posterior standard deviations of ln load, ln fraction and "
            "ln(load x fraction), and the correlation",
            "of load and fraction; process ilit-2006 unless said, default priors; simulated",
        ),
        ("level", "design", "sd_load", "sd_fraction", "sd_product", "correlation"),
        rows,
    )


def _widths(
    iris,
    measure,
    noise,
    solver,
    free=FREE,
    fixed=(),
    separate=(),
    process=None,
    law=False,
    strength=False,
):
    seen = measure(iris)
    truth = {k: float(v) for k, v in of_iris(iris).items()}
    problem = ij.problem(
        seen,
        free=[*(n for n in free if n not in fixed), *(["scattering_scale"] if strength else [])],
        fixed={n: truth[n] for n in fixed},
        separate=separate,
        noise=noise,
        base=iris,
        process=process,
        solver=solver,
    )
    if law:
        problem = problem.under(ij.PowerLaw())
        truth |= {k: float(v) for k, v in of_iris(problem.base).items() if k not in truth}
    values = {
        n: truth[n.partition("@")[0]] * (2 if n == "melanin_load@2" else 1) for n in problem.free
    }
    z = problem.standard(values)
    exact = problem.predict(z)
    problem = problem.with_observations(
        *(
            with_values(o, m)
            for o, m in zip(seen if isinstance(seen, tuple) else (seen,), exact, strict=True)
        )
    )
    found = fit(problem, starts=1, start=z)
    names = list(problem.free)
    a = names.index("melanin_load@1" if separate else "melanin_load")
    b = names.index("abl_fraction")
    slope = np.array([float(found.sd[n] / found.values[n]) for n in (names[a], names[b])])
    c = np.asarray(found.covariance)[np.ix_([a, b], [a, b])]
    correlation = c[0, 1] / np.sqrt(c[0, 0] * c[1, 1])
    product = np.sqrt(slope @ np.array([[1, correlation], [correlation, 1]]) @ slope)
    return float(slope[0]), float(slope[1]), float(product), float(correlation)


def _spectra(low, high, step):
    grid = ij.wavelengths(np.ceil(low / step) * step, np.floor(high / step) * step, step)
    return lambda iris: ij.spectrum(grid, np.ones(grid.size))


def _bands(iris):
    bands = ij.Passbands.slit(CENTRES, FWHM)
    return ij.spectrum(CENTRES, np.ones(CENTRES.size), bands=bands)


def _filters(n, width, how):
    """Filters from 420 to 680 nm, even or each next step 1.3 times as wide as the one before."""
    steps = np.ones(n - 1) if how == "even" else 1.3 ** np.arange(n - 1)
    centres = 420 + 260 * np.concatenate([[0], steps.cumsum() / steps.sum()])
    bands = ij.Passbands.slit(centres, width)
    return lambda iris: ij.spectrum(np.asarray(bands.centres), np.ones(n), bands=bands)


def _colour(iris):
    xyz = np.asarray(ij.colour(iris, 400 + 10.0 * np.arange(31)).xyz)
    return ij.colour_data(xyz, np.diag((0.01 * xyz) ** 2 + 1e-8))


def _twice(iris):
    return (_spectra(400, 700, 10)(iris),) * 2


def _two_angles(iris):
    grid = ij.wavelengths(400, 700, 10)
    return tuple(ij.spectrum(grid, np.ones(grid.size), cos_incidence=c) for c in (1.0, 0.5))


def _two_spots(iris):
    grid = ij.wavelengths(400, 700, 10)
    return tuple(ij.spectrum(grid, np.ones(grid.size)) for _ in range(2))


if __name__ == "__main__":
    start(main, __doc__)
