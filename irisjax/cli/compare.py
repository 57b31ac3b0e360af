"""`irisjax fit --compare`: one measurement by several models of light, side by side."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import irisjax as ij
from irisjax import io
from irisjax.cli import sentences
from irisjax.cli.fit_options import Sampler
from irisjax.cli.report import figure_data, label_with_unit, print_table, step_counter
from irisjax.infer.model_comparison import COMPARED, Assessment, compare_models
from irisjax.infer.parameters import kind
from irisjax.infer.problem import Problem
from irisjax.io.tables import csv_of
from irisjax.plot.beside import Later
from irisjax.transport.process import option_of

FILES = ("compare.csv", "compare.png")
_FIRST_COLUMNS = (
    "model",
    "process",
    "sampler",
    "ln_evidence",
    "ln_evidence_error",
    "score",
    "score_error",
)


def report_comparison(
    problem: Problem,
    folder: Path | None,
    sampler: Sampler,
    bar: Any,
    draw: Callable[..., Later],
) -> None:
    """Compare models of light for one measurement, print the result, and write it into `folder` if
    there is one; `bar` shows the progress.
    """
    count = step_counter(bar, leave=False)

    def progress(name: str, rounds: int) -> None:
        if rounds:
            count(rounds, f"{name}: evidence")

    assessments = compare_models(problem, progress=progress, key=sampler.key)
    sentence = sentences.models_sentence(assessments)
    if folder is not None:
        bar.set_description_str("files")
        table = _table(assessments, sentence, sampler.seed)
        figure = _draw(assessments, sentence, draw)
        folder.mkdir(parents=True, exist_ok=True)
        io.write_together({folder / FILES[0]: table.encode(), folder / FILES[1]: figure()})
    bar.close()
    _print(assessments, sentence)


def _table(assessments: Sequence[Assessment], sentence: str, seed: int) -> str:
    """Return CSV with a row for each model, after comments with the sentence and the settings."""
    problems = [a.problem for a in assessments]
    priors = dict(pair for p in problems for pair in zip(p.free, p.priors, strict=True))
    names, shared = _names(assessments), list(assessments[0].ratios)
    columns = [f"{n}{end}" for n in names for end in ("", "_q2.5", "_q97.5")]
    columns += [f"{n}_ratio{end}" for n in shared for end in ("", "_q2.5", "_q97.5")]
    rows = []
    for a in assessments:
        numbers = [a.evidence.log_integral, a.evidence.error, a.score, a.score_error]
        texts = [f"{x:.6g}" for x in numbers]
        for n, values in (*((n, a.values) for n in names), *((n, a.ratios) for n in shared)):
            texts += [f"{x:.6g}" for x in values[n]] if n in values else [""] * 3
        process = option_of(a.problem.process)
        rows.append([a.name, process, "importance sampling", *texts])
    prior_texts = "; ".join(f"{n} ~ {p}" for n, p in priors.items())
    header = f"# {sentence}\n# irisjax {ij.__version__}, seed {seed}; priors: {prior_texts}\n"
    return header + csv_of([[*_FIRST_COLUMNS, *columns], *rows])


def _draw(assessments: Sequence[Assessment], sentence: str, draw: Callable[..., Later]) -> Later:
    shapes = [figure_data(o) for o in assessments[0].problem.observations]
    fits = {a.name: (list(a.models), list(a.residuals)) for a in assessments}
    names = [n for n in assessments[0].values if kind(n) in COMPARED]
    pigments = {
        label_with_unit(n): {a.name: tuple(a.values[n]) for a in assessments} for n in names
    }
    return draw("models_figure", shapes, fits, pigments, sentence)


def _print(assessments: Sequence[Assessment], sentence: str) -> None:
    names = _names(assessments)
    columns = {"median (95 %)": ["ln evidence", "predictive score", *map(label_with_unit, names)]}
    for a in assessments:
        cells = [sentences.interval(a.values[n]) if n in a.values else "" for n in names]
        score = f"{a.score:.1f} ± {a.score_error:.1f}"
        columns[a.name] = [sentences.with_error(a), score, *cells]
    remark = (
        "evidences hold for these priors; neighbouring wavelengths are not independent, so that "
        "the score is no evidence of its own"
    )
    print_table([sentence], columns, [remark])


def _names(assessments: Sequence[Assessment]) -> list[str]:
    """List the parameters that any of the models has."""
    return list(dict.fromkeys(n for a in assessments for n in a.values))
