"""The result of every solver, with its status."""

from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from irisjax._types import Spectrum


class RESULTS(eqx.Enumeration):
    """Outcome of a solve."""

    successful = ""
    invalid_input = (
        "a layer's optical depth is negative or not finite, or an index does not keep to the order "
        "of media the iris was made with, or a wavelength is outside the pigment tables"
    )
    ill_conditioned = (
        "the stroma scatters so often before it absorbs that this precision loses count; compute "
        "in float64"
    )
    under_resolved = (
        "the stroma is optically too thick, or light too near to grazing, for the number of depth "
        "panels or doublings; give RadiativeExact(n_panels=...) or "
        "AddingDoubling(n_doublings=...) a larger one"
    )
    not_converged = "the orders of scattering did not converge"
    outside_table = "an optical depth or index lies outside the range the table was built for"
    too_few_angles = (
        "so few angles do not follow light in a stroma that scatters so sharply, or between such "
        "interfaces; give AddingDoubling(n_angles=...) a larger number"
    )


class Absorbed(eqx.Module):
    """Share of the incident light absorbed in each layer, one value a wavelength; `ipe` is that of
    the pigment epithelium.
    """

    abl: Spectrum
    stroma: Spectrum
    ipe: Spectrum

    def total(self) -> Float[Array, "*batch wavelengths"]:
        """Sum over the layers."""
        return self.abl + self.stroma + self.ipe


class Polarisation(eqx.Module):
    """Mueller matrices of what comes back: rows and columns are I, Q, U, V.

    Q is the intensity of the field in the plane of the normal and the ray, less that across it; U
    that along the diagonal between θ and φ (polar angle from the normal that points at the light,
    azimuth round it), less that across it; V is positive for light whose field turns clockwise as
    its receiver sees it.

    Attributes:
        reflected: Matrix of the light that `Solution.reflectance` counts, as a lens collects it,
            shape (wavelengths, 4, 4): Q and U are those in the lens's plane, along the plane of
            incidence. The first row times light's Stokes vector is the share that comes back.
        mirrored: Matrix of the light that the first surface reflects, likewise.
        brdf: Matrices at the requested exits, 1/sr, shape (wavelengths, exits, 4, 4), or `None`.
    """

    reflected: Float[Array, "wavelengths 4 4"]
    mirrored: Float[Array, "wavelengths 4 4"]
    brdf: Float[Array, "wavelengths exits 4 4"] | None


class Solution(eqx.Module):
    """Fate of the light that falls on the iris from the aqueous humour.

    `reflectance`, `mirrored`, `absorbed` and `transmitted` are shares of the incident power, one
    value a wavelength; they sum to one.

    Attributes:
        reflectance: Share that entered the iris and came back.
        mirrored: Share reflected by the first surface.
        absorbed: Shares absorbed in the layers.
        status: A `RESULTS` item.
        standard_error: Standard error of `reflectance` if it is sampled, otherwise `None`.
        total_error: Standard error of `reflectance` plus `mirrored`, likewise.
        brdf: Bidirectional reflectance distribution function (1/sr) at the requested exits, without
            the mirrored part, shape (wavelengths, exits), or `None`.
        brdf_error: Its standard error, likewise.
        polarisation: Mueller matrices, if a polarised process was asked for them; all other values
            are those of unpolarised light.
        transmitted: Share that leaves the pigment epithelium behind; `None` if that is black.
        transmitted_error: Its standard error, likewise.
    """

    reflectance: Spectrum
    mirrored: Spectrum
    absorbed: Absorbed
    status: RESULTS
    standard_error: Spectrum | None = None
    total_error: Spectrum | None = None
    brdf: Float[Array, "wavelengths exits"] | None = None
    brdf_error: Float[Array, "wavelengths exits"] | None = None
    polarisation: Polarisation | None = None
    transmitted: Spectrum | None = None
    transmitted_error: Spectrum | None = None

    @property
    def energy(self) -> Float[Array, "*batch wavelengths"]:
        """Sum of all shares; differs from one by rounding only."""
        behind = 0.0 if self.transmitted is None else self.transmitted
        return self.reflectance + self.mirrored + self.absorbed.total() + behind


class Flux(NamedTuple):
    """Shares of the light by the place where it ends, and the BRDF, if exits are requested.

    `ipe` is the share that enters the pigment epithelium and does not return, `behind` the part of
    it that leaves the epithelium behind.
    """

    reflectance: Array
    mirrored: Array
    abl: Array
    stroma: Array
    ipe: Array
    brdf: Array | None = None
    behind: Array | None = None

    def solution(self, status: RESULTS, **fields: Any) -> Solution:
        """The `Solution` of these shares, of a `status` and other `fields`."""
        ipe = self.ipe if self.behind is None else self.ipe - self.behind
        absorbed = Absorbed(self.abl, self.stroma, ipe)
        shares = self.reflectance, self.mirrored, absorbed
        return Solution(*shares, status, brdf=self.brdf, transmitted=self.behind, **fields)


def outcome(valid: Bool[Array, ""], *checks: tuple[Bool[Array, ""], RESULTS]) -> RESULTS:
    """The status of a solve: invalid input unless the layers are `valid`, else the result of the
    first of `checks` that is not passed.
    """
    status = RESULTS.successful
    for passed, failure in reversed(checks):
        status = RESULTS.where(passed, status, failure)
    return RESULTS.where(valid, status, RESULTS.invalid_input)


def worst(status: RESULTS) -> RESULTS:
    """Return an unsuccessful outcome of a batch, if there is one."""
    return jax.tree.map(jnp.max, status)


_T = TypeVar("_T")


def raise_failure(result: _T, status: Any) -> _T:
    """Return the result, or raise with the reason if `status`, an item of an enumeration such as
    `RESULTS`, is not its `successful`.

    A concrete status raises `ValueError` at once. A traced one raises an error of Equinox when the
    program runs (`equinox.error_if`), which takes no time otherwise, provided that the program uses
    what is returned here.
    """
    if isinstance(status._value, Tracer):
        return _guarded(result, status=status)
    # Read the code itself: comparing enumerations would dispatch a computation for every call.
    codes = np.asarray(status._value)
    if codes.any():
        message = "some of the batch failed; see status"
        raise ValueError(message if codes.ndim else status._enumeration[status])
    return result


@eqx.filter_custom_jvp
def _guarded(result, *, status: Any):
    return status.error_if(result, status != status._enumeration.successful)


@_guarded.def_jvp
def _guarded_jvp(primals, tangents, *, status: Any):
    # A gradient does not use the value: the factor 1 brings the check into the derivative.
    (result,), (slopes,) = primals, tangents
    unit = status.error_if(jnp.ones(()), status != status._enumeration.successful)
    slopes = jax.tree.map(lambda t: unit.astype(t.dtype) * t, slopes)
    return _guarded(result, status=status), slopes
