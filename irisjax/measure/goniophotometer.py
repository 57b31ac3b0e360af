"""Virtual goniophotometer: the BRDF of the iris."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import PRNGKey, Spectrum
from irisjax.anatomy.media import Media
from irisjax.measure.instrument import AbstractInstrument
from irisjax.measure.measurement import COSINE
from irisjax.measure.observe import observe
from irisjax.numerics.checks import check_range
from irisjax.tissue.iris import Iris
from irisjax.transport.light import Directions
from irisjax.transport.solution import RESULTS, Solution
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


class Goniophotometer(AbstractInstrument):
    """Reads the BRDF of the iris in the aqueous humour, at given exit directions.

    - `cos_exit`, `azimuth` (radians from the plane of incidence): shape (exits,).

    The cornea is left out, and so is light mirrored by the first surface: a delta of its own.
    """

    cos_exit: Float[Array, " exits"]
    azimuth: Float[Array, " exits"]

    def __init__(self, wavelengths, *, cos_exit, azimuth: Any = 0.0, **settings: Any):
        if isinstance(settings.get("cos_incidence"), str) or isinstance(cos_exit, str):
            raise ValueError(
                "a BRDF needs directions: cos_incidence and cos_exit must be numbers in [0, 1]"
            )
        super().__init__(wavelengths, **settings)
        if self.cornea != "none":
            raise ValueError(f"a BRDF is that of the bare iris: cornea = {self.cornea!r}")
        check_range("cos_exit", cos_exit, COSINE)
        dtype, shapes = self.wavelengths.dtype, (np.shape(cos_exit), np.shape(azimuth))
        if max(map(len, shapes)) > 1:
            raise ValueError(f"exits must be a list of directions, got shapes {shapes}")
        sizes = {shape[0] for shape in shapes if shape} - {1}
        if len(sizes) > 1:
            raise ValueError(
                "cos_exit and azimuth must be one number or one for each exit, "
                f"got shapes {shapes[0]} and {shapes[1]}"
            )
        exits = (jnp.atleast_1d(jnp.asarray(x, dtype)) for x in (cos_exit, azimuth))
        self.cos_exit, self.azimuth = jnp.broadcast_arrays(*exits)

    @property
    def exits(self) -> Directions:
        """The directions it looks from."""
        return Directions(self.cos_exit, self.azimuth)

    def reading(self, light: Solution, factor) -> Brdf:
        """See `AbstractInstrument`."""
        assert light.brdf is not None
        assert self.cos_incidence is not None
        scale, error = factor * self.gain, light.brdf_error
        return Brdf(
            wavelengths=self.wavelengths,
            cos_incidence=self.cos_incidence,
            cos_exit=self.cos_exit,
            azimuth=self.azimuth,
            values=scale * light.brdf,
            standard_error=None if error is None else scale * error,
            mirrored=factor * light.mirrored,
            status=light.status,
        )


def brdf(
    iris: Iris,
    wavelengths,
    *,
    cos_incidence=1.0,
    cos_exit,
    azimuth=0.0,
    solver: AbstractSolver | None = None,
    media: Media | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
) -> Brdf:
    """BRDF of the iris in the aqueous humour, at given exit directions.

    ILIT redraws directions on entry, so its BRDF does not depend on the azimuth and on the
    incidence only through the first surface's transmittance; radiative transfer depends on all
    three.

    `cos_exit` and `azimuth` broadcast together to shape (exits,); cosines in [0, 1]. `MonteCarlo`
    returns averages over cells of the cosine bounded half-way between the exits given. For the rest
    see `reflectance`. **Raises:** `ValueError` for concrete input out of range.
    """
    instrument = Goniophotometer(
        wavelengths, cos_incidence=cos_incidence, cos_exit=cos_exit, azimuth=azimuth, media=media
    )
    return observe(iris, instrument, solver, key=key, throw=throw)


def principal_plane(n: int = 181):
    """Signed exit angles (radians), their cosines and azimuths across the principal plane, grazing
    left out.

    Negative angles lie on the light's side (azimuth π).
    """
    angle = (jnp.arange(n) - (n - 1) / 2) / n * jnp.pi
    return angle, jnp.cos(angle), jnp.where(angle < 0, jnp.pi, 0.0)
