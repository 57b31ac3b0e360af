"""What a file says of itself: what it holds, how far to trust it, every setting that made it."""

import dataclasses

import irisjax as ij
from irisjax.cli.model import IrisOptions, ProcessOptions
from irisjax.cli.options import Group
from irisjax.tissue.iris import LIMITS
from irisjax.tissue.scattering import POWER_LAW_LIMITS
from irisjax.transport.process import AbstractProcess, Ilit, is_polarised
from irisjax.transport.solver import AbstractSolver


def head(
    command: str,
    quantity: str,
    iris: ij.Iris,
    process: AbstractProcess,
    solver: AbstractSolver,
    groups: tuple[IrisOptions, ProcessOptions, *tuple[Group, ...]],
    left_out: str | None = None,
) -> dict[str, str]:
    """Header of a file of simulated values; `left_out`: what polarisation would change in them."""
    return {
        "irisjax": ij.__version__,
        "simulated": f"{quantity} of a modelled human iris, not a measurement",
        "command": command,
        "approximation": _approximation(process, left_out),
        **settings(iris, process, *groups),
        "transport": process.transport,
        "solver settings": ", ".join(
            f"{field.name} = {value}"
            for field in dataclasses.fields(solver)
            # The process has lines of its own.
            if field.name != "process" and (value := getattr(solver, field.name)) is not None
        ),
    }


def settings(
    iris: ij.Iris,
    process: AbstractProcess,
    iris_options: IrisOptions,
    process_options: ProcessOptions,
    *others: Group,
) -> dict[str, str]:
    """Every setting as text, complete enough for `--from`; `iris` and `process` are what the
    options made.
    """
    # float, not text made by numpy: that loses digits once colour-science has been imported.
    fields = {
        name: float(getattr(iris if name in LIMITS else iris.power_law, name))
        for name in iris.parameters()
    }
    groups = (
        dataclasses.replace(iris_options, **fields, melanin_load=float(iris.melanin_load)),
        dataclasses.replace(process_options, **process.describe()),
        *others,
    )
    lines: dict[str, str] = {}
    for name, value in (pair for group in groups for pair in group.settings().items()):
        ranges = LIMITS | POWER_LAW_LIMITS
        unit = ranges[name].unit if name in ranges else {"wavelengths": "nm"}.get(name)
        text = {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
        if name == "melanin_load":  # both melanins say it already
            lines["melanin load that follows"] = f"{value:.12g} [ug/mm2]"
        elif name != "level" and not (name == "scattering" and iris.power_law is not None):
            lines[name] = f"{text}{f' [{unit}]' if unit else ''}"
    return lines


def _approximation(process: AbstractProcess, left_out: str | None) -> str:
    """What a reader of the numbers must know about the process that made them."""
    if is_polarised(process):
        return (
            "Stokes vectors, Rayleigh's phase matrix: this model depolarises less than photographs "
            "of irides through crossed polarisers show"
        )
    if not isinstance(process, Ilit):
        return f"scalar theory, no polarisation: {left_out}"
    ours, theirs = (
        ("0.0148", "darker than")
        if process.rescatter == "retest"
        else ("0.0405", "about twice as bright as")
    )
    return (
        f"ILIT tests whole layers at once: in the blue, light eyes come out {theirs} by "
        "depth-resolved transport of the same layers "
        f"({ours} against 0.0202 at 450 nm, low pigmentation, rescatter = {process.rescatter})"
    )
