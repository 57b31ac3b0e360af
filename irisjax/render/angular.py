"""Functions of directions in which the BRDFs of tabulated irides are written."""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Scalar
from irisjax.anatomy.eye import Eye
from irisjax.numerics.chunks import pixelwise
from irisjax.numerics.interpolation import chebyshev_nodes
from irisjax.optics.conicoid import dot, from_parts, norm
from irisjax.optics.fresnel import fresnel, refract
from irisjax.render.polynomials import chebyshev_coefficients, chebyshev_polynomials
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Facing, camera_share, flux_at, hiding_factor, normal_at
from irisjax.tissue.iris import Iris
from irisjax.transport.light import Directions

_AZIMUTHS = 0.0, np.pi / 2, np.pi  # three values determine the orders 0, 1 and 2
_CHECK_AZIMUTHS = 0.4, 1.9, 2.8
_DECAY = 0.2  # typical ratio of the coefficients of one degree in a cosine to those of the last
_MIXTURES = 6  # number of mixtures of functions that light is summed in
_SAMPLES = 4096  # number of pixels by which the mixtures are chosen

PerPixel = Float[Array, " pixels"]
Functions = Float[Array, "functions pixels"]
Nodes = tuple[Float[Array, " incidences"], Directions]
NodeBrdf = Float[Array, "texels incidences exits channels"]
Coefficients = Float[Array, "texels functions channels"]


class AbstractAngularFunctions(eqx.Module):
    """Functions of the directions of light and sight, at an iris in the aqueous humour.

    Attributes:
        indices: Refractive indices before and behind the surface of the iris.
    """

    indices: eqx.AbstractVar[tuple[Scalar, Scalar]]

    @abc.abstractmethod
    def functions(
        self, cos_incidence: PerPixel, cos_exit: PerPixel, across: PerPixel | None
    ) -> Functions:
        """Evaluate the functions at pairs of directions in the aqueous humour.

        Args:
            cos_incidence: Cosines of incidence.
            cos_exit: Cosines of exit.
            across: Scalar product of the two directions' components along the iris. `None` gives
                the means over azimuth, of those functions whose mean is not zero.
        """

    @abc.abstractmethod
    def nodes(self) -> tuple[Nodes, Nodes]:
        """Return the directions at which the BRDF is solved, and as many others at which the
        table is checked.
        """

    @abc.abstractmethod
    def coefficients(self, brdf: NodeBrdf) -> Coefficients:
        """Compute the functions' coefficients from BRDFs at the nodes."""

    def exit_functions(self, cos_exit: PerPixel) -> Functions | None:
        """Evaluate functions that depend on the exit alone; `None` if all depend on the light."""
        del cos_exit
        return None

    def inside_nodes(self, degree: int) -> Float[Array, " nodes"]:
        """Return nodes of polynomials in the cosine within the ABL, from grazing to normal exit."""
        unit = jnp.asarray((chebyshev_nodes(degree + 1) + 1) / 2, self.indices[0].dtype)
        lowest = refract(jnp.zeros_like(self.indices[0]), *self.indices)
        return lowest + (1 - lowest) * unit

    def cross_surface(self, cosine: PerPixel, degree: int) -> tuple[PerPixel, Functions, PerPixel]:
        """Return the cosine within the ABL, polynomials of it, and the share 1 − F that crosses
        the surface. A BRDF is smooth in the cosine within, not in that outside.
        """
        inside = refract(cosine, *self.indices)
        lowest = refract(jnp.zeros_like(inside), *self.indices)
        rows = chebyshev_polynomials(2 * (inside - lowest) / (1 - lowest) - 1, degree + 1)
        return inside, rows, fresnel(cosine, inside, *self.indices)[1]

    def transmission(self, inside: Float[Array, " nodes"]) -> Float[Array, " nodes"]:
        """Return the share 1 − F that crosses the surface at cosines within the ABL."""
        return fresnel(refract(inside, *self.indices[::-1]), inside, *self.indices)[1]


class AngularFunctions(AbstractAngularFunctions):
    """Products of polynomials in both cosines within the ABL, the same both ways, for each
    azimuthal order: every BRDF of Rayleigh's law can be written in them.

    Such a BRDF has the azimuthal orders m = 0, 1 and 2 and no more:
    f = t(μ_i) t(μ_o) Σ_m cos(mφ) s_m(v_i) s_m(v_o) Σ_ab c_mab T_a(v_i) T_b(v_o), with v the cosines
    in the ABL, t the share that crosses the first surface and s_m = 1, v √(1 − v²), 1 − v². By
    reciprocity c is symmetric in a and b.  [Chandrasekhar 1960, Sections 13, 16]

    Attributes:
        degrees: Degree of the polynomials of each azimuthal order.
    """

    degrees: tuple[int, int, int] = eqx.field(static=True)
    indices: tuple[Scalar, Scalar]

    def functions(
        self, cos_incidence: PerPixel, cos_exit: PerPixel, across: PerPixel | None
    ) -> Functions:
        (v, incident, entering), (w, exiting, leaving) = (
            self.cross_surface(c, max(self.degrees)) for c in (cos_incidence, cos_exit)
        )
        transmitted = entering * leaving
        orders = [transmitted]
        if across is not None:
            along = (self.indices[0] / self.indices[1]) ** 2 * across
            sines = (1 - v * v) * (1 - w * w)
            orders += [along * v * w * transmitted, (2 * along * along - sines) * transmitted]
        rows = []
        for weight, degree in zip(orders, self.degrees, strict=False):
            for a, b in _degree_pairs(degree):
                product = incident[a] * exiting[b]
                if a != b:
                    product = product + incident[b] * exiting[a]
                rows.append(weight * product)
        return jnp.stack(rows)

    def nodes(self) -> tuple[Nodes, Nodes]:
        inside = self.inside_nodes(max(self.degrees))
        check_cosines = jnp.asarray(np.linspace(0.2, 0.95, inside.size), inside.dtype)
        outside = refract(inside, *self.indices[::-1])
        return _direction_grid(outside, _AZIMUTHS), _direction_grid(check_cosines, _CHECK_AZIMUTHS)

    def coefficients(self, brdf: NodeBrdf) -> Coefficients:
        inside = self.inside_nodes(max(self.degrees))
        transmitted = self.transmission(inside)
        brdf = brdf.reshape(*brdf.shape[:2], len(_AZIMUTHS), inside.size, -1)
        brdf = brdf / (transmitted[:, None, None, None] * transmitted[:, None])
        forward, sideways, backward = (brdf[:, :, k] for k in range(3))
        cos_two = (forward + backward - 2 * sideways) / 4
        orders = sideways + cos_two, (forward - backward) / 2, cos_two
        sine = jnp.sqrt(1 - inside * inside)
        factors = jnp.ones_like(sine), sine * inside, sine * sine
        rows = []
        for values, factor, degree in zip(orders, factors, self.degrees, strict=True):
            scaled = values / (factor[:, None, None] * factor[:, None])
            table = chebyshev_coefficients(chebyshev_coefficients(scaled, 1), 2)
            # Reciprocal but for rounding and the table's error.
            rows += [(table[:, a, b] + table[:, b, a]) / 2 for a, b in _degree_pairs(degree)]
        return jnp.stack(rows, 1)

    def coefficient_scales(self) -> np.ndarray:
        """Estimate the functions' coefficients relative to the largest, shape (functions,)."""
        pairs = [pair for degree in self.degrees for pair in _degree_pairs(degree)]
        return np.array([_DECAY ** (a + b) for a, b in pairs])


LightMoments = tuple[Float[Array, "tints parts pixels"], Float[Array, "functions mixtures"] | None]
"""Sums over the lights, and the mixtures that they are sums of.

The first is the irradiance at the pixels times each function of directions, or each mixture of
functions, and times all shares on the way out; where the texels hold the functions it is the
irradiance alone. The second is the share of each function in each mixture; `None` without mixtures.
"""


@pixelwise
def light_moments(
    pixels_and_facing: tuple[IrisPixels, Facing | None],
    flux: Float[Array, "lights 3 rows columns"],
    tints: Float[Array, "lights tints"],
    eye: Eye,
    angles: AngularFunctions,
    mixtures: Float[Array, "functions mixtures"] | None,
) -> Float[Array, "tints parts pixels"]:
    """Sum irradiance times the functions of directions, or mixtures of them, over the lights, and
    weight the sums by the share that reaches the camera.
    """
    pixels, facing = pixels_and_facing
    flat = eye.iris_normal(from_parts(pixels.point))
    normal = from_parts(normal_at(pixels, eye, facing))
    view = from_parts(pixels.direction)

    def add(total, light):
        flux_grid, tint = light
        arriving = from_parts(tuple(flux_at(flux_grid, eye.iris_radius, pixels.point)))
        irradiance = jnp.maximum(-dot(arriving, normal), 0.0)
        power = norm(arriving)
        towards = arriving / jnp.where(power > 0, power, 1.0)[..., None]
        cosine = -dot(towards, flat)
        lit = (power > 0) & (cosine > 0)
        if facing is not None:
            irradiance *= facing.unshadowed(hiding_factor(cosine, eye))
        # The line of sight points into the eye, against the light that leaves.
        across = -(dot(towards, view) - dot(towards, flat) * dot(view, flat))
        values = angles.functions(jnp.where(lit, cosine, 1.0), pixels.cosine, across)
        return total + tint[:, None, None] * (values * jnp.where(lit, irradiance, 0.0)), None

    shape = tints.shape[1], len(angles.coefficient_scales()), pixels.cosine.size
    total = jax.lax.scan(add, jnp.zeros(shape, flux.dtype), (flux, tints))[0]
    total = total if mixtures is None else jnp.einsum("kr,tkp->trp", mixtures, total)
    return total * camera_share(pixels, eye)


@eqx.filter_jit
def sample_pixels(pixels: Any) -> Any:
    """Return `_SAMPLES` pixels that are spread evenly over the picture."""
    count = jax.tree.leaves(pixels)[0].shape[-1]
    chosen = np.linspace(0, count - 1, _SAMPLES).astype(int)
    return jax.tree.map(lambda leaf: leaf[..., chosen], pixels)


@eqx.filter_jit
def choose_mixtures(
    light: Float[Array, "tints functions pixels"], angles: AngularFunctions
) -> tuple[Float[Array, "functions mixtures"], Float[Array, "functions mixtures"]]:
    """Choose the mixtures of functions that light at some pixels is made of: the principal
    components of the functions, each weighted by the size of its coefficients.

    Args:
        light: `light_moments` of these pixels, without mixtures.
        angles: The functions.

    Returns:
        The weights by which functions are summed into mixtures, and those by which mixtures
        approximate the functions.
    """
    weights = jnp.asarray(angles.coefficient_scales(), light.dtype)[:, None]
    weighted = light * weights
    moments = jnp.einsum("tkp,tlp->kl", weighted, weighted)
    moments = moments / jnp.maximum(jnp.trace(moments), jnp.finfo(light.dtype).tiny)
    # One matrix, in a program that runs alone: no thread of LAPACK's waits for another.
    largest = jnp.linalg.eigh(moments)[1][:, -_MIXTURES:]  # noqa: TID251
    return largest * weights, largest / weights


def surface_indices(iris: Iris, aqueous_index: Scalar) -> tuple[Scalar, Scalar]:
    """Return the refractive indices before and behind the iris's surface."""
    indices, dtype = iris.indices(aqueous_index), jnp.result_type(float)
    return jnp.asarray(indices.aqueous, dtype), jnp.asarray(indices.abl, dtype)


def _degree_pairs(degree: int) -> list[tuple[int, int]]:
    """Return the degrees a ≤ b of a reciprocal product of two polynomials."""
    return [(a, b) for a in range(degree + 1) for b in range(a, degree + 1)]


def _direction_grid(cosines, azimuths):
    """Pair cosines of incidence with each combination of an azimuth and an exit cosine."""
    exit_azimuths = jnp.repeat(jnp.asarray(azimuths, cosines.dtype), cosines.size)
    return cosines, Directions(jnp.tile(cosines, len(azimuths)), exit_azimuths)
