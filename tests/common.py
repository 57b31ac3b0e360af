"""What several tests need: the reference tables, batches of irides, quick compilation."""

import csv
import dataclasses
import functools
import importlib.metadata
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from irisjax.measure.colour import lab_of

# Cases of `parametrize` that are left to another tier: their neighbours find the same faults.
slowly = functools.partial(pytest.param, marks=pytest.mark.slow)

LEVELS = ("low", "moderate", "high")
GRID = ij.wavelengths(400, 700, 10)

PROCESSES = {
    "lb06": ij.ILIT_2006,
    "rayleigh": ij.ILIT_CORRECTED,
    "lb06-retest": ij.Ilit(rescatter="retest"),
    "rayleigh-retest": ij.Ilit(phase="rayleigh", rescatter="retest"),
    "lb06-redrawn": ij.Ilit(perturb_on_reflection=True),
    "rayleigh-redrawn": ij.Ilit(phase="rayleigh", perturb_on_reflection=True),
    "retest-redrawn": ij.Ilit(phase="rayleigh", rescatter="retest", perturb_on_reflection=True),
    "depth-resolved": ij.DEPTH_RESOLVED,
}
ILIT = {name: p for name, p in PROCESSES.items() if not isinstance(p, ij.RadiativeTransfer)}


def rows_of(path):
    """Rows of a CSV file below its comments, as dictionaries of strings."""
    with Path(path).open(encoding="utf-8") as f:
        return list(csv.DictReader(line for line in f if not line.startswith("#")))


def rows_by(key, path):
    """The same by the entry that names each row."""
    return {row[key]: row for row in rows_of(path)}


def reference(name):
    """Rows of a reference table, as dictionaries of strings."""
    return rows_of(Path(__file__).parent / "reference" / name)


def chandrasekhar(albedo, cosine):
    """Reflectance of a deep, isotropic medium of matched index, 1 − H(μ₀) √(1 − ω), H by iteration
    [Chandrasekhar 1960, Section 37].
    """
    x, w = np.polynomial.legendre.leggauss(200)
    x, w = (x + 1) / 2, w / 2
    root, h = np.sqrt(1 - albedo), np.ones_like(x)
    for _ in range(400):
        h = 1 / (root + albedo / 2 * (w * x * h / (x[:, None] + x)).sum(1))
    return 1 - root / (root + albedo / 2 * (w * x * h / (cosine + x)).sum())


def lab_of_linear(colour):
    """CIE 1976 L*a*b* of linear sRGB, by the matrix as IEC 61966-2-1 prints it."""
    to_xyz = np.array(
        [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    )
    return np.asarray(lab_of(jnp.asarray(to_xyz @ colour / to_xyz.sum(1))))


class Csv(NamedTuple):
    header: dict[str, str]
    columns: dict[str, np.ndarray]


def read_csv(path):
    """A CSV file of a command."""
    lines = Path(path).read_text("utf-8").splitlines()
    names, *rows = csv.reader(line for line in lines if line and not line.startswith("#"))
    columns = dict(zip(names, np.array(rows, float).T, strict=True))
    return Csv(ij.io.read_header(path), columns)


def stack(irides):
    """One `Iris` with a leading batch axis."""
    return jax.tree.map(lambda *x: jnp.stack([jnp.asarray(v, float) for v in x]), *irides)


def all_irides():
    """The nine irides of the reference tables, with their names."""
    names = [(level, f) for level in LEVELS for f in (0.2, 0.5, 0.8)]
    return names, stack([ij.Iris.of_level(level).replace(abl_fraction=f) for level, f in names])


# XLA optimises these programs for 4 to 9 s each, where a test runs them for milliseconds. Those
# that come in dozens (derivatives, every switch of a process, every order of media) are compiled
# with little optimisation; the public functions and `tests/transport`'s tables are optimised.
QUICK = {"xla_backend_optimization_level": 0}
if importlib.metadata.version("jaxlib").startswith("0.10."):
    # Four times quicker, and a quarter; unknown to other releases.
    QUICK["xla_cpu_use_fusion_emitters"] = False
    QUICK["xla_cpu_parallel_codegen_split_count"] = 1


def quick_jit(f, **options):
    """`jax.jit` with little optimisation, for programs that compile slowly and run once."""
    if jax.default_backend() != "cpu":
        return jax.jit(f, **options)
    return jax.jit(f, compiler_options=QUICK, **options)


def layers(abl, absorption, scattering, indices):
    """Layers with the given optical depths; indices are (aqueous, abl, stroma, ipe)."""
    abl, absorption, scattering = np.broadcast_arrays(
        *(np.atleast_1d(x) for x in (abl, absorption, scattering))
    )
    media = ij.RefractiveIndices(*(jnp.asarray(n, float) for n in indices))
    as_float = [jnp.asarray(x, float) for x in (abl, absorption, scattering)]
    return ij.Layers(*as_float, indices=media, order=media.order())


@functools.cache
def _solving(solver):
    return quick_jit(solver.solve)


def light(cosine=1.0, exits=None, azimuth=None):
    """`ij.Light` of numbers as tests have them."""
    cosine = None if isinstance(cosine, str) else jnp.asarray(cosine, float)
    if exits is None:
        return ij.Light(cosine)
    return ij.Light(cosine, ij.Directions(exits, 0.0 if azimuth is None else azimuth))


def filled(x, multiple):
    """The last entry repeated until the length is a multiple: fewer shapes, fewer programs."""
    x = np.asarray(x)
    return jnp.asarray(np.concatenate([x, np.repeat(x[-1:], -len(x) % multiple, 0)]))


def exact(process, n_angles=40):
    """The deterministic solver of a process."""
    ilit = isinstance(process, ij.Ilit)
    return (ij.IlitExact if ilit else ij.RadiativeExact)(n_angles, process=process)


def any_order(made):
    """The same layers, compiled for every order of media alike: one program for all of them."""
    fields = {f.name: getattr(made, f.name) for f in dataclasses.fields(made)}
    return type(made)(**fields | {"order": type(made.order)()})


def solve(solver, made, cosine=1.0, exits=None, azimuth=None):
    """A solver on layers, compiled once for each solver, filled shape and order of media."""
    depths = ("abl_absorption", "stroma_absorption", "stroma_scattering")
    n, n_exits = len(made.abl_absorption), None if exits is None else len(exits)
    if exits is not None:
        exits = filled(exits, 6)
        azimuth = None if azimuth is None else filled(azimuth, 6)
    lit = light(cosine, exits, azimuth)
    solver = solver.prepare(made, lit)
    made = dataclasses.replace(made, **{d: filled(getattr(made, d), 4) for d in depths})
    found = _solving(solver)(made, lit)
    # Cut by NumPy, which compiles nothing.
    found = jax.tree.map(lambda x: jnp.asarray(np.asarray(x)[:n]) if jnp.ndim(x) else x, found)
    if exits is None:
        return found

    def cut(x):
        return jnp.asarray(np.asarray(x)[:, :n_exits])

    if found.polarisation is not None:
        found = eqx.tree_at(lambda r: r.polarisation.brdf, found, replace_fn=cut)
    return eqx.tree_at(lambda r: r.brdf, found, replace_fn=cut)


def operations(f, *args, name=None):
    """Operations (of a name, if given) in the traced program, those of inner programs included."""
    return operations_of(jax.make_jaxpr(f)(*args).jaxpr, name)


def operations_of(jaxpr, name=None):
    """The same of a program that is traced."""
    total = 0
    for equation in jaxpr.eqns:
        total += name is None or equation.primitive.name == name
        inner = jax.tree.leaves(list(equation.params.values()), is_leaf=_is_jaxpr)
        total += sum(operations_of(getattr(p, "jaxpr", p), name) for p in inner if _is_jaxpr(p))
    return total


def _is_jaxpr(x):
    return hasattr(x, "eqns") or hasattr(getattr(x, "jaxpr", None), "eqns")


def counting(monkeypatch, **places):
    """How often functions of these names are called; `places` are their modules."""
    counts = dict.fromkeys(places, 0)

    def counted(name, function):
        def call(*given, **named):
            counts[name] += 1
            return function(*given, **named)

        return call

    for name, module in places.items():
        monkeypatch.setattr(module, name, counted(name, getattr(module, name)))
    return counts
