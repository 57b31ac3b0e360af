"""Settings of each command: one table reads the command line and a file's header, and writes that
header.
"""

import dataclasses
import math
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, get_args

import irisjax as ij
from irisjax import io
from irisjax.cli.options import Grid, Setting, cosine, flag, grid, number, one_of, whole
from irisjax.measure.colour import OBSERVER
from irisjax.tissue.iris import LIMITS
from irisjax.tissue.pigments import common_range
from irisjax.transport.montecarlo import Estimator
from irisjax.transport.process import PROCESSES, Cornea, Phase, Rescatter, Scattering

_IRIS, _PROCESS, _SOLVER, _LIGHT, _FILES = "Iris", "Process", "Solver", "Measurement", "Files"
# As written in the class: making an iris would start JAX before the precision is chosen.
_DEFAULTS = {
    field.name: field.default
    for field in dataclasses.fields(ij.Iris)
    if isinstance(field.default, float)
}


def _choice(name: str, panel: str, help: str, names: Iterable[str], default: str | None) -> Setting:
    return Setting(name, panel, f"{', '.join(names)}: {help}", one_of(*names), default, "name")


def _iris_setting(name: str) -> Setting:
    low, high, unit, meaning, above = LIMITS[name]
    allowed = f"{low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
    if above:
        allowed = f"above {low:g}, at most {high:g}" if math.isfinite(high) else f"above {low:g}"
    # The melanins are the level's.
    default = f"{_DEFAULTS[name]:g}" if name in _DEFAULTS and not name.endswith("melanin") else None
    return Setting(name, _IRIS, f"{meaning}, {allowed}", number(), default, unit or "number")


def _wavelengths(default: str, option: str | None = None) -> Setting:
    low, high = common_range()
    help = f"start:stop:step or a list like 450,550; within {low:g} to {high:g}"

    def within(text: str) -> Grid:
        found = grid(text)
        outside = [w for w in found.values if not low <= w <= high]
        if outside:
            raise ValueError(
                f"{outside[0]:g} nm is outside the pigment tables ({low:g} to {high:g} nm)"
            )
        return found

    return Setting("wavelengths", _LIGHT, help, within, default, "nm", option=option)


_MODEL = (
    _choice(
        "level",
        _IRIS,
        "pigmentation of the paper; sets both melanins",
        ("low", "moderate", "high"),
        "moderate",
    ),
    *map(_iris_setting, LIMITS),
    Setting(
        "melanin_load",
        _IRIS,
        "melanin mass per iris area, at least 0: rescales both melanins, keeping their ratio",
        number(),
        metavar="ug/mm2",
    ),
    _choice(
        "process",
        _PROCESS,
        "rules of light transport; by ilit, light eyes are twice as bright in the blue as "
        "depth-resolved",
        PROCESSES,
        "ilit-2006",
    ),
    _choice(
        "phase",
        _PROCESS,
        "phase function, the paper's sampling or Rayleigh's law",
        get_args(Phase),
        None,
    ),
    _choice(
        "rescatter",
        _PROCESS,
        "after a scatter straight out, or tested over the layer again",
        get_args(Rescatter),
        None,
    ),
    Setting(
        "perturb_on_reflection",
        _PROCESS,
        "redraw directions when reflected inside a layer",
        flag,
        flag=True,
    ),
    _choice(
        "scattering", _PROCESS, "scattering coefficient of the stroma", get_args(Scattering), None
    ),
    _choice(
        "solver", _SOLVER, "integrate the process, or sample it", ("exact", "monte-carlo"), "exact"
    ),
    Setting(
        "photons",
        _SOLVER,
        "photons at each wavelength",
        whole(1, 2**31 - 2**20),
        "1000000",
        "count",
    ),
    _choice(
        "estimator",
        _SOLVER,
        "event by event; expected values; those on a lattice",
        get_args(Estimator),
        "analog",
    ),
    # 32 bits: larger seeds would start other streams in a float32 Python session than here.
    Setting(
        "seed",
        _SOLVER,
        "0 to 4294967295; equal seeds give equal bytes",
        whole(0, 2**32 - 1),
        "0",
        "number",
    ),
)
_CORNEA = _choice(
    "cornea",
    _PROCESS,
    "whether light crosses tear film and cornea; auto is inward for radiance, else none",
    ("auto", *get_args(Cornea)),
    "auto",
)
_INCIDENCE = (
    Setting(
        "cos_incidence", _LIGHT, "cosine of incidence, 0 to 1, or diffuse", cosine, "1.0", "number"
    ),
    Setting(
        "incidence_deg", _LIGHT, "the same as an angle, 0 to 90", number(0, 90), None, "degrees"
    ),
)
_FIRST_SURFACE = Setting(
    "first_surface",
    _LIGHT,
    "count light mirrored by the iris's own surface",
    flag,
    "yes",
    flag=True,
)
_ILLUMINANT = Setting(
    "illuminant", _LIGHT, "light source by its name in colour-science", str, "D65", "name"
)
_SOURCE = Setting(
    "source",
    _FILES,
    "run this file's header again, with what other options change",
    Path,
    metavar="FILE.csv",
    option="--from",
)
_OUTPUT = Setting(
    "output",
    _FILES,
    "write the CSV here; without it, to standard output",
    Path,
    None,
    "FILE.csv",
    option="-o --output",
)
_PLOT = Setting("plot", _FILES, "draw a figure: .png, .pdf or .svg", Path, None, "FILE.png")

COMMANDS: dict[str, tuple[Setting, ...]] = {
    "spectrum": (
        *_MODEL,
        _CORNEA,
        _wavelengths("400:700:10"),
        _choice(
            "instrument",
            _LIGHT,
            "share of the light sent back, or radiance under an illuminant",
            ("reflectance", "radiance"),
            "reflectance",
        ),
        _ILLUMINANT,
        *_INCIDENCE,
        _FIRST_SURFACE,
        _SOURCE,
        _OUTPUT,
        _PLOT,
    ),
    "brdf": (
        *_MODEL,
        _wavelengths("550", "--wavelength --wavelengths"),
        *_INCIDENCE,
        _choice("plane", _LIGHT, "exit directions", ("principal", "hemisphere"), "principal"),
        Setting(
            "angles",
            _LIGHT,
            "exit directions over 180 degrees, 2 to 3600",
            whole(2, 3600),
            "90",
            "count",
        ),
        _SOURCE,
        _OUTPUT,
        _PLOT,
    ),
    "colour": (
        *_MODEL,
        _CORNEA,
        _wavelengths("380:780:5"),
        _ILLUMINANT,
        Setting(
            "observer",
            _LIGHT,
            "standard observer by its name in colour-science",
            str,
            OBSERVER,
            "name",
        ),
        *_INCIDENCE,
        _FIRST_SURFACE,
        _SOURCE,
        Setting("swatch", _FILES, "paint the colour", Path, None, "FILE.png"),
    ),
}
COMMANDS["simulate-measurement"] = (
    *(s for s in _MODEL if s.panel != _SOLVER),
    _CORNEA,
    _wavelengths("400:700:10"),
    *_INCIDENCE,
    _FIRST_SURFACE,
    Setting(
        "scattering_scale",
        _LIGHT,
        "factor on the stroma's scattering",
        number(0, 1e6),
        "1.0",
        "number",
    ),
    Setting(
        "gain", _LIGHT, "factor of the instrument on every value", number(0, 1e6), "1.0", "number"
    ),
    Setting(
        "relative_noise",
        _LIGHT,
        "standard deviation, share of the value",
        number(0, 10),
        "0.02",
        "share",
    ),
    Setting(
        "absolute_noise",
        _LIGHT,
        "the same, of every value alike",
        number(0, 10),
        "2e-4",
        "reflectance",
    ),
    Setting("scans", _LIGHT, "repeated scans, a column each", whole(1, 1000), "1", "count"),
    Setting(
        "seed",
        _LIGHT,
        "0 to 4294967295; equal seeds give equal bytes",
        whole(0, 2**32 - 1),
        "0",
        "number",
    ),
    _SOURCE,
    _OUTPUT,
)
"""Settings of each command, in the order of help and header."""

# Settings that mean nothing unless another has one of these values; giving them then is an error.
_ONLY_WITH: dict[str, tuple[str, tuple[str, ...]]] = {
    "photons": ("solver", ("monte-carlo",)),
    "estimator": ("solver", ("monte-carlo",)),
    "seed": ("solver", ("monte-carlo",)),
    "illuminant": ("instrument", ("radiance",)),
    "rescatter": ("process", ("ilit-2006", "ilit-corrected")),
    "perturb_on_reflection": ("process", ("ilit-2006", "ilit-corrected")),
}
# The first, given on the command line, sets the others: a file's values for those yield.
_SETS = {
    "level": ("eumelanin", "pheomelanin"),
    "process": ("phase", "rescatter", "perturb_on_reflection", "scattering"),
    "incidence_deg": ("cos_incidence",),
    "cos_incidence": ("incidence_deg",),
}
FOR_PEOPLE = (
    "irisjax",
    "simulated",
    "command",
    "approximation",
    "melanin load that follows",
    "transport",
    "solver settings",
    "unit",
    "directions",
    "truth",
)
"""Keys of a header that set nothing."""


def settled(command: str, given: Mapping[str, str | bool]) -> dict[str, Any]:
    """Values of a command's settings: what was given, else what `--from` says, else the defaults.

    Settings left open are `None`. **Raises:** `ValueError` naming option or file, value and allowed
    range.
    """
    table = {setting.name: setting for setting in COMMANDS[command]}
    texts = {name: _text(value) for name, value in given.items()}
    filed = _filed(Path(texts["source"]), command, table, texts) if "source" in texts else {}
    values: dict[str, Any] = {}
    for name, setting in table.items():
        text = texts.get(name, filed.get(name, setting.default))
        # A default that the help shows but the model holds (an iris's index, say) stays with the
        # model.
        if text is None or (name in LIMITS and name not in texts and name not in filed):
            values[name] = None
            continue
        try:
            values[name] = setting.parse(text)
        except ValueError as error:
            where = setting.typed() if name in texts else f"{texts.get('source')}: {name}"
            raise ValueError(f"{where}: {error}") from None
    for name in texts:
        if not _applies(name, values):
            other, allowed = _ONLY_WITH[name]
            raise ValueError(
                f"{table[name].typed()} means something only with --{other} {' or '.join(allowed)}"
            )
    if "cos_incidence" in texts and "incidence_deg" in texts:
        raise ValueError("give --cos-incidence or --incidence-deg, not both")
    if values["incidence_deg"] is not None:
        values["cos_incidence"] = math.cos(math.radians(values["incidence_deg"]))
    return values


def header(
    command: str, values: Mapping[str, Any], iris: ij.Iris, process: ij.Process
) -> dict[str, str]:
    """The settings as a file's header, complete enough for `--from`; `iris` and `process` made from
    them.
    """
    out: dict[str, str] = {}
    parameters = iris.parameters()
    values = {**values, **{name: getattr(process, name) for name in _SETS["process"]}}
    for setting in COMMANDS[command]:
        name = setting.name
        if name in parameters:
            unit = LIMITS[name].unit
            # float, not text made by numpy: that loses digits once colour-science has been
            # imported.
            out[name] = f"{float(getattr(iris, name))!r}{f' [{unit}]' if unit else ''}"
        elif name == "melanin_load":
            out["melanin load that follows"] = f"{float(iris.melanin_load):.12g} [ug/mm2]"
        elif (
            name not in LIMITS
            and name not in ("level", "incidence_deg")
            and setting.panel != _FILES
        ):
            value = values[name]
            if value is not None and _applies(name, values):
                out[name] = f"{_text(value)}{' [nm]' if name == 'wavelengths' else ''}"
    return out


def _applies(name: str, values: Mapping[str, Any]) -> bool:
    other, allowed = _ONLY_WITH.get(name, ("", ()))
    return other not in values or values[other] in allowed


def _filed(
    path: Path, command: str, table: Mapping[str, Setting], texts: Mapping[str, str]
) -> dict[str, str]:
    """Settings from a file's header that this command has and the command line does not
    overrule.
    """
    entries = io.read_header(path)
    known = {
        setting.name
        for settings in COMMANDS.values()
        for setting in settings
        if setting.panel != _FILES
    }
    if not known & set(entries):
        raise ValueError(f"{path}: no header of settings (lines like '# eumelanin: 0.1201')")
    for name in entries:
        if name not in known and name not in FOR_PEOPLE:
            raise ValueError(
                f"{path}: unknown setting {name!r} in the header; known: {', '.join(sorted(known))}"
            )
    overruled = {name for setter, names in _SETS.items() if setter in texts for name in names}
    # Another command's file lends its iris, process and solver; what it measured is its own affair.
    foreign = entries.get("command", command) != command
    left_out = [n for n in entries if n in table and n not in texts and table[n].panel == _LIGHT]
    if foreign and left_out:
        print(
            f"irisjax: note: {path} is of another command; not taken from it: "
            f"{', '.join(left_out)}",
            file=sys.stderr,
        )
    return {
        name: text
        for name, text in entries.items()
        if name in table
        and name not in overruled
        and name not in FOR_PEOPLE
        and not (foreign and table[name].panel == _LIGHT)
    }


def _text(value: Any) -> str:
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
