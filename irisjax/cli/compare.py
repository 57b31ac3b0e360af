"""`irisjax fit --compare`: one measurement by several models of light, side by side."""

import csv
import io as text_io
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import irisjax as ij
from irisjax import io
from irisjax.cli.report import key_of
from irisjax.infer.model_comparison import Assessment, compare_models, comparison_sentence
from irisjax.infer.parameters import kind, unit_of
from irisjax.infer.problem import Problem
from irisjax.plot.beside import Later, here
from irisjax.transport.process import option_of

FILES = ("compare.csv", "compare.png")
_FIRST = ("model", "process", "sampler", "ln_evidence", "ln_evidence_error", "score", "score_error")
_DRAWN = ("melanin_load", "abl_fraction", "pheomelanin_share", "hemoglobin", "saturation")


def models(problem: Problem, folder: Path | None, sampler: Mapping[str, Any], bar, draw=here):
    """Compare, print, and write into `folder` where there is one; progress on `bar`."""

    def progress(name: str, steps: int) -> None:
        if steps and not bar.disable and bar.bar_format is not None:
            bar.reset()  # compiling does not count as time for steps
            bar.bar_format, bar.leave = None, False
        bar.set_description_str(f"{name}: evidence", refresh=False)
        bar.update(steps - bar.n)

    found = compare_models(problem, progress=progress, key=key_of(sampler))
    sentence = comparison_sentence(found)
    if folder is not None:
        bar.set_description_str("files")
        table = _table(found, sentence, sampler["seed"])
        figure = _drawing(found, sentence, draw)
        folder.mkdir(parents=True, exist_ok=True)
        io.write_together({folder / FILES[0]: table.encode(), folder / FILES[1]: figure()})
    bar.close()
    _print(found, sentence)


def _table(found: Sequence[Assessment], sentence: str, seed: int) -> str:
    """CSV, a model a row; what it says and is made with stand above, after `#`."""
    out = text_io.StringIO()
    problems = [a.candidate.problem for a in found]
    priors = dict(pair for p in problems for pair in zip(p.free, p.priors, strict=True))
    out.write(f"# {sentence}\n")
    out.write(f"# irisjax {ij.__version__}, seed {seed}; ")
    out.write(f"priors: {'; '.join(f'{n} ~ {p}' for n, p in priors.items())}\n")
    names, shared = _names(found), list(found[0].ratios)
    columns = [f"{n}{end}" for n in names for end in ("", "_q2.5", "_q97.5")]
    columns += [f"{n}_ratio{end}" for n in shared for end in ("", "_q2.5", "_q97.5")]
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*_FIRST, *columns])
    for a in found:
        numbers = [a.evidence.log_evidence, a.evidence.error, a.score, a.score_error]
        texts = [f"{x:.6g}" for x in numbers]
        for n, of in (*((n, a.values) for n in names), *((n, a.ratios) for n in shared)):
            texts += [f"{x:.6g}" for x in of[n]] if n in of else [""] * 3
        writer.writerow([a.name, option_of(a.candidate.problem.process), a.evidence.by, *texts])
    return out.getvalue()


def _drawing(found: Sequence[Assessment], sentence: str, draw) -> Later:
    shapes = [
        (o.name, o.quantity, o.is_colour, np.asarray(o.wavelengths), np.asarray(o.values))
        for o in found[0].candidate.problem.observations
    ]
    fits = {a.name: (list(a.models), list(a.residuals)) for a in found}
    names = [n for n in found[0].values if kind(n) in _DRAWN]
    labels = {n: f"{n} ({unit})" if (unit := unit_of(n)) else n for n in names}
    pigments = {labels[n]: {a.name: tuple(a.values[n]) for a in found} for n in names}
    return draw("models_figure", shapes, fits, pigments, sentence)


def _print(found: Sequence[Assessment], sentence: str) -> None:
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 1000, highlight=False)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    rows = {
        "ln evidence": [a.evidence.text for a in found],
        "predictive score": [f"{a.score:.1f} ± {a.score_error:.1f}" for a in found],
    }
    for name in _names(found):
        unit = f" ({unit_of(name)})" if unit_of(name) else ""
        rows[f"{name}{unit}"] = [_cell(a, name) for a in found]
    table.add_column("median (95 %)", no_wrap=True)
    for a in found:
        table.add_column(a.name, justify="right", no_wrap=True)
    for label, cells in rows.items():
        table.add_row(label, *cells)
    console.print(sentence, markup=False, soft_wrap=True)
    console.print(table, crop=False)
    console.print(
        "evidences hold for these priors; the score's wavelengths tell of one another, so it is "
        "no evidence of its own",
        soft_wrap=True,
    )


def _names(found: Sequence[Assessment]) -> list[str]:
    """Parameters that any of the models has."""
    return list(dict.fromkeys(n for a in found for n in a.values))


def _cell(a: Assessment, name: str) -> str:
    if name not in a.values:
        return ""
    value, low, high = a.values[name]
    return f"{value:.3g} ({low:.3g} to {high:.3g})"
