"""Groups of options: what the iris is made of, how light goes through it, how that is solved."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, get_args

import jax

import irisjax as ij
from irisjax.cli.options import (
    SEED_HELP,
    Group,
    dashed,
    named_option,
    number_parser,
    option,
    overrules,
    read_seed,
    whole_parser,
)
from irisjax.tissue.indices import Scattering
from irisjax.tissue.iris import LIMITS
from irisjax.tissue.scattering import POWER_LAW_LIMITS, PowerLaw
from irisjax.transport.defaults import exact_solver
from irisjax.transport.montecarlo import MonteCarlo
from irisjax.transport.process import (
    POLARISED,
    PROCESSES,
    AbstractProcess,
    Phase,
    RadiativeTransfer,
    Rescatter,
    is_polarised,
)
from irisjax.transport.radiative.polarised.montecarlo import PolarisedMonteCarlo
from irisjax.transport.solver import AbstractSolver

# As written in the class: making an iris would start JAX before the precision is chosen.
_DEFAULTS = {
    field.name: field.default for kind in (ij.Iris, PowerLaw) for field in dataclasses.fields(kind)
}
_RANGES = LIMITS | POWER_LAW_LIMITS
_LEVELS = ("low", "moderate", "high")
_DEEP = "depth-resolved"


def _field(name: str) -> Any:
    """Option of a field of `Iris`; the iris checks the range and holds the default."""
    low, high, unit, meaning, above = _RANGES[name]
    allowed = f"{low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
    if above:
        allowed = f"above {low:g}, at most {high:g}" if math.isfinite(high) else f"above {low:g}"
    default = _DEFAULTS[name]
    if name in POWER_LAW_LIMITS:
        meaning = f"{meaning}; makes scattering a power law, for --process {_DEEP} alone"
    shown = isinstance(default, float) and not name.endswith("melanin")  # those are the level's
    return option(
        parse=number_parser(),
        metavar=unit or "number",
        help=f"{meaning}, {allowed}{f'; default {default:g}' if shown else ''}",
    )


# An option for each number of an iris, in the order of its fields; the class below defines three.
_Numbers: Any = dataclasses.make_dataclass(
    "_Numbers",
    [
        (name, Annotated[float | None, _field(name) if name in _RANGES else None], None)
        for name in ("level", *LIMITS, "melanin_load", "scattering", *POWER_LAW_LIMITS)
    ],
    bases=(Group,),
    frozen=True,
    kw_only=True,
)


@dataclass(frozen=True, kw_only=True)
class IrisOptions(_Numbers):
    """What the iris is made of; `None` stands for the level's value or LB06's."""

    PANEL = "Iris"

    level: Annotated[
        str,
        named_option(
            "pigmentation of the paper; sets both melanins",
            *_LEVELS,
            callback=overrules("eumelanin", "pheomelanin"),
        ),
    ] = "moderate"
    melanin_load: Annotated[
        float | None,
        option(
            parse=number_parser(),
            metavar="ug/mm2",
            help="melanin mass per iris area, at least 0: rescales both melanins, keeping their "
            "ratio",
        ),
    ] = None
    scattering: Annotated[
        str,
        named_option(
            "scattering coefficient of the stroma",
            *get_args(Scattering),
            callback=overrules(*POWER_LAW_LIMITS),
        ),
    ] = "lb06"


def _polarising(context, param, value):
    """Polarised light, typed, is light of the one process that has it, whatever a file's was."""
    return overrules("process")(context, param, value) if value else value


@dataclass(frozen=True, kw_only=True)
class ProcessOptions(Group):
    """Rules of light transport; `None` stands for the named process's own."""

    PANEL = "Process"
    ONLY_WITH: ClassVar = {
        "phase": ("process", ("ilit-2006", "ilit-corrected")),
        "rescatter": ("process", ("ilit-2006", "ilit-corrected")),
        "perturb_on_reflection": ("process", ("ilit-2006", "ilit-corrected")),
        "polarised": ("process", ("depth-resolved",)),
    }

    process: Annotated[
        str,
        named_option(
            "rules of light transport; by ilit, light eyes are twice as bright in the blue as "
            "depth-resolved",
            *PROCESSES,
            callback=overrules("phase", "rescatter", "perturb_on_reflection"),
        ),
    ] = "ilit-2006"
    phase: Annotated[
        str | None,
        named_option("phase function, the paper's sampling or Rayleigh's law", *get_args(Phase)),
    ] = None
    rescatter: Annotated[
        str | None,
        named_option(
            "after a scatter straight out, or tested over the layer again", *get_args(Rescatter)
        ),
    ] = None
    perturb_on_reflection: Annotated[
        bool | None,
        option(
            "--perturb-on-reflection/--no-perturb",
            metavar="",
            help="redraw directions when reflected inside a layer",
        ),
    ] = None
    polarised: Annotated[
        bool | None,
        option(
            "--polarised/--scalar",
            metavar="",
            help="depth-resolved transport of Stokes vectors, or of intensities alone",
            callback=_polarising,
        ),
    ] = None

    def __post_init__(self):
        if self.polarised and "process" not in self.typed:
            object.__setattr__(self, "process", _DEEP)
        super().__post_init__()

    def seeing_polarisation(self, instrument: str) -> "ProcessOptions":
        """The options with polarisation, for an instrument that needs it."""
        if self.polarised is False or ("process" in self.typed and self.process != _DEEP):
            raise ValueError(f"--instrument {instrument} needs --process {_DEEP} --polarised")
        return dataclasses.replace(self, process=_DEEP, polarised=True)


@dataclass(frozen=True, kw_only=True)
class SolverOptions(Group):
    """How the process is solved."""

    PANEL = "Solver"
    ONLY_WITH: ClassVar = {
        "photons": ("solver", ("monte-carlo",)),
        "seed": ("solver", ("monte-carlo",)),
    }

    solver: Annotated[
        str, named_option("integrate the process, or sample it", "exact", "monte-carlo")
    ] = "exact"
    photons: Annotated[
        int,
        option(
            parse=whole_parser(1, 2**31 - 2**20), metavar="count", help="photons at each wavelength"
        ),
    ] = 1_000_000
    seed: Annotated[int, option(parse=read_seed, metavar="number", help=SEED_HELP + "bytes")] = 0


def modelled_iris(options: IrisOptions) -> ij.Iris:
    """The iris that the options describe."""
    names = (*LIMITS, *POWER_LAW_LIMITS, "melanin_load")
    fields = {n: v for n in names if (v := getattr(options, n)) is not None}
    law = [n for n in POWER_LAW_LIMITS if n in fields]
    if law and "scattering" in options.typed:
        raise ValueError(
            f"{dashed(law[0])} replaces the formula that --scattering names; give one of the two"
        )
    return ij.Iris.of_level(options.level).replace(**fields, scattering=options.scattering)


def process_of(options: ProcessOptions) -> AbstractProcess:
    """The process that the options name."""
    process = PROCESSES[options.process]
    if options.polarised:
        return POLARISED
    switches = {n: getattr(options, n) for n in process.describe()}
    return dataclasses.replace(process, **{n: v for n, v in switches.items() if v is not None})


def check_scattering(iris: ij.Iris, process: AbstractProcess) -> None:
    """Refuse a power law of scattering for a process that does not know it."""
    law = "a power law of scattering (--reduced-scattering, --anisotropy, ...)"
    if iris.power_law is None:
        return
    if not isinstance(process, RadiativeTransfer):
        raise ValueError(f"{law} needs --process {_DEEP}")
    if process.polarised:
        raise ValueError(
            f"{law} cannot be combined with polarised light, which scatters by Rayleigh's law only"
        )


def solver_of(
    options: SolverOptions,
    process: AbstractProcess,
    iris: ij.Iris,
    *,
    exits: bool = False,
) -> AbstractSolver:
    """The solver that the options name, for such a process and iris; `exits`: for a BRDF."""
    if options.solver == "exact":
        return exact_solver(process, iris, exits=exits)
    if is_polarised(process):
        return PolarisedMonteCarlo(options.photons)
    return MonteCarlo(options.photons, process=process)


def sampling_key(options: SolverOptions) -> jax.Array | None:
    """The key of a solver that samples; its kind is fixed, whatever the environment prefers."""
    if options.solver == "exact":
        return None
    return jax.random.key(options.seed, impl="threefry2x32")
