"""The commands of the page "My spectrum is ..." read their files and options."""

import re
import shlex
from pathlib import Path

import pytest

from irisjax.cli import report

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "my-spectrum-is.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"`irisjax (fit [^`]+)`", PAGE)


@pytest.mark.parametrize("command", COMMANDS, ids=lambda c: c.split()[-1])
def test_commands_of_the_page_state_a_problem(irisjax, quick, monkeypatch, tmp_path, command):
    problems = []
    monkeypatch.setattr(
        report, "report_eye", lambda problem, *_, **__: problems.append(problem) or True
    )
    monkeypatch.chdir(ROOT)
    *given, _, folder = shlex.split(command)
    status, _, err = irisjax(*given, "-o", tmp_path / folder)
    assert (status, len(problems)) == (0, 1), err
    (seen,) = problems[0].observations
    assert ("--bands" in given or "--bandwidth" in given or "--boxcar" in given) == (
        seen.instrument.bands is not None
    )
