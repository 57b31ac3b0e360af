"""Virtual spectrophotometer: directional–hemispherical and diffuse–hemispherical reflectance,
radiance.
"""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp

from irisjax._types import PRNGKey
from irisjax.measure.measurement import (
    Measurement,
    check_cosine,
    check_wavelengths,
    layers_of,
    prepared,
    through_cornea,
)
from irisjax.tissue.iris import Iris
from irisjax.tissue.pigments import extinction
from irisjax.transport.ilit.exact import DIFFUSE, Exact
from irisjax.transport.process import ILIT_2006, Process
from irisjax.transport.solution import Absorbed, throw
from irisjax.transport.solver import AbstractSolver


def reflectance(
    iris: Iris,
    wavelengths,
    *,
    solver: AbstractSolver = Exact(),  # noqa: B008  (solvers are immutable values)
    process: Process = ILIT_2006,
    cos_incidence=1.0,
    first_surface: bool = True,
    key: PRNGKey | None = None,
    raise_on_failure: bool = True,
) -> Measurement:
    """Spectral reflectance of an iris: the share of the light falling on it that it sends back.

    **Arguments:**

    - `iris`: its fields may be traced; batch with `jax.vmap`.
    - `wavelengths`: nm, increasing, shape (n,), within the pigment tables; see `wavelengths`.
    - `solver`: `Exact`, `Tabulated` or `MonteCarlo` (which needs `key`).
    - `process`: `ILIT_2006`, `ILIT_CORRECTED`, `DEPTH_RESOLVED` or a `Process` of your own.
    - `cos_incidence`: cosine of the light's angle to the iris's normal, in the aqueous humour (in
        air, if the process includes the cornea), or `"diffuse"` for light from the whole
        hemisphere.
    - `first_surface`: whether light mirrored by the aqueous/ABL interface counts.

    **Returns:** a `Measurement`. **Raises:** `ValueError` for concrete input out of range or,
    unless `raise_on_failure=False`, for a solve that failed; while tracing, look at `.status`.
    """
    return _measure(
        iris,
        wavelengths,
        solver,
        process,
        cos_incidence,
        first_surface and process.first_surface,
        process.cornea or "none",
        None,
        key,
        raise_on_failure,
    )


def radiance(
    iris: Iris,
    wavelengths,
    *,
    illuminant: str = "D65",
    solver: AbstractSolver = Exact(),  # noqa: B008
    process: Process = ILIT_2006,
    cos_incidence=1.0,
    first_surface: bool = True,
    key: PRNGKey | None = None,
    raise_on_failure: bool = True,
) -> Measurement:
    """Reflected spectral radiance under an illuminant, as measured in vivo  [LB06 Section 4].

    The illuminant's relative spectral power E (1 at 560 nm) falls on the eye; light is dimmed on
    its way through tear film and cornea (`process.cornea`, by default inward only; light mirrored
    by the tear film is dropped), and what comes back is shared over the hemisphere, L = R·E/π. A
    perfect white diffuser in the eye's place reads E/π. `cos_incidence` is measured in air. With
    `MonteCarlo`'s analogue estimator, the number of rays at each wavelength follows the illuminant,
    as in LB06.

    `illuminant` is a name known to colour-science; for the rest see `reflectance`.
    """
    from irisjax.measure.colour import illuminant_power

    check_wavelengths(wavelengths)
    return _measure(
        iris,
        wavelengths,
        solver,
        process,
        cos_incidence,
        first_surface and process.first_surface,
        process.cornea or "inward",
        illuminant_power(illuminant, wavelengths),
        key,
        raise_on_failure,
    )


def _measure(
    iris,
    wavelengths,
    solver,
    process,
    cos_incidence,
    first_surface,
    cornea,
    power,
    key,
    raise_on_failure,
) -> Measurement:
    check_wavelengths(wavelengths)
    check_cosine("cos_incidence", cos_incidence)
    if isinstance(cos_incidence, str) and cornea != "none":
        raise ValueError(
            'cos_incidence = "diffuse" needs cornea="none": the cornea sends light on one course'
        )
    table = extinction(wavelengths)
    solver = prepared(solver, iris, table, process)
    diffuse = isinstance(cos_incidence, str)
    result = _solve(
        iris,
        table,
        solver,
        process,
        0.0 if diffuse else cos_incidence,
        diffuse,
        first_surface,
        cornea,
        power,
        key,
    )
    if raise_on_failure:
        throw(result.status)
    return result


@partial(jax.jit, static_argnums=(5, 6, 7))
def _solve(
    iris, table, solver, process, cosine, diffuse, first_surface, cornea, power, key
) -> Measurement:
    dtype = table.wavelengths.dtype
    process = dataclasses.replace(process, first_surface=first_surface)
    factor, cosine = (
        (1.0, DIFFUSE) if diffuse else through_cornea(iris, jnp.asarray(cosine, dtype), cornea)
    )
    solution = solver.solve(layers_of(iris, table, process), process, cosine, key=key, rays=power)
    values = solution.reflectance + solution.mirrored if first_surface else solution.reflectance
    error = solution.standard_error
    scale = factor if power is None else factor * power / jnp.pi
    return Measurement(
        wavelengths=table.wavelengths,
        values=scale * values,
        standard_error=None if error is None else scale * error,
        status=solution.result,
        absorbed=Absorbed(
            *(
                factor * a
                for a in (solution.absorbed.abl, solution.absorbed.stroma, solution.absorbed.ipe)
            )
        ),
        mirrored=factor * solution.mirrored,
        quantity="reflectance" if power is None else "radiance",
        unit="" if power is None else "relative/sr",
    )
