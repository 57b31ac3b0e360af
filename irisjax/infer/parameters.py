"""What an inversion can set free: names, units, bounds and priors, and the iris they make."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

from irisjax.infer.priors import AbstractPrior, LogitNormal, LogNormal, Uniform
from irisjax.measure.instrument import GAIN
from irisjax.numerics.checks import Range
from irisjax.tissue.iris import LIMITS, MELANIN_LOAD, Iris
from irisjax.tissue.scattering import POWER_LAW_LIMITS


class Parameter(NamedTuple):
    """A quantity that may be free: its unit, bounds, default prior, meaning, and where the prior
    comes from.
    """

    unit: str
    low: float
    high: float
    prior: AbstractPrior
    meaning: str
    source: str
    above: bool = False  # `low` itself is not allowed
    most: float = float("inf")  # of a value that is stated; priors may have tails beyond

    @property
    def allowed(self) -> Range:
        """Its bounds, with their unit."""
        return Range(self.low, min(self.high, self.most), self.unit, self.meaning, self.above)


_INF = float("inf")


PARAMETERS: dict[str, Parameter] = {
    "melanin_load": Parameter(
        "ug/mm2",
        0,
        _INF,
        LogNormal(0.15, 1.2),
        "melanin mass per iris area",
        "two thirds between 0.045 and 0.5: LB06 Table 2 has 0.048 (low), 0.35, 0.44 (high)",
        most=MELANIN_LOAD.high,
    ),
    "abl_fraction": Parameter(
        "",
        0,
        1,
        Uniform(0.0, 1.0),
        "share of the melanin in the anterior border layer",
        "no preference; LB06 Figs. 7 and 9 use 0.2 to 0.8",
    ),
    "pheomelanin_share": Parameter(
        "",
        0,
        1,
        LogitNormal(0.2, 0.8),
        "share of pheomelanin in the melanin",
        "LB06 Table 2 has 0.14 (low), 0.20, 0.21 (high); two thirds between 0.1 and 0.36",
    ),
    "hemoglobin": Parameter(
        "mmol/l",
        0,
        _INF,
        LogNormal(0.084, 0.5),
        "haemoglobin of both kinds in the stroma",
        "LB06 Table 2: 0.084; a factor 1.6 either way",
        most=LIMITS["oxyhemoglobin"].high,
    ),
    "saturation": Parameter(
        "",
        0,
        1,
        LogitNormal(0.6, 1.0),
        "oxygen saturation, the share of oxyhaemoglobin",
        "LB06 Table 2 has 0.5; arterial blood 0.97, venous 0.7: two thirds between 0.36 and 0.8",
    ),
    "stroma_thickness": Parameter(
        "mm",
        0,
        _INF,
        LogNormal(0.2855, 0.2),
        "thickness of the stroma",
        "LB06 Section 3.1, 20 % either way",
        most=LIMITS["stroma_thickness"].high,
    ),
    "abl_thickness": Parameter(
        "mm",
        0,
        _INF,
        LogNormal(0.05675, 0.2),
        "thickness of the anterior border layer",
        "LB06 Section 3.1, 20 % either way",
        most=LIMITS["abl_thickness"].high,
    ),
    "scattering_scale": Parameter(
        "",
        0,
        _INF,
        LogNormal(1.0, 0.3),
        "factor on the stroma's scattering",
        "the formula's own value, 30 %",
    ),
    "reduced_scattering": Parameter(
        "1/mm",
        0,
        _INF,
        LogNormal(1.0, 0.8),
        "reduced scattering of the stroma at 500 nm, a' of a power law",
        "soft tissues 0.2 to 5, Jacques 2013; that is 95 % of the prior",
        most=POWER_LAW_LIMITS["reduced_scattering"].high,
    ),
    "rayleigh_share": Parameter(
        "",
        0,
        1,
        Uniform(0.0, 1.0),
        "share of Rayleigh scattering in it, f_Ray",
        "no preference",
    ),
    "scattering_power": Parameter(
        "",
        0,
        POWER_LAW_LIMITS["scattering_power"].high,
        Uniform(0.2, 3.0),
        "power of the wavelength by which the rest of it falls, b",
        "soft tissues 0.2 to 3, Jacques 2013",
    ),
    "anisotropy": Parameter(
        "",
        POWER_LAW_LIMITS["anisotropy"].low,
        POWER_LAW_LIMITS["anisotropy"].high,
        Uniform(0.7, 0.95),
        "mean cosine of the rest's scattering angle, g",
        "0.7 to 0.95 in soft tissues, Jacques 2013",
    ),
    "gain": Parameter(
        "",
        0,
        _INF,
        LogNormal(1.0, 0.03),
        "factor of the instrument on every value",
        "calibration of a reflectance standard, 3 %",
        above=True,
        most=GAIN.high,
    ),
    "noise": Parameter(
        "",
        0,
        _INF,
        LogNormal(1.0, 0.5),
        "factor on the stated standard deviations",
        "statements of noise hold to a factor of 1.6",
        above=True,
    ),
}
"""Every parameter by name."""

DEFAULT_FREE = (
    "melanin_load",
    "abl_fraction",
    "pheomelanin_share",
    "hemoglobin",
    "saturation",
    "gain",
    "noise",
)
"""What is free unless the user says otherwise."""

OF_POWER_LAW = tuple(POWER_LAW_LIMITS)
"""Parameters that only an iris with a power law of scattering has."""

DERIVED = {"eumelanin": "mg/ml", "pheomelanin": "mg/ml", "abl_melanin": "ug/mm2"}
"""What follows from the parameters, with units."""


def of_iris(iris: Iris) -> dict[str, Any]:
    """The parameters that make this iris; the instrument as stated.

    **Raises:** `ValueError` for an iris whose melanins are shared out differently: a spectrum's
    parameters have one ABL fraction.
    """
    if iris.pheomelanin_abl_fraction is not None:
        raise ValueError("pheomelanin_abl_fraction: an inversion knows one abl_fraction of both")
    melanin, blood = iris.eumelanin + iris.pheomelanin, iris.oxyhemoglobin + iris.deoxyhemoglobin

    def share(part, whole, otherwise):
        # Of nothing there is no share: any gives the same iris, LB06's stands in.
        none = whole <= 0
        return jnp.where(none, otherwise, part / jnp.where(none, 1.0, whole))

    return {
        "melanin_load": iris.melanin_load,
        "abl_fraction": iris.abl_fraction,
        "pheomelanin_share": share(iris.pheomelanin, melanin, 0.2),
        "hemoglobin": blood,
        "saturation": share(iris.oxyhemoglobin, blood, 0.5),
        "stroma_thickness": iris.stroma_thickness,
        "abl_thickness": iris.abl_thickness,
        "scattering_scale": iris.scattering_scale,
        **({} if iris.power_law is None else iris.power_law.parameters()),
        "gain": 1.0,
        "noise": 1.0,
    }


def iris_of(values: Mapping[str, Any], base: Iris) -> Iris:
    """The iris with these parameters, `base` in all else (indices, carotenoids)."""
    concentration = values["melanin_load"] / (values["abl_thickness"] + values["stroma_thickness"])
    return base.replace(
        eumelanin=concentration * (1 - values["pheomelanin_share"]),
        pheomelanin=concentration * values["pheomelanin_share"],
        abl_fraction=values["abl_fraction"],
        oxyhemoglobin=values["hemoglobin"] * values["saturation"],
        deoxyhemoglobin=values["hemoglobin"] * (1 - values["saturation"]),
        stroma_thickness=values["stroma_thickness"],
        abl_thickness=values["abl_thickness"],
        scattering_scale=values["scattering_scale"],
        **({} if base.power_law is None else {n: values[n] for n in POWER_LAW_LIMITS}),
    )


def derived(values: Mapping[str, Any]) -> dict[str, Any]:
    """Concentrations over the whole iris (mg/ml) and the melanin of the ABL (µg/mm²)."""
    concentration = values["melanin_load"] / (values["abl_thickness"] + values["stroma_thickness"])
    return {
        "eumelanin": concentration * (1 - values["pheomelanin_share"]),
        "pheomelanin": concentration * values["pheomelanin_share"],
        "abl_melanin": values["melanin_load"] * values["abl_fraction"],
    }


def kind(name: str) -> str:
    """The parameter that a free name is of: `melanin_load@2` is a `melanin_load`."""
    return name.partition("@")[0]


def unit_of(name: str) -> str:
    """Unit of a free or derived name."""
    return (
        DERIVED.get(kind(name)) or PARAMETERS[kind(name)].unit
        if kind(name) in PARAMETERS
        else DERIVED[kind(name)]
    )


def seen_by(values: Mapping[str, Any], i: int) -> dict[str, Any]:
    """The parameters that the i-th observation has, under their plain names."""
    tag = f"@{i + 1}"
    return {kind(n): v for n, v in values.items() if "@" not in n or n.endswith(tag)}
