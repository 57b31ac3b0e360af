"""Run by test_composition.py with four devices: solvers on meshes against the same without.

Prints, as JSON, the largest difference by name, or the error, of the cases whose names begin with
one of the arguments.
"""

import json
import sys
import traceback
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

import irisjax as ij

GRID = np.linspace(420.0, 660.0, 8)
KEY = jax.random.key(0)
BATCH = jnp.linspace(0.1, 2.0, 8)
SPLIT = PartitionSpec("d")
AUTO = jax.make_mesh((4,), ("d",), axis_types=(AxisType.Auto,))
EXPLICIT = jax.make_mesh((4,), ("d",), axis_types=(AxisType.Explicit,))
SOLVERS = {
    "exact": ij.IlitExact(8),
    "rayleigh": ij.IlitExact(8, process=ij.ILIT_CORRECTED),
    "retest": ij.IlitExact(8, process=ij.Ilit(rescatter="retest")),
    "tabulated": ij.IlitTabulated.build(tolerance=1e-2, n_intervals=16, n_albedos=4),
    "radiative": ij.RadiativeExact(8, 4),
    "polarised": ij.RadiativeExact(8, 4, process=ij.POLARISED),
    "monte carlo": ij.MonteCarlo(200, lanes=16),
}


def values(solver, eumelanin, grid=GRID):
    iris = ij.Iris().replace(eumelanin=eumelanin)
    return ij.reflectance(iris, grid, solver=solver, key=KEY, throw=False).values


def over_shards(f, x):
    return jax.jit(jax.shard_map(f, mesh=AUTO, in_specs=SPLIT, out_specs=SPLIT, check_vma=True))(x)


def difference(found, expected):
    return float(np.abs(np.asarray(found) - np.asarray(expected)).max())


def irides(run):
    return difference(over_shards(jax.vmap(run), BATCH), jax.jit(jax.vmap(run))(BATCH))


def wavelengths(run):
    f = partial(run, 0.1)
    each = [jax.jit(f)(part) for part in jnp.asarray(GRID).reshape(4, 2)]
    return difference(over_shards(f, jnp.asarray(GRID)), jnp.concatenate(each))


def explicit(run):
    expected = jax.jit(jax.vmap(run))(BATCH)
    with jax.set_mesh(EXPLICIT):
        found = jax.jit(jax.vmap(run))(jax.device_put(BATCH, NamedSharding(EXPLICIT, SPLIT)))
    assert found.sharding.spec[0] == "d", found.sharding
    return difference(found, expected)


def derivatives():
    def loss(x):
        return sum(values(SOLVERS[name], x).sum() for name in ("exact", "tabulated", "radiative"))

    f = jax.vmap(jax.grad(loss))
    expected = jax.jit(f)(BATCH)
    with jax.set_mesh(EXPLICIT):
        found = jax.jit(f)(jax.device_put(BATCH, NamedSharding(EXPLICIT, SPLIT)))
    return max(difference(found, expected), difference(over_shards(f, BATCH), expected))


def photons():
    """Counts of photons dealt to four devices against one, all bits."""
    layers = ij.Iris.of_level("low").layers(ij.extinction(GRID))
    worst = 0.0
    for process in (ij.ILIT_2006, ij.DEPTH_RESOLVED):
        one, four = (
            ij.MonteCarlo(5_000, lanes=64, mesh=mesh, process=process).count(
                layers, ij.Light(1.0), key=KEY
            )
            for mesh in (None, ij.photon_mesh())
        )
        worst = max(worst, difference(one.fates, four.fates))
    return worst


def photons_of_a_caller():
    """Blocks of photons dealt out by a caller's own `shard_map`, summed over its mesh."""
    layers = ij.Iris.of_level("low").layers(ij.extinction(GRID))
    solver = ij.MonteCarlo(4_000, lanes=64)

    def block(first):
        first = first[0]
        counts = solver.count(layers, ij.Light(1.0), key=KEY, first=first, last=first + 1_000)
        return jax.lax.psum(counts.fates, "d")

    first = jnp.arange(4, dtype=jnp.int32) * 1_000
    dealt = jax.shard_map(
        block, mesh=AUTO, in_specs=SPLIT, out_specs=PartitionSpec(), check_vma=True
    )
    whole = solver.count(layers, ij.Light(1.0), key=KEY)
    return difference(jax.jit(dealt)(first), whole.fates)


def main():
    cases = {}
    for name, solver in SOLVERS.items():
        run = partial(values, solver)
        cases[f"{name}: shard_map over irides"] = partial(irides, run)
        cases[f"{name}: shard_map over wavelengths"] = partial(wavelengths, run)
        cases[f"{name}: explicit mesh of irides"] = partial(explicit, run)
    cases["derivatives"] = derivatives
    cases["photons"] = photons
    cases["photons in a caller's sharding"] = photons_of_a_caller
    found = {}
    for name, case in cases.items():
        if not name.startswith(tuple(sys.argv[1:])):
            continue
        try:
            found[name] = case()
        except Exception:
            found[name] = traceback.format_exc()[-1500:]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
