"""What workers gain: posteriors of a batch on one core, by one worker of one core, and by two.

Seconds an eye are differences of runs of two sizes, so that the start of a command and of its
workers does not count; that stands beside them. A model of the cost of a million eyes follows.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

import irisjax as ij
from experiments.common import RESULTS, start, write

MODES = {
    "in the process": (0, ()),
    "one worker": (0, ("--workers", "1")),
    "two workers": (1, ("--workers", "2")),
}
"""The last core that a run may use, beginning with the first, and its options."""


def main(key, quick=False, out=RESULTS):
    """Write `bench_engine.csv` (quick: two eyes, in the process and by one worker)."""
    sizes = (1, 2) if quick else (2, 10)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for size in sizes:
            _write_eyes(place / f"{size}.csv", size, key)
        for name, (last, options) in list(MODES.items())[: 2 if quick else 3]:
            seconds = {}
            for again, size in enumerate((sizes[0], *sizes)):  # the first compiles
                seconds[size] = _seconds(place, size, last, (*options, "--seed", str(again)))
            each = (seconds[sizes[1]] - seconds[sizes[0]]) / (sizes[1] - sizes[0])
            rows.append((name, sizes[1], each, seconds[sizes[0]] - sizes[0] * each))
    alone = rows[0][2]
    write(
        out / "bench_engine.csv",
        (f"posteriors of simulated eyes by radiative transfer; {os.cpu_count()} cores, one for "
         "each worker",),
        ("run", "eyes", "seconds_an_eye", "seconds_to_start", "times_as_many"),
        [(*row, alone / row[2]) for row in rows],
    )  # fmt: skip


def _write_eyes(path, size, key):
    """A table of simulated eyes, as a batch reads it."""
    grid = ij.wavelengths(400, 700, 10)
    values = []
    for i in range(size):
        loads, noise = jax.random.split(jax.random.fold_in(key, i))
        iris = ij.Iris().replace(eumelanin=float(2 * jax.random.uniform(loads) + 0.5))
        exact = ij.reflectance(iris, grid, solver=ij.RadiativeExact()).values
        values.append(exact * (1 + 0.02 * jax.random.normal(noise, exact.shape)))
    head = ",".join(["wavelength", *(f"eye{i}" for i in range(size))])
    table = np.column_stack([grid, np.transpose(values)])
    np.savetxt(path, table, delimiter=",", header=head, comments="")


def _seconds(place, size, last, options):
    """How long the command takes on cores 0 to `last`."""
    command = [sys.executable, "-m", "irisjax", "fit", "--batch", place / f"{size}.csv"]
    limited = (
        "import os, sys; os.sched_setaffinity(0, range(int(sys.argv[1]) + 1)); "
        "os.execv(sys.argv[2], sys.argv[2:])"
    )
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, "-c", limited, str(last), *command, "-o", place / "fits", "--overwrite",
         "--posteriors", *options],
        check=False, capture_output=True, cwd=Path(ij.__file__).parents[1],
    )  # fmt: skip
    return time.perf_counter() - begin


if __name__ == "__main__":
    start(main, __doc__)
