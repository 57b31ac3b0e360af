"""The base class of solvers, and checks of their input."""

import abc

import equinox as eqx

from irisjax._types import PRNGKey
from irisjax.tissue.layers import Layers
from irisjax.transport.light import Light
from irisjax.transport.process import AbstractProcess
from irisjax.transport.solution import Solution


class AbstractSolver(eqx.Module):
    """A solver is an immutable value: a process, a method for it, and the method's settings.

    A new one is a subclass with a `process` and a method `solve`; no instrument needs to know it.

    Attributes:
        process: The rules that the light follows.
    """

    process: eqx.AbstractVar[AbstractProcess]

    def prepare(self, layers: Layers, light: Light) -> "AbstractSolver":
        """Return the solver with all settings fixed that must be known before tracing.

        Args:
            layers: The layers, with concrete values where the caller has them.
            light: The light, likewise.
        """
        return self

    @abc.abstractmethod
    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        """Compute where the light goes.

        Args:
            layers: The iris at the wavelengths of interest.
            light: The light on it, and the directions it is observed from.
            key: For solvers that sample.
        """

    @property
    def numbers_per_wavelength(self) -> int:
        """Size, per wavelength, of the largest array on the way to a solution: many spectra are
        solved in chunks that stay in the processor's cache.
        """
        return 1


def check_process(solver: AbstractSolver, kind: type[AbstractProcess]) -> None:
    """Raise `ValueError` unless the solver's process is of the kind that it treats."""
    if not isinstance(solver.process, kind):
        raise ValueError(
            f"{type(solver).__name__} treats {kind.__name__} processes, not "
            f"{type(solver.process).__name__}"
        )


def check_layers(solver: AbstractSolver, layers: Layers, *, black: bool = False) -> None:
    """Raise `ValueError` unless the stroma scatters by Rayleigh's law and, for solvers that assume
    a `black` pigment epithelium, no light passes that.
    """
    if layers.phase is not None:
        raise ValueError(
            "a power law of scattering takes radiative transfer (depth-resolved) by AddingDoubling "
            f"or MonteCarlo, not {solver.process.transport} transport by {type(solver).__name__}"
        )
    if black and layers.ipe_absorption is not None:
        raise ValueError(
            f"{type(solver).__name__} has a black pigment epithelium; one with ipe_melanin takes "
            "IlitExact, RadiativeExact, AddingDoubling or MonteCarlo"
        )
