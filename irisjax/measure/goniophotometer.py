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

    Attributes:
        wavelengths: In nm.
        cos_incidence: Cosine of the angle of incidence.
        cos_exit: Cosines of the exit angles, shape (exits,).
        azimuth: Azimuths of the exits from the plane of incidence, radians, shape (exits,); 0 is
            where a mirror would send the light.
        values: The BRDF, shape (wavelengths, exits).
        standard_error: Its standard error where it is sampled, otherwise `None`.
        mirrored: Share of the light that the first surface reflects into the mirror direction,
            shape (wavelengths,); `values` do not include this delta function.
        status: A `RESULTS` item.
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
    """An instrument that reads the BRDF of the bare iris in the aqueous humour.

    Light reflected by the first surface is not included, because it is a delta function.

    Attributes:
        cos_exit: Cosines of the exit angles, shape (exits,).
        azimuth: Azimuths of the exits from the plane of incidence, radians, shape (exits,).
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
        """The exit directions."""
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
    """Compute the BRDF of the iris in the aqueous humour, at given exit directions.

    ILIT redraws directions on entry, so its BRDF is independent of the azimuth and depends on the
    incidence only through the first surface's transmittance; radiative transfer depends on all
    three. `MonteCarlo` returns averages over cells of the cosine, bounded half-way between the
    exits.

    Args:
        iris: The iris.
        wavelengths: In nm, increasing, within the pigment tables.
        cos_incidence: Cosine of the angle of incidence.
        cos_exit: Cosines of the exit angles, in [0, 1].
        azimuth: Azimuths of the exits, radians; it broadcasts with `cos_exit` to shape (exits,).
        solver: See `observe`.
        media: See `AbstractInstrument`.
        key: See `observe`.
        throw: See `observe`.

    Raises:
        ValueError: As `observe` does.
    """
    instrument = Goniophotometer(
        wavelengths, cos_incidence=cos_incidence, cos_exit=cos_exit, azimuth=azimuth, media=media
    )
    return observe(iris, instrument, solver, key=key, throw=throw)


def principal_plane(n: int = 181):
    """Return exit directions across the principal plane, without grazing ones.

    Args:
        n: Number of directions.

    Returns:
        Signed exit angles (radians; negative on the light's side), their cosines, and azimuths (π
        on the light's side).
    """
    angle = (jnp.arange(n) - (n - 1) / 2) / n * jnp.pi
    return angle, jnp.cos(angle), jnp.where(angle < 0, jnp.pi, 0.0)
