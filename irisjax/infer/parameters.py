"""Parameters of an inversion: names, units, bounds and priors, and the iris that they make."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from irisjax.infer.priors import AbstractPrior, LogitNormal, LogNormal, LogUniform, Uniform
from irisjax.measure.instrument import GAIN
from irisjax.numerics.checks import Range
from irisjax.numerics.roots import share_of
from irisjax.tissue.iris import BLOOD, LIMITS, MELANIN_LOAD, Iris
from irisjax.tissue.scattering import POWER_LAW_LIMITS


class Parameter(NamedTuple):
    """A quantity that may be free: values that may be stated, default prior, and its source."""

    allowed: Range
    prior: AbstractPrior
    source: str

    @property
    def support(self) -> tuple[float, float]:
        """The interval in which priors may lie: a tail may reach beyond what may be stated."""
        allowed = self.allowed
        return allowed.low, float("inf") if self.prior.high > allowed.high else allowed.high


_INF = float("inf")
_ALLOWED = {
    **LIMITS,
    **POWER_LAW_LIMITS,
    "melanin_load": MELANIN_LOAD,
    "abl_fraction": Range(0, 1, "", "share of the melanin in the anterior border layer"),
    "pheomelanin_share": Range(0, 1, "", "share of pheomelanin in the melanin"),
    **BLOOD,
    "gain": GAIN,
    "noise": Range(0, _INF, "", "factor on the stated standard deviations", above=True),
}
_PRIORS: dict[str, tuple[AbstractPrior, str]] = {
    "melanin_load": (
        LogNormal(0.15, 1.2),
        "two thirds between 0.045 and 0.5: LB06 Table 2 has 0.048 (low), 0.35, 0.44 (high)",
    ),
    "abl_fraction": (Uniform(0.0, 1.0), "no preference; LB06 Figs. 7 and 9 use 0.2 to 0.8"),
    "pheomelanin_share": (
        LogitNormal(0.2, 0.8),
        "LB06 Table 2 has 0.14 (low), 0.20, 0.21 (high); two thirds between 0.1 and 0.36",
    ),
    "hemoglobin": (LogNormal(0.084, 0.5), "LB06 Table 2: 0.084; a factor 1.6 either way"),
    "saturation": (
        LogitNormal(0.6, 1.0),
        "LB06 Table 2 has 0.5; arterial blood 0.97, venous 0.7: two thirds between 0.36 and 0.8",
    ),
    "stroma_thickness": (LogNormal(0.2855, 0.2), "LB06 Section 3.1, 20 % either way"),
    "abl_thickness": (LogNormal(0.05675, 0.2), "LB06 Section 3.1, 20 % either way"),
    "scattering_scale": (
        LogUniform(0.3, 40.0),
        "no preference up to 40 times LB06's formula; soft tissues 4 to 20 times, Jacques 2013",
    ),
    "reduced_scattering": (
        LogNormal(1.0, 0.8),
        "soft tissues 0.2 to 5, Jacques 2013; that is 95 % of the prior",
    ),
    "rayleigh_share": (Uniform(0.0, 1.0), "no preference"),
    "scattering_power": (Uniform(0.2, 3.0), "soft tissues 0.2 to 3, Jacques 2013"),
    "anisotropy": (Uniform(0.7, 0.95), "0.7 to 0.95 in soft tissues, Jacques 2013"),
    "gain": (LogNormal(1.0, 0.03), "calibration of a reflectance standard, 3 %"),
    "noise": (LogNormal(1.0, 0.5), "statements of noise hold to a factor of 1.6"),
}

PARAMETERS = {name: Parameter(_ALLOWED[name], *prior) for name, prior in _PRIORS.items()}
"""Every parameter by name."""

DEFAULT_FREE = (
    "melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "saturation", "gain",
    "noise",
)  # fmt: skip
"""Parameters that are free by default."""

OF_POWER_LAW = tuple(POWER_LAW_LIMITS)
"""Parameters that only an iris with a power law of scattering has."""

# Parameters that an iris has under their own names.
_OF_IRIS = (
    *("abl_fraction", "hemoglobin", "saturation"),
    *("stroma_thickness", "abl_thickness", "scattering_scale"),
)

DERIVED = {"eumelanin": "mg/ml", "pheomelanin": "mg/ml", "abl_melanin": "ug/mm2"}
"""Derived quantities and their units."""


def of_iris(iris: Iris) -> dict[str, Any]:
    """Return the parameters of an iris, with gain and noise as stated; `ValueError` for one whose
    melanins have different ABL fractions: the parameters have one for both.
    """
    if iris.pheomelanin_abl_fraction is not None:
        raise ValueError("pheomelanin_abl_fraction: an inversion has one abl_fraction for both")
    melanin = iris.eumelanin + iris.pheomelanin
    # Without any melanin every share gives the same iris; LB06's is returned.
    share = share_of(iris.pheomelanin, melanin, 0.2)
    values = {name: getattr(iris, name) for name in ("melanin_load", *_OF_IRIS)}
    values |= {"pheomelanin_share": share, "gain": 1.0, "noise": 1.0}
    values |= {} if iris.power_law is None else iris.power_law.parameters()
    return {name: values[name] for name in PARAMETERS if name in values}


def iris_of(values: Mapping[str, Any], base: Iris) -> Iris:
    """Return the iris with these parameters, and all else (indices, carotenoids) from `base`."""
    numbers = {**values, **derived(values)}
    law = () if base.power_law is None else OF_POWER_LAW
    return base.replace(**{n: numbers[n] for n in ("eumelanin", "pheomelanin", *_OF_IRIS, *law)})


def derived(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return concentrations over the whole iris (mg/ml) and the melanin of the ABL (µg/mm²)."""
    concentration = values["melanin_load"] / (values["abl_thickness"] + values["stroma_thickness"])
    return {
        "eumelanin": concentration * (1 - values["pheomelanin_share"]),
        "pheomelanin": concentration * values["pheomelanin_share"],
        "abl_melanin": values["melanin_load"] * values["abl_fraction"],
    }


def kind(name: str) -> str:
    """Return the parameter of a free name: that of `melanin_load@2` is `melanin_load`."""
    return name.partition("@")[0]


def unit_of(name: str) -> str:
    """Return the unit of a free or derived name."""
    parameter = PARAMETERS.get(kind(name))
    return DERIVED[kind(name)] if parameter is None else parameter.allowed.unit


def of_observation(values: Mapping[str, Any], i: int) -> dict[str, Any]:
    """Return the parameters of the i-th observation, under their plain names."""
    tag = f"@{i + 1}"
    return {kind(n): v for n, v in values.items() if "@" not in n or n.endswith(tag)}
