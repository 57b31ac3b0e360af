"""What a user waits for: whole commands from the shell, imports and files included.

Each is run with empty caches (first), then twice as every later time (second: the quicker one),
once for something else that it has not met before (another), and once more under Python's profiler,
for where the time of a second run goes. Shares are of that profiled run, in which Python's own work
counts for more than it takes. Of the viewer it is the time until it says its address, and from a
page's connection to the first draft and the first fine picture of the eye.
"""

import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from experiments import common

DATA = Path(__file__).parents[1] / "data"
SPECTRA, PHOTOGRAPHS = DATA / "spectra", DATA / "photographs"
COMMANDS = {
    "spectrum": ("spectrum -o {folder}/a{run}.csv --level", "low", "high"),
    "radiance": ("spectrum --instrument radiance -o {folder}/b{run}.csv --level", "low", "high"),
    "colour": ("colour --melanin-load", "0.05", "0.3"),
    "fit": (
        "fit --overwrite -o {folder}/fit",
        f"{SPECTRA}/simulated_moderate.csv",
        f"{SPECTRA}/simulated_low.csv",
    ),
    "render": (
        "render --overwrite -o {folder}/eye.png --preset",
        "blue",
        "hazel",
        "--size",
        "700x500",
    ),
    "render 1 x 1": ("render --size 1x1 --overwrite -o {folder}/1.png --preset", "blue", "hazel"),
    "clone": (
        "clone --overwrite -o {folder}/clone",
        f"{PHOTOGRAPHS}/blue.jpg",
        f"{PHOTOGRAPHS}/brown.jpg",
    ),
    "export": ("export -o {folder}/eye{run} --preset", "hazel", "blue"),
}
"""Words of each command, what it is about, and what else it may be about."""
VIEWER = ("view: its address", "view: draft on the page", "view: picture on the page")
PARTS = {
    "imports": "_find_and_load",
    "lowering": "lower_sharding_computation",
    "compiling_or_loading": "compile_or_get_cached",
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
    rows = [] if quick else _viewer()
    for name, (words, usual, *other) in list(COMMANDS.items())[: 1 if quick else None]:
        with tempfile.TemporaryDirectory() as folder:
            place = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
            place["XDG_CACHE_HOME"] = f"{folder}/cache"

            def arguments(i, about, words=words, folder=folder):
                return [*(w.format(folder=folder, run=i) for w in words.split()), *about]

            times = []
            for i, about in enumerate(([usual], [usual], [usual], other)):
                begin = time.perf_counter()
                _run([sys.executable, "-m", "irisjax", *arguments(i, about)], place)
                times.append(time.perf_counter() - begin)
            first, *again, another = times
            shares = Path(folder, "shares.json")
            given = [str(shares), json.dumps(PARTS), *arguments(4, [usual])]
            _run([sys.executable, "-c", PROFILED, *given], place)
            parts = json.loads(shares.read_text())
        rows.append([name, first, min(again), another, *(parts[part] for part in PARTS)])
        print(
            f"{name}: first {first:.1f} s, second {min(again):.1f} s, another {another:.1f} s",
            flush=True,
        )
    header = [
        f"whole commands, seconds of wall time on {os.cpu_count()} processors; shares of a "
        "profiled second run"
    ]
    columns = ["command", "first_s", "second_s", "another_s", *(f"share_{part}" for part in PARTS)]
    common.write(out / "bench_shell.csv", header, columns, rows)


def _viewer() -> list[list]:
    """Rows of the viewer."""
    with tempfile.TemporaryDirectory() as folder:
        place = {**os.environ, "XDG_CACHE_HOME": folder}
        place.pop("JAX_COMPILATION_CACHE_DIR", None)
        runs = [asyncio.run(_opened(place)) for _ in range(3)]
    rows = []
    for name, of_all in zip(VIEWER, zip(*runs, strict=True), strict=True):
        rows.append([name, of_all[0], min(of_all[1:]), *[float("nan")] * (1 + len(PARTS))])
        print(f"{name}: first {of_all[0]:.1f} s, second {min(of_all[1:]):.1f} s", flush=True)
    return rows


async def _opened(environment) -> tuple[float, float, float]:
    """Seconds to the viewer's address, and from a page's connection to draft and picture."""
    import viser
    import websockets
    import zstandard
    from websockets.typing import Subprotocol

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "irisjax", "view", "--port", str(port)]
    begin, found = time.perf_counter(), {}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            ready = time.perf_counter() - begin
            address, protocol = f"ws://127.0.0.1:{port}", Subprotocol(f"viser-v{viser.__version__}")
            begin = time.perf_counter()
            async with websockets.connect(address, subprotocols=[protocol], max_size=None) as page:
                while b"picture " not in found:
                    message = await asyncio.wait_for(page.recv(decode=False), 120)
                    # Behind a header of its own: what one batch of changes is packed into.
                    packed = message[message.find(bytes.fromhex("28b52ffd")) :]
                    text = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
                    for word in (b"draft ", b"picture "):
                        if word in text:
                            found.setdefault(word, time.perf_counter() - begin)
        finally:
            process.terminate()
    return ready, found.get(b"draft ", found[b"picture "]), found[b"picture "]


def _run(command, environment) -> None:
    subprocess.run(command, env=environment, check=True, capture_output=True)


if __name__ == "__main__":
    common.start(main, __doc__)
