"""Batches shared among worker processes: real ones of dask.distributed, killed and restarted."""

import gc
import os
import signal
import subprocess
import sys
import time
from collections import Counter

import numpy as np
import pytest

from irisjax.cli.engine import LostPiece, Workers, describe_fault, run_pieces

# Dask leaves the sockets of a scheduler that was killed to the garbage collector.
pytestmark = [pytest.mark.peer, pytest.mark.filterwarnings("ignore::ResourceWarning")]
dask = pytest.importorskip("dask")
pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")  # distributed needs it

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def square(i):
    """A piece of work; an eye that raises, and the process that did it."""
    time.sleep(0.1)
    if i == 3:
        raise ValueError("3 is no eye")
    return i * i, os.getpid()


def fatal(i):
    """A piece that takes its worker with it, and one that does not."""
    if i == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return i


def check(found):
    """All pieces are there, once, and the one that raised says why."""
    assert sorted(found) == list(range(12))
    assert found.pop(3) == LostPiece("3 is no eye")
    assert all(result[0] == i * i for i, result in found.items())


def test_a_killed_worker_loses_nothing():
    found, times = {}, Counter()
    for i, result in run_pieces(square, {i: (i,) for i in range(12)}, Workers(workers=2)):
        if not found:
            os.kill(result[1], signal.SIGKILL)
        found[i] = result
        times[i] += 1
    assert set(times.values()) == {1}
    assert len({r[1] for r in found.values() if not isinstance(r, LostPiece)}) >= 2
    check(found)


def test_a_piece_that_kills_every_worker_fails_alone():
    # Long before a worker has been replaced.
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "100 ms"}):
        found = dict(run_pieces(fatal, {i: (i,) for i in range(3)}, Workers(workers=1)))
    assert found == {0: LostPiece(found[0].reason), 1: 1, 2: 2}
    assert "the worker died on it several times" in found[0].reason


def test_a_restarted_scheduler_loses_nothing():
    address, running = "tcp://127.0.0.1:18786", []
    # A worker finds this file by the same name as this process.
    env = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, os.path.dirname(__file__)])}

    def start(name, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.dask_{name}", *arguments]
        quiet = subprocess.DEVNULL
        running.append(subprocess.Popen(command, env=env, stdout=quiet, stderr=quiet))
        return running[-1]

    def scheduler():
        return start("scheduler", "--host", "127.0.0.1", "--port", "18786", "--no-dashboard")

    def worker():
        start("worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny")

    try:
        first = scheduler()
        worker()
        found = {}
        for i, result in run_pieces(
            square, {i: (i,) for i in range(12)}, Workers(scheduler=address)
        ):
            found[i] = result
            if len(found) == 5:
                first.kill()
                first.wait()
                scheduler()
                worker()
        check(found)
    finally:
        for process in running:
            process.kill()
            process.wait()
        gc.collect()


def test_a_refused_run_leaves_no_folder(irisjax, tmp_path, monkeypatch):
    monkeypatch.setattr("irisjax.cli.engine._CONNECTING", 0.5)
    (tmp_path / "eyes.csv").write_text("wavelength,a\n450,0.03\n550,0.02\n650,0.02\n")
    target = tmp_path / "fits"
    status, _, error = irisjax(
        *("fit", "--batch", tmp_path / "eyes.csv", "-o", target),
        *("--scheduler", "tcp://127.0.0.1:9"),
    )
    assert status == 2 and "no dask scheduler answers" in error
    assert not target.exists()


def test_maps_of_equal_bytes(done, tmp_path, monkeypatch):
    """The pixels of a cube fitted here, and by two processes in pieces of eight rows."""
    monkeypatch.setattr("irisjax.cli.map._CHUNK", 256)
    monkeypatch.setattr("irisjax.cli.map.picture", lambda figure, suffix: b"a picture")
    cubes = os.path.join(ROOT, "data", "cubes")
    given = [os.path.join(cubes, "cube.hdr"), "--white", os.path.join(cubes, "white.csv")]
    given += ["--dark", os.path.join(cubes, "dark.csv"), "--relative-noise", "0.01"]
    given += ["--process", "ilit-2006", "--free", "melanin_load,scattering_scale"]
    for name, more in (("here", ()), ("there", ("--workers", "2"))):
        done("map", *given, "-o", tmp_path / name, *more)
    here, there = ((tmp_path / name / "maps.nc").read_bytes() for name in ("here", "there"))
    assert here == there


def test_faults_in_words():
    assert describe_fault(ValueError("no\n eye")) == "no eye"
    assert describe_fault(KeyError("x")) == "internal error: KeyError: 'x'"


_ON_A_FULL_DISK = """
import os, resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))
os.execv(sys.argv[1], sys.argv[1:])
"""


# A shell lets jobs in the background, and their children, ignore SIGINT.
_HEARS_CTRL_C = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
os.execv(sys.argv[1], sys.argv[1:])
"""


def _command(folder, *arguments, before=(), **more):
    """`irisjax fit --batch` in a process of its own, with a cache that all these share."""
    env = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(folder / "cache")}
    model = ("--process", "ilit-2006", "--free", "melanin_load")
    call = [sys.executable, *before, "-m", "irisjax", "fit", "--batch", folder / "eyes.csv", *model]
    return subprocess.Popen(
        [*call, *arguments], env=env, cwd=ROOT, stderr=subprocess.PIPE, text=True, **more
    )


def _finish(process):
    error = process.communicate()[1]
    assert process.returncode in (0, 3), error


def _alive(group, patience=5):
    """Whether processes of a group are still there after some seconds."""
    for _ in range(int(10 * patience)):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return False
        time.sleep(0.1)
    return True


def test_equal_bytes_whatever_the_workers_and_the_faults(tmp_path):
    """A run in one process, and one that a full disk stops, is interrupted by Ctrl-C, and ends with
    two workers: the same table, and nobody left behind.
    """
    grid, draw = np.linspace(400, 700, 7), np.random.default_rng(0)
    eyes = 0.02 * (1 + 0.1 * draw.normal(size=(128, grid.size)))
    rows = np.column_stack([grid, eyes.T])
    head = ",".join(["wavelength", *(f"eye{i}" for i in range(128))])
    np.savetxt(tmp_path / "eyes.csv", rows, delimiter=",", header=head, comments="")

    def files(name):
        return [(tmp_path / name / f).read_bytes() for f in ("fits.csv", "fits-covariance.csv")]

    _finish(_command(tmp_path, "-o", tmp_path / "one"))

    target = tmp_path / "two"
    full = _command(tmp_path, "-o", target, before=("-c", _ON_A_FULL_DISK, sys.executable))
    error = full.communicate()[1].strip().splitlines()
    assert (full.returncode, len(error)) == (2, 1), error
    assert error[0].startswith(f"irisjax: {target}")
    assert not list(target.glob("*"))

    hears = "-c", _HEARS_CTRL_C, sys.executable
    stopped = _command(
        tmp_path, "-o", target, "--workers", "2", before=hears, start_new_session=True
    )
    # Once both workers are there, beside the tracker of their pipes: they import for a second.
    for _ in range(200):
        if len(psutil.Process(stopped.pid).children(recursive=True)) >= 3:
            break
        time.sleep(0.1)
    time.sleep(0.5)
    stopped.send_signal(signal.SIGINT)
    assert stopped.communicate(timeout=20)[1] == "irisjax: interrupted\n"
    assert stopped.returncode == 130
    assert not _alive(stopped.pid)

    _finish(_command(tmp_path, "-o", target, "--workers", "2", "--resume"))
    assert files("one") == files("two")
