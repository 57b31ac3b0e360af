"""The solver that is meant where none is named."""

from irisjax.transport.ilit.exact import IlitExact
from irisjax.transport.process import AbstractProcess, Ilit
from irisjax.transport.radiative.exact import RadiativeExact
from irisjax.transport.solver import AbstractSolver


def exact_solver(process: AbstractProcess) -> AbstractSolver:
    """The deterministic reference solver of a process, at its default accuracy."""
    return IlitExact() if isinstance(process, Ilit) else RadiativeExact()
