"""`Iris`: the biophysical parameters of LB06, its levels, and the layers that follow from them."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from irisjax._types import Scalar
from irisjax.anatomy.media import AQUEOUS
from irisjax.numerics.checks import Range, check_fields, check_known, check_range, check_scalars
from irisjax.numerics.roots import share_of
from irisjax.tissue.indices import (
    COLLAGEN_FRACTION,
    FIBROBLAST_FRACTION,
    SCATTERING,
    Order,
    RefractiveIndices,
    Scattering,
    gladstone_dale,
)
from irisjax.tissue.layers import Layers
from irisjax.tissue.pigments import PER_CENT, Extinction
from irisjax.tissue.scattering import POWER_LAW_LIMITS, PowerLaw

_INF = float("inf")
_PURE = Range(0, 2000, "mg/ml")  # denser than melanin itself
LIMITS: dict[str, Range] = {
    "eumelanin": _PURE._replace(meaning="eumelanin over the whole iris"),
    "pheomelanin": _PURE._replace(meaning="pheomelanin over the whole iris"),
    "abl_fraction": Range(0, 1, "", "share of the melanin mass in the anterior border layer"),
    "pheomelanin_abl_fraction": Range(
        0, 1, "", "the same of the pheomelanin alone, where it differs from the eumelanin's"
    ),
    "oxyhemoglobin": Range(0, 10, "mmol/l", "oxyhaemoglobin in the stroma"),
    "deoxyhemoglobin": Range(0, 10, "mmol/l", "deoxyhaemoglobin in the stroma"),
    "lutein": Range(0, 1000, "mg/ml", "lutein in the stroma"),
    "zeaxanthin": Range(0, 1000, "mg/ml", "zeaxanthin in the stroma"),
    "abl_thickness": Range(0, 3, "mm", "thickness of the anterior border layer"),
    "stroma_thickness": Range(0, 3, "mm", "thickness of the stroma"),
    "intensification": Range(
        0, _INF, "", "factor of intensification of melanin absorption", above=True
    ),
    "fibril_radius": Range(0, 200, "nm", "radius of the collagen fibrils", above=True),
    "fibroblast_index": Range(1, 3, "", "refractive index of the ABL's fibroblasts"),
    "collagen_index": Range(1, 3, "", "refractive index of the collagen fibrils"),
    "base_index": Range(1, 3, "", "refractive index of the base material"),
    "ipe_index": Range(1, 3, "", "refractive index of the iris pigment epithelium"),
    "fibroblast_fraction": Range(0, 1, "", "volume fraction of fibroblasts in the ABL"),
    "collagen_fraction": Range(0, 1, "", "volume fraction of fibrils in the stroma", above=True),
    "abl_index": Range(1, 3, "", "refractive index of the ABL, in place of Gladstone-Dale's"),
    "stroma_index": Range(1, 3, "", "refractive index of the stroma, in place of Gladstone-Dale's"),
    "scattering_scale": Range(0, _INF, "", "factor on the stroma's scattering"),
    "ipe_melanin": Range(
        0, 12000, "ug/mm2", "eumelanin of the pigment epithelium, which is black without a number"
    ),
}
"""Every settable number of `Iris` with its allowed range and unit."""
MELANIN_LOAD = Range(0, 12000, "ug/mm2", "melanin mass per iris area")
"""Allowed melanin loads: the most is what layers of the largest thicknesses could hold."""
BLOOD = {
    "hemoglobin": LIMITS["oxyhemoglobin"]._replace(
        meaning="haemoglobin of both kinds in the stroma"
    ),
    "saturation": Range(0, 1, "", "oxygen saturation, the share of oxyhaemoglobin"),
}
"""Allowed values of what `Iris.replace` takes in place of the two haemoglobins."""
CONCENTRATIONS = ("abl_eumelanin", "abl_pheomelanin", "stroma_eumelanin", "stroma_pheomelanin")
"""The melanins of the two layers, mg/ml of each layer."""
FRACTIONS = {
    f"{name}_percent": Range(0, 100, "%", f"{kind} in the {layer}, in per cent of its volume")
    for name in CONCENTRATIONS
    for layer, kind in [name.replace("abl", "ABL").split("_")]
}
"""Allowed values of what `Iris.replace` takes, all four, in place of the melanins  [F09 Eq. 10]."""
Absorption = Literal["lb06", "f09"]

_SHARES = ("abl_fraction", "pheomelanin_abl_fraction")
# Fields that decide the order of media.
_OPTICAL = {
    *(n for n in LIMITS if n.endswith("_index")),
    "fibroblast_fraction",
    "collagen_fraction",
}
_CHOICES = ("scattering", "absorption", "power_law")

_LEVELS = {"high": (1.008, 0.2674), "moderate": (0.8138, 0.2054), "low": (0.1201, 0.0194)}


def _parameter(name: str, default: float | None) -> Any:
    """A field of `Iris`: whatever number it is given becomes a float array."""

    def convert(value):
        return None if value is None and default is None else _as_float(name, value)

    return eqx.field(default=default, converter=convert)


class Iris(eqx.Module):
    """A human iris by its biophysical parameters, by default LB06's with moderate pigmentation.

    Every number is a float array of shape (); batch with `jax.vmap`, and make variations with
    `replace`. A changed thickness keeps the concentration of melanin over both layers and its
    division by mass, whereas maps (`IrisMaps`) keep the concentration in each layer and so give
    another picture.

    Attributes:
        eumelanin: Concentration over the whole iris, mg/ml.
        pheomelanin: Concentration over the whole iris, mg/ml.
        abl_fraction: Share of the melanin's mass in the anterior border layer (ABL).
        pheomelanin_abl_fraction: The same of the pheomelanin, if it differs from the eumelanin's
            [F09 Section 5.2]; otherwise `None`.
        oxyhemoglobin: Concentration in the stroma, mmol/l.
        deoxyhemoglobin: Concentration in the stroma, mmol/l.
        lutein: Concentration in the stroma, mg/ml.
        zeaxanthin: Concentration in the stroma, mg/ml.
        abl_thickness: Thickness of the ABL, mm.
        stroma_thickness: Thickness of the stroma, mm.
        intensification: Factor on the absorption of melanin.
        fibril_radius: Radius of the collagen fibrils, nm.
        fibroblast_index: Refractive index of the ABL's fibroblasts.
        collagen_index: Refractive index of the collagen fibrils.
        base_index: Refractive index of the base material.
        ipe_index: Refractive index of the iris pigment epithelium.
        fibroblast_fraction: Volume fraction of fibroblasts in the ABL.
        collagen_fraction: Volume fraction of fibrils in the stroma.
        abl_index: Refractive index of the ABL; `None` for the Gladstone–Dale mixture.
        stroma_index: Refractive index of the stroma; `None` for the Gladstone–Dale mixture.
        scattering_scale: Factor on the stroma's scattering.
        ipe_melanin: Eumelanin of the iris pigment epithelium per iris area, µg/mm², which lets the
            rest of the light out behind; `None` for LB06's epithelium, which is black.
        scattering: Formula of the stroma's scattering: `"lb06"` as printed, or
            `"rayleigh-spheres"`, independent small spheres.
        absorption: Absorption of the melanins: `"lb06"` by tables, or `"f09"` by F09's power laws,
            under which `PER_CENT` states what a per cent of volume is.
        power_law: Power law that replaces the formula, for radiative transfer; `None` for none.
        order: Which layers are denser than their neighbours, known before tracing.

    Raises:
        ValueError: For a concrete value out of range, with its field, value and range.
    """

    eumelanin: Scalar = _parameter("eumelanin", _LEVELS["moderate"][0])
    pheomelanin: Scalar = _parameter("pheomelanin", _LEVELS["moderate"][1])
    abl_fraction: Scalar = _parameter("abl_fraction", 0.5)
    pheomelanin_abl_fraction: Scalar | None = _parameter("pheomelanin_abl_fraction", None)
    oxyhemoglobin: Scalar = _parameter("oxyhemoglobin", 0.042)
    deoxyhemoglobin: Scalar = _parameter("deoxyhemoglobin", 0.042)
    lutein: Scalar = _parameter("lutein", 1.562e-4)
    zeaxanthin: Scalar = _parameter("zeaxanthin", 5.968e-5)
    abl_thickness: Scalar = _parameter("abl_thickness", 0.05675)
    stroma_thickness: Scalar = _parameter("stroma_thickness", 0.2855)
    intensification: Scalar = _parameter("intensification", 2.2)
    fibril_radius: Scalar = _parameter("fibril_radius", 30.0)
    fibroblast_index: Scalar = _parameter("fibroblast_index", 1.42)
    collagen_index: Scalar = _parameter("collagen_index", 1.47)
    base_index: Scalar = _parameter("base_index", 1.5)
    ipe_index: Scalar = _parameter("ipe_index", 1.5)
    fibroblast_fraction: Scalar = _parameter("fibroblast_fraction", FIBROBLAST_FRACTION)
    collagen_fraction: Scalar = _parameter("collagen_fraction", COLLAGEN_FRACTION)
    abl_index: Scalar | None = _parameter("abl_index", None)
    stroma_index: Scalar | None = _parameter("stroma_index", None)
    scattering_scale: Scalar = _parameter("scattering_scale", 1.0)
    ipe_melanin: Scalar | None = _parameter("ipe_melanin", None)
    scattering: Scattering = eqx.field(static=True, default="lb06")
    absorption: Absorption = eqx.field(static=True, default="lb06")
    power_law: PowerLaw | None = None
    order: Order = eqx.field(init=False)

    def __post_init__(self) -> None:
        # Plain numbers stay known inside a program: the order of media must be.
        with jax.ensure_compile_time_eval():
            # Equinox's converters run after this method, and the checks want arrays.
            for name in LIMITS:
                value = getattr(self, name)
                if value is not None:
                    object.__setattr__(self, name, _as_float(name, value))
            order = self.indices().order()
        check_fields(self, LIMITS)
        if not isinstance(self.scattering, str) or self.scattering not in SCATTERING:
            text = repr(self.scattering).split("(")[0]
            known = ", ".join(SCATTERING)
            raise ValueError(f"scattering = {text}; known: {known}; power_law holds a PowerLaw")
        check_known("absorption", self.absorption, get_args(Absorption))
        object.__setattr__(self, "order", order)

    @classmethod
    def of_level(cls, level: str) -> "Iris":
        """Make the iris of a level of LB06 Table 2: `"low"`, `"moderate"` or `"high"`."""
        check_known("pigmentation level", level, sorted(_LEVELS))
        eumelanin, pheomelanin = _LEVELS[level]
        return cls(eumelanin=jnp.asarray(eumelanin), pheomelanin=jnp.asarray(pheomelanin))

    def replace(self, **fields: Any) -> "Iris":
        """Return a copy with some fields changed.

        The static order of media is kept unless an index changes, so an iris can be carried through
        a loop.

        Args:
            **fields: New values of fields. Besides the fields, `melanin_load` (µg/mm²) rescales
                both melanins after the other changes and keeps their ratio (all eumelanin if there
                was none), `hemoglobin` (mmol/l) and `saturation` set both haemoglobins, the
                four `FRACTIONS` set the melanins and F09's absorption, and the numbers of a
                `PowerLaw` change the iris's or make one.

        Raises:
            ValueError: For an unknown name and for a value out of range.
        """
        load = fields.pop("melanin_load", None)
        for name in fields:
            names = ("melanin_load", *BLOOD, *FRACTIONS, *LIMITS, *_CHOICES, *POWER_LAW_LIMITS)
            check_known("parameter", name, names)
        if FRACTIONS.keys() & fields.keys():
            return self._with_fractions(fields, load)
        if blood := {name: fields.pop(name) for name in BLOOD if name in fields}:
            if set(fields) & {"oxyhemoglobin", "deoxyhemoglobin"}:
                message = f"{' and '.join(blood)}: both haemoglobins are set by it"
                raise ValueError(f"{message}; give no oxyhemoglobin and deoxyhemoglobin")
            for name, value in blood.items():
                check_range(name, value, BLOOD[name])
            blood = {name: getattr(self, name) for name in BLOOD} | blood
            fields["oxyhemoglobin"] = blood["hemoglobin"] * blood["saturation"]
            fields["deoxyhemoglobin"] = blood["hemoglobin"] * (1 - blood["saturation"])
        law = {name: fields.pop(name) for name in POWER_LAW_LIMITS if name in fields}
        if law:
            old = fields.get("power_law", self.power_law)
            fields["power_law"] = PowerLaw(**{**({} if old is None else old.parameters()), **law})
        current = {name: getattr(self, name) for name in (*LIMITS, *_CHOICES)}
        iris = Iris(**{**current, **fields})
        if not any(name in _OPTICAL for name in fields):
            object.__setattr__(iris, "order", self.order)
        if load is None:
            return iris
        load = _as_float("melanin_load", load)
        check_range("melanin_load", load, MELANIN_LOAD)
        total = iris.eumelanin + iris.pheomelanin
        share = share_of(iris.pheomelanin, total, 0.0)
        concentration = load / (iris.abl_thickness + iris.stroma_thickness)
        return iris.replace(
            eumelanin=concentration * (1 - share), pheomelanin=concentration * share
        )

    def _with_fractions(self, fields: dict[str, Any], load: Any) -> "Iris":
        """A copy with F09's melanins, and with other fields changed before."""
        if missing := [name for name in FRACTIONS if name not in fields]:
            raise ValueError(f"the four {', '.join(FRACTIONS)} go together; give {missing[0]}")
        percents = {name: _as_float(name, fields.pop(name)) for name in FRACTIONS}
        conflicting = [n for n in ("eumelanin", "pheomelanin", *_SHARES) if n in fields]
        conflicting += ["melanin_load"] * (load is not None)
        if conflicting or fields.get("absorption", "f09") != "f09":
            name = (*conflicting, "absorption")[0]
            raise ValueError(f"{', '.join(FRACTIONS)} set the melanins by F09; give no {name}")
        for name, value in percents.items():
            check_range(name, value, FRACTIONS[name])
        iris = self.replace(**fields, absorption="f09")
        scale = PER_CENT / iris.intensification
        values = zip(CONCENTRATIONS, percents.values(), strict=True)
        return iris.with_layers({name: scale * value for name, value in values})

    def with_layers(self, concentrations: Mapping[str, Any]) -> "Iris":
        """Return a copy with the melanins of both layers, by the names `CONCENTRATIONS`."""
        fields = {}
        for kind, share in zip(("eumelanin", "pheomelanin"), _SHARES, strict=True):
            abl = concentrations[f"abl_{kind}"] * self.abl_thickness
            total = abl + concentrations[f"stroma_{kind}"] * self.stroma_thickness
            fields[kind] = total / (self.abl_thickness + self.stroma_thickness)
            fields[share] = share_of(abl, total, 0.5)
        return self.replace(**fields)

    def layer_concentrations(self) -> dict[str, float]:
        """Return the melanins of both layers, by the names `CONCENTRATIONS`."""
        second = self.pheomelanin_abl_fraction
        shares = self.abl_fraction, self.abl_fraction if second is None else second
        depth = self.abl_thickness + self.stroma_thickness
        concentrations = {}
        for kind, share in zip(("eumelanin", "pheomelanin"), shares, strict=True):
            mass = getattr(self, kind) * depth
            concentrations[f"abl_{kind}"] = float(mass * share / self.abl_thickness)
            concentrations[f"stroma_{kind}"] = float(mass * (1 - share) / self.stroma_thickness)
        return {name: concentrations[name] for name in CONCENTRATIONS}

    def volume_fractions(self) -> dict[str, float]:
        """Return the melanins of both layers in per cent of volume, by the names `FRACTIONS`; of an
        iris with LB06's absorption, those that absorb about as much  [F09 Eq. 10].
        """
        scale = float(self.intensification) / PER_CENT
        return {f"{n}_percent": scale * c for n, c in self.layer_concentrations().items()}

    @property
    def melanin_load(self) -> Scalar:
        """Melanin mass per iris area, (c_eu + c_pheo)(h_A + h_S), in µg/mm²."""
        return (self.eumelanin + self.pheomelanin) * (self.abl_thickness + self.stroma_thickness)

    @property
    def hemoglobin(self) -> Scalar:
        """Haemoglobin of both kinds in the stroma, mmol/l."""
        return self.oxyhemoglobin + self.deoxyhemoglobin

    @property
    def saturation(self) -> Scalar:
        """Oxygen saturation; LB06's 0.5 where there is no blood."""
        return share_of(self.oxyhemoglobin, self.hemoglobin, 0.5)

    @property
    def abl_melanin(self) -> Scalar:
        """Melanin mass of the ABL per iris area, µg/mm²."""
        if (fraction := self.pheomelanin_abl_fraction) is None:
            return self.melanin_load * self.abl_fraction
        mass = self.eumelanin * self.abl_fraction + self.pheomelanin * fraction
        return mass * (self.abl_thickness + self.stroma_thickness)

    def indices(self, aqueous_index: Scalar | float = AQUEOUS) -> RefractiveIndices:
        """Compute the refractive indices around the layers  [LB06 Eqs. 8, 9].

        Args:
            aqueous_index: Index of the chamber in front of them, from an eye or an instrument.
        """
        abl = gladstone_dale(self.fibroblast_index, self.fibroblast_fraction, self.base_index)
        stroma = gladstone_dale(self.collagen_index, self.collagen_fraction, self.base_index)
        return RefractiveIndices(
            aqueous=jnp.asarray(aqueous_index, self.base_index.dtype),
            abl=abl if self.abl_index is None else self.abl_index,
            stroma=stroma if self.stroma_index is None else self.stroma_index,
            ipe=self.ipe_index,
        )

    def layers(self, extinction: Extinction, aqueous_index: Scalar | float = AQUEOUS) -> Layers:
        """Compute the layers' optical depths  [LB06 Section 3.3, Eqs. 4, 5] [F09 Eq. 10].

        Args:
            extinction: Extinction of the pigments at the wavelengths.
            aqueous_index: Refractive index of the chamber in front of the layers.

        Raises:
            ValueError: If a field is an array: use `jax.vmap` for batches.
        """
        check_scalars(self, LIMITS)
        e = extinction if self.absorption == "lb06" else extinction.by_f09()
        absorption = jnp.matmul(self._masses(), e.matrix, precision="highest")
        law = self.power_law
        if law is None:
            fibrils = self.fibril_radius, self.collagen_fraction, self.collagen_index
            mu_s = SCATTERING[self.scattering](e.wavelengths, *fibrils, self.base_index)
        else:
            mu_s = law.coefficient(e.wavelengths)
        return Layers(
            abl_absorption=absorption[0],
            stroma_absorption=absorption[1],
            stroma_scattering=self.scattering_scale * mu_s * self.stroma_thickness,
            indices=self.indices(aqueous_index),
            order=self.order,
            phase=None if law is None else law.phase(e.wavelengths),
            ipe_absorption=None
            if self.ipe_melanin is None
            else self.intensification * self.ipe_melanin * e.eumelanin,
        )

    def _masses(self):
        """Masses per area in ABL and stroma, (2, pigments), in units of `Extinction` times mm."""
        height = self.intensification * (self.abl_thickness + self.stroma_thickness)
        melanin = jnp.stack([self.eumelanin, self.pheomelanin]) * height
        fraction, pheomelanin_fraction = self.abl_fraction, self.pheomelanin_abl_fraction
        if pheomelanin_fraction is not None:
            fraction = jnp.stack([fraction, pheomelanin_fraction])
        other_pigments = [self.oxyhemoglobin, self.deoxyhemoglobin, self.lutein, self.zeaxanthin]
        other_pigments = jnp.stack(other_pigments) * self.stroma_thickness
        abl = jnp.concatenate([melanin * fraction, jnp.zeros_like(other_pigments)])
        return jnp.stack([abl, jnp.concatenate([melanin * (1 - fraction), other_pigments])])

    def parameters(self) -> dict[str, Any]:
        """Return every number that is set by its name, concrete scalars as Python floats."""
        numbers, law = {}, {} if self.power_law is None else self.power_law.parameters()
        for name, value in {**{n: getattr(self, n) for n in LIMITS}, **law}.items():
            if value is not None:
                numbers[name] = value if isinstance(value, Tracer) or value.ndim else _short(value)
        return numbers

    def __repr__(self) -> str:
        ranges = LIMITS | POWER_LAW_LIMITS
        units = {n: f" {limits.unit}" if limits.unit else "" for n, limits in ranges.items()}
        lines = [f"  {n} = {v}{units[n]}" for n, v in self.parameters().items()]
        if self.power_law is None:
            lines.append(f"  scattering = {self.scattering}")
        if self.absorption != "lb06":
            lines.append(f"  absorption = {self.absorption}")
        return "Iris(\n" + "\n".join(lines) + "\n)"


def _short(value) -> float:
    # float32 0.1201 is printed as it was written, not as its nearest float64.
    # (Not `str`: NumPy's print options are global, and colour-science sets them.)
    plain = value.item() if value.dtype == np.float64 else np.float32(value)
    return float(np.format_float_positional(plain, unique=True, trim="0"))


def _as_float(name: str, value) -> jax.Array:
    if isinstance(value, (bool, str)) or value is None:
        raise ValueError(f"{name} must be a number, got {value!r}")
    dtype = jnp.result_type(value)
    if not jnp.issubdtype(dtype, jnp.floating) and not jnp.issubdtype(dtype, jnp.integer):
        raise ValueError(f"{name} must be a real number, got {value!r}")
    # Never weakly typed: an iris with fields replaced must not be compiled for again.
    is_float_array = isinstance(value, jax.Array) and dtype.kind == "f"
    return jnp.asarray(value, dtype if is_float_array else jnp.result_type(float))


assert {f.name for f in dataclasses.fields(Iris)} == {*LIMITS, *_CHOICES, "order"}
