"""Virtual spectrophotometer, radiometer, colorimeter and goniophotometer."""

import dataclasses
from typing import Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from irisjax._types import Numbers, PRNGKey, Scalar, Spectrum
from irisjax.measure.colour import OBSERVER, Colour, Observer, illuminant_power
from irisjax.measure.instrument import AbstractInstrument, InstrumentSettings
from irisjax.measure.measurement import COSINE, Reading
from irisjax.measure.measurement import wavelengths as grid
from irisjax.measure.observe import observe
from irisjax.numerics.checks import check_range
from irisjax.tissue.iris import Iris
from irisjax.transport.light import Directions
from irisjax.transport.solution import RESULTS, Solution
from irisjax.transport.solver import AbstractSolver


class Spectrophotometer(AbstractInstrument):
    """An instrument that reads the share of the incident light that the iris sends back.

    With an `aperture` it reads the reflectance factor in that cone, π⟨f⟩ of the BRDF f: 1 for a
    white diffuser. The first surface's mirror reflection is then left out: a contact probe is
    matched to the iris, and at 45°/0° it goes elsewhere. The spot is infinitely wide: what leaves a
    small one sideways is not lost. Through the cornea (`"round-trip"`) and without an aperture, all
    that is sent back is taken as even in all directions.
    """

    has_bands = has_aperture = True

    def __init__(self, wavelengths: Numbers, **settings: Unpack[InstrumentSettings]):
        super().__init__(wavelengths, **settings)

    @property
    def exits(self) -> Directions | None:
        if self.aperture is None:
            return None
        # Gauss's rule in sin², which a matt surface fills evenly, and the azimuth's for cos and
        # cos 2φ: the mean of four directions.
        nodes = 0.5 + np.array([-1, -1, 1, 1]) / 12**0.5
        square = (self.aperture / self.media.aqueous) ** 2 * nodes
        return Directions(jnp.sqrt(1 - square), np.pi / 4 * np.array([1.0, 3, 1, 3]))

    def counted(self, solution: Solution) -> tuple[Spectrum, Spectrum | None]:
        if solution.brdf is None:
            return super().counted(solution)
        error = solution.brdf_error
        error = None if error is None else jnp.pi / 4 * jnp.sqrt((error**2).sum(-1))
        return jnp.pi * solution.brdf.mean(-1), error

    def reading(self, solution: Solution, factor: Scalar) -> Reading:
        return self.spectrum(solution, factor, factor * self.gain, "reflectance")


class Radiometer(AbstractInstrument):
    """An instrument that reads the spectral radiance under an illuminant  [LB06 Section 4].

    The illuminant's relative spectral power E (1 at 560 nm) falls on the eye. Light is dimmed on
    its way through tear film and cornea (by default inward only; light reflected by the tear film
    is not included) and returns evenly over the hemisphere, L = R·E/π. The reading of a perfect
    white diffuser in place of the eye is E/π.
    """

    has_bands = True

    power: Spectrum
    illuminant: str = eqx.field(static=True)

    def __init__(
        self,
        wavelengths: Numbers,
        *,
        illuminant: str = "D65",
        **settings: Unpack[InstrumentSettings],
    ):
        settings.setdefault("cornea", "inward")
        super().__init__(wavelengths, **settings)
        power = illuminant_power(illuminant, self.wavelengths)
        self.power = jnp.asarray(power, self.wavelengths.dtype)
        self.illuminant = illuminant

    @property
    def rays(self) -> Spectrum:
        return self.power  # as in LB06

    def reading(self, solution: Solution, factor: Scalar) -> Reading:
        known = jnp.isfinite(self.power).all()
        status = RESULTS.where(known, solution.status, RESULTS.invalid_input)
        solution = dataclasses.replace(solution, status=status)
        scale = factor * self.gain * self.power / jnp.pi
        return self.spectrum(solution, factor, scale, "radiance", unit="relative/sr")


class Transmissometer(AbstractInstrument):
    """An instrument that reads the share of the incident light that leaves the iris behind, into
    the posterior chamber, in all directions; the iris has an `ipe_melanin`.
    """

    has_bands = True

    def __init__(self, wavelengths: Numbers, **settings: Unpack[InstrumentSettings]):
        super().__init__(wavelengths, **settings)
        if self.cornea == "round-trip":
            raise ValueError("transmitted light leaves behind: cornea is 'none' or 'inward'")

    def counted(self, solution: Solution) -> tuple[Spectrum, Spectrum | None]:
        if solution.transmitted is None:
            message = "no light gets behind a black pigment epithelium"
            raise ValueError(f"{message}: give the iris an ipe_melanin, ug/mm2 (--ipe-melanin)")
        return solution.transmitted, solution.transmitted_error

    def reading(self, solution: Solution, factor: Scalar) -> Reading:
        return self.spectrum(solution, factor, factor * self.gain, "transmittance")


class Colorimeter(AbstractInstrument):
    """An instrument that reads the colour of the iris's reflectance for an observer under an
    illuminant, by default on 380–780 nm in steps of 5 nm.
    """

    observer: Observer

    def __init__(
        self,
        wavelengths: Numbers = None,
        *,
        illuminant: str = "D65",
        observer: str = OBSERVER,
        **settings: Unpack[InstrumentSettings],
    ):
        wavelengths = grid(380, 780, 5) if wavelengths is None else wavelengths
        super().__init__(wavelengths, **settings)
        self.observer = Observer.of(wavelengths, illuminant, observer)

    def reading(self, solution: Solution, factor: Scalar) -> Colour:
        values, _ = self.counted(solution)
        return self.observer.colour(jnp.asarray(factor * self.gain * values), solution.status)


class Brdf(eqx.Module):
    """Bidirectional reflectance distribution function, 1/sr, without the mirrored part.

    Attributes:
        azimuth: Azimuths of the exits from the plane of incidence, radians; 0 is where a mirror
            would send the light.
        standard_error: Standard errors of sampled values, 1/sr; `None` for computed ones.
        mirrored: Share of the light that the first surface reflects into the mirror direction, a
            delta function that is not in `values`.
        status: A `RESULTS` item.
    """

    wavelengths: Spectrum
    cos_incidence: Scalar
    cos_exit: Float[Array, " exits"]
    azimuth: Float[Array, " exits"]
    values: Float[Array, "wavelengths exits"]
    standard_error: Float[Array, "wavelengths exits"] | None
    mirrored: Spectrum
    status: RESULTS

    def __repr__(self) -> str:
        return f"Brdf of shape {self.values.shape} (wavelengths, exits), 1/sr"


class Goniophotometer(AbstractInstrument):
    """An instrument that reads the BRDF of the bare iris in the aqueous humour, at exits with these
    cosines and azimuths (radians from the plane of incidence).

    Light reflected by the first surface is not included, because it is a delta function.
    """

    cos_exit: Float[Array, " exits"]
    azimuth: Float[Array, " exits"]

    def __init__(
        self,
        wavelengths: Numbers,
        *,
        cos_exit: Numbers,
        azimuth: Numbers = 0.0,
        **settings: Unpack[InstrumentSettings],
    ):
        if isinstance(settings.get("cos_incidence"), str) or isinstance(cos_exit, str):
            message = "cos_incidence and cos_exit must be numbers in [0, 1]"
            raise ValueError(f"a BRDF needs directions: {message}")
        super().__init__(wavelengths, **settings)
        if self.cornea != "none":
            raise ValueError(f"a BRDF is that of the bare iris: cornea = {self.cornea!r}")
        check_range("cos_exit", cos_exit, COSINE)
        dtype, shapes = self.wavelengths.dtype, (np.shape(cos_exit), np.shape(azimuth))
        if max(map(len, shapes)) > 1:
            raise ValueError(f"exits must be a list of directions, got shapes {shapes}")
        sizes = {shape[0] for shape in shapes if shape} - {1}
        if len(sizes) > 1:
            message = "must be one number or one for each exit, got shapes"
            raise ValueError(f"cos_exit and azimuth {message} {shapes[0]} and {shapes[1]}")
        exits = (jnp.atleast_1d(jnp.asarray(x, dtype)) for x in (cos_exit, azimuth))
        self.cos_exit, self.azimuth = jnp.broadcast_arrays(*exits)

    @property
    def exits(self) -> Directions:
        return Directions(self.cos_exit, self.azimuth)

    def reading(self, solution: Solution, factor: Scalar) -> Brdf:
        assert solution.brdf is not None
        assert self.cos_incidence is not None
        scale, error = factor * self.gain, solution.brdf_error
        error = None if error is None else scale * error
        directions = self.cos_incidence, self.cos_exit, self.azimuth
        read = scale * solution.brdf, error, factor * solution.mirrored
        return Brdf(self.wavelengths, *directions, *read, solution.status)


def reflectance(
    iris: Iris,
    wavelengths: Numbers,
    *,
    solver: AbstractSolver | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
    **settings: Unpack[InstrumentSettings],
) -> Reading:
    """Compute the spectral reflectance of an iris, the share of incident light it sends back.

    Args:
        iris: The iris.
        wavelengths: In nm, increasing, within the pigment tables; see `wavelengths`.
        solver: See `observe`.
        key: See `observe`.
        throw: See `observe`.
        **settings: Of the instrument; see `AbstractInstrument`.

    Raises:
        ValueError: As `observe` does.
    """
    return observe(iris, Spectrophotometer(wavelengths, **settings), solver, key=key, throw=throw)


def transmittance(
    iris: Iris,
    wavelengths: Numbers,
    *,
    solver: AbstractSolver | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
    **settings: Unpack[InstrumentSettings],
) -> Reading:
    """Compute the spectral transmittance of an iris with `ipe_melanin`, the share of incident light
    that leaves it behind.

    The arguments are those of `reflectance`; so are the errors, and an iris whose pigment
    epithelium is black is one.
    """
    return observe(iris, Transmissometer(wavelengths, **settings), solver, key=key, throw=throw)


def radiance(
    iris: Iris,
    wavelengths: Numbers,
    *,
    illuminant: str = "D65",
    solver: AbstractSolver | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
    **settings: Unpack[InstrumentSettings],
) -> Reading:
    """Compute the spectral radiance of an iris under an illuminant; see `Radiometer`.

    Its arguments are those of `reflectance`, but light crosses the cornea by default
    (`cornea="inward"`); `illuminant` is a name in colour-science.
    """
    instrument = Radiometer(wavelengths, illuminant=illuminant, **settings)
    return observe(iris, instrument, solver, key=key, throw=throw)


def colour(
    iris: Iris,
    wavelengths: Numbers = None,
    *,
    illuminant: str = "D65",
    observer: str = OBSERVER,
    solver: AbstractSolver | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
    **settings: Unpack[InstrumentSettings],
) -> Colour:
    """Compute the colour of the iris's reflectance under an illuminant; see `Colorimeter`.

    Light reflected by the first surface is included by default; it adds a little grey to a dark
    iris. The arguments are those of `reflectance`, of `observe` and of the instrument; `illuminant`
    and `observer` are names in colour-science.
    """
    instrument = Colorimeter(wavelengths, illuminant=illuminant, observer=observer, **settings)
    return observe(iris, instrument, solver, key=key, throw=throw)


def brdf(
    iris: Iris,
    wavelengths: Numbers,
    *,
    cos_exit: Numbers,
    azimuth: Numbers = 0.0,
    solver: AbstractSolver | None = None,
    key: PRNGKey | None = None,
    throw: bool = True,
    **settings: Unpack[InstrumentSettings],
) -> Brdf:
    """Compute the BRDF of the iris in the aqueous humour; see `Goniophotometer`.

    ILIT redraws directions on entry, so its BRDF is independent of the azimuth and depends on the
    incidence only through the first surface's transmittance; radiative transfer depends on all
    three. `MonteCarlo` returns averages over cells of the cosine, bounded half-way between the
    exits. The arguments are those of `reflectance` and the cosines (in [0, 1]) and azimuths
    (radians) of the exits, which broadcast to shape (exits,).
    """
    instrument = Goniophotometer(wavelengths, cos_exit=cos_exit, azimuth=azimuth, **settings)
    return observe(iris, instrument, solver, key=key, throw=throw)


def principal_plane(n: int = 181) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return `n` exit directions across the principal plane, without grazing ones: signed angles
    (radians; negative on the light's side), their cosines, and azimuths (π on the light's side).
    """
    angle = (jnp.arange(n) - (n - 1) / 2) / n * jnp.pi
    return angle, jnp.cos(angle), jnp.where(angle < 0, jnp.pi, 0.0)
