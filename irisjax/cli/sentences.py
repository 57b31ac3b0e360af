"""Sentences of `irisjax fit` about its numbers."""

import math
from collections.abc import Sequence

import numpy as np

from irisjax.infer.analysis import Analysis
from irisjax.infer.identifiability import Direction, Information
from irisjax.infer.model_comparison import PREFERRED, Assessment, Interval, Moved, ProcessComparison
from irisjax.infer.parameters import kind, unit_of
from irisjax.infer.problem import Problem

_WORDS = {
    "melanin_load": "load", "abl_fraction": "fraction", "hemoglobin": "haemoglobin",
    "abl_thickness": "ABL thickness", "scattering_scale": "scattering",
    "rayleigh_share": "Rayleigh share",
}  # fmt: skip
# Parameters whose change with the process is printed, in words.
_QUOTED = {"melanin_load": "melanin load", "abl_fraction": "ABL fraction"}
_FEW, _WIDE = 12, 15.0  # at most so many values, so many nm apart, are those of filters
_DENSE = 3.0  # spacing in nm up to which neighbouring values may share pixels of a spectrometer
_UNKNOWN = 3.0  # relative sd above which a parameter counts as unknown: a factor of twenty


def process_lines(comparison: ProcessComparison) -> list[str]:
    """Describe the change of the pigments with the process; warn if the data prefer the other."""
    names = [n for n in comparison.moved if kind(n) in _QUOTED] or list(comparison.moved)[:1]
    lines = []
    if names:
        parts = ", ".join(_shift(n, comparison.moved[n]) for n in names)
        warning = "WARNING: the pigments depend on the model by more than their intervals: "
        differ = any(moved.differs for moved in comparison.moved.values())
        lines.append(f"{warning if differ else ''}by {comparison.process.name} {parts}")
    if comparison.preferred:
        lines.append(f"WARNING: {preference(comparison)}")
    return lines


def preference(comparison: ProcessComparison) -> str:
    """State the odds by which the data prefer the other process."""
    return (
        f"the data prefer {comparison.process.name}, by odds of {odds(comparison.log_odds)} to 1 "
        f"(least squares, Laplace's approximation)"
    )


def information_lines(information: Information) -> list[str]:
    """Describe the best and the least known combination, and each parameter by itself."""
    best, least = information.directions[0], information.directions[-1]
    lines = [
        f"best known: {product(best)}, to {_percent(best.relative)}",
        f"least known: {product(least)}, to {_percent(least.relative)}",
    ]
    load, fraction = information.alone.get("melanin_load"), information.alone.get("abl_fraction")
    if load is not None and fraction is not None:
        of_product = _percent(information.of_product("melanin_load", "abl_fraction"))
        lines.append(
            f"load × fraction (the melanin of the ABL) is known to {of_product}, the load alone to "
            f"{_percent(load)}, the fraction alone to {_percent(fraction)} (data only, without "
            f"priors)"
        )
    for name, (left, partner, correlation) in information.trades.items():
        share = f"{100 * left:.0f} % of its prior's width"
        known = "not determined by the data" if left > 0.9 else share
        ridge = f"; trades with {_word(partner)} (correlation {correlation:+.2f})"
        lines.append(f"{_word(name)}: {known}{ridge if abs(correlation) > 0.3 else ''}")
    return lines


def product(direction: Direction) -> str:
    """Write a combination of parameters as a product of powers."""
    above = [_power(n, e) for n, e in direction.exponents.items() if e > 0]
    below = [_power(n, -e) for n, e in direction.exponents.items() if e < 0]
    divisor = f"({' × '.join(below)})" if len(below) > 1 else "".join(below)
    return (" × ".join(above) or "1") + (f" / {divisor}" if below else "")


def data_warnings(problem: Problem) -> list[str]:
    """Describe what the data of a problem cannot determine, whatever their values."""
    lines = []
    if problem.undetermined:
        data = sum(o.values.shape[-1] for o in problem.observations)
        lines.append(
            f"{data} value{'s' * (data > 1)} for {data + problem.undetermined} parameters: at "
            f"least {problem.undetermined} of them keep their priors whatever was measured"
        )
    for o in problem.observations:
        steps = np.diff(np.asarray(o.wavelengths))
        is_filtered = (
            not o.is_colour and 1 < o.values.shape[-1] <= _FEW and np.median(steps) >= _WIDE
        )
        if is_filtered and o.instrument.bands is None:
            lines.append(
                f"WARNING: {o.values.shape[-1]} values {np.median(steps):.0f} nm apart are read as "
                "light of single wavelengths; a camera's or filters' bands give other pigments: "
                "state them by --bands FILE or --bandwidth NM"
            )
    return lines


def result_warnings(analysis: Analysis) -> list[str]:
    """Return warnings about the result."""
    lines = []
    if analysis.unmoved:
        lines.append(
            f"the data hardly move {', '.join(analysis.unmoved)}: what is shown is mostly the prior"
        )
    check, faults = analysis.check, []
    if check.large:
        faults.append(f"residuals are larger than the noise (p = {check.p_chi_square:.3g})")
    if check.smooth:
        faults.append(f"residuals are correlated over wavelength (p = {check.p_pattern:.3g})")
        width = _correlated_over(analysis)
        if width is not None and not check.large:
            faults.append(
                f"if the instrument averages its pixels, neighbouring values share their noise "
                f"over about {width:.0f} nm: state it by --boxcar NM"
            )
    if check.noisy:
        faults.append(f"it takes {check.noise:.1f} times the stated noise")
    if faults:
        lines.append(f"WARNING: the model does not produce these data: {'; '.join(faults)}")
    if not analysis.chains.converged:
        lines.append(f"NOT CONVERGED: {analysis.chains.reason}")
    return lines


def _correlated_over(analysis: Analysis) -> float | None:
    """Estimate the width of the moving average, nm, that would correlate the residuals as observed;
    `None` if wavelengths are too far apart to share pixels, or errors are stated as correlated.
    """
    observation, predicted = analysis.problem.observations[0], np.asarray(analysis.fit.predicted[0])
    if predicted.size <= _FEW:
        return None
    step = float(np.median(np.diff(np.asarray(observation.wavelengths))))
    if not 0 < step <= _DENSE or observation.correlation_root is not None or observation.is_colour:
        return None
    residual = (np.asarray(observation.values) - predicted) / np.abs(predicted)
    correlation = np.correlate(residual, residual, "full")[residual.size - 1 :]
    # Values half a width apart have a correlation of one half after a moving average.
    return 2 * step * int(np.argmax(correlation < 0.5 * correlation[0]))


def models_sentence(assessments: Sequence[Assessment]) -> str:
    """Write one sentence to quote: the model that the data prefer, by what odds, and the change of
    the melanin load between models.
    """
    first, second = sorted(assessments, key=lambda a: -a.evidence.log_integral)[:2]
    log_odds = first.evidence.log_integral - second.evidence.log_integral
    error = math.hypot(first.evidence.error, second.evidence.error)
    if log_odds - 2 * error > PREFERRED:
        verdict = f"prefer {first.name} to {second.name} by odds of {odds(log_odds)} to 1"
    else:
        verdict = f"do not decide between {first.name} and {second.name}"
    evidences = ", ".join(f"{with_error(a)} by {a.name}" for a in assessments)
    data = ", ".join(o.name for o in assessments[0].problem.observations)
    sentence = (
        f"The data ({data}) {verdict} (ln evidence {evidences}; importance sampling, equal priors)"
    )
    pigments = (_by_models(n, assessments) for n in assessments[0].values if kind(n) in _QUOTED)
    return f"{'; '.join([sentence, *pigments])}."


def with_error(assessment: Assessment) -> str:
    """Write an evidence and its error, with as many digits as the error allows."""
    evidence = assessment.evidence
    digits = 1 if evidence.error >= 0.05 else 2
    return f"{evidence.log_integral:.{digits}f} ± {evidence.error:.{digits}f}"


def interval(estimate: Interval) -> str:
    """Write a value and its 95 % interval."""
    return f"{estimate.value:.3g} ({estimate.low:.3g} to {estimate.high:.3g})"


def odds(log_odds: float) -> str:
    """Write odds to one, from their logarithm."""
    return _number(math.exp(log_odds)) if log_odds < 12 else f"1e{log_odds / math.log(10):.0f}"


def _by_models(name: str, assessments: Sequence[Assessment]) -> str:
    """Write a pigment by every model, and its ratio to that by the first."""
    texts = []
    for a in assessments:
        text = f"{interval(a.values[name])} by {a.name}"
        if a is not assessments[0]:
            ratio, least, most = a.ratios[name]
            text += f", {ratio:.2g} ({least:.2g} to {most:.2g}) times that"
        texts.append(text)
    plain, tag = _QUOTED[kind(name)], name.partition("@")[2]
    unit = unit_of(name) and f", {unit_of(name)}"
    return f"{plain}{tag and f' {tag}'}{unit} (95 %): {', '.join(texts)}"


def _shift(name: str, moved: Moved) -> str:
    own, other = moved
    text = f"{name} is {interval(other)}"
    if kind(name) != "melanin_load" or not (own.value > 0 and other.value > 0):
        return f"{text} for {own.value:.3g}"
    ratio = other.value / own.value
    if 0.95 < ratio < 1.05:
        return f"{text}, about the same"
    more = ratio > 1
    return f"{text}, {_number(ratio if more else 1 / ratio)} times {'more' if more else 'less'}"


def _number(x: float) -> str:
    """Write a number with two digits, without an exponent."""
    return f"{x:.2g}" if x < 100 else f"{float(f'{x:.2g}'):,.0f}"


def _percent(x: float) -> str:
    if not np.isfinite(x) or x > _UNKNOWN:
        return "no limit"
    return f"a factor of {np.exp(x):.2g}" if x > 1 else f"{100 * x:.2g} %"


def _word(name: str) -> str:
    plain, at, tag = name.partition("@")
    return _WORDS.get(plain, plain.replace("_", " ")) + at + tag


def _power(name: str, exponent: float) -> str:
    word = _word(name)
    return word if abs(exponent - 1) < 0.05 else f"{word}^{exponent:.1f}"
