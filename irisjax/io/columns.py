"""Roles of a table's columns by their headers, and the choice of those that are a spectrum."""

import functools
import re
from typing import NamedTuple

import numpy as np

from irisjax.infer.observation import RADIANCE, REFLECTANCE
from irisjax.io.text import Columns

ABSORBANCE, KUBELKA_MUNK = "absorbance", "kubelka-munk"
QUANTITIES = (REFLECTANCE, RADIANCE, ABSORBANCE, KUBELKA_MUNK)
"""Roles whose columns can become a spectrum."""

SD = "standard deviation"
"""Role of a standard deviation."""
_MEAN, _STATISTIC = "mean", "statistic"
_TRANSMITTANCE = "transmittance"
_OTHER, _LN = "another quantity", "natural logarithm"
_OD = "optical density or right eye"  # oculus dexter, the right one where OS is there too
_WITHOUT_ASKING = (REFLECTANCE, ABSORBANCE, KUBELKA_MUNK, "", _MEAN)  # the first that there is
# These words count between characters that are no letters, as in "left_sd" and "SD (R)".
_SD_WORDS = (
    r"sd|std|stds?dev|stdev|std\W?dev(iation)?|se|sem|stderr|err|errors?|sigma|σ|"
    r"(?<!a\.)u|unc|uncert|incert\w*|uncertainty|noise|δr|dr|(?<=[+±])/-|±|"
    r"standard[\W_]?(deviation|error|uncertainty)|standardabweichung|stabw|standardfehler|"
    r"[ée]cart[\W_]?type|(mess)?unsicherheit|desviaci[oó]n|desvio|deviazione|scarto|"
    r"standaardafwijking|standardavvikelse|odchylenie|отклонение|標準偏差|标准差"
)
_BEFORE, _AFTER = r"(?<![^\W\d_])", r"(?![^\W\d_])"
# The first form that a header matches gives its role.
_FORMS = {
    "dark signal": rf"{_BEFORE}(dark|dunkel|oscuro|baseline){_AFTER}",
    "arbitrary units": r"arbitrary|^(?!.*absor).*\ba\.\s?u\.",
    _STATISTIC: rf"{_BEFORE}(min|max|minimum|maximum|variance|covariance|range|n|snr|skew|flags?|"
    rf"quality|ci|q[13]|quartile|percentile){_AFTER}",
    SD: rf"{_BEFORE}({_SD_WORDS}){_AFTER}",
    _OTHER: r"(absorption|scattering|extinction|attenuation)\W+coeff|\b[mµμ]u?_?[as]\b|epsilon|"
    r"\bbrdf\b|absorptance|(?-i:^A\W*%)|\bdB\b|1\s*-\s*R\b|volt|photocurrent|fluoresc|luminescen|"
    r"\bemission|\bpower\b|[\[(]([mkµμn]?(?-i:[VJ])|[mµμn]A|1/[mc]?m|[mc]?m\W?-1)\b",
    _LN: r"\bln\W*(1\s*/\s*)?[RT]\b",
    ABSORBANCE: r"absorb|absorpti|extin[ck]tion|optical density|吸光度|"
    r"\bA\.?U\b|\bAbs\b|(?-i:^A$)|log\W*1\s*/\s*[RT]\b|[-−–]\s*log(10)?\W*[RT]\b",
    _OD: r"(?-i:^OD$)",
    KUBELKA_MUNK: r"kubelka|munk|\bk-m\b|\bk\s*/\s*s\b|\bf\(r",
    _TRANSMITTANCE: rf"transmi|trasmit|透過率|%\s*T\b|\bT\s*\(?%|{_BEFORE}M_T\b|(?-i:^T$)",
    "irradiance": r"irradian|[µμu]W",
    REFLECTANCE: r"refle[ckxt]|r[ée]flect|riflett|remission|albedo|odbici|отраж|反射率|"
    r"radian\w*\W(factor|coeff)|\w\s*/\s*(white|ref(erence)?)\b|"
    rf"^R\b|^R_|%\s*R\b|{_BEFORE}R\s*\(?%|{_BEFORE}M_R\b|\bSC[IE]\b",
    RADIANCE: rf"radian[cz]|luminancia|{_BEFORE}rad{_AFTER}",
    "counts": r"count|scope|intensity|\braw\b|\badu\b|\bdn\b|\bwhite\b|^ref(erence)?\b|"
    r"z[äa]hler|cuentas",
    _MEAN: rf"{_BEFORE}(mean|median|average|avg|mittel(wert)?|moyenne|media|promedio|平均){_AFTER}",
}
SPECTRAL_ROLES = (*QUANTITIES, "irradiance", "counts", "dark signal", SD)
"""Roles of columns of a spectrum, which no sensitivity has."""
_REFUSALS = {
    RADIANCE: "a radiance; give --quantity radiance",
    _TRANSMITTANCE: "a transmittance; where it is the light sent back, give --quantity reflectance",
    _OTHER: "no reflectance; where it is one, give --quantity reflectance",
    _LN: "a natural logarithm; divide it by 2.302585 and give --quantity absorbance",
    _OD: "an optical density or the right eye; give --quantity absorbance or reflectance",
}
_RAW = ("counts", "dark signal")
_TO_DO = "divide the light of the eye by that of a white reference, both less the dark signal"
# Names that differ in a number only are scans of one thing, unless the number is that of an eye.
_NOT_SCANS = re.compile(
    r"(^|sample|eye|subject|patient|person|probe|muestra|auge|œil|\bid|\bp)[\W_]*$", re.I
)
_MEASURE = re.compile(r"\s*(°|deg|[smhd]\b|sec|min|day|week|month|year|[mµn]m|%)", re.I)
# Words that tell columns from repeated scans: whether the specular component is included, and how
# the numbers were processed.
_KINDS = re.compile(r"\bsc[ie]\b|smooth|filter|\braw|correct|interpol|\bfit|model|total|diffuse")
_APART = 0.5  # relative difference between the medians of columns that are scans by their names
_LEAST_ROWS = 8  # by which the noise of columns can be told from what differs


class Selection(NamedTuple):
    """Columns of one spectrum, by their index.

    Attributes:
        spectra: Scans of it, all of one role.
        sd: Its standard deviation, or `None`.
        role: Of the scans; empty where no header gives it.
        label: Header of the first scan.
        notes: Which columns are used and which are left out.
    """

    spectra: list[int]
    sd: int | None
    role: str
    label: str
    notes: tuple[str, ...] = ()


def select(
    table: Columns,
    requested: str | None,
    column: str | None = None,
    sd: str | None = None,
    among: list[int] | None = None,
) -> Selection:
    """Choose the columns of one spectrum.

    Columns of reflectance come first, then those of absorbance and of K/S, then those without a
    role; others, such as counts and references beside a reflectance, are left out. Several columns
    are scans of one spectrum if their names differ in a number only, or if their values differ by
    no more than noise.

    Args:
        table: The table; its first column is the wavelength.
        requested: The role to take; by default the first one there is.
        column: Name of the column to take, or a part of it that no other has.
        sd: The same of its standard deviation.
        among: The columns of one eye of many, see `eyes_of`, which are taken as they are.

    Raises:
        ValueError: Listing the columns with their roles where they leave a choice.
    """
    roles = _roles_of(table)
    if among is not None:
        spectra = among
    elif column is not None:
        spectra = _lookup(table, column, roles)
    else:
        spectra = _spectra(table, roles, requested)
    role, explicit = roles[spectra[0]], among is not None or column is not None
    if explicit and not requested and role not in _WITHOUT_ASKING:
        raise ValueError(_refusal(table, spectra[0], role))
    if sd is not None:
        sds = _lookup(table, sd, roles)[:1]
    else:  # of several scans there is none
        stated = [j for j, name in roles.items() if name == SD and len(spectra) == 1]
        sds = [j for j in stated if _owner(j, _values_among(roles), table) in spectra]
    if len(sds) > 1 and among is None:
        raise ValueError(f"{_legend(table, roles)}: two standard deviations; choose with --sd NAME")
    deviation = sds[0] if len(sds) == 1 else None
    indices = [*spectra, *sds]
    left = [j for j in roles if j not in indices]
    notes: tuple[str, ...] = ()
    if left and among is None:
        notes = (f"of the columns {_titles(table, indices)} used, {_titles(table, left)} left out",)
    role = role if role in QUANTITIES else ""
    return Selection(spectra, deviation, role, table.names[spectra[0]], notes)


def eyes_of(table: Columns) -> dict[str, list[int]]:
    """Columns of each eye by its name: those of one name, without standard deviations that belong
    to another column, and without statistics.
    """
    eyes: dict[str, list[int]] = {}
    roles = _roles_of(table)
    spectra = _values_among(roles)
    for j, role in roles.items():
        if j in spectra or (role == SD and _owner(j, spectra, table) is None):
            eyes.setdefault(_title(table, j), []).append(j)
    end = f" {table.samples}"
    if table.samples is not None and all(name.endswith(end) for name in eyes):
        eyes = {name.removesuffix(end): columns for name, columns in eyes.items()}
    return eyes


def _spectra(table: Columns, roles: dict[int, str], requested: str | None) -> list[int]:
    """Scans of the one spectrum in a table."""
    others = {j: roles[j] for j in _values_among(roles)}
    first = (requested, "", _MEAN) if requested else _WITHOUT_ASKING
    role = next((role for role in first if role in others.values()), None)
    if role is None and not requested and others:
        # The columns that can be used after all are named rather than those that cannot.
        j = min(others, key=lambda j: [*_REFUSALS, others[j]].index(others[j]))
        raise ValueError(_refusal(table, j, others[j]))
    raw = [j for j in others if others[j] in _RAW]
    if role in ("", _MEAN) and raw and not requested:
        text = f"{_legend(table, roles)}: beside {table.names[raw[0]]!r} the others may be counts"
        raise ValueError(f"{text}; choose the reflectance with --column NAME")
    spectra = [j for j in others if role is None or others[j] == role]
    if not spectra:
        raise ValueError(f"{_legend(table, roles)}; need one spectrum, such as a reflectance")
    stated = [_owner(j, spectra, table) for j in roles if roles[j] == SD and len(spectra) > 1]
    paired = len(set(stated) & set(spectra)) > 1  # each has its standard deviation
    paired |= table.samples is not None and len({table.names[j] for j in spectra}) > 1
    if len(spectra) > 1 and (paired or not _one_thing(table, spectra)):
        raise ValueError(
            f"{_legend(table, roles)}: these are no scans of one spectrum, whose names would "
            "differ in a number only, or whose values by noise; choose with --column NAME"
        )
    return spectra


def _values_among(roles: dict[int, str]) -> list[int]:
    """Columns that hold measured values."""
    return [j for j, role in roles.items() if role not in (SD, _STATISTIC)]


def _owner(j: int, spectra: list[int], table: Columns) -> int | None:
    """The spectrum to which a standard deviation belongs: that of the rest of its name, or else the
    only one, or else the one just before it.
    """
    stem = _plain(re.sub(_FORMS[SD], " ", table.names[j], flags=re.I))
    plain = {k: _plain(re.sub(_FORMS[_MEAN], " ", table.names[k], flags=re.I)) for k in spectra}
    owners = [k for k in spectra if stem and stem in (plain[k], _plain(table.names[k]))]
    if len(owners) == 1:
        return owners[0]
    usable = [k for k in spectra if role_of(table.names[k]) in _WITHOUT_ASKING]
    if len(usable) == 1:
        return usable[0]
    return j - 1 if j - 1 in spectra and not stem else None


def _one_thing(table: Columns, columns: list[int]) -> bool:
    """Whether columns are scans of one spectrum, by their names or by their values."""
    names = {table.names[j] for j in columns}
    if len({tuple(_KINDS.findall(name.lower())) for name in names}) > 1:
        return False
    values = table.values[:, columns]
    values = values[np.isfinite(values).all(1)]
    if names != {""} and (len(names) == 1 or _differ_in_number(names)):
        middle = np.median(values, axis=0) if len(values) else np.ones(1)
        return bool(np.ptp(middle) <= _APART * np.abs(np.median(middle)))
    if not len(values):
        return False
    deviation = values - np.median(values, axis=1, keepdims=True)
    size = np.abs(np.median(values)) or 1.0
    if names == {""}:
        return bool((np.median(np.abs(deviation), axis=0) <= 0.1 * size).all())
    if len(values) < _LEAST_ROWS:
        return False
    # Noise differs from one wavelength to the next: its second difference has √6 times its size.
    noise = np.diff(values - values.mean(1, keepdims=True), n=2, axis=0).std(axis=0) / np.sqrt(6)
    spread = np.sqrt((deviation**2).mean(axis=0))
    return bool((spread <= np.maximum(2 * noise.max(), 1e-9 * size)).all())


def _differ_in_number(names: set[str]) -> bool:
    """Whether names differ in numbers only, none of them that of an eye or with a unit."""
    parts = [re.split(r"(\d+)", name) for name in names]
    if len({tuple(re.sub(r"[\W_]+", " ", p).lower() for p in x[::2]) for x in parts}) > 1:
        return False
    for i in range(1, len(parts[0]), 2):
        before, after = ("0" if i > 1 else "") + parts[0][i - 1], parts[0][i + 1]
        if len({x[i] for x in parts}) > 1 and (_NOT_SCANS.search(before) or _MEASURE.match(after)):
            return False
    return True


def _lookup(table: Columns, title: str, roles: dict[int, str]) -> list[int]:
    """The columns of this name, or of the only one that contains it."""
    names = {j: _title(table, j) for j in roles}
    begins, part = f"{title} ".lower(), title.lower()
    for matches in (
        lambda j: names[j] == title,
        lambda j: names[j].lower().startswith(begins) and roles[j] != SD,
        lambda j: part in names[j].lower(),
    ):
        columns = [j for j in names if matches(j)]
        if len({names[j] for j in columns}) == 1:
            return columns
    number = "no column" if not columns else "more than one column"
    raise ValueError(f"{number} is called {title!r}: {_legend(table, roles)}")


def _refusal(table: Columns, j: int, role: str) -> str:
    message = _REFUSALS.get(role, f"{role}, not a reflectance: {_TO_DO}")
    return f"column {table.names[j]!r} holds {message}"


def _legend(table: Columns, roles: dict[int, str]) -> str:
    titles = (f"{_title(table, j)!r} ({roles[j] or 'no role'})" for j in roles)
    return f"columns {', '.join(titles)}"


def _titles(table: Columns, columns: list[int]) -> str:
    titles = [repr(_title(table, j)) for j in columns]
    return ", ".join(titles[:8] + ["..."] * (len(titles) > 8))


def _title(table: Columns, j: int) -> str:
    return table.names[j] or f"column {j + 1}"


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", " ", re.sub(r"[\[(].*?[\])]", "", name)).strip().lower()


def _roles_of(table: Columns) -> dict[int, str]:
    """Roles of all columns but the wavelength's."""
    roles = {j: role_of(name) for j, name in enumerate(table.names) if j}
    return {j: "" if r == _OD and "OS" in table.names else r for j, r in roles.items()}


@functools.lru_cache(maxsize=1 << 16)  # in a table of many eyes each asks for the roles of all
def role_of(header: str) -> str:
    """The role that a column's header gives it, or an empty text."""
    return next((role for role, form in _FORMS.items() if re.search(form, header, re.I)), "")
