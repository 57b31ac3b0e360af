"""The solvers that are meant where none is named, and the tables that come with the package.

`python -m experiments.ilit_table` and `python -m experiments.radiative_table` make the tables;
tests of `tests/transport` make them again.
"""

import functools
from importlib import resources

import jax
import jax.numpy as jnp
import numpy as np

from irisjax._types import Real
from irisjax.numerics.checks import is_known
from irisjax.numerics.tucker import Tucker
from irisjax.tissue.indices import RefractiveIndices
from irisjax.tissue.iris import Iris
from irisjax.transport.ilit.exact import IlitExact
from irisjax.transport.ilit.tabulated import IlitTabulated
from irisjax.transport.process import (
    DEPTH_RESOLVED,
    ILIT_2006,
    POLARISED,
    AbstractProcess,
    Ilit,
    RadiativeTransfer,
)
from irisjax.transport.radiative.adding import AddingDoubling
from irisjax.transport.radiative.exact import RadiativeExact
from irisjax.transport.radiative.tabulated import RadiativeTabulated
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


def quickest(iris: Iris, aqueous_index: Real, process: AbstractProcess) -> AbstractSolver:
    """The solver for many spectra of irides such as this one: its table; `AddingDoubling` for a
    power law of scattering; an exact solver for polarised light, for a pigment epithelium that lets
    light through, and for other indices than those of the table of radiative transfer.
    """
    deep = iris.ipe_melanin is not None
    if isinstance(process, Ilit):
        indices = iris.indices(aqueous_index)
        return IlitExact(24, process=process) if deep else table_for(indices, process)
    if iris.power_law is not None:
        return AddingDoubling(16, 10)
    if process.polarised:
        return RadiativeExact(16, 8, process=POLARISED)
    table = None if deep else shipped_table(iris.indices(aqueous_index))
    return RadiativeExact(16, 8) if table is None else table


def table_for(indices: RefractiveIndices, process: AbstractProcess) -> AbstractSolver:
    """The table of a process for some refractive indices: read from the package for those of LB06's
    iris, built for others by ILIT.

    Raises:
        ValueError: If what is built is not accurate enough, and for other indices in radiative
            transfer.
    """
    table = _table(*_key(indices), process)
    if table is None:
        raise ValueError("the table of radiative transfer has LB06's indices; use RadiativeExact")
    return table


def shipped_table(indices: RefractiveIndices) -> RadiativeTabulated | None:
    """The table of radiative transfer in the package; `None` for other or traced indices."""
    if not is_known(indices):
        return None
    table = _table(*_key(indices), DEPTH_RESOLVED)
    return table if isinstance(table, RadiativeTabulated) else None


def _key(indices: RefractiveIndices) -> tuple[tuple[float, ...], str]:
    return tuple(float(n) for n in jax.tree.leaves(indices)), str(jnp.result_type(float))


@functools.lru_cache(maxsize=16)
def _table(indices: tuple[float, ...], dtype: str, process: AbstractProcess):
    """The package's table, if it has one of this process, its indices and its precision; otherwise
    one that is built, `None` for radiative transfer.
    """
    # Kept for other callers: nothing of a trace that may be going on here.
    with jax.ensure_compile_time_eval():
        media = RefractiveIndices(*(jnp.asarray(n, dtype) for n in indices))
    ilit = isinstance(process, Ilit)
    if ilit and (process != ILIT_2006 or dtype != "float64"):
        return IlitTabulated.build(media, process)
    name = "ilit/tables/ilit_2006.npz" if ilit else "radiative/tables/radiative.npz"
    with (resources.files("irisjax.transport") / name).open("rb") as file, np.load(file) as arrays:
        stored = dict(arrays)
    # Rounding of one library or another, or of single precision: not other tissue.
    rounding = 1e-14 if dtype == "float64" else 4 * float(jnp.finfo(dtype).eps)
    if not np.allclose(stored["indices"], indices, rtol=rounding, atol=0):
        return IlitTabulated.build(media, process) if ilit else None
    with jax.ensure_compile_time_eval():
        npz = {name: jnp.asarray(x, dtype) for name, x in stored.items()}
    if ilit:
        error = float(stored["error"])
        return IlitTabulated(npz["abl"], npz["stroma"], media, error, process=process)
    out, ends, multiple = (
        Tucker(tuple(npz[f"{x}_{i}"] for i in range(npz[f"{x}_core"].ndim - 1)), npz[f"{x}_core"])
        for x in ("out", "ends", "multiple")
    )
    error = float(stored[f"error_{dtype}"])
    return RadiativeTabulated(out, ends, multiple, media, error)
