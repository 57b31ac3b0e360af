"""What the experiments share: where results go, how they are written, how they are started."""

import argparse
import csv
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import jax
import numpy as np
from scipy import stats

RESULTS = Path(__file__).parent / "results"


def write(
    path: Path,
    header: Sequence[str],
    columns: Sequence[str],
    rows: Iterable[Sequence],
    quiet: bool = False,
) -> Path:
    """Write a CSV with `# ` header lines; a failed run leaves the old file. `quiet`: without a
    word, for files that grow.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    with temporary.open("w", newline="", encoding="utf-8") as f:
        f.writelines(f"# {line}\n" for line in header)
        writer = csv.writer(f, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([f"{v:.9g}" if isinstance(v, float) else v for v in row] for row in rows)
    temporary.replace(path)
    if not quiet:
        print(f"wrote {path}")
    return path


def uniform_ranks(ranks: np.ndarray, draws: int) -> tuple[float, float]:
    """p-values of ranks from 0 to `draws` being uniform: chi-square in 8 bins, Kolmogorov."""
    counts = np.bincount(ranks.astype(int) * 8 // (draws + 1), minlength=8)
    kolmogorov = stats.kstest((ranks + 0.5) / (draws + 1), "uniform")
    return float(stats.chisquare(counts).pvalue), float(kolmogorov.pvalue)


def start(main: Callable, doc: str | None, out: Path = RESULTS) -> None:
    """Parse `--quick`, `--seed` and `--out`, switch to float64 and run `main(key, quick=...,
    out=...)`.
    """
    parser = argparse.ArgumentParser(description=doc)
    parser.add_argument("--quick", action="store_true", help="a small version, for tests")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=out, help="folder for the results")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    jax.config.update("jax_enable_x64", True)
    main(jax.random.key(options.seed), quick=options.quick, out=options.out)
