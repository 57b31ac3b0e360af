"""How long `irisjax map --posterior` takes, beside the fits alone of `cubes.py`, and its memory.

A cube of a grown iris is mapped by the process that simulated it, in a process of its own, after a
small cube for which the flow is trained.
"""

import tempfile
from pathlib import Path

from experiments.common import RESULTS, start, write
from experiments.cubes import PROCESSES, about, mapped, simulate


def main(key, quick=False, out=RESULTS):
    """Write times and memory (quick: a cube of 16 by 16 pixels)."""
    size, rows = 16 if quick else 512, []
    with tempfile.TemporaryDirectory() as temporary:
        for process in PROCESSES:
            tiny, cube, maps = (Path(temporary, f"{n}-{process}") for n in ("tiny", "cube", "maps"))
            simulate(tiny, 16, process, key)
            simulate(cube, size, process, key)
            flows = "--posterior", "--flows", Path(temporary, f"flows-{process}")
            training, *_ = mapped(tiny, maps, *flows)
            seconds, cpu, peak = mapped(cube, maps, *flows)
            rows += [
                (process, "posteriors of 16 by 16 (trains the flow): seconds", training, "s"),
                (process, "posteriors: seconds", seconds, "s"),
                (process, "posteriors: CPU seconds", cpu, "s"),
                (process, "posteriors: peak memory", peak, "MiB"),
            ]
    write(out / "cube_posteriors.csv", (about(size),), ("process", "what", "value", "unit"), rows)


if __name__ == "__main__":
    start(main, __doc__)
