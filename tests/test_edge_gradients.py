"""Irides at the edges of the physics: energy, status, gradients forward, reverse and by differences."""

import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import irisjax as ij
from common import GRID, PROCESSES, exact, quick_jit, slowly, stack
from edges import (
    BASE,
    COSINES,
    EDGES,
    NO_SLOPE,
    NUMBERS,
    OF_DEPTHS,
    SAME_MEDIA,
    TINY,
    VECTORS,
    edge,
)
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


def built(vector):
    """The iris is built inside the program, from traced numbers: any order of media is possible."""
    return ij.Iris(**dict(zip(NUMBERS, vector, strict=True)))


def replaced(iris, vector):
    """With other numbers, and the order of media that it has."""
    return eqx.tree_at(lambda i: [getattr(i, n) for n in NUMBERS], iris, list(vector))


CASES = pytest.mark.parametrize(
    ("name", "traced_order"),
    [("rayleigh-retest", True), slowly("lb06-redrawn", False), slowly("depth-resolved", True)],
)


def values(name, traced_order):
    """Spectra as a function of an iris's numbers; otherwise its order of media is known."""
    solver = exact(PROCESSES[name], 12)

    def of(v):
        iris = built(v) if traced_order else replaced(TEMPLATE, v)
        return ij.reflectance(iris, GRID[::6], solver=solver, throw=False).values

    return of


def kept(name, traced_order):
    """The edges of a case, and their irides' numbers."""
    edges = [e for e in EDGES if not (name == "depth-resolved" and e in ONLY_FINITE)]
    if not traced_order:
        edges = [e for e in edges if ORDERS[e] == TEMPLATE.order]
    assert len(edges) >= 9
    return edges, np.stack([VECTORS[e] for e in edges])


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
    vectors = jnp.asarray(np.stack(list(VECTORS.values())), jnp.float32)
    found = quick_jit(jax.vmap(jax.jacfwd(values("rayleigh", True))))(vectors)
    bad = np.argwhere(~np.isfinite(np.asarray(found)).all(1))
    assert [(list(EDGES)[i], NUMBERS[j]) for i, j in bad] == []


@pytest.mark.parametrize(
    ("name", "bits"), [("lb06", 64), ("rayleigh-retest", 32), ("depth-resolved", 64)]
)
def test_energy_and_status(name, bits):
    vectors = jnp.asarray(np.stack(list(VECTORS.values())), jnp.result_type(float))
    # Traced irides do not tell how many panels they take.
    panelled = ij.RadiativeExact(12, n_panels=5)
    solver = panelled if name == "depth-resolved" else exact(PROCESSES[name], 12)

    @quick_jit
    @functools.partial(jax.vmap, in_axes=(0, None))
    def run(v, cosine):
        grid = GRID[::6]
        return ij.reflectance(built(v), grid, solver=solver, cos_incidence=cosine, throw=False)

    for cosine in COSINES:
        found = run(vectors, jnp.asarray(cosine, float))
        assert np.asarray(found.status == ij.RESULTS.successful).all()
        assert np.isfinite(found.values).all()
        assert found.values.min() >= 0 and found.values.max() <= 1
        parts = jax.tree.leaves((found.values, found.absorbed))
        total = sum(np.asarray(x).astype(np.float64) for x in parts)
        np.testing.assert_allclose(total, 1, rtol=0, atol=TINY[bits])


def test_tabulated_values_and_gradients(tabulated):
    irides = stack([BASE.replace(**EDGES[e]) for e in SAME_MEDIA])
    depths = jnp.stack([getattr(irides, n) for n in OF_DEPTHS], -1)

    def run(solver):
        def measured(v, iris):
            iris = iris.replace(**dict(zip(OF_DEPTHS, v, strict=True)))
            return ij.reflectance(iris, GRID, solver=solver, throw=False)

        def both(v, iris):
            return measured(v, iris), jax.jacfwd(lambda v: measured(v, iris).values)(v)

        return quick_jit(jax.vmap(both))(depths, irides)

    (found, slopes), (true, true_slopes) = run(tabulated), run(ij.IlitExact(n_angles=64))
    assert bool((found.status == ij.RESULTS.successful).all())
    np.testing.assert_allclose(found.values, true.values, rtol=0, atol=8 * tabulated.error)
    total = sum(np.asarray(x) for x in jax.tree.leaves((found.values, found.absorbed)))
    np.testing.assert_allclose(total, 1, rtol=0, atol=1e-12)
    assert np.isfinite(slopes).all()
    sloping = np.array([e not in NO_SLOPE for e in SAME_MEDIA])
    slopes, true_slopes = slopes[sloping], true_slopes[sloping]
    scale = np.abs(true_slopes).max(axis=(0, 1))
    np.testing.assert_allclose(slopes / scale, true_slopes / scale, rtol=0, atol=1e-5)
