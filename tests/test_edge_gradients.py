"""Gradients of irides at the edges of the physics: forward, reverse, and by differences."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import GRID, PROCESSES, exact, quick_jit
from edges import BASE, EDGES, NO_SLOPE, OF_DEPTHS, SAME_MEDIA, SWEEP, as_vector, edge
from irisjax.tissue.iris import LIMITS

# Steps are chosen by field; where a field stands at an edge the difference is one-sided.
SCALE = ("eumelanin", "pheomelanin", "abl_fraction", "lutein", "zeaxanthin")
INDEX_FIELDS = (
    *(n for n in LIMITS if n.endswith("_index")), "fibroblast_fraction", "collagen_fraction",
)  # fmt: skip
# Loads of a million: the derivative is far below the rounding of the value; only finiteness is
# asked there.
ONLY_FINITE = ("most-melanin", "most-blood", "most-of-all", "no-intensification")
# Where two indices agree, reflectance has a kink in them (a critical angle appears on one side
# only).
KINKED = {
    "equal-indices": INDEX_FIELDS, "abl-is-stroma": ("abl_index", "stroma_index"), "no-scattering": ("collagen_index", "base_index"),
    "nothing-at-all": ("collagen_index", "base_index"),
}  # fmt: skip


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
ORDERS = {e: ij.Iris(**edge(e)).order for e in EDGES}


def replaced(iris, vector):
    """With other numbers, and the order of media that it has."""
    return eqx.tree_at(lambda i: [getattr(i, n) for n in LIMITS], iris, list(vector))


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
    solver = exact(PROCESSES[name], 12)
    asked, edges = edges, [e for e in edges if not (name == "depth-resolved" and e in ONLY_FINITE)]
    if not traced_order:
        edges = [e for e in edges if ORDERS[e] == TEMPLATE.order]
    assert len(edges) >= min(9, len(asked) - 1)
    vectors = np.stack([as_vector(e) for e in edges])

    def values(v):
        iris = (
            ij.Iris(**dict(zip(LIMITS, v, strict=True))) if traced_order else replaced(TEMPLATE, v)
        )
        return ij.reflectance(iris, GRID[::6], solver=solver, throw=False).values

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
            # Beside a kink what is subtracted cancels to half of its digits.
            kinked = field in KINKED.get(e, ())
            atol = 1e-8 if kinked else 1e-13 * max(1.0, np.abs(f).max())
            if not np.allclose(f, r, rtol=1e-9, atol=atol):
                problems.append(f"{e} {field}: forward {f}, reverse off by {r - f}")
            if e in ONLY_FINITE or e in NO_SLOPE or kinked:
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
        traced = name == "rayleigh"
        iris = ij.Iris(**dict(zip(LIMITS, v, strict=True))) if traced else replaced(TEMPLATE, v)
        return ij.reflectance(iris, GRID[::6], solver=exact(PROCESSES[name]), throw=False).values

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
    vectors = jnp.asarray(
        [[getattr(BASE.replace(**EDGES[e]), f) for f in OF_DEPTHS] for e in SAME_MEDIA]
    )

    def slopes(solver):
        def f(v):
            return ij.reflectance(
                BASE.replace(**dict(zip(OF_DEPTHS, v, strict=True))), GRID[::6], solver=solver
            ).values

        return np.asarray(quick_jit(jax.vmap(jax.jacfwd(f)))(vectors))

    found, true = slopes(tabulated), slopes(ij.IlitExact(n_angles=64))
    assert np.isfinite(found).all()
    sloping = [i for i, e in enumerate(SAME_MEDIA) if e not in NO_SLOPE]
    found, true = found[sloping], true[sloping]
    scale = np.abs(true).max(axis=(0, 1))
    np.testing.assert_allclose(found / scale, true / scale, rtol=0, atol=1e-5)
