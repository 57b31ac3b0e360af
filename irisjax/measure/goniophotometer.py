"""Virtual goniophotometer: the BRDF of the iris."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from irisjax._types import PRNGKey, Spectrum
from irisjax.measure.measurement import check_cosine, check_wavelengths, layers_of, prepared
from irisjax.tissue.iris import Iris
from irisjax.tissue.pigments import extinction
from irisjax.transport.ilit.exact import Exact
from irisjax.transport.process import ILIT_2006, Process
from irisjax.transport.solution import RESULTS, throw
from irisjax.transport.solver import AbstractSolver


class Brdf(eqx.Module):
    """Bidirectional reflectance distribution function, 1/sr, without the mirrored part.

    - `values`: shape (wavelengths, exits); `standard_error` likewise, or `None`.
    - `cos_exit`, `azimuth`: exit directions, shape (exits,), azimuth in radians from the plane of
        incidence (0 is forward scattering, where a mirror would send the light).
    - `mirrored`: share of the light mirrored by the first surface into the mirror direction, shape
        (wavelengths,): a delta that `values` leave out.
    """

    wavelengths: Spectrum
    cos_incidence: Float[Array, ""]
    cos_exit: Float[Array, " exits"]
    azimuth: Float[Array, " exits"]
    values: Float[Array, "wavelengths exits"]
    standard_error: Float[Array, "wavelengths exits"] | None
    mirrored: Spectrum
    status: RESULTS

    def __repr__(self):
        return f"Brdf of shape {self.values.shape} (wavelengths, exits), 1/sr"


def brdf(
    iris: Iris,
    wavelengths,
    *,
    cos_incidence=1.0,
    cos_exit,
    azimuth=0.0,
    solver: AbstractSolver = Exact(),  # noqa: B008
    process: Process = ILIT_2006,
    key: PRNGKey | None = None,
    raise_on_failure: bool = True,
) -> Brdf:
    """BRDF of the iris in the aqueous humour, at given exit directions.

    ILIT redraws directions on entry, so its BRDF does not depend on the azimuth and on the
    incidence only through the first surface's transmittance; depth-resolved transport depends on
    all three.

    `cos_exit` and `azimuth` broadcast together to shape (exits,); cosines in [0, 1]. The cornea is
    left out, whatever the process says. `MonteCarlo` returns averages over cells of the cosine
    bounded half-way between the exits given. For the rest see
    `reflectance`. **Raises:** `ValueError` for concrete input out of range.
    """
    check_wavelengths(wavelengths)
    check_cosine("cos_incidence", cos_incidence)
    check_cosine("cos_exit", cos_exit)
    if isinstance(cos_incidence, str) or isinstance(cos_exit, str):
        raise ValueError(
            "a BRDF needs directions: cos_incidence and cos_exit must be numbers in [0, 1]"
        )
    table = extinction(wavelengths)
    dtype = table.wavelengths.dtype
    exits, azimuth = jnp.broadcast_arrays(
        jnp.atleast_1d(jnp.asarray(cos_exit, dtype)), jnp.atleast_1d(jnp.asarray(azimuth, dtype))
    )
    solver = prepared(solver, iris, table, process)
    result = _solve(
        iris, table, solver, process, jnp.asarray(cos_incidence, dtype), exits, azimuth, key
    )
    if raise_on_failure:
        throw(result.status)
    return result


def principal_plane(n: int = 181):
    """Signed exit angles (radians), their cosines and azimuths across the principal plane, grazing
    left out.

    Negative angles lie on the light's side (azimuth π).
    """
    angle = (jnp.arange(n) - (n - 1) / 2) / n * jnp.pi
    return angle, jnp.cos(angle), jnp.where(angle < 0, jnp.pi, 0.0)


@jax.jit
def _solve(iris, table, solver, process, cosine, exits, azimuth, key) -> Brdf:
    layers = layers_of(iris, table, process)
    solution = solver.solve(layers, process, cosine, cos_exit=exits, azimuth=azimuth, key=key)
    return Brdf(
        wavelengths=table.wavelengths,
        cos_incidence=cosine,
        cos_exit=exits,
        azimuth=azimuth,
        values=solution.brdf,
        standard_error=solution.brdf_error,
        mirrored=solution.mirrored,
        status=solution.result,
    )
