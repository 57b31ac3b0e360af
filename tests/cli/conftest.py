"""The command run in this process, and files made once a worker.

What it prints and writes, refuses and runs again does not depend on the numbers: those are the
library's, and its tests'. Most tests replace what compiles for long; see `stand_ins`.
"""

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import jax
import pytest
from stand_ins import FREE, with_quick, without_search

from common import read_csv
from irisjax import cli


@pytest.fixture
def quick(monkeypatch):
    """The command's exact solver is `Quick`: files and messages do not depend on the numbers."""
    with_quick(monkeypatch)


@pytest.fixture(autouse=True)
def _precision_kept():
    # The command switches x64 on; the tests that share this process must not notice.
    before = jax.config.read("jax_enable_x64")
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture
def irisjax(capsys, monkeypatch):
    """Run the command in this process; gives status, standard output and standard error."""
    monkeypatch.delenv("IRISJAX_DEBUG", raising=False)

    def run(*arguments):
        status = cli.run([str(a) for a in arguments])
        return status, *capsys.readouterr()

    return run


@pytest.fixture
def done(irisjax):
    """Run the command, which must succeed; gives standard output and standard error."""

    def run(*arguments):
        status, *said = irisjax(*arguments)
        assert status == 0, said
        return said

    return run


@pytest.fixture
def printed(tmp_path):
    """Header and columns of what the command printed."""

    def read(text):
        path = tmp_path / "printed.csv"
        path.write_text(text)
        return read_csv(path)

    return read


@pytest.fixture(scope="session")
def eye(tmp_path_factory):
    """A spectrum file that `Quick` could have made; its header holds the truth."""
    path = tmp_path_factory.mktemp("eye") / "eye.csv"
    with pytest.MonkeyPatch.context() as monkeypatch:
        with_quick(monkeypatch)
        made = ("simulate-measurement", "--level", "low", "--seed", "2", "-o", str(path))
        assert cli.run([*made]) == 0
    return path


@pytest.fixture
def copies(eye, tmp_path):
    """A folder with copies of the spectrum `eye`."""

    def of(*names):
        folder = tmp_path / "eyes"
        folder.mkdir()
        for name in names:
            (folder / f"{name}.csv").write_bytes(eye.read_bytes())
        return folder

    return of


@pytest.fixture
def sampled(quick, monkeypatch):
    """`irisjax fit` without its search; the calls of the sampler."""
    return without_search(monkeypatch)


class Fitted(NamedTuple):
    """A run of `irisjax fit`: how it was called and what it left."""

    arguments: tuple[str, ...]
    status: int
    printed: str
    folder: Path


@pytest.fixture(scope="session")
def fitted(eye, tmp_path_factory):
    """`irisjax fit` of `eye` without its search, for tests that only look."""
    folder = tmp_path_factory.mktemp("fit") / "out"
    arguments = ("fit", str(eye), "-o", str(folder), *FREE)
    with pytest.MonkeyPatch.context() as monkeypatch, redirect_stdout(StringIO()) as printed:
        with_quick(monkeypatch)
        without_search(monkeypatch)
        status = cli.run([*arguments])
    return Fitted(arguments, status, printed.getvalue(), folder)
