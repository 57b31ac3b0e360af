"""The house's rules that a machine can hold."""

import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import irisjax as ij
from common import operations

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "irisjax").rglob("*.py"))
INDEX = ROOT / "paper_figs" / "README.md"
# Paper: how its equations are indexed, and which of them the package holds.
_PAPERS = {"LB06": ("", set(range(1, 10))), "F09": ("F09 ", {3, 15, 16, 17})}


def test_floors():
    run = subprocess.run(
        [
            sys.executable,
            "-c",
            "from importlinter.cli import lint_imports; raise SystemExit(lint_imports())",
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_files_stay_short():
    long = {
        p.name: n for p in SOURCES if (n := len(p.read_text(encoding="utf-8").splitlines())) > 500
    }
    assert not long


def _equations(text, paper):
    """Numbers of a paper's equations tagged in a text."""
    out = set()
    for tag in re.findall(rf"\[{paper} [^\]]*?\]", text):
        for numbers in re.findall(r"Eqs?\. ([\d, ]+)", tag):
            out |= {int(n) for n in re.findall(r"\d+", numbers)}
    return out


@pytest.mark.parametrize("paper", _PAPERS)
def test_equation_index_both_ways(paper):
    """Every equation the code names stands in the index with a file that names it, and the other
    way round.
    """
    prefix, known = _PAPERS[paper]
    rows = re.findall(
        rf"^\| {prefix}Eq\. (\d+) \|[^|]*\| (.*?) \|$",
        INDEX.read_text(encoding="utf-8"),
        flags=re.M,
    )
    indexed = {int(n): re.findall(r"`([\w/]+\.py)`", files) for n, files in rows}
    named = {}
    for path in SOURCES:
        for n in _equations(path.read_text(encoding="utf-8"), paper):
            named.setdefault(n, set()).add(str(path.relative_to(ROOT / "irisjax")))
    assert set(indexed) == set(named) == known
    for n, files in indexed.items():
        assert set(files) <= named[n], (
            f"the index sends readers of Eq. {n} to files that do not name it"
        )


def test_what_is_not_asked_for_costs_nothing():
    layers = ij.Iris.of_level("low").layers(ij.extinction([450.0, 550.0]))
    exits = jnp.asarray([0.5, 0.9])

    def program(process, cos_exit=None, panels=1, name=None):
        ilit = isinstance(process, ij.Ilit)
        solver = ij.IlitExact(8) if ilit else ij.RadiativeExact(8, 4, panels)
        return operations(
            lambda x: solver.solve(x, process, 1.0, cos_exit=cos_exit), layers, name=name
        )

    plain, deep = program(ij.ILIT_CORRECTED), program(ij.DEPTH_RESOLVED)
    # The two azimuthal orders of Rayleigh's phase function are compiled for a BRDF only.
    assert program(ij.DEPTH_RESOLVED, name="custom_linear_solve") == 1
    assert program(ij.DEPTH_RESOLVED, exits, name="custom_linear_solve") == 3
    assert plain < program(ij.ILIT_CORRECTED, exits)
    # Rank two needs no sum over orders of scattering.
    assert program(ij.ILIT_CORRECTED, name="while") == 0 < program(ij.ILIT_2006, name="while")
    assert deep < program(ij.DEPTH_RESOLVED, panels=3)


def test_panels_without_a_critical_angle_are_not_compiled():
    layers = ij.Iris.of_level("low").layers(ij.extinction([450.0]))
    nodes = {}
    for name, index in (("default", None), ("denser stroma", 1.49)):
        iris = ij.Iris.of_level("low").replace(stroma_index=index)
        layers = iris.layers(ij.extinction([450.0]))
        nodes[name] = operations(lambda x: ij.IlitExact(8).solve(x, ij.ILIT_CORRECTED, 1.0), layers)
    assert nodes["default"] < nodes["denser stroma"]


@pytest.mark.parametrize("field", ["eumelanin", "abl_fraction", "stroma_thickness"])
def test_new_numbers_are_not_compiled_for_again(field):
    calls = []

    @jax.jit
    def spectrum(iris):
        calls.append(1)
        return ij.reflectance(iris, [450.0, 550.0]).values

    iris = ij.Iris.of_level("low")
    for value in (0.1, 0.2, jnp.asarray(0.3)):
        spectrum(iris.replace(**{field: value}))
    assert len(calls) == 1
