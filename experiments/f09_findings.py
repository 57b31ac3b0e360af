"""Two findings of F09 Section 7: green eyes have more pheomelanin per eumelanin, and more lamps in
place of the surroundings leave the concentrations as they are; all simulated but the mean colours
of photographed eyes.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

import irisjax as ij
from experiments.clone_thickness import ABOUT, EYES, clone_by_f09, simulated
from experiments.clone_truth import premises
from experiments.common import RESULTS, start, write
from experiments.meeting_measurements import GRID, PHOTOGRAPHED
from irisjax.measure.colour import colour_of, lab_of
from irisjax.photo.clone import CloneSettings
from irisjax.photo.pigments import CONCENTRATIONS
from irisjax.photo.thickness import BETA, SIGMA
from irisjax.tissue import FRACTIONS

RATIOS = (0.0, 0.226, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
"""Pheomelanin over eumelanin, m of F09 Section 5.2; 0.226 is LB06's."""
SEARCHED = {"ABL": (0.003, 30.0), "stroma": (0.003, 30.0), "scattering": (0.3, 40.0)}
"""Eumelanin of the layers in per cent of volume, and the factor on the scattering: all that varies
beside m."""
LAMPS = 2, 5, 25, 100
"""Lamps that stand for the room."""


def main(key, quick=False, out=RESULTS):
    """Write two tables (quick: few irides; one eye, a third as large, two numbers of lamps)."""
    del key  # points are even, and a clone up to its pigments draws no random numbers
    green_eyes(quick, out)
    lamps(quick, out)


def green_eyes(quick: bool, out) -> None:
    """The iris nearest to the mean colour of photographed eyes, for each m."""
    low, high = np.log(list(SEARCHED.values())).T
    points = qmc.Sobol(3, scramble=False).random_base2(7 if quick else 12)
    tried = np.exp(low + (high - low) * points)
    rows = []
    for m in RATIOS:
        xyz = np.asarray(_relative_xyz(jnp.asarray(tried), m))
        for name, ((lightness, *mean), (_, *spread)) in PHOTOGRAPHED.items():
            exposure = ((lightness + 16) / 116) ** 3 / xyz[:, 1:2]
            seen = np.asarray(jax.vmap(lab_of)(jnp.asarray(exposure * xyz)))[:, 1:]
            off = np.sqrt((((seen - mean) / spread) ** 2).mean(-1))
            best = int(np.argmin(off))
            rows.append((name, m, float(off[best]), *map(float, (*seen[best], *tried[best]))))
    header = (
        "simulated irides (ILIT, F09's absorption) nearest to the mean a* and b* of photographed "
        "eyes (iori, 39 irides, uncalibrated) at their L*: the exposure is free",
        "sds: root mean square of the distances in standard deviations of the class",
    )
    columns = "class", "pheomelanin_per_eumelanin", "sds", "a", "b", *SEARCHED
    write(out / "f09_findings_green.csv", header, columns, rows)


@jax.jit
def _relative_xyz(tried, m):
    """XYZ over that of white, of irides."""
    white = colour_of(GRID, np.ones(len(GRID))).xyz

    def one(x):
        shares = dict(zip(FRACTIONS, (x[0], m * x[0], x[1], m * x[1]), strict=True))
        iris = ij.Iris().replace(**shares, scattering_scale=x[2])
        how = {"solver": ij.IlitExact(16), "first_surface": False, "throw": False}
        return ij.colour(iris, GRID, **how).xyz / white

    return jax.lax.map(one, tried, batch_size=256)


def lamps(quick: bool, out) -> None:
    """F09's search under its premises, the room by more and more lamps."""
    rows = []
    for colour in EYES[:1] if quick else EYES:
        given, _ = premises(colour)
        for count in LAMPS[:2] if quick else LAMPS:
            held = given._replace(environment_lights=count)
            settings = CloneSettings(beta=BETA, sigma=SIGMA)
            found = clone_by_f09(simulated(colour, quick), colour, settings, held)
            values = [found.fit.values[name] for name in CONCENTRATIONS]
            rows.append((colour, count, *values, float(found.fit.rms.mean())))
            print(f"{colour}: {count} lamps", flush=True)
    write(out / "f09_findings_lamps.csv", ABOUT, ("eye", "lamps", *CONCENTRATIONS, "rms"), rows)


if __name__ == "__main__":
    start(main, __doc__)
