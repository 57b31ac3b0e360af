"""Groups of options: the iris, the process of light transport, and its solver."""

import dataclasses
from typing import Any, ClassVar, get_args

import jax

import irisjax as ij
from irisjax.cli import options as opt
from irisjax.numerics.checks import Range
from irisjax.numerics.streams import key_of
from irisjax.tissue.indices import Scattering
from irisjax.tissue.iris import BLOOD, FRACTIONS, LIMITS, Absorption
from irisjax.tissue.scattering import POWER_LAW_LIMITS, PowerLaw
from irisjax.transport import process as processes
from irisjax.transport.defaults import exact_solver
from irisjax.transport.montecarlo import MonteCarlo
from irisjax.transport.process import PROCESSES, AbstractProcess
from irisjax.transport.solver import AbstractSolver

# As written in the class: making an iris would start JAX before the precision is chosen.
_DEFAULTS = {
    field.name: field.default for kind in (ij.Iris, PowerLaw) for field in dataclasses.fields(kind)
}
RANGES = LIMITS | POWER_LAW_LIMITS
"""Allowed values of an iris's numbers."""
_MELANINS = "eumelanin", "pheomelanin", "abl_fraction", "pheomelanin_abl_fraction"
_DEEP = "depth-resolved"
_ILIT = "process", ("ilit-2006", "ilit-corrected")
_SAMPLED = "solver", ("monte-carlo",)


def _number_option(name: str) -> Any:
    """Make the option of a field of `Iris`, which checks the range and has the default."""
    words, default = RANGES[name].meaning, _DEFAULTS[name]
    if name in POWER_LAW_LIMITS:
        words += f"; makes scattering a power law, for --process {_DEEP} alone"
    words += f", {opt.in_words(RANGES[name])}"
    if isinstance(default, float) and not name.endswith("melanin"):  # `--level` sets melanins
        words += f"; default {default:g}"
    return opt.number(words, metavar=RANGES[name].unit)


def _blood_option(name: str) -> Any:
    """Make the option of the blood's amount or oxygenation, in place of the two haemoglobins."""
    words = f"{BLOOD[name].meaning}, {opt.in_words(BLOOD[name])}; sets both haemoglobins"
    return opt.number(words, metavar=BLOOD[name].unit or "number")


# An option for each number of an iris, in the order of its fields; the class defines the others.
_CHOICES = "scattering", *POWER_LAW_LIMITS, "absorption"
_NAMES = ("level", *LIMITS, "melanin_load", *BLOOD, *_CHOICES, *FRACTIONS)
_FIELDS: dict[str, Any] = {n: _number_option(n) if n in RANGES else None for n in _NAMES}
_ALL_FOUR = "sets F09's absorption, all four are needed"
_FIELDS |= {
    n: opt.number(f"{volume.meaning}; {_ALL_FOUR}", metavar=volume.unit, overrules=_MELANINS)
    for n, volume in FRACTIONS.items()
}
_FIELDS["__annotations__"] = dict.fromkeys(_NAMES, float | None)
_Numbers: type[opt.Group] = type("_Numbers", (opt.Group,), _FIELDS, panel="Iris")


class IrisOptions(_Numbers):
    """The iris; `None` stands for the level's value or LB06's."""

    level: str = opt.choice(
        "pigmentation of the paper; sets both melanins",
        ("low", "moderate", "high"),
        "moderate",
        overrules=("eumelanin", "pheomelanin"),
    )
    melanin_load: float | None = opt.number(
        "melanin mass per iris area, at least 0: rescales both melanins, keeping their ratio",
        metavar="ug/mm2",
    )
    hemoglobin: float | None = _blood_option("hemoglobin")
    saturation: float | None = _blood_option("saturation")
    scattering: str = opt.choice(
        "scattering coefficient of the stroma",
        get_args(Scattering),
        "lb06",
        overrules=tuple(POWER_LAW_LIMITS),
    )
    absorption: str = opt.choice(
        "absorption of melanin, by LB06's tables or by F09's power laws",
        get_args(Absorption),
        "lb06",
    )


class ProcessOptions(opt.Group, panel="Process"):
    """Rules of light transport; `None` stands for the named process's own."""

    ONLY_WITH: ClassVar[opt.OnlyWith] = {
        **dict.fromkeys(("phase", "rescatter", "perturb_on_reflection"), _ILIT),
        "polarised": ("process", (_DEEP,)),
    }

    process: str = opt.choice(
        "rules of light transport; by ilit, light eyes are twice as bright in the blue as "
        "depth-resolved",
        PROCESSES,
        "ilit-2006",
        overrules=("phase", "rescatter", "perturb_on_reflection"),
    )
    phase: str | None = opt.choice(
        "phase function, the paper's sampling or Rayleigh's law", get_args(processes.Phase)
    )
    rescatter: str | None = opt.choice(
        "after a scatter straight out, or tested over the layer again",
        get_args(processes.Rescatter),
    )
    perturb_on_reflection: bool | None = opt.option(
        "redraw directions when reflected inside a layer",
        names="--perturb-on-reflection/--no-perturb",
    )
    # If typed, it sets the one process with polarised light, whatever the process of a file.
    polarised: bool | None = opt.option(
        "depth-resolved transport of Stokes vectors, or of intensities alone",
        names="--polarised/--scalar",
        overrules=("process",),
    )

    def __post_init__(self) -> None:
        if self.polarised and "process" not in self.typed:
            object.__setattr__(self, "process", _DEEP)
        super().__post_init__()

    def seeing_polarisation(self, instrument: str) -> "ProcessOptions":
        """Return the options with polarisation, for an instrument that measures it."""
        if self.polarised is False or ("process" in self.typed and self.process != _DEEP):
            raise ValueError(f"--instrument {instrument} needs --process {_DEEP} --polarised")
        return dataclasses.replace(self, process=_DEEP, polarised=True)


class SolverOptions(opt.Group, panel="Solver"):
    ONLY_WITH: ClassVar[opt.OnlyWith] = {"photons": _SAMPLED, "seed": _SAMPLED}

    solver: str = opt.choice(
        "integrate the process, or sample it", ("exact", "monte-carlo"), "exact"
    )
    photons: int = opt.whole("photons at each wavelength", Range(1, 2**31 - 2**20), 1_000_000)
    seed: int = opt.seeded("bytes")

    @property
    def key(self) -> jax.Array | None:
        """The key of a solver that samples."""
        return None if self.solver == "exact" else key_of(self.seed)


def build_model(options: IrisOptions, rules: ProcessOptions) -> tuple[ij.Iris, AbstractProcess]:
    """Make the iris and the process that the options describe."""
    names = (*RANGES, "melanin_load", *BLOOD, *FRACTIONS)
    fields = {n: v for n in names if (v := getattr(options, n)) is not None}
    blood = {n: fields.pop(n) for n in BLOOD if n in fields}
    single_haemoglobins = [
        opt.dashed(n) for n in ("oxyhemoglobin", "deoxyhemoglobin") if n in options.typed
    ]
    if blood and single_haemoglobins:
        raise ValueError(
            f"{opt.dashed(next(iter(blood)))} sets both haemoglobins: omit {single_haemoglobins[0]}"
        )
    law = [opt.dashed(n) for n in POWER_LAW_LIMITS if n in fields]
    if law and "scattering" in options.typed:
        message = "replaces the formula that --scattering names; give one of the two"
        raise ValueError(f"{law[0]} {message}")
    if not fields.keys() & FRACTIONS.keys() or "absorption" in options.typed:
        fields["absorption"] = options.absorption
    iris = ij.Iris.of_level(options.level).replace(**fields, scattering=options.scattering)
    iris = iris.replace(**blood) if blood else iris
    process = processes.POLARISED if rules.polarised else PROCESSES[rules.process]
    switches = {n: getattr(rules, n) for n in process.describe()}
    process = dataclasses.replace(process, **{n: v for n, v in switches.items() if v is not None})
    if iris.power_law is not None:
        subject = "a power law of scattering (--reduced-scattering, --anisotropy, ...)"
        if not isinstance(process, processes.RadiativeTransfer):
            raise ValueError(f"{subject} needs --process {_DEEP}")
        if rules.polarised:
            reason = (
                "cannot be combined with polarised light, which scatters by Rayleigh's law only"
            )
            raise ValueError(f"{subject} {reason}")
    return iris, process


def make_solver(
    options: SolverOptions, process: AbstractProcess, iris: ij.Iris, *, exits: bool
) -> AbstractSolver:
    """Make the solver that the options name, for this process and iris; `exits` for a BRDF."""
    if options.solver == "exact":
        return exact_solver(process, iris, exits=exits)
    if process.polarised:
        raise ValueError("--solver monte-carlo follows unpolarised light: give --solver exact")
    return MonteCarlo(options.photons, process=process)
