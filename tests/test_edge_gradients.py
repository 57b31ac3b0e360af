"""Gradients of irides at the edges of the physics: forward, reverse, and by differences."""

import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import GRID, PROCESSES, exact, quick_jit, slowly
from edges import BASE, EDGES, NO_SLOPE, NUMBERS, OF_DEPTHS, SAME_MEDIA, as_vector, edge
from irisjax.tissue.iris import LIMITS

pytestmark = pytest.mark.peer

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
    return eqx.tree_at(lambda i: [getattr(i, n) for n in NUMBERS], iris, list(vector))


CASES = pytest.mark.parametrize(
    ("name", "traced_order"),
    [("rayleigh-retest", True), slowly("lb06-redrawn", False), slowly("depth-resolved", True)],
)


def values(name, traced_order):
    """Spectra as a function of an iris's numbers.

    Either the iris is built outside and all its leaves are batched (its order of media is known),
    or it is built inside the program from traced numbers (any order is possible).
    """
    solver = exact(PROCESSES[name], 12)

    def of(v):
        iris = (
            ij.Iris(**dict(zip(NUMBERS, v, strict=True))) if traced_order else replaced(TEMPLATE, v)
        )
        return ij.reflectance(iris, GRID[::6], solver=solver, throw=False).values

    return of


def kept(name, traced_order):
    """The edges of a case, and their irides' numbers."""
    edges = [e for e in EDGES if not (name == "depth-resolved" and e in ONLY_FINITE)]
    if not traced_order:
        edges = [e for e in edges if ORDERS[e] == TEMPLATE.order]
    assert len(edges) >= 9
    return edges, np.stack([as_vector(e) for e in edges])


@functools.cache
def forward_mode(name, traced_order):
    run = quick_jit(jax.vmap(jax.jacfwd(values(name, traced_order))))
    return np.asarray(run(kept(name, traced_order)[1]))


def fields_of(edges):
    """Edges and fields, their places, and whether there is a kink."""
    for (i, e), (j, field) in itertools.product(enumerate(edges), enumerate(NUMBERS)):
        yield i, j, e, field, field in KINKED.get(e, ())


@CASES
def test_gradients_are_those_of_differences(name, traced_order):
    forward = forward_mode(name, traced_order)
    edges, vectors = kept(name, traced_order)
    batch, index = [], []
    for i, j, _, field, _ in fields_of(edges):
        for o, w in zip(*stencil(field, vectors[i, j]), strict=True):
            moved = vectors[i].copy()
            moved[j] += o
            batch.append(moved)
            index.append((i, j, w))
    outcome = np.asarray(quick_jit(jax.vmap(values(name, traced_order)))(np.stack(batch)))
    difference = np.zeros_like(forward)
    for (i, j, w), v in zip(index, outcome, strict=True):
        difference[i, :, j] += w * v
    for i, j, e, field, kinked in fields_of(edges):
        f, d = forward[i, :, j], difference[i, :, j]
        assert np.isfinite(f).all(), (e, field)
        if e in ONLY_FINITE or e in NO_SLOPE or kinked:
            continue
        # Rounding of the values over the step is all that is forgiven beside 1e-5.
        noise = 2e-15 * np.abs(stencil(field, vectors[i, j])[1]).sum()
        assert (np.abs(f - d) <= 1e-5 * np.abs(d) + noise).all(), (e, field, f, d)


@CASES
def test_gradients_in_reverse_are_those_forward(name, traced_order):
    forward = forward_mode(name, traced_order)
    edges, vectors = kept(name, traced_order)
    reverse = np.asarray(quick_jit(jax.vmap(jax.jacrev(values(name, traced_order))))(vectors))
    for i, j, e, field, kinked in fields_of(edges):
        f, r = forward[i, :, j], reverse[i, :, j]
        # Beside a kink what is subtracted cancels to half of its digits.
        atol = 1e-8 if kinked else 1e-13 * max(1.0, np.abs(f).max())
        np.testing.assert_allclose(r, f, rtol=1e-9, atol=atol, err_msg=f"{e} {field}")


def test_gradients_in_single_precision_are_finite(float32):
    vectors = jnp.asarray(np.stack([as_vector(e) for e in EDGES]), jnp.float32)
    g = quick_jit(jax.vmap(jax.jacfwd(values("rayleigh", True))))(vectors)
    bad = [
        (e, f)
        for i, e in enumerate(EDGES)
        for j, f in enumerate(NUMBERS)
        if not np.isfinite(np.asarray(g)[i, :, j]).all()
    ]
    assert not bad


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
