"""Edges of the physics: nothing, everything, equal indices, grazing light; values, energy, status,
gradients.
"""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import GRID, PROCESSES, any_order, exact, layers, quick_jit, stack
from irisjax.tissue.iris import LIMITS

DEPTHS = np.array([0.0, 1e-12, 1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6])
ABL, ABSORPTION, SCATTERING = (
    x.ravel() for x in np.meshgrid(DEPTHS, DEPTHS, DEPTHS, indexing="ij")
)
MEDIA = {
    "iris": (1.336, 1.4733333, 1.4727930, 1.5),
    "all-equal": (1.4, 1.4, 1.4, 1.4),
    "aqueous-abl": (1.45, 1.45, 1.4, 1.5),
    "abl-stroma": (1.336, 1.45, 1.45, 1.5),
    "stroma-ipe": (1.336, 1.45, 1.5, 1.5),
    "guided-stroma": (1.336, 1.4, 1.6, 1.5),
    "guided-both": (1.3, 1.5, 1.55, 1.2),
    "rising": (1.3, 1.4, 1.5, 1.6),
    "falling": (1.6, 1.5, 1.4, 1.3),
    "extreme": (1.0, 3.0, 1.0, 3.0),
    "nearly-equal": (1.4, 1.4 * (1 + 1e-9), 1.4, 1.4 * (1 + 1e-14)),
}
COSINES = (1.0, 0.3, 1e-6, 0.0)
TINY = {64: 1e-12, 32: 1e-6}


def check(solution, bits):
    """Shares in [0, 1] that close."""
    parts = [
        np.asarray(x).astype(np.float64)
        for x in jax.tree.leaves((solution.reflectance, solution.mirrored, solution.absorbed))
    ]
    for part in parts:
        assert np.isfinite(part).all()
        assert part.min() >= -TINY[bits]
        assert part.max() <= 1 + TINY[bits]
    np.testing.assert_allclose(sum(parts), 1, rtol=0, atol=TINY[bits])


SWEEP = pytest.mark.slow
FEW = np.flatnonzero(
    np.isin(ABL, (0, 1e-6, 1e3)) & np.isin(ABSORPTION, DEPTHS[[0, 1, 5, 8]]) & np.isin(SCATTERING, DEPTHS[[0, 2, 5, 8]])
)  # fmt: skip
"""Depths that stand for all: none, hardly any, one, a million."""


def run_grid(process, solver, chosen):
    """All chosen depths as one spectrum, all media and cosines as a batch: one program."""
    sets = [layers(ABL[chosen], ABSORPTION[chosen], SCATTERING[chosen], m) for m in MEDIA.values()]
    # One static order for all: every critical angle possible.
    anything = ij.Layers(sets[0].abl_absorption, sets[0].stroma_absorption, sets[0].stroma_scattering,
                         jax.tree.map(lambda *n: jnp.stack(n), *[s.indices for s in sets]), type(sets[0].order)())  # fmt: skip

    def one(indices, cosine):
        made = ij.Layers(
            anything.abl_absorption,
            anything.stroma_absorption,
            anything.stroma_scattering,
            indices,
            anything.order,
        )
        return solver.solve(made, process, cosine)

    run = quick_jit(jax.vmap(one, in_axes=(0, None)))
    return [run(anything.indices, jnp.asarray(c, float)) for c in COSINES]


@pytest.mark.parametrize(
    ("name", "chosen"),
    [
        ("rayleigh-retest", FEW),
        *(pytest.param(n, slice(None), marks=SWEEP) for n, p in PROCESSES.items() if p != ij.DEPTH_RESOLVED),
    ],
)  # fmt: skip
def test_every_depth_index_and_incidence(name, chosen, bits):
    for solution in run_grid(PROCESSES[name], ij.IlitExact(n_angles=16), chosen):
        check(solution, bits)
        assert bool((solution.status == ij.RESULTS.successful).all())


SHALLOW = np.flatnonzero(ABSORPTION + SCATTERING <= 2)


@pytest.mark.parametrize("chosen", [SHALLOW[::11], pytest.param(SHALLOW, marks=SWEEP)])
@pytest.mark.parametrize("media", MEDIA)
def test_depth_resolved_shallow(media, chosen, bits):
    made = any_order(layers(ABL[chosen], ABSORPTION[chosen], SCATTERING[chosen], MEDIA[media]))
    for cosine in COSINES:
        solution = shallow(made, jnp.asarray(cosine, float))
        check(solution, bits)
        assert bool(solution.status == ij.RESULTS.successful)


@quick_jit
def shallow(made, cosine):
    return ij.RadiativeExact(n_angles=24, n_panels=3).solve(made, ij.DEPTH_RESOLVED, cosine)


def holds(absorption, scattering, bits):
    """Where the precision bears the number of scatterings, 1/(1 − ω + 1/τ²)."""
    total = np.maximum(absorption + scattering, 1e-300)
    return absorption / total + 1 / np.maximum(total, 1) ** 2 >= (0 if bits == 64 else 2e-6)


@SWEEP
@pytest.mark.parametrize("media", ["iris", "all-equal", "guided-both"])
def test_depth_resolved_at_every_depth(media, bits):
    held = np.flatnonzero(holds(ABSORPTION, SCATTERING, bits))
    made = layers(ABL[held], ABSORPTION[held], SCATTERING[held], MEDIA[media])
    solver = ij.RadiativeExact().prepare(lambda: made, ij.DEPTH_RESOLVED)
    solution = quick_jit(lambda x: solver.solve(x, ij.DEPTH_RESOLVED, jnp.asarray(1.0, float)))(
        made
    )
    check(solution, bits)
    assert bool(solution.status == ij.RESULTS.successful)


@SWEEP
def test_depth_resolved_deep(bits):
    """Twenty-two panels for an optical depth of a million; where single precision does not hold it,
    the status says so.
    """
    depths = np.array([1e-12, 1e-3, 1.0, 1e3, 1e6])
    absorption, scattering = (x.ravel() for x in np.meshgrid(depths, depths))
    held = holds(absorption, scattering, bits)
    assert held.sum() > 15
    solver = ij.RadiativeExact(n_panels=22)
    run = quick_jit(lambda x: solver.solve(x, ij.DEPTH_RESOLVED, jnp.asarray(1.0, float)))
    good = run(
        layers(0.0, np.where(held, absorption, 1.0), np.where(held, scattering, 1.0), MEDIA["iris"])
    )
    check(good, bits)
    assert bool(good.status == ij.RESULTS.successful)
    if bits == 32:
        everything = run(layers(0.0, absorption, scattering, MEDIA["iris"]))
        assert bool(everything.status == ij.RESULTS.ill_conditioned)
        assert all(
            np.isfinite(x).all()
            for x in jax.tree.leaves((everything.reflectance, everything.absorbed))
        )
        np.testing.assert_allclose(everything.energy, 1, rtol=0, atol=1e-6)


MONOTONIC = ("lb06", "rayleigh")


@pytest.mark.parametrize("name", [*MONOTONIC, "depth-resolved"])
def test_monotonic(name):
    """More absorption is never brighter; in depth-resolved transport more scatterers in matched
    media never darker.
    """
    steps = np.geomspace(1e-9, 2.0, 60)
    deep = name == "depth-resolved"
    solver = ij.RadiativeExact(n_panels=1) if deep else ij.IlitExact()
    run = quick_jit(lambda x: solver.solve(x, PROCESSES[name], jnp.asarray(1.0)).reflectance)
    for abl, absorption, scattering in ((steps, 0.1, 0.3), (0.05, steps, 0.3)):
        if name != "depth-resolved" and abl is not steps:
            # ILIT's whole-layer tests let weak absorption help: P grows with it while few events
            # absorb.
            continue
        r = np.asarray(run(layers(abl, absorption, scattering, MEDIA["iris"])))
        assert (np.diff(r) <= 1e-14).all()
    matched = np.asarray(run(layers(0.05, 0.1, steps, MEDIA["all-equal"])))
    assert (np.diff(matched) > 0).all()


# Irides at the edges.
BASE = ij.Iris.of_level("low")
BARE = {"oxyhemoglobin": 0.0, "deoxyhemoglobin": 0.0, "lutein": 0.0, "zeaxanthin": 0.0}
EDGES = {
    "plain": {},
    "no-melanin": {"eumelanin": 0.0, "pheomelanin": 0.0},
    "no-pigment": {"eumelanin": 0.0, "pheomelanin": 0.0, **BARE},
    "abl-fraction-0": {"abl_fraction": 0.0},
    "abl-fraction-1": {"abl_fraction": 1.0},
    "no-abl": {"abl_thickness": 0.0},
    "no-stroma": {"stroma_thickness": 0.0},
    "no-layers": {"abl_thickness": 0.0, "stroma_thickness": 0.0},
    "no-scattering": {"collagen_index": 1.5},
    "nothing-at-all": {"eumelanin": 0.0, "pheomelanin": 0.0, **BARE, "collagen_index": 1.5},
    "no-intensification": {"intensification": 1e-30},
    "melanin-1e6": {"eumelanin": 1e6},
    "blood-1e6": {"oxyhemoglobin": 1e6},
    "all-1e6": {"eumelanin": 1e6, "pheomelanin": 1e6, "lutein": 1e6},
    "equal-indices": {
        "abl_index": 1.4,
        "stroma_index": 1.4,
        "ipe_index": 1.4,
    },
    "abl-is-stroma": {"abl_index": 1.4727, "stroma_index": 1.4727},
    "guided-stroma": {"stroma_index": 1.6, "abl_index": 1.4},
    "total-at-ipe": {"ipe_index": 1.3},
}


def edge(name):
    fields = {"abl_index": BASE.indices().abl, "stroma_index": BASE.indices().stroma, **EDGES[name]}
    return {n: float(fields.get(n, getattr(BASE, n))) for n in LIMITS}


VECTORS = {e: np.array([edge(e)[n] for n in LIMITS]) for e in EDGES}
"""Made once, in double precision."""


def as_vector(name):
    return VECTORS[name]


def reflectance_of(vector, process, solver, cosine=1.0):
    """Everything traced: the iris is built inside the program."""
    iris = ij.Iris(**dict(zip(LIMITS, vector, strict=True)))
    return ij.reflectance(
        iris,
        GRID[::6],
        process=process,
        solver=solver,
        cos_incidence=cosine,
        throw=False,
    )


SOME = ("plain", "no-layers", "nothing-at-all", "equal-indices", "guided-stroma", "all-1e6")


@pytest.mark.parametrize(
    ("name", "edges", "bits"),
    [
        ("lb06", SOME, 64),
        ("rayleigh-retest", SOME, 64),
        ("rayleigh-retest", SOME, 32),
        ("depth-resolved", SOME, 64),
        *(pytest.param(n, tuple(EDGES), b, marks=SWEEP) for n in PROCESSES for b in (64, 32)),
    ],
)
def test_edge_irides(name, edges, bits):
    vectors = jnp.asarray(np.stack([as_vector(e) for e in edges]), jnp.result_type(float))
    # The printed phase function builds its operator for every iris whose indices are traced: keep
    # it small.
    solver = ij.IlitExact(12) if name.startswith("lb06") else exact(PROCESSES[name])
    run = quick_jit(
        jax.vmap(lambda v, c: reflectance_of(v, PROCESSES[name], solver, c), in_axes=(0, None))
    )
    for cosine in COSINES:
        r = run(vectors, jnp.asarray(cosine, float))
        values = np.asarray(r.values)
        assert np.isfinite(values).all()
        total = sum(
            np.asarray(x).astype(np.float64) for x in jax.tree.leaves((r.values, r.absorbed))
        )
        np.testing.assert_allclose(total, 1, rtol=0, atol=TINY[bits])
        fine = np.asarray(r.status == ij.RESULTS.successful)
        for i, e in enumerate(edges):
            deep = name == "depth-resolved" and e in ("melanin-1e6", "blood-1e6", "all-1e6")
            assert fine[i] != deep, e
            if not deep:
                assert values[i].min() >= 0, e
                assert values[i].max() <= 1, e


def test_edge_irides_tabulated(tabulated):
    same = [
        e
        for e in EDGES
        if not {"abl_index", "stroma_index", "ipe_index", "collagen_index"} & set(EDGES[e])
    ]
    irides = stack([ij.Iris.of_level("low").replace(**EDGES[e]) for e in same])

    def run(solver):
        f = jax.vmap(lambda iris: ij.reflectance(iris, GRID, solver=solver, throw=False))
        return quick_jit(f)(irides)

    found, true = run(tabulated), run(ij.IlitExact(n_angles=64))
    assert bool((found.status == ij.RESULTS.successful).all())
    np.testing.assert_allclose(found.values, true.values, rtol=0, atol=8 * tabulated.error)
    total = sum(np.asarray(x) for x in jax.tree.leaves((found.values, found.absorbed)))
    np.testing.assert_allclose(total, 1, rtol=0, atol=1e-12)


@pytest.mark.parametrize("n", [1, 4_000, pytest.param(100_000, marks=SWEEP)])
def test_number_of_wavelengths(n):
    grid = np.array([700.0]) if n == 1 else np.linspace(400, 700, n)
    for process in (ij.ILIT_2006, ij.DEPTH_RESOLVED) if n != 4_000 else (ij.ILIT_2006,):
        if n > 1 and isinstance(process, ij.RadiativeTransfer):
            grid = grid[::20]
        values = spectrum_of(grid, process)
        assert values.shape == grid.shape
        assert ((values > 0) & (values < 1)).all()
        one = spectrum_of(grid[-1:], process)[0]
        assert values[-1] == pytest.approx(float(one), rel=1e-13)


@functools.cache
def _spectrum(process, *grid):
    return quick_jit(lambda x: ij.reflectance(x, np.array(grid), process=process).values)


def spectrum_of(grid, process):
    return np.asarray(_spectrum(process, *grid.tolist())(BASE))


# Gradients. Steps are chosen by field; where a field stands at an edge the difference is one-sided.
SCALE = {
    "eumelanin": 0.1,
    "pheomelanin": 0.1,
    "abl_fraction": 0.1,
    "lutein": 0.1,
    "zeaxanthin": 0.1,
}
NEAR_ZERO = ("abl_thickness", "stroma_thickness")
INDEX_FIELDS = (
    *tuple(n for n in LIMITS if n.endswith("_index")),
    "fibroblast_fraction",
    "collagen_fraction",
)
# Loads of a million: the derivative is far below the rounding of the value; only finiteness is
# asked there.
ONLY_FINITE = ("melanin-1e6", "blood-1e6", "all-1e6", "no-intensification")
# Where two indices agree, reflectance has a kink in them (a critical angle appears on one side
# only).
KINKED = {
    "equal-indices": INDEX_FIELDS, "abl-is-stroma": ("abl_index", "stroma_index"), "no-scattering": ("collagen_index", "base_index"),
    "nothing-at-all": ("collagen_index", "base_index"),
}  # fmt: skip


# An empty stroma between mirrors: grazing rays make reflectance go as τ ln τ, whose slope at 0 is
# infinite.
NO_SLOPE = ("no-layers", "nothing-at-all")


def stencil(field, value):
    """Offsets and weights of a difference of fourth order (central), or of first order and a tiny
    step (at an edge).
    """
    low, high = LIMITS[field].low, LIMITS[field].high
    if value <= low or value >= high:
        # Layer functions go as τ ln τ beside zero depth: no difference of high order converges
        # there.
        h = 1e-9 if field in SCALE or field.endswith(("thickness", "hemoglobin")) else 1e-7
        h = h if value <= low else -h
        return np.array([0.0, h]), np.array([-1.0, 1.0]) / h
    h = 1e-3 * (value if value else 1.0) if field not in INDEX_FIELDS else 5e-6
    return np.array([-2, -1, 1, 2]) * h, np.array([1, -8, 8, -1]) / (12 * h)


TEMPLATE = ij.Iris(**edge("plain"))
LEAVES, TREE = jax.tree.flatten(TEMPLATE)
ORDERS = {e: ij.Iris(**edge(e)).order for e in EDGES}


@pytest.mark.parametrize(
    ("name", "traced_order", "edges"),
    [
        ("rayleigh", False, ("plain", "no-stroma", "nothing-at-all")),
        *(
            pytest.param(n, traced, tuple(EDGES), marks=SWEEP)
            for n, traced in (
                ("lb06", False), ("rayleigh", False), ("rayleigh", True), ("rayleigh-retest", True), ("rayleigh-redrawn", True), ("lb06-retest", False), ("lb06-redrawn", False),
                ("depth-resolved", True), ("depth-resolved", False),
            )
        ),
    ],
)  # fmt: skip
def test_gradients(name, traced_order, edges):
    """Forward mode, reverse mode and finite differences agree for every field, in one vmapped
    program each.

    Either the iris is built outside and all its leaves are batched (its order of media is known),
    or it is built inside the program from traced numbers (any order is possible).
    """
    process, solver = PROCESSES[name], exact(PROCESSES[name], 24)
    asked, edges = edges, [e for e in edges if not (name == "depth-resolved" and e in ONLY_FINITE)]
    if not traced_order:
        edges = [e for e in edges if ORDERS[e] == TEMPLATE.order]
    assert len(edges) >= min(9, len(asked) - 1)
    vectors = np.stack([as_vector(e) for e in edges])

    def values(v):
        iris = (
            ij.Iris(**dict(zip(LIMITS, v, strict=True)))
            if traced_order
            else jax.tree.unflatten(TREE, list(v))
        )
        return ij.reflectance(iris, GRID[::6], process=process, solver=solver, throw=False).values

    forward = np.asarray(quick_jit(jax.vmap(jax.jacfwd(values)))(jnp.asarray(vectors)))
    reverse = np.asarray(quick_jit(jax.vmap(jax.jacrev(values)))(jnp.asarray(vectors)))
    run = quick_jit(jax.vmap(values))
    batch, index = [], []
    for i in range(len(edges)):
        for j, field in enumerate(LIMITS):
            offsets, weights = stencil(field, vectors[i, j])
            for o, w in itertools.zip_longest(offsets, weights):
                moved = vectors[i].copy()
                moved[j] += o
                batch.append(moved)
                index.append((i, j, w))
    outcome = np.asarray(run(jnp.asarray(np.stack(batch))))
    difference = np.zeros_like(forward)
    for (i, j, w), v in zip(index, outcome, strict=True):
        difference[i, :, j] += w * v

    problems = []
    for i, e in enumerate(edges):
        for j, field in enumerate(LIMITS):
            f, r, d = forward[i, :, j], reverse[i, :, j], difference[i, :, j]
            _, weights = stencil(field, vectors[i, j])
            if not (np.isfinite(f).all() and np.isfinite(r).all()):
                problems.append(f"{e} {field}: not finite, forward {f}, reverse {r}")
                continue
            # Rounding of the values over the step is all that is forgiven beside 1e-5.
            noise = 2e-15 * np.abs(weights).sum()
            if not np.allclose(
                f,
                r,
                rtol=1e-9,
                atol=1e-9 if field in KINKED.get(e, ()) else 1e-13 * max(1.0, np.abs(f).max()),
            ):
                problems.append(f"{e} {field}: forward {f} reverse {r}")
            if e in ONLY_FINITE or e in NO_SLOPE or field in KINKED.get(e, ()):
                continue
            if not (np.abs(f - d) <= 1e-5 * np.abs(d) + noise).all():
                problems.append(f"{e} {field}: derivative {f} difference {d}")
    assert not problems, "\n".join(problems)


@SWEEP
@pytest.mark.parametrize("name", ["rayleigh", "lb06"])
def test_gradients_in_single_precision_are_finite(name, float32):
    names = [e for e in EDGES if name == "rayleigh" or ORDERS[e] == TEMPLATE.order]
    vectors = jnp.asarray(np.stack([as_vector(e) for e in names]), jnp.float32)

    def values(v):
        if name == "rayleigh":
            return reflectance_of(v, PROCESSES[name], None).values
        iris = jax.tree.unflatten(TREE, list(v))
        return ij.reflectance(iris, GRID[::6], process=PROCESSES[name], throw=False).values

    g = quick_jit(jax.vmap(jax.jacfwd(values)))(vectors)
    bad = [
        (e, f)
        for i, e in enumerate(names)
        for j, f in enumerate(LIMITS)
        if not np.isfinite(np.asarray(g)[i, :, j]).all()
    ]
    assert not bad


@SWEEP
def test_tabulated_gradients_at_edges(tabulated):
    names = [
        e
        for e in EDGES
        if not {"abl_index", "stroma_index", "ipe_index", "collagen_index"} & set(EDGES[e])
    ]
    fields = (
        "eumelanin",
        "pheomelanin",
        "abl_fraction",
        "oxyhemoglobin",
        "lutein",
        "abl_thickness",
        "stroma_thickness",
    )
    vectors = jnp.asarray([[getattr(BASE.replace(**EDGES[e]), f) for f in fields] for e in names])

    def slopes(solver):
        def f(v):
            return ij.reflectance(
                BASE.replace(**dict(zip(fields, v, strict=True))), GRID[::6], solver=solver
            ).values

        return np.asarray(quick_jit(jax.vmap(jax.jacfwd(f)))(vectors))

    found, true = slopes(tabulated), slopes(ij.IlitExact(n_angles=64))
    assert np.isfinite(found).all()
    sloping = [i for i, e in enumerate(names) if e not in NO_SLOPE]
    found, true = found[sloping], true[sloping]
    scale = np.abs(true).max(axis=(0, 1))
    np.testing.assert_allclose(found / scale, true / scale, rtol=0, atol=1e-5)
