"""The command as a process: its status, Ctrl-C, and what an import loads."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest

from irisjax import _interrupt
from irisjax.__main__ import main as door


def python(code, **options):
    call = [sys.executable, "-c", code]
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    return subprocess.run(
        call, capture_output=True, text=True, timeout=120, env=environment, **options
    )


def test_what_was_printed_is_not_lost(monkeypatch):
    """A command leaves at once, and what it printed into a pipe before a complaint stays."""
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    done = python("from irisjax import _interrupt as i; print('said', end=''); i.done(2)")
    assert (done.returncode, done.stdout, done.stderr) == (2, "said", "")


def test_ctrl_c_while_importing(monkeypatch, capsys):
    class Interrupted:
        @staticmethod
        def find_spec(name, *_):
            if name == "irisjax.cli":
                raise KeyboardInterrupt

    _interrupt.begin()  # as a process does; a test before this one may have said it already
    monkeypatch.delitem(sys.modules, "irisjax.cli")
    monkeypatch.setattr(sys, "meta_path", [Interrupted, *sys.meta_path])
    with pytest.raises(SystemExit) as left:
        door()
    assert (left.value.code, capsys.readouterr().err) == (130, "irisjax: interrupted\n")


def test_nobody_leaves_while_another_thread_prints_the_line(monkeypatch):
    """A process that is left in between would have ended in half a line."""
    printed, begun = [], threading.Event()

    def write(text):
        begun.set()
        time.sleep(0.2)
        printed.append(text)

    _interrupt.begin()
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(write=write, flush=lambda: None))
    other = threading.Thread(target=_interrupt.say)
    other.start()
    begun.wait()
    _interrupt.say()
    assert "".join(printed) == "irisjax: interrupted\n"
    other.join()


ON_POSIX = pytest.mark.skipif(
    os.name == "nt",
    reason="Windows hands no SIGINT to one process; there Python alone hears Ctrl-C",
)

# Says when it measures, for a minute.
INTERRUPTIBLE = """
import time
from irisjax.__main__ import main
from irisjax.cli import measure
measure.observe = lambda *_, **__: print("block", flush=True) or time.sleep(60)
main()
"""


@ON_POSIX
def test_ctrl_c_in_a_long_run(tmp_path):
    said = ("spectrum", "--solver", "monte-carlo", "-o", "x.csv")
    interrupted(tmp_path, INTERRUPTIBLE, *said)


def interrupted(folder, code, *arguments) -> float:
    """Interrupt Python code once it has printed "block"; the seconds until it was gone."""
    # A shell lets jobs in the background, and their children, ignore SIGINT.
    hears = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    with subprocess.Popen(
        [sys.executable, "-c", hears + code, *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == "block\n"
            process.send_signal(signal.SIGINT)
            begun = time.monotonic()
            _, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, err) == (130, "irisjax: interrupted\n")
    assert not list(folder.iterdir())
    return time.monotonic() - begun


# The main thread is where Python hears nothing, as while a program is compiled. A file is half
# written.
DEAF = """
import ctypes
from irisjax import _interrupt
from irisjax.io.tables import replacing

def work():
    with replacing("eye.png") as half:
        half.write_bytes(b"half")
        print("block", flush=True)
        ctypes.CDLL(None).poll(None, 0, 60_000)
    return 0

_interrupt.guarded(work)
"""


@ON_POSIX
def test_ctrl_c_where_python_does_not_hear_it(tmp_path):
    assert interrupted(tmp_path, DEAF) < 2


IMPORTS = """
import json, runpy, sys, jax
import irisjax as ij
ij.reflectance
library = sorted(sys.modules)
import irisjax.cli
command = sorted(sys.modules)
names = [ij.io.read_maps.__name__, ij.infer.Fit.__name__, hasattr(ij.render, "nothing")]
print(json.dumps([library, command, names, jax.config.read("jax_enable_x64")]))
sys.argv[1:] = "spectrum", "--level", "none", "-o", "x.csv"
runpy.run_module("irisjax", run_name="__main__", alter_sys=True)
"""


def test_imports_and_the_status_of_wrong_input(tmp_path):
    done = python(IMPORTS, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "irisjax: --level: unknown 'none'; known: low, moderate, high\n"
    assert not list(tmp_path.iterdir())
    library, command, names, double = json.loads(done.stdout)
    heavy = {"matplotlib", "colour", "emcee", "arviz", "viser", "typer", "tqdm", "OpenImageIO"}
    assert not heavy & set(library)
    assert not {"matplotlib", "colour", "OpenImageIO", "scipy.special"} & set(command)
    # Names load when asked for.
    assert names == ["read_maps", "Fit", False]
    assert double is False  # the precision is left alone
