"""What a user waits for: whole commands from the shell, imports and files included.

Each is run with empty caches (first), then twice as every later time (second: the quicker one),
and once more under Python's profiler, for where the time of a second run goes. Shares are of that
profiled run, in which Python's own work counts for more than it takes.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from experiments import common

EXAMPLE = Path(__file__).parents[1] / "data" / "spectra" / "simulated_moderate.csv"
COMMANDS = {
    "spectrum": ("spectrum", "--level", "low", "-o", "{}/a.csv"),
    "radiance": ("spectrum", "--level", "low", "--instrument", "radiance", "-o", "{}/b.csv"),
    "colour": ("colour", "--melanin-load", "0.05"),
    "fit": ("fit", str(EXAMPLE), "--overwrite", "-o", "{}/fit"),
    "render": ("render", "--preset", "blue", "--overwrite", "-o", "{}/eye.png"),
    "render 1 x 1": (
        "render",
        "--preset",
        "blue",
        "--size",
        "1x1",
        "--overwrite",
        "-o",
        "{}/1.png",
    ),
    "export": ("export", "--preset", "hazel", "-o", "{}/eye{}"),
}
PARTS = {
    "imports": "_find_and_load",
    "lowering": "lower_sharding_computation",
    "compiling_or_loading": "compile_or_get_cached",
    "sampling_steps": "advance",
}
PROFILED = """
import cProfile, json, pstats, sys, time
profile = cProfile.Profile()
begin = time.perf_counter()
profile.enable()
from irisjax.cli import run
status = run(sys.argv[3:])
profile.disable()
total, found = time.perf_counter() - begin, {}
for (_, _, name), (*_, cumulative, _) in pstats.Stats(profile).stats.items():
    found[name] = max(found.get(name, 0.0), cumulative)
shares = {part: found.get(name, 0.0) / total for part, name in json.loads(sys.argv[2]).items()}
open(sys.argv[1], "w").write(json.dumps(shares))
sys.exit(status)
"""


def main(key=None, quick: bool = False, out: Path = common.RESULTS) -> None:
    """Time every command; nothing is drawn at random."""
    rows = []
    for name, command in list(COMMANDS.items())[: 1 if quick else None]:
        with tempfile.TemporaryDirectory() as folder:
            place = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
            place["XDG_CACHE_HOME"] = f"{folder}/cache"

            def arguments(i, command=command, folder=folder):
                return [part.format(folder, i) for part in command]

            times = []
            for i in range(3):
                begin = time.perf_counter()
                _run([sys.executable, "-m", "irisjax", *arguments(i)], place)
                times.append(time.perf_counter() - begin)
            shares = Path(folder, "shares.json")
            given = [str(shares), json.dumps(PARTS), *arguments(3)]
            _run([sys.executable, "-c", PROFILED, *given], place)
            parts = json.loads(shares.read_text())
        rows.append([name, times[0], min(times[1:]), *(parts[part] for part in PARTS)])
        print(f"{name}: first {times[0]:.1f} s, second {min(times[1:]):.1f} s", flush=True)
    header = [
        f"whole commands, seconds of wall time on {os.cpu_count()} processors; shares of a "
        "profiled second run"
    ]
    columns = ["command", "first_s", "second_s", *(f"share_{part}" for part in PARTS)]
    common.write(out / "bench_shell.csv", header, columns, rows)


def _run(command, environment) -> None:
    subprocess.run(command, env=environment, check=True, capture_output=True)


if __name__ == "__main__":
    common.start(main, __doc__)
