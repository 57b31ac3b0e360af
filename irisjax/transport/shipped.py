"""Tables of either process for an iris's indices: those of LB06's iris come with the package."""

from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.iris import Iris
from irisjax.transport.ilit import shipped as ilit
from irisjax.transport.process import POLARISED, AbstractProcess, Ilit, is_polarised
from irisjax.transport.radiative import shipped as radiative
from irisjax.transport.radiative.adding import AddingDoubling
from irisjax.transport.radiative.exact import RadiativeExact
from irisjax.transport.solver import AbstractSolver


def table(indices: RefractiveIndices, process: AbstractProcess) -> AbstractSolver:
    """The solver for many spectra of irides with these indices: `IlitTabulated`, or for radiative
    transfer `RadiativeTabulated`; where media guide light so that a table is not good to 1e-4, and
    for polarised light, `RadiativeExact`.
    """
    if isinstance(process, Ilit):
        return ilit.table(indices, process)
    if is_polarised(process):
        return RadiativeExact(16, 8, process=POLARISED)
    try:
        return radiative.table(indices)
    except ValueError:
        return RadiativeExact(16, 8)


def quickest(iris: Iris, aqueous_index, process: AbstractProcess) -> AbstractSolver:
    """The solver for many spectra of irides such as this one: its `table`, or `AddingDoubling`
    where a power law of scattering has none.
    """
    if iris.power_law is not None and not isinstance(process, Ilit):
        return AddingDoubling(16, 10)
    return table(iris.indices(aqueous_index), process)
