"""Functions of directions in which every BRDF of Rayleigh's law can be written.

Such a BRDF has the azimuthal orders m = 0, 1 and 2 and no more:
f = t(μ_i) t(μ_o) Σ_m cos(mφ) s_m(v_i) s_m(v_o) Σ_ab c_mab T_a(v_i) T_b(v_o), with v the cosines in
the ABL, t the share that crosses the first surface and s_m = 1, v √(1 − v²), 1 − v². By reciprocity
c is symmetric in a and b.  [Chandrasekhar 1960, Sections 13, 16]
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax.anatomy.eye import Eye
from irisjax.numerics.interpolation import chebyshev_nodes
from irisjax.numerics.linear import leading_subspace
from irisjax.numerics.portions import pixelwise
from irisjax.optics.conicoid import dot, joined, norm
from irisjax.optics.fresnel import fresnel, refract
from irisjax.render.polynomials import along_nodes, polynomials
from irisjax.render.project import IrisPixels
from irisjax.render.shading import Field, normals, shares
from irisjax.tissue.iris import Iris

AZIMUTHS = 0.0, np.pi / 2, np.pi
"""Three values tell the orders 0, 1 and 2."""
_FALLS = 0.2  # coefficients, from degree to degree in a cosine
_MIXTURES = 6


class AngularFunctions(eqx.Module):
    """The functions of directions: products of polynomials in both cosines within the ABL, the same
    both ways, for each azimuthal order.
    """

    degrees: tuple[int, int, int] = eqx.field(static=True)

    def count(self, orders: int = 3) -> int:
        """How many functions the first azimuthal orders have."""
        return sum(len(_pairs(degree)) for degree in self.degrees[:orders])

    def nodes(self, indices: tuple[Array, Array], dtype: Any) -> Float[Array, " nodes"]:
        """Cosines in the ABL at which a BRDF is asked for, those of directions that leave the
        eye's tissue.
        """
        unit = jnp.asarray((chebyshev_nodes(max(self.degrees) + 1) + 1) / 2, dtype)
        lowest = refract(jnp.zeros((), dtype), *indices)
        return lowest + (1 - lowest) * unit

    def functions(
        self,
        cos_incidence: Float[Array, " pixels"],
        cos_exit: Float[Array, " pixels"],
        across: Float[Array, " pixels"],
        indices: tuple[Array, Array],
    ) -> Float[Array, "functions pixels"]:
        """At directions in the aqueous humour, (functions, pixels); `across`: the scalar product of
        their parts along the iris.
        """
        n, found = max(self.degrees) + 1, []
        inside = [refract(c, *indices) for c in (cos_incidence, cos_exit)]
        passed = [
            fresnel(c, v, *indices)[1]
            for c, v in zip((cos_incidence, cos_exit), inside, strict=True)
        ]
        lowest = refract(jnp.zeros_like(cos_exit), *indices)
        into, out = (polynomials(2 * (v - lowest) / (1 - lowest) - 1, n) for v in inside)
        bent = (indices[0] / indices[1]) ** 2
        along = bent * across
        sines = [1 - v * v for v in inside]
        orders = (
            jnp.ones_like(along),
            along * inside[0] * inside[1],
            2 * along * along - sines[0] * sines[1],
        )
        both = passed[0] * passed[1]
        for order, degree in zip(orders, self.degrees, strict=True):
            weight = order * both
            for a, b in _pairs(degree):
                product = into[a] * out[b] if a == b else into[a] * out[b] + into[b] * out[a]
                found.append(weight * product)
        return jnp.stack(found)

    def coefficients(
        self,
        found: Float[Array, "texels in azimuths out channels"],
        inside: Float[Array, " nodes"],
    ) -> Float[Array, "texels functions channels"]:
        """Of values (texels, in, azimuths, out, channels) at the nodes: (texels, functions,
        channels).
        """
        first, half, last = (found[:, :, k] for k in range(3))
        cos_two = (first + last - 2 * half) / 4
        orders = half + cos_two, (first - last) / 2, cos_two
        sine = jnp.sqrt(1 - inside * inside)
        rows = []
        for values, factor, degree in zip(
            orders, (jnp.ones_like(sine), sine * inside, sine * sine), self.degrees, strict=True
        ):
            scaled_values = values / (factor[:, None, None] * factor[:, None])
            whole = along_nodes(along_nodes(scaled_values, 1), 2)
            # Reciprocal but for rounding and the table's error.
            rows += [(whole[:, a, b] + whole[:, b, a]) / 2 for a, b in _pairs(degree)]
        return jnp.stack(rows, 1)

    def weights(self) -> np.ndarray:
        """About how large the coefficients are, of the largest: (functions,)."""
        return np.array([_FALLS ** (a + b) for degree in self.degrees for a, b in _pairs(degree)])


class AngularLight(eqx.Module):
    """Light of all lamps at the pixels, in functions of directions or in mixtures of these.

    Attributes:
        light: Irradiance of all lights together times each function, or mixture, and all shares on
            the way out.
        mixtures: The share of each function in each mixture; `None` where there are none.
    """

    light: Float[Array, "tints parts pixels"]
    mixtures: Float[Array, "functions mixtures"] | None = None


@pixelwise
def light_of(
    seen: IrisPixels,
    flux: Float[Array, "lights 3 rows columns"],
    tint: Float[Array, "lights 3"] | None,
    eye: Eye,
    slopes: Float[Array, "2 angles radii"] | None,
    iris: Iris,
    angles: AngularFunctions,
) -> Float[Array, "tints functions pixels"]:
    """Sum over the lights of irradiance times the functions of directions and the share that
    reaches the camera.
    """
    n = iris.indices(eye.aqueous_index)
    indices = n.aqueous, n.abl
    flat = eye.iris_normal(joined(seen.point))
    tilted = joined(normals(seen, eye, slopes))
    view = joined(seen.direction)

    def add(total, light):
        one, colour = light
        arriving = joined(tuple(Field(one[None], eye.iris_radius).at(seen.point)[0]))
        irradiance = jnp.maximum(-dot(arriving, tilted), 0.0)
        power = norm(arriving)
        towards = arriving / jnp.where(power > 0, power, 1.0)[..., None]
        cosine = -dot(towards, flat)
        lit = (power > 0) & (cosine > 0)
        cosine = jnp.where(lit, cosine, 1.0)
        # The line of sight runs into the eye: light comes out against it.
        across = -(dot(towards, view) - dot(towards, flat) * dot(view, flat))
        values = angles.functions(cosine, seen.cosine, across, indices)
        values = values * jnp.where(lit, irradiance, 0.0)
        return total + colour[:, None, None] * values, None

    tints = jnp.ones((flux.shape[0], 1), flux.dtype) if tint is None else tint
    zero = jnp.zeros((tints.shape[1], angles.count(), seen.cosine.size), flux.dtype)
    return jax.lax.scan(add, zero, (flux, tints))[0] * shares(seen, eye)


@eqx.filter_jit
def mixed(
    light: Float[Array, "tints functions pixels"], angles: AngularFunctions
) -> tuple[Float[Array, "tints mixtures pixels"], Float[Array, "functions mixtures"]]:
    """Light in the mixtures of functions that it has most of, as coefficients weigh them, and what
    of each function is in a mixture.
    """
    weights = jnp.asarray(angles.weights(), light.dtype)[:, None]
    weighted = light * weights
    product = jnp.einsum("tkp,tlp->kl", weighted, weighted)
    product = product / jnp.maximum(jnp.trace(product), jnp.finfo(light.dtype).tiny)
    most = leading_subspace(product, min(_MIXTURES, len(product)))
    return jnp.einsum("kr,tkp->trp", most, weighted), most / weights


def _pairs(degree: int) -> list[tuple[int, int]]:
    return [(a, b) for a in range(degree + 1) for b in range(a, degree + 1)]
