"""What an instrument reads, and the checks every instrument makes of its settings."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from irisjax._types import Spectrum
from irisjax.anatomy import media as eye
from irisjax.tissue.iris import Iris
from irisjax.tissue.layers import Layers
from irisjax.tissue.pigments import Extinction
from irisjax.transport.ilit.exact import DIFFUSE
from irisjax.transport.process import Process
from irisjax.transport.solution import RESULTS, Absorbed
from irisjax.transport.solver import AbstractSolver


class Measurement(eqx.Module):
    """One value a wavelength, and what is known about it.

    - `wavelengths` (nm) and `values`, shape (wavelengths,); `unit` and `quantity` say what they
        are.
    - `standard_error`: of `values` where they are sampled, `None` where they are integrated.
    - `status`: a `RESULTS` item; compare with `RESULTS.successful`.
    - `absorbed`: share of the light falling on the eye absorbed in `.abl`, `.stroma`, `.ipe`.
    - `mirrored`: share mirrored by the iris's first surface, whether or not `values` count it.
    """

    wavelengths: Spectrum
    values: Spectrum
    standard_error: Spectrum | None
    status: RESULTS
    absorbed: Absorbed
    mirrored: Spectrum
    quantity: str = eqx.field(static=True)
    unit: str = eqx.field(static=True)

    def __repr__(self):
        return _table(self, {self.quantity: self.values, "standard_error": self.standard_error})

    def __array__(self, dtype=None, copy=None):
        return np.asarray(self.values, dtype)


def wavelengths(start: float, stop: float, step: float) -> np.ndarray:
    """Grid from `start` to `stop` inclusive in nm, built from whole steps so that all steps are
    equal.

    **Raises:** `ValueError` unless start ≤ stop and the step is positive and divides the range.
    """
    if not all(np.isfinite(v) for v in (start, stop, step)) or step <= 0 or stop < start:
        raise ValueError(
            f"wavelengths({start:g}, {stop:g}, {step:g}): need start <= stop and step > 0, in nm"
        )
    n = round((stop - start) / step)
    if not np.isclose(start + n * step, stop, rtol=0, atol=1e-6 * step):
        raise ValueError(
            f"wavelengths({start:g}, {stop:g}, {step:g}): the step does not divide the range"
        )
    return start + step * np.arange(n + 1)


def check_wavelengths(grid) -> None:
    """Raise `ValueError` unless a concrete grid is one-dimensional, not empty, finite and
    increasing.
    """
    if isinstance(grid, Tracer):
        return
    grid = np.asarray(grid)
    if grid.ndim != 1 or grid.size == 0:
        raise ValueError(
            f"wavelengths must be a list of at least one number, got shape {grid.shape}"
        )
    if not np.isfinite(grid).all():
        raise ValueError("wavelengths must be finite numbers of nm")
    if (np.diff(grid) <= 0).any():
        i = int(np.argmax(np.diff(grid) <= 0))
        raise ValueError(
            f"wavelengths must increase; {grid[i]:g} nm is followed by {grid[i + 1]:g} nm"
        )


def check_cosine(name: str, cosine) -> None:
    """Raise `ValueError` unless a concrete cosine (or `DIFFUSE`) lies in [0, 1]."""
    if isinstance(cosine, str):
        if cosine != DIFFUSE:
            raise ValueError(f"{name} must be a number in [0, 1] or {DIFFUSE!r}, got {cosine!r}")
        return
    if isinstance(cosine, Tracer):
        return
    value = np.asarray(cosine, np.float64)
    if not ((value >= 0) & (value <= 1)).all():
        raise ValueError(f"{name} = {cosine} is outside [0, 1]")


def through_cornea(iris: Iris, cos_air, cornea: str):
    """Factor on the light and its cosine at the iris, for a `cornea` setting of a process.

    `"round-trip"` takes the way out along the normal, as a camera before the eye does.
    """
    if cornea == "none":
        return 1.0, cos_air
    media = (iris.tear_index, iris.cornea_index, iris.aqueous_index)
    inward, cos_iris = eye.inward_transmittance(cos_air, media)
    if cornea == "round-trip":
        inward = inward * eye.inward_transmittance(jnp.ones_like(cos_iris), media)[0]
    return inward, cos_iris


@jax.jit
def layers_of(iris: Iris, extinction: Extinction, process: Process) -> Layers:
    """The iris's layers under a process's scattering formula."""
    return iris.layers(extinction, process.scattering)


def prepared(
    solver: AbstractSolver, iris: Iris, extinction: Extinction, process: Process
) -> AbstractSolver:
    """The solver after a look at the still concrete problem."""
    # Through the class: binding a method of an Equinox module costs more than the call.
    return type(solver).prepare(solver, partial(layers_of, iris, extinction, process), process)


def _table(measurement, columns: dict[str, Float[Array, "..."] | None]) -> str:
    shown = {
        name: np.asarray(c) for name, c in columns.items() if c is not None and eqx.is_array(c)
    }
    if any(isinstance(c, Tracer) for c in jax.tree.leaves(measurement)):
        return f"{type(measurement).__name__}(traced)"
    grid = np.asarray(measurement.wavelengths)
    head = (
        f"{measurement.quantity} ({measurement.unit})" if measurement.unit else measurement.quantity
    )
    if grid.ndim != 1 or any(c.shape != grid.shape for c in shown.values()):
        return f"{head}, batch of shape {next(iter(shown.values())).shape}"
    rows = [head, "  ".join(["wavelength_nm", *(f"{name:>14}" for name in shown)])]
    index = (
        range(grid.size) if grid.size <= 12 else [*range(6), -1, *range(grid.size - 6, grid.size)]
    )
    for i in index:
        rows.append(
            "..."
            if i == -1
            else "  ".join([f"{grid[i]:>13g}", *(f"{c[i]:>14.6g}" for c in shown.values())])
        )
    return "\n".join(rows)
