"""The solver that is meant where none is named."""

from irisjax.tissue.iris import Iris
from irisjax.transport.ilit.exact import IlitExact
from irisjax.transport.process import DEPTH_RESOLVED, AbstractProcess, Ilit, RadiativeTransfer
from irisjax.transport.radiative.adding import AddingDoubling
from irisjax.transport.radiative.exact import RadiativeExact
from irisjax.transport.solver import AbstractSolver


def exact_solver(
    process: AbstractProcess, iris: Iris | None = None, *, exits: bool = False
) -> AbstractSolver:
    """The deterministic reference solver of a process, at its default accuracy; for radiative
    transfer of an iris with a power law of scattering `AddingDoubling`, with as many angles as a
    BRDF takes if there are `exits`.
    """
    if iris is not None and iris.power_law is not None and process == DEPTH_RESOLVED:
        return AddingDoubling.following(iris.power_law.anisotropy) if exits else AddingDoubling()
    if isinstance(process, Ilit):
        return IlitExact(process=process)
    if isinstance(process, RadiativeTransfer):
        return RadiativeExact(process=process)
    raise ValueError(f"no deterministic solver treats {type(process).__name__} processes")
