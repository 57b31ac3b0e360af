"""Puts the model beside measurements of living eyes: transmission, colour, brightness, the bends of
blood.

The numbers of measurement are published ones; none was made for this model, and none was used to
make it.
"""

import functools

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import brentq, least_squares

import irisjax as ij
from experiments.common import RESULTS, start, write
from irisjax.grow.presets import PHOTOGRAPHED_COLOURS
from irisjax.measure.colour import lab_of

GRID = ij.wavelengths(400, 700, 10)
PHOTOGRAPHED = {k: PHOTOGRAPHED_COLOURS[k] for k in ("blue", "green", "hazel", "brown")}
FREE = {  # bounds; all but the fraction and the saturation are searched by their logarithms
    "eumelanin": (1e-3, 10.0),
    "pheomelanin": (1e-3, 20.0),
    "abl_fraction": (0.0, 1.0),
    "hemoglobin": (0.01, 1.0),
    "saturation": (0.0, 1.0),
    "stroma_thickness": (0.2, 0.6),
    "scattering_scale": (0.3, 40.0),
}
PROCESSES = {"ilit-2006": ij.IlitExact(16), "depth-resolved": ij.RadiativeExact(12, 6, 4)}
MOST = 1.0, 3.0, 10.0, 40.0
RED, GREEN = 650.0, 550.0  # nm, where the source says red and green
MEASURED = {"red": 1e-2, "green": 2e-3, "dark brown over light blue": 1e-2}


def main(key, quick=False, out=RESULTS):
    """Write the tables and the figure (quick: few irides, one process, one class)."""
    processes = dict(list(PROCESSES.items())[: 1 if quick else 2])
    transmission(processes, out)
    blood(processes, out)
    clouds = colours(processes, key, quick, out)
    figure(clouds, out)


def transmission(processes, out):
    """Fit the epithelium of a light-blue iris to the red, and write what follows."""
    rows = [row for name, solver in processes.items() for row in _transmissions(name, solver)]
    header = (
        "transmittance of simulated irides beside the effective transmission of living ones, van "
        "den Berg, IJspeert & de Waard, Vision Research 31, 1361 (1991)",
        f"light along the normal; red is taken as {RED:g} nm, green as {GREEN:g} nm",
    )
    columns = "process", "quantity", "model", "measured", "model over measured"
    rows = [tuple(float(v) if isinstance(v, np.floating) else v for v in row) for row in rows]
    write(out / "meeting_transmission.csv", header, columns, rows)


def _transmissions(name, solver):
    """Return the rows of one process."""

    @jax.jit
    def through(mass, load):
        iris = ij.Iris.of_level("low").replace(ipe_melanin=mass, melanin_load=load)
        return ij.transmittance(iris, [GREEN, RED], solver=solver, throw=False).values

    def load_that_lets_through(k, wanted):
        return brentq(lambda load: float(through(mass, load)[k]) - wanted, blue, 50.0)

    blue = float(ij.Iris.of_level("low").melanin_load)
    brown = float(ij.Iris.of_level("high").melanin_load)
    mass = brentq(lambda m: float(through(m, blue)[1]) - MEASURED["red"], 0.1, 50.0)
    seen, dark = np.asarray(through(mass, blue)), np.asarray(through(mass, brown))
    rows = [
        (name, "pigment epithelium, ug/mm2 of eumelanin, fitted to the red", mass, "", ""),
        (name, "light blue, red", seen[1], MEASURED["red"], seen[1] / MEASURED["red"]),
        (name, "light blue, green", seen[0], MEASURED["green"], seen[0] / MEASURED["green"]),
    ]
    for k, colour in ((1, "red"), (0, "green")):
        ratio, measured = dark[k] / seen[k], MEASURED["dark brown over light blue"]
        load = load_that_lets_through(k, measured * seen[k])
        rows += [
            (name, f"high pigmentation over low, {colour}", ratio, measured, ratio / measured),
            (name, f"melanin load that has it, {colour}, ug/mm2", load, "", ""),
        ]
    return rows


def blood(processes, out):
    """Write how deep the bend between the bands of oxyhaemoglobin is."""
    rows = []
    for name, solver in processes.items():
        for level in ("low", "moderate", "high"):
            iris = ij.Iris.of_level(level)
            read = ij.reflectance(iris, [542.0, 560.0, 577.0], solver=solver, first_surface=False)
            a, b, c = (float(x) for x in read.values)
            bend = b - (a + c) / 2
            rows.append((name, level, bend, bend / b))
    header = (
        "bend of the w of blood, R(560 nm) less the mean of R(542) and R(577 nm), of simulated "
        "irides, first surface left out [LB06 Section 5]",
    )
    columns = "process", "pigmentation", "bend", "bend over R(560 nm)"
    write(out / "meeting_blood.csv", header, columns, rows)


def colours(processes, key, quick, out):
    """The colours nearest to photographed classes, by how much the stroma may scatter."""
    count, starts = (64, 1) if quick else (3000, 3)
    rows, clouds = [], {}
    for name, solver in processes.items():
        seen = functools.partial(_lab, solver)
        many, slope = jax.jit(jax.vmap(seen)), jax.jit(jax.jacfwd(seen))
        one = jax.jit(seen)
        for most in (MOST[0], MOST[-1]) if quick else MOST:
            u = np.asarray(jax.random.uniform(key, (count, len(FREE))))
            x = _bounds(most)[0] + u * np.diff(_bounds(most), axis=0)
            found = np.concatenate([np.asarray(many(part)) for part in np.array_split(x, 8)])
            clouds[name, most] = found
            for kind, (mean, sd) in list(PHOTOGRAPHED.items())[: 1 if quick else None]:
                for free in (False, True):
                    how = _bounds(most), free, starts
                    far, at, lab = _nearest(one, slope, x, found, np.array(mean), *how)
                    seen_so = _at_lightness(lab, mean[0]) if free else lab
                    scaled = (seen_so - mean) / np.array(sd)
                    values = {n: float(v) for n, v in _named(at).items()}
                    exposed = "free" if free else "as photographed"
                    y = float(((lab[0] + 16) / 116) ** 3)
                    off = float(np.sqrt((scaled[1 if free else 0 :] ** 2).mean()))
                    rows.append((name, most, kind, exposed, far, off, y, *values.values()))
    header = (
        "simulated irides whose colour (D65, light along the normal, first surface left out) comes "
        "nearest to the mean of photographed ones (iori, 39 irides, uncalibrated)",
        "deltaE: CIE 1976; with the exposure free that of a* and b* alone, at the photograph's L*; "
        "sds: its root mean square in standard deviations of the class",
    )
    columns = (
        "process", "most_scattering", "class", "exposure", "deltaE", "sds", "luminance", *FREE,
    )  # fmt: skip
    write(out / "meeting_colours.csv", header, columns, rows)
    spread = []
    for (name, most), found in clouds.items():
        y = np.where(found[:, 0] > 8, ((found[:, 0] + 16) / 116) ** 3, found[:, 0] / 903.3)
        spread.append((name, most, *(float(q) for q in np.quantile(y, (0.025, 0.5, 0.975)))))
    header = (
        "luminance of simulated irides, of white, over pigments drawn evenly (log) within FREE",
        "ten photographs have 0.05 to 0.45 of the white of the eye, median 0.18",
    )
    columns = "process", "most_scattering", "low_2.5", "median", "high_97.5"
    write(out / "meeting_brightness.csv", header, columns, spread)
    return clouds


def _bounds(most):
    low, high = np.array(list(FREE.values())).T.copy()
    high[-1] = most if most > 1 else 1.0 + 1e-9
    low[-1] = 1.0 if most == 1 else low[-1]
    logs = _LOG
    low[logs], high[logs] = np.log(low[logs]), np.log(high[logs])
    return np.stack([low, high])


_LOG = np.array([name not in ("abl_fraction", "saturation") for name in FREE])


def _named(x):
    return dict(zip(FREE, jnp.where(_LOG, jnp.exp(x), x), strict=True))


def _lab(solver, x):
    """Colour of an iris with these numbers."""
    read = ij.colour(
        ij.Iris().replace(**_named(x)), GRID, solver=solver, first_surface=False, throw=False
    )
    return read.lab


def _at_lightness(lab, lightness):
    """The colour with its exposure changed so that L* is that of the photograph."""
    fy = (lab[0] + 16) / 116
    f = np.array([fy + lab[1] / 500, fy, fy - lab[2] / 200])
    ratio = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))  # of the white
    return np.asarray(lab_of(ratio * ((lightness + 16) / 116) ** 3 / ratio[1]))


def _nearest(one, slope, x, found, target, bounds, free, starts):
    """The smallest distance, where it is, and the colour there."""

    def off(lab):
        return _at_lightness(lab, target[0])[1:] - target[1:] if free else lab - target

    far = np.array([np.linalg.norm(off(lab)) for lab in found])
    best = None
    for k in np.argsort(far)[:starts]:
        ends = np.clip(x[k], bounds[0] + 1e-9, bounds[1] - 1e-9)
        at = least_squares(
            lambda v: off(np.asarray(one(v))),
            ends,
            jac=(lambda v: np.asarray(slope(v))) if not free else "2-point",
            bounds=bounds + np.array([[-1e-6], [1e-6]]),
            max_nfev=60,
            x_scale=np.diff(bounds, axis=0)[0] + 1e-6,
        ).x
        lab = np.asarray(one(at))
        reached = float(np.linalg.norm(off(lab)))
        if best is None or reached < best[0]:
            best = reached, at, lab
    return best


def figure(clouds, out):
    """Draw the colours of the model beside those of photographed irides, in a* and b*."""
    names = sorted({name for name, _ in clouds}, reverse=True)
    drawn, axes = plt.subplots(1, len(names), figsize=(4.5 * len(names), 4.4), squeeze=False)
    for ax, name in zip(axes[0], names, strict=True):
        for most, colour in ((MOST[-1], "#56b4e9"), (MOST[0], "#333333")):
            found = clouds[name, most]
            said = "LB06's scattering" if most == 1 else f"up to {most:g} times as much"
            ax.plot(found[:, 1], found[:, 2], ".", ms=2, color=colour, label=said)
        for kind, (mean, sd) in PHOTOGRAPHED.items():
            ax.errorbar(mean[1], mean[2], sd[2], sd[1], "o", color="#d55e00", capsize=2)
            ax.annotate(kind, (mean[1], mean[2]), (4, 4), textcoords="offset points")
        ax.set(title=f"simulated, {name}", xlabel="a*", ylabel="b*", xlim=(-15, 45), ylim=(-35, 50))
        ax.plot([], [], "o", color="#d55e00", label="photographed, mean and sd")
        ax.legend(loc="lower right", fontsize=8)
    drawn.tight_layout()
    out.mkdir(parents=True, exist_ok=True)
    drawn.savefig(out / "meeting_colours.png", dpi=100)
    plt.close(drawn)


if __name__ == "__main__":
    start(main, __doc__)
