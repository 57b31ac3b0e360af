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
from irisjax.render.polynomials import along_nodes, polynomials
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Facing, flux_at, hidden_by, normal_at, shares
from irisjax.tissue.iris import Iris
from irisjax.transport.light import Directions

_AZIMUTHS = 0.0, np.pi / 2, np.pi  # three values determine the orders 0, 1 and 2
_OFF = 0.4, 1.9, 2.8
_FALLS = 0.2  # coefficients, from degree to degree in a cosine
_MIXTURES = 6
_CHOSEN_BY = 4096  # pixels

PerPixel = Float[Array, " pixels"]
Functions = Float[Array, "functions pixels"]
Nodes = tuple[Float[Array, " incidences"], Directions]
Solved = Float[Array, "texels incidences exits channels"]
Coefficients = Float[Array, "texels functions channels"]


class AbstractAngular(eqx.Module):
    """Functions of the directions of light and sight, at an iris in the aqueous humour.

    Attributes:
        indices: Refractive indices before and behind the surface of the iris.
    """

    indices: eqx.AbstractVar[tuple[Scalar, Scalar]]

    @abc.abstractmethod
    def functions(
        self, cos_incidence: PerPixel, cos_exit: PerPixel, across: PerPixel | None
    ) -> Functions:
        """Values at directions in the aqueous humour. `across` is the scalar product of their
        parts along the iris; `None` is the mean over azimuths, of functions that have one.
        """

    @abc.abstractmethod
    def nodes(self) -> tuple[Nodes, Nodes]:
        """Incidences and exits at which the BRDF is solved, and as many others at which the table
        is compared.
        """

    @abc.abstractmethod
    def coefficients(self, brdf: Solved) -> Coefficients:
        """Coefficients from BRDFs at the nodes."""

    def exits(self, cos_exit: PerPixel) -> Functions | None:
        """Functions that no light changes; `None` if all depend on the light."""
        del cos_exit
        return None

    def inside(self, degree: int) -> Float[Array, " nodes"]:
        """Nodes of polynomials in the cosine within the ABL, from grazing exit to normal."""
        unit = jnp.asarray((chebyshev_nodes(degree + 1) + 1) / 2, self.indices[0].dtype)
        lowest = refract(jnp.zeros_like(self.indices[0]), *self.indices)
        return lowest + (1 - lowest) * unit

    def crossing(self, cosine: PerPixel, degree: int) -> tuple[PerPixel, Functions, PerPixel]:
        """The cosine within the ABL, polynomials of it (a BRDF is smooth in it, not in the cosine
        outside), and the share 1 − F that crosses the surface.
        """
        inside = refract(cosine, *self.indices)
        lowest = refract(jnp.zeros_like(inside), *self.indices)
        rows = polynomials(2 * (inside - lowest) / (1 - lowest) - 1, degree + 1)
        return inside, rows, fresnel(cosine, inside, *self.indices)[1]


class AngularFunctions(AbstractAngular):
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
        (v, into, passed), (w, out, left) = (
            self.crossing(c, max(self.degrees)) for c in (cos_incidence, cos_exit)
        )
        both = passed * left
        orders = [both]
        if across is not None:
            along = (self.indices[0] / self.indices[1]) ** 2 * across
            sines = (1 - v * v) * (1 - w * w)
            orders += [along * v * w * both, (2 * along * along - sines) * both]
        found = []
        for weight, degree in zip(orders, self.degrees, strict=False):
            for a, b in _pairs(degree):
                product = into[a] * out[b] if a == b else into[a] * out[b] + into[b] * out[a]
                found.append(weight * product)
        return jnp.stack(found)

    def nodes(self) -> tuple[Nodes, Nodes]:
        inside = self.inside(max(self.degrees))
        others = jnp.asarray(np.linspace(0.2, 0.95, inside.size), inside.dtype)
        outside = refract(inside, *self.indices[::-1])
        return _each(outside, _AZIMUTHS), _each(others, _OFF)

    def coefficients(self, brdf: Solved) -> Coefficients:
        inside = self.inside(max(self.degrees))
        passed = fresnel(refract(inside, *self.indices[::-1]), inside, *self.indices)[1]
        brdf = brdf.reshape(*brdf.shape[:2], len(_AZIMUTHS), inside.size, -1)
        brdf = brdf / (passed[:, None, None, None] * passed[:, None])
        first, half, last = (brdf[:, :, k] for k in range(3))
        cos_two = (first + last - 2 * half) / 4
        orders = half + cos_two, (first - last) / 2, cos_two
        sine = jnp.sqrt(1 - inside * inside)
        factors = jnp.ones_like(sine), sine * inside, sine * sine
        rows = []
        for values, factor, degree in zip(orders, factors, self.degrees, strict=True):
            scaled = values / (factor[:, None, None] * factor[:, None])
            whole = along_nodes(along_nodes(scaled, 1), 2)
            # Reciprocal but for rounding and the table's error.
            rows += [(whole[:, a, b] + whole[:, b, a]) / 2 for a, b in _pairs(degree)]
        return jnp.stack(rows, 1)

    def weights(self) -> np.ndarray:
        """About how large the coefficients are, of the largest: (functions,)."""
        return np.array([_FALLS ** (a + b) for degree in self.degrees for a, b in _pairs(degree)])


AngularLight = tuple[Float[Array, "tints parts pixels"], Float[Array, "functions mixtures"] | None]
"""Irradiance of all lights at the pixels times each function of directions (none where the texels
hold them), or mixture of these, and all shares on the way out; and the share of each function in
each mixture, `None` where there are none.
"""


@pixelwise
def light_of(
    turned: tuple[IrisPixels, Facing | None],
    flux: Float[Array, "lights 3 rows columns"],
    tints: Float[Array, "lights tints"],
    eye: Eye,
    angles: AngularFunctions,
    mixtures: Float[Array, "functions mixtures"] | None,
) -> Float[Array, "tints parts pixels"]:
    """Sum over the lights of irradiance times the functions of directions, or mixtures of them, and
    the share that reaches the camera.
    """
    seen, facing = turned
    flat = eye.iris_normal(from_parts(seen.point))
    normal = from_parts(normal_at(seen, eye, facing))
    view = from_parts(seen.direction)

    def add(total, light):
        one, colour = light
        arriving = from_parts(tuple(flux_at(one, eye.iris_radius, seen.point)))
        irradiance = jnp.maximum(-dot(arriving, normal), 0.0)
        power = norm(arriving)
        towards = arriving / jnp.where(power > 0, power, 1.0)[..., None]
        cosine = -dot(towards, flat)
        lit = (power > 0) & (cosine > 0)
        if facing is not None:
            irradiance *= facing.left_of(hidden_by(cosine, eye))
        # The line of sight runs into the eye: light comes out against it.
        across = -(dot(towards, view) - dot(towards, flat) * dot(view, flat))
        values = angles.functions(jnp.where(lit, cosine, 1.0), seen.cosine, across)
        return total + colour[:, None, None] * (values * jnp.where(lit, irradiance, 0.0)), None

    shape = tints.shape[1], len(angles.weights()), seen.cosine.size
    total = jax.lax.scan(add, jnp.zeros(shape, flux.dtype), (flux, tints))[0]
    total = total if mixtures is None else jnp.einsum("kr,tkp->trp", mixtures, total)
    return total * shares(seen, eye)


@eqx.filter_jit
def some_of(pixels: Any) -> Any:
    """Return the `_CHOSEN_BY` pixels, spread over the picture, by which mixtures are chosen."""
    count = jax.tree.leaves(pixels)[0].shape[-1]
    places = np.linspace(0, count - 1, _CHOSEN_BY).astype(int)
    return jax.tree.map(lambda leaf: leaf[..., places], pixels)


@eqx.filter_jit
def mixtures_of(
    light: Float[Array, "tints functions pixels"], angles: AngularFunctions
) -> tuple[Float[Array, "functions mixtures"], Float[Array, "functions mixtures"]]:
    """Choose the mixtures of functions that light has most of, as coefficients weigh them: what a
    function adds to each, and the share of each in a function.
    """
    weights = jnp.asarray(angles.weights(), light.dtype)[:, None]
    weighted = light * weights
    product = jnp.einsum("tkp,tlp->kl", weighted, weighted)
    product = product / jnp.maximum(jnp.trace(product), jnp.finfo(light.dtype).tiny)
    most = jnp.linalg.eigh(product)[1][:, -_MIXTURES:]
    return most * weights, most / weights


def surface_indices(iris: Iris, aqueous_index: Scalar) -> tuple[Scalar, Scalar]:
    """Indices before and behind the iris's surface."""
    n, dtype = iris.indices(aqueous_index), jnp.result_type(float)
    return jnp.asarray(n.aqueous, dtype), jnp.asarray(n.abl, dtype)


def _pairs(degree: int) -> list[tuple[int, int]]:
    return [(a, b) for a in range(degree + 1) for b in range(a, degree + 1)]


def _each(cosines, azimuths):
    """Incidences, and each azimuth with each exit."""
    turns = jnp.repeat(jnp.asarray(azimuths, cosines.dtype), cosines.size)
    return cosines, Directions(jnp.tile(cosines, len(azimuths)), turns)
