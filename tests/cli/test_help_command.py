"""The help of every command, whole at 80 columns."""

import pytest

import irisjax as ij
from irisjax.cli import parser

COMMANDS = parser(["--help"]).commands


def test_version_and_list_of_commands(irisjax, done):
    assert irisjax("--version") == (0, f"irisjax {ij.__version__}\n", "")
    assert not parser(["--version"]).commands  # their modules take seconds to import
    out, _ = done()
    assert set(COMMANDS) <= set(out.split())


@pytest.mark.parametrize("name", COMMANDS)
def test_help_is_whole_at_80_columns(irisjax, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "80")
    status, out, err = irisjax(name, "--help")
    assert (status, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    assert "…" not in out
    words = {word for piece in out.split() for word in (piece, *piece.split(","))}
    for parameter in COMMANDS[name].params:
        for option in (*parameter.opts, *parameter.secondary_opts):
            if option.startswith("-"):
                assert option in words
        if parameter.metavar:
            assert parameter.metavar in words
        assert parameter.help.split()[-1].split()[0] in out


def test_help_tells_ranges_units_and_defaults(irisjax, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for name, words in {
        "spectrum": ("mg/ml", "0 to 1; default 0.5", "[default: 400:700:10]"),
        "brdf": ("within 350 to 800 [default: 550]",),
        "fit": ("4 to 4096 [default: 64]",),
        "render": ("1 to 8 [default: 1]",),
        "view": ("0 to 65535",),
    }.items():
        said = " ".join(irisjax(name, "--help")[1].replace("│", " ").split())
        assert all(word in said for word in words)
