"""The house's rules that a machine can hold."""

import ast
import functools
import graphlib
import importlib
import re
import sys
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

import irisjax as ij
from common import operations, operations_of, quick_jit
from irisjax.numerics.quadrature import cosine_rule

ROOT = Path(__file__).parent.parent
SOURCES = sorted((ROOT / "irisjax").rglob("*.py"))
INDEX = ROOT / "docs" / "equation-index.md"
# Paper: how its equations are indexed, and which of them the package holds.
_PAPERS = {
    "LB06": ("", set(range(1, 10))),
    "F09": ("F09 ", set(range(1, 18))),
    "L03": ("L03 ", {1, 2}),
}


def _files(*folders):
    return [p for f in folders for p in sorted((ROOT / f).rglob("*.py"))]


@functools.cache
def _tree(path):
    return ast.parse(path.read_text(encoding="utf-8"))


def _parsed():
    """Modules of the package by name, parsed."""
    return {
        ".".join(p.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): _tree(p)
        for p in SOURCES
    }


def test_modules_do_not_import_each_other_in_circles():
    modules, needs = _parsed(), {}
    for name, tree in modules.items():
        needs[name] = set()
        for node in tree.body:
            if isinstance(node, ast.Import):
                needs[name] |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                full = {f"{node.module}.{alias.name}" for alias in node.names}
                needs[name] |= {f if f in modules else node.module for f in full}
        needs[name] = needs[name] & modules.keys() - {name}
    graphlib.TopologicalSorter(needs).prepare()  # raises CycleError


def test_no_public_name_stands_for_two_things():
    homes = {}
    for module, tree in _parsed().items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                homes.setdefault(node.name, []).append(module)
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                for target in getattr(node, "targets", None) or [node.target]:
                    if isinstance(target, ast.Name):
                        homes.setdefault(target.id, []).append(module)
    twice = {n: m for n, m in homes.items() if len(m) > 1 and not n.startswith("_")}
    assert twice == {}


def test_public_functions_are_annotated():
    missing = []
    for name, tree in _parsed().items():
        classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
        for home in [tree, *(c for c in classes if not c.name.startswith("_"))]:
            for f in home.body:
                if not isinstance(f, ast.FunctionDef) or f.name.startswith("_"):
                    continue
                given = [*f.args.posonlyargs, *f.args.args, *f.args.kwonlyargs]
                bare = {a.arg for a in given if a.annotation is None} - {"self", "cls"}
                if bare or f.returns is None:
                    missing.append(f"{name}.{f.name}")
    assert missing == []


def test_every_public_name_is_there():
    """A stub (`__init__.pyi`) names what a package offers; `py.typed` publishes its types."""
    assert (ROOT / "irisjax" / "py.typed").is_file()
    for stub in sorted((ROOT / "irisjax").rglob("__init__.pyi")):
        package = importlib.import_module(".".join(stub.parent.relative_to(ROOT).parts))
        assert [name for name in package.__all__ if not hasattr(package, name)] == [], stub


def _offered(package):
    """Return the names that a package imports from its modules, in its stub if it has one."""
    stub = package / "__init__.pyi"
    source = stub if stub.is_file() else package / "__init__.py"
    body = ast.parse(source.read_text(encoding="utf-8")).body
    found = [n for n in body if isinstance(n, ast.ImportFrom)]
    own = [n for n in found if n.module and (n.level or n.module.startswith("irisjax."))]
    return {alias.asname or alias.name for n in own for alias in n.names}


def test_every_public_name_has_an_entry_and_no_other():
    """The pages of docs/api have an entry for each public name."""
    top = _offered(ROOT / "irisjax")
    public = set(top)
    for package in (p for p in (ROOT / "irisjax").iterdir() if (p / "__init__.py").is_file()):
        if package.name not in ("cli", "numerics"):
            public |= {f"{package.name}.{name}" for name in _offered(package) - top}
    pages = "\n".join(
        p.read_text(encoding="utf-8") for p in sorted((ROOT / "docs" / "api").glob("*.md"))
    )
    entries = re.findall(r"^::: irisjax\.(\S+)", pages, flags=re.M)
    assert len(entries) == len(set(entries)), "an object has two entries"
    assert set(entries) == public
    overview = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    assert [name for name in sorted(top) if f"`{name}`" not in overview] == []


# Modules whose distribution has another name.
_DISTRIBUTIONS = {
    "PIL": "pillow",
    "OpenImageIO": "openimageio",
    "colour": "colour-science",
    "skimage": "scikit-image",
}
_IMPORT = re.compile(
    r"""^\s*(?:import (\w+)[\w.]*(?: as \w+)?$|from (\w+)[\w.]* import|.*importorskip\(\s*"(\w+))""",
    re.M,
)


def _imported(*folders):
    """Distributions that files import, each with one of the files."""
    found = {}
    own = {"irisjax", "experiments", "paper_figs", "__future__"}
    own |= {p.stem for p in _files("tests")} | {p.name for p in (ROOT / "tests").iterdir()}
    for path in _files(*folders):
        names = set(map("".join, _IMPORT.findall(path.read_text(encoding="utf-8"))))
        for name in names - own - sys.stdlib_module_names:
            found[_DISTRIBUTIONS.get(name, name).lower().replace("_", "-")] = path.name
    return found


def _declared(project, *extras):
    """Distributions of the dependencies and of extras, those of an extra's extras included."""
    out = set()
    for line in [*project["dependencies"], *(x for e in extras for x in _extra(project, e))]:
        if inner := re.match(r"irisjax\[(.*)\]", line):
            out |= _declared(project, *inner[1].split(","))
        else:
            out.add(re.match(r"[\w-]+", line)[0].lower())
    return out


def _extra(project, name):
    return project["optional-dependencies"][name]


def test_every_import_is_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    package, tests = _imported("irisjax"), _imported("tests")
    everything = _imported("irisjax", "tests", "experiments", "paper_figs")

    def undeclared(imports, *extras):
        return {n: f for n, f in imports.items() if n not in _declared(project, *extras)}

    extras = "photo mesh view video raw heic instruments arviz cubes cluster posteriors"
    assert undeclared(package, *extras.split()) == {}
    assert undeclared(tests, "dev") == {}
    assert undeclared(everything, "dev", "bench") == {}
    assert _declared(project) - set(package) == set(), "declared, but not imported"


def _equations(text, paper):
    """Numbers of a paper's equations tagged in a text, wherever its lines end."""
    out, text = set(), " ".join(text.split())
    for tag in re.findall(rf"\[{paper} [^\]]*?\]", text):
        for numbers in re.findall(r"Eqs?\. ([\d, ]+)", tag):
            out |= {int(n) for n in re.findall(r"\d+", numbers)}
    return out


@pytest.mark.parametrize("paper", _PAPERS)
def test_equation_index_both_ways(paper):
    """Every equation the code names stands in the index with the files that name it, and the other
    way round.
    """
    prefix, known = _PAPERS[paper]
    row = rf"^\| {prefix}Eq\. (\d+) \|[^|]*\| (.*?) \|$"
    rows = re.findall(row, INDEX.read_text(encoding="utf-8"), flags=re.M)
    indexed = {int(n): re.findall(r"`([\w/]+\.py)`", files) for n, files in rows}
    named = {}
    for path in SOURCES:
        for n in _equations(path.read_text(encoding="utf-8"), paper):
            named.setdefault(n, set()).add(str(path.relative_to(ROOT / "irisjax")))
    assert set(indexed) == set(named) == known
    assert {n: set(files) for n, files in indexed.items()} == named


def test_what_is_not_asked_for_costs_nothing():
    iris, exits = ij.Iris.of_level("low"), ij.Directions([0.5, 0.9])
    layers = quick_jit(ij.Iris.layers)(iris, ij.extinction([450.0, 550.0]))

    @functools.cache
    def traced(process, beyond, panels):
        ilit = isinstance(process, ij.Ilit)
        solver = ij.IlitExact(8, process=process) if ilit else ij.RadiativeExact(8, 4, panels)
        light = ij.Light(1.0, exits if beyond else None)
        return jax.make_jaxpr(lambda x: solver.solve(x, light))(layers).jaxpr

    def program(process, exits=None, panels=1, name=None):
        return operations_of(traced(process, exits is not None, panels), name)

    plain, deep = program(ij.ILIT_CORRECTED), program(ij.DEPTH_RESOLVED)
    # The two azimuthal orders of Rayleigh's phase function are compiled for a BRDF only.
    solves = program(ij.DEPTH_RESOLVED, name="custom_linear_solve")
    assert program(ij.DEPTH_RESOLVED, exits, name="custom_linear_solve") == 3 * solves > 0
    assert plain < program(ij.ILIT_CORRECTED, exits)
    # Rank two needs no sum over orders of scattering.
    assert program(ij.ILIT_CORRECTED, name="while") == 0 < program(ij.ILIT_2006, name="while")
    assert deep < program(ij.DEPTH_RESOLVED, panels=3)


def test_seeds_become_keys_in_one_place():
    """Elsewhere a key would follow JAX's setting, and equal seeds would not give equal bytes."""
    made = {
        name
        for name, tree in _parsed().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "jax.random.key"
    }
    assert made == {"irisjax.numerics.streams"}


def test_panels_without_a_critical_angle_are_not_compiled():
    """LB06's stroma has none, so its rule costs no more than one that could have two panels."""
    order, critical = ij.Iris.of_level("low").order, jnp.asarray([-0.1, -0.2])
    none = (order.stroma_over_abl, order.stroma_over_ipe)
    assert none == (False, False)
    rules = [lambda c, p=p: cosine_rule(c, p, 8) for p in (none, (True, False), (True, True))]
    counts = [operations(rule, critical) for rule in rules]
    sizes = [jax.eval_shape(rule, critical).cosine.size for rule in rules]
    assert counts[0] < counts[1] < counts[2]
    assert sizes[0] == sizes[1] == 8 < sizes[2]
