"""Windows whose radiance is a formula, for tests of the search and of the sampler."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from irisjax.anatomy.eye import Eye
from irisjax.photo.pigments import parameter_values, predicted_colours
from irisjax.photo.windows import COUNT, Windows
from irisjax.render.bands import colour_bands
from irisjax.render.separable import Separable
from irisjax.tissue.iris import Iris
from irisjax.tissue.maps import Scales

BASE = Iris(fibril_radius=jnp.asarray(57.0))
_ABSORPTION = jnp.asarray([[0.15, 0.25, 0.45], [0.1, 0.25, 0.6]])  # of both melanins, per mg/ml


class FormulaWindows(Windows):
    """Absorption in two layers over scattering that grows with the stroma's thickness."""

    light: jax.Array = eqx.field(default_factory=lambda: jnp.ones(COUNT))

    def radiance_and_slope(self, iris, room=0.0):
        def radiance(log_thickness):
            height = iris.stroma_thickness * jnp.exp(log_thickness)
            whole = iris.abl_thickness + iris.stroma_thickness
            pigments = iris.eumelanin * iris.abl_fraction, iris.pheomelanin
            abl = jnp.stack([pigments[0], pigments[1] * iris.pheomelanin_abl_fraction]) * whole
            stroma = jnp.stack(
                [
                    iris.eumelanin * (1 - iris.abl_fraction),
                    iris.pheomelanin * (1 - iris.pheomelanin_abl_fraction),
                ]
            )
            scattering = iris.scattering_scale * jnp.asarray([0.3, 0.5, 0.9]) * height
            melanin = stroma * whole * jnp.exp(log_thickness)
            back = scattering / (scattering + 0.3 + melanin @ _ABSORPTION)
            seen = back * jnp.exp(-2 * abl @ _ABSORPTION)
            return self.light[:, None] * seen

        zero = jnp.zeros(())
        return jax.jvp(radiance, (zero,), (jnp.ones_like(zero),))


def formula_windows(z) -> FormulaWindows:
    """Windows whose colours are those of the parameters z; lamps without a room."""
    eye = Eye()
    bare = FormulaWindows(
        colour=np.ones((COUNT, 3)),
        present=np.ones(COUNT, bool),
        matrix=jnp.zeros((2, COUNT, 3, 1)),
        room=jnp.zeros((2, COUNT, 3, 1)),
        in_room=np.zeros(()),
        veil=np.zeros(COUNT),
        mirrored=np.zeros((COUNT, 3)),
        bands=colour_bands("D65", cornea=eye.cornea),
        ranges=Scales(stroma=jnp.asarray([0.5, 2.0])),
        integrator=Separable(),
        aqueous_index=jnp.asarray(eye.aqueous_index),
        light=jnp.linspace(0.8, 1.2, COUNT),
    )
    colour = predicted_colours(parameter_values(jnp.asarray(z)), bare, BASE)
    return eqx.tree_at(lambda w: w.colour, bare, np.asarray(colour))
