"""Read irides whose colours are by radiative transfer with ILIT, as texels of a clone are read:
how far are the strength of the stroma and the melanins off by the choice of the process?

All is simulated. Irides are drawn from the priors of clones. Colours are of the diffuse reflectance
at normal incidence under D65.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from experiments.common import RESULTS, start, write
from irisjax.measure.photometers import colour
from irisjax.photo.clone import usual_iris
from irisjax.photo.pigments import FREE_NAMES, iris_of_concentrations, parameter_values
from irisjax.photo.texels import CHANNEL_NOISE, DARK, NAMES, POWER, PRIOR_SD
from irisjax.transport.ilit.exact import IlitExact
from irisjax.transport.radiative.exact import RadiativeExact

ABOUT = (
    "simulated: irides of the priors of clones, colours by radiative transfer, read by ILIT",
    "columns of names: ln found over true; off: largest error of an encoded channel",
)
COUNT = 400
WAVELENGTHS = np.arange(400.0, 701.0, 20.0)
MADE = 0.01
"""Errors of encoded channels up to which ILIT can make a colour of radiative transfer."""
STARTS = np.array([[0.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
_STROMA = 0.4  # mm


def main(key, quick=False, out=RESULTS):
    """Write a CSV (quick: four irides)."""
    draws = jax.random.normal(key, (4 if quick else COUNT, len(FREE_NAMES)))
    rows = np.stack([np.asarray(read(draw)) for draw in draws])
    about = *ABOUT, *summary(rows)
    write(out / "texels_by_process.csv", about, (*NAMES, "off"), rows.tolist())


def summary(rows: np.ndarray) -> list[str]:
    """Return lines on the colours that ILIT can make: their number and the means of products."""
    made = rows[rows[:, -1] < MADE, : len(NAMES)]
    moments = (made.T @ made / max(len(made), 1)).round(3)
    lines = [f"{len(made)} of {len(rows)} colours can be made; their means of products:"]
    for name, row in zip(NAMES, moments, strict=True):
        lines.append(f"{name}: {', '.join(map(str, row))}")
    return lines


@eqx.filter_jit
def read(draw):
    """Return the logarithms of what is found over the truth, and the largest error of a channel."""
    target = encoded(draw, jnp.zeros(3), RadiativeExact())

    def errors(logs, _):
        off = encoded(draw, logs, IlitExact()) - target
        return jnp.concatenate([off / CHANNEL_NOISE, logs / PRIOR_SD])

    solver = optx.LevenbergMarquardt(1e-6, 1e-6)
    search = partial(optx.least_squares, errors, solver, max_steps=60, throw=False)
    found = jax.vmap(lambda start: search(start).value)(jnp.asarray(STARTS))
    every = jax.vmap(lambda logs: errors(logs, None))(found)
    best = jnp.argmin((every**2).sum(1))
    return jnp.append(found[best], CHANNEL_NOISE * jnp.abs(every[best, :3]).max())


def encoded(draw, logs, solver):
    """Compute the encoded channels of an iris of the priors whose `NAMES` are multiplied."""
    values, (stroma, eumelanin, pheomelanin) = parameter_values(draw), jnp.exp(logs)
    for layer in ("abl", "stroma"):
        values[f"{layer}_eumelanin"] *= eumelanin
        values[f"{layer}_pheomelanin"] *= pheomelanin
    iris = iris_of_concentrations(values, usual_iris(_STROMA * stroma))
    seen = colour(iris, WAVELENGTHS, solver=solver, throw=False).srgb_linear
    return (jnp.maximum(seen, 0) + DARK) ** POWER


if __name__ == "__main__":
    start(main, __doc__)
