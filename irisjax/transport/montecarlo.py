"""Analogue Monte Carlo: photons followed event by event, with standard errors.

Photons are dealt out by their index, over a mesh of devices where the caller gives one; integer
counts do not depend on how.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Int

from irisjax._types import PRNGKey
from irisjax.numerics.checks import check_whole
from irisjax.numerics.sharding import call_with_layout
from irisjax.numerics.streams import check_key, scales
from irisjax.tissue.layers import Layers
from irisjax.transport import lanes
from irisjax.transport.ilit.analog import ilit_event
from irisjax.transport.light import Directions, Light, first_surface
from irisjax.transport.process import ILIT_2006, AbstractProcess, Ilit, RadiativeTransfer
from irisjax.transport.radiative.analog import radiative_event
from irisjax.transport.solution import Absorbed, Solution, outcome
from irisjax.transport.solver import AbstractSolver, check_layers

_LIMIT = 2**31 - 2**20  # counts are int32; lanes look a stride ahead


class Counts(NamedTuple):
    """Photons by fate: `fates` (wavelengths, fates) as in `lanes.FATES`, without the last over a
    black epithelium; `exits` (wavelengths, exits) or `None`; and `photons` sent (wavelengths,).
    Counts of disjoint blocks of photons add.
    """

    fates: Int[Array, "wavelengths fates"]
    exits: Int[Array, "wavelengths exits"] | None
    photons: Int[Array, " wavelengths"]


class MonteCarlo(AbstractSolver):
    """Analogue sampling of any process of unpolarised light; needs a `key`, and has no derivatives.

    Arithmetic is float32 whatever the iris's precision; counts are integers. Where the light has a
    `power` (an illuminant's), the photons at each wavelength are in proportion to it, at most
    `n_photons`. The BRDF is the average over cells of the cosine bounded half-way between the exits
    requested.

    Attributes:
        n_photons: Photons a wavelength, up to 2.1e9 a call.
        lanes: Photons followed at once; affects speed and memory only (about 100 bytes each).
            Default 16,384, on an accelerator 131,072.
        mesh: Devices to deal the photons to, or `None` for where the program runs; see
            `photon_mesh`.
        process: `ILIT_2006`, `ILIT_CORRECTED`, `DEPTH_RESOLVED`, or another `Ilit` or
            `RadiativeTransfer`.
    """

    n_photons: int = eqx.field(static=True)
    lanes: int | None = eqx.field(static=True, default=None)
    mesh: Mesh | None = eqx.field(static=True, default=None)
    process: AbstractProcess = eqx.field(default=ILIT_2006, kw_only=True)

    def __check_init__(self) -> None:
        check_whole("n_photons", self.n_photons, 1, _LIMIT)
        if self.lanes is not None:
            check_whole("lanes", self.lanes, 16)
        if not isinstance(self.process, (Ilit, RadiativeTransfer)):
            message = f"MonteCarlo has no events of {self.process!r}"
            raise ValueError(f"{message}; known: Ilit, RadiativeTransfer")
        if self.process.polarised:
            raise ValueError("MonteCarlo does not treat polarised light; use RadiativeExact")

    def solve(self, layers: Layers, light: Light, *, key: PRNGKey | None = None) -> Solution:
        return self.summarise(self.count(layers, light, key=key), layers, light.exits)

    def count(
        self,
        layers: Layers,
        light: Light,
        *,
        key: PRNGKey | None,
        first: Array | int = 0,
        last: Array | int | None = None,
    ) -> Counts:
        """Follow photons `first` to `last` (default all) and count their fates; blocks of them add.

        `first` and `last` may be traced.
        """
        check_key(key)
        if isinstance(self.process, Ilit):
            check_layers(self, layers)
        elif light.exits is not None:
            raise ValueError("MonteCarlo has no BRDF of radiative transfer; use RadiativeExact")
        layers, light = _constant((layers, light))
        cells = None if light.exits is None else _cells(light.exits)
        power = jnp.ones_like(layers.extinction) if light.power is None else light.power
        share = (power / jnp.max(power)).astype(jnp.result_type(float))
        numbers = jnp.maximum(jnp.ceil(self.n_photons * share), 1).astype(jnp.int32)
        start = jnp.asarray(first, jnp.int32)
        end = numbers if last is None else jnp.minimum(jnp.asarray(last, jnp.int32), numbers)
        mirrored = first_surface(light, layers.indices, layers.extinction.dtype)[0]
        incidence = -1.0 if light.cosine is None else light.cosine
        return call_with_layout(
            lambda *x: _count(*x, self),
            layers.extinction,
            *(key, layers, mirrored, incidence, start, end, cells, scales()),
        )

    def summarise(
        self, counts: Counts, layers: Layers, exits: Directions | None = None
    ) -> Solution:
        """Compute shares and standard errors from counts."""
        dtype = layers.extinction.dtype
        n, fates = counts.photons.astype(dtype)[:, None], counts.fates.astype(dtype)
        brdf = brdf_error = None
        if counts.exits is not None and exits is not None:
            cells, exit_counts = _cells(exits).astype(dtype), counts.exits.astype(dtype)
            scale = jnp.pi * (cells[:, 1] ** 2 - cells[:, 0] ** 2)[None]
            brdf, brdf_error = exit_counts / n / scale, _binomial_error(exit_counts, n) / scale
        mirrored, reflected, abl, stroma, ipe, *behind = (fates / n).T
        errors = _binomial_error(fates, n)
        total = fates[:, :2].sum(1, keepdims=True)
        return Solution(
            reflected,
            mirrored,
            Absorbed(abl, stroma, ipe),
            outcome(layers.valid()),
            standard_error=errors[:, 1],
            total_error=_binomial_error(total, n)[:, 0],
            brdf=brdf,
            brdf_error=brdf_error,
            transmitted=behind[0] if behind else None,
            transmitted_error=errors[:, 5] if behind else None,
        )


@eqx.filter_custom_jvp
def _constant(tree):
    return tree


@_constant.def_jvp
def _constant_jvp(primals, tangents):
    raise NotImplementedError(
        "MonteCarlo has no derivatives: counts of photons do not change smoothly. "
        "Use an exact solver"
    )


def _binomial_error(count: Array, n: Array) -> Array:
    """Standard error of a share of `n` photons; by Laplace's rule, so that a count of 0 has one."""
    p = (count + 1) / (n + 2)
    return jnp.sqrt(p * (1 - p) / n)


def _cells(exits: Directions):
    """Lower and upper cosine round each exit, half-way to the nearest other ones, (exits, 2)."""
    c = exits.cosine
    gap = c[None, :] - c[:, None]
    distinct = jnp.abs(gap) > 1e-6
    lower = jnp.where(distinct & (gap < 0), c[None, :], -jnp.inf).max(1)
    upper = jnp.where(distinct & (gap > 0), c[None, :], jnp.inf).min(1)
    low = jnp.where(jnp.isfinite(lower), (c + lower) / 2, 0.0)
    high = jnp.where(jnp.isfinite(upper), (c + upper) / 2, 1.0 + 1e-6)
    return jnp.stack([low, high], -1).astype(jnp.float32)


@partial(jax.jit, static_argnums=8)
def _count(
    key, layers: Layers, mirrored, incidence, first, last, cells, scale, solver: MonteCarlo
) -> Counts:
    process = solver.process
    event = partial(ilit_event if isinstance(process, Ilit) else radiative_event, process=process)
    n_waves = layers.extinction.shape[0]
    devices = 1 if solver.mesh is None else solver.mesh.size
    # Eight times as many keep an H100 busy: 2.3e9 photons a second instead of 2.9e8.
    n_lanes = solver.lanes or (1 << 14 if jax.default_backend() == "cpu" else 1 << 17)
    # Multiples of 16: whole vectors, a lane's loop never falls back to scalars.
    copies = max(16, n_lanes // n_waves // 16 * 16)
    f = jnp.float32
    ok = layers.valid()
    words = jax.random.key_data(jax.vmap(lambda j: jax.random.fold_in(key, j))(jnp.arange(n_waves)))

    def spread(values):
        # Photons in invalid layers would never end: none are sent.
        return jnp.repeat(jnp.where(ok, values, 0).astype(f), copies)

    n = layers.indices
    lane_layers = lanes.LaneLayers(
        *(spread(x) for x in (layers.abl_absorption, layers.extinction, layers.albedo)),
        *(jnp.asarray(x, f) for x in (mirrored, incidence, n.aqueous, n.abl, n.stroma, n.ipe)),
        ipe=None if layers.ipe_absorption is None else spread(layers.ipe_absorption),
        phase=jax.tree.map(spread, layers.phase),
    )
    wave_words = (jnp.repeat(words[:, 0], copies), jnp.repeat(words[:, 1], copies))
    last = jnp.where(ok, jnp.broadcast_to(last, (n_waves,)), 0)
    lane = jnp.tile(jnp.arange(copies, dtype=jnp.int32), n_waves)
    stride = jnp.int32(copies * devices)

    def on_device(place):
        start = first + lane + place * copies
        tally = lanes.run_lanes(
            *(event, wave_words, start, stride, jnp.repeat(last, copies), lane_layers, scale),
            deep=not isinstance(process, Ilit),
            cells=cells,
        )
        return jax.tree.map(lambda c: c.reshape(n_waves, copies, -1).sum(1, dtype=jnp.int32), tally)

    if solver.mesh is None:
        total = on_device(jnp.int32(0))
    else:
        # All that a device needs to know is its place in the deal; every process ends with all
        # counts.
        axes = solver.mesh.axis_names
        total = jax.shard_map(
            lambda: jax.lax.psum(on_device(jax.lax.axis_index(axes).astype(jnp.int32)), axes),
            mesh=solver.mesh,
            in_specs=(),
            out_specs=PartitionSpec(),
            check_vma=False,
        )()
    return Counts(*total, photons=jnp.maximum(last - first, 0))


def photon_mesh(devices: Sequence[Any] | None = None) -> Mesh:
    """A mesh that deals photons to these devices (default: all of every process)."""
    devices = jax.devices() if devices is None else devices
    return jax.make_mesh((len(devices),), ("photons",), devices=devices)
