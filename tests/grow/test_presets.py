"""Eye colours beside photographed irides."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.anatomy.eye import Eye
from irisjax.anatomy.media import AQUEOUS
from irisjax.grow.presets import PHOTOGRAPHED_COLOURS, PRESETS
from irisjax.measure.colour import XYZ_TO_SRGB, lab_of
from irisjax.render.bands import colour_bands
from irisjax.tissue.maps import Scales, cell_centres, texel_layers
from irisjax.tissue.pigments import extinction
from irisjax.transport.light import Light

SHAPE = (96, 64)
SOLVERS = {"ilit-2006": ij.IlitExact(12), "depth-resolved": ij.RadiativeExact(12, 4, 1)}


@pytest.mark.parametrize(
    "process", [pytest.param("ilit-2006", marks=pytest.mark.peer), "depth-resolved"]
)
def test_presets_are_within_one_standard_deviation_of_photographed_irides(process):
    """Exact reflectance of texels of the ciliary zone, averaged by area in XYZ."""
    solver, bands, eye = SOLVERS[process], colour_bands(), Eye()
    table = extinction(np.asarray(bands.wavelengths))
    place = np.asarray(cell_centres(SHAPE)[1])
    columns = np.flatnonzero((place > 0.4) & (place < 0.9))[::3]
    weight = np.asarray(eye.from_axis(place))[columns] / eye.from_axis(place)[columns].sum()

    @jax.jit
    @jax.vmap
    def reflected(iris, scales):
        layers = texel_layers(iris, AQUEOUS, table, scales)
        return bands.weights @ solver.solve(layers, Light(1.0)).reflectance

    to_white = np.linalg.inv(XYZ_TO_SRGB)
    to_white /= to_white.sum(1, keepdims=True)
    irides, texels = [], []
    for grow in PRESETS.values():
        iris, maps = grow(eye, process=solver.process, shape=SHAPE, key=jax.random.key(5))
        scales = (jnp.ones(SHAPE) if s is None else s for s in Scales.of(maps, iris))
        some = Scales(*(s[::6, columns].ravel() for s in scales))
        irides.append(jax.tree.map(lambda v, n=some.abl.size: jnp.full(n, v), iris))
        texels.append(some)
    together = [jax.tree.map(lambda *v: jnp.concatenate(v), *each) for each in (irides, texels)]
    seen = np.asarray(reflected(*together)).reshape(len(PRESETS), -1, len(columns), 3)
    for colour, rgb in zip(PRESETS, seen.mean(1), strict=True):
        xyz = to_white @ (weight @ rgb)
        mean, sd = map(np.array, PHOTOGRAPHED_COLOURS[colour])
        off = (np.asarray(lab_of(xyz)) - mean) / sd
        assert np.abs(off).max() < 1, (colour, off)
        # Over the white of the eye, whose reflectance is about 0.6.
        assert (0.05 if colour == "dark-brown" else 0.1) < xyz[1] / 0.6 < 0.35
