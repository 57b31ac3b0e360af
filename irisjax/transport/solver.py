"""What instruments and the inversion ask of a solver."""

import abc
from collections.abc import Callable
from typing import ClassVar, TypeVar

import equinox as eqx

from irisjax.tissue.layers import Layers
from irisjax.transport.process import AbstractProcess, RadiativeTransfer
from irisjax.transport.solution import Solution

P = TypeVar("P", bound=AbstractProcess)


class AbstractSolver(eqx.Module):
    """A solver is an immutable value: a method and its settings.

    A new one is a subclass with these two methods; no instrument needs to know of it.

    - `scattering_is_known`: whether it is made for layers that scatter alike, without derivatives
        by their scattering.
    """

    scattering_is_known: ClassVar[bool] = False

    @abc.abstractmethod
    def prepare(self, layers: Callable[[], Layers], process: AbstractProcess) -> "AbstractSolver":
        """The solver with all fixed that must be known before tracing.

        `layers` gives the layers (concrete ones, if the caller has them) when called. **Raises:**
        `ValueError` for a process that the solver does not treat.
        """

    def along(self, layers: Callable[[], Layers], cos_incidence, cos_exit=None) -> "AbstractSolver":
        """The solver with what light from and into these directions takes; called before `prepare`
        where they are known. Most solvers need nothing.
        """
        return self

    @abc.abstractmethod
    def solve(
        self,
        layers: Layers,
        process: AbstractProcess,
        cos_incidence,
        *,
        cos_exit=None,
        azimuth=None,
        key=None,
        rays=None,
    ) -> Solution:
        """Transport of light from direction `cos_incidence` in the aqueous humour, or `DIFFUSE`.

        **Arguments:** `cos_exit`, `azimuth`: exit directions, shape (exits,), for the BRDF, or
        `None`; `key`: for solvers that sample; `rays`: relative number of rays a wavelength for
        those.
        """

    @property
    def numbers_per_wavelength(self) -> int:
        """Those in the largest array on the way to a solution: many spectra are solved in portions
        that stay in the processor's cache.
        """
        return 1


def checked_process(
    solver,
    process: AbstractProcess,
    kind: type[P],
    layers: Layers | None = None,
    *,
    polarised: bool = False,
) -> P:
    """The process, of the kind that a solver treats; `ValueError` if it is of another, if it is of
    polarised light where the solver is of scalar theory, or if `layers` scatter otherwise than by
    Rayleigh's law, the only one that most solvers know.
    """
    if not isinstance(process, kind):
        name = _name(solver)
        raise ValueError(f"{name} treats {kind.__name__} processes, not {type(process).__name__}")
    if is_polarised(process) and not polarised:
        raise ValueError(
            f"{_name(solver)} does not treat polarised light; use RadiativeExact, or "
            "PolarisedMonteCarlo to sample"
        )
    if layers is not None and layers.phase is not None:
        raise ValueError(
            "a power law of scattering takes radiative transfer (depth-resolved) by AddingDoubling "
            f"or MonteCarlo, not {type(process).__name__} by {_name(solver)}"
        )
    return process


def is_polarised(process: AbstractProcess) -> bool:
    """Whether a process follows light by its Stokes vector."""
    return isinstance(process, RadiativeTransfer) and process.polarised


def _name(solver) -> str:
    return getattr(solver, "__name__", type(solver).__name__)
