"""Monte Carlo solver: samples the process of `transport.process`, and says how well.

Photons are dealt to all devices JAX sees, in one process or several, by their index; integer counts
do not depend on how.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Int

from irisjax.numerics.streams import check_key, scales
from irisjax.tissue.layers import Layers
from irisjax.transport import analog
from irisjax.transport.ilit import weighted
from irisjax.transport.ilit.exact import first_surface
from irisjax.transport.process import Process
from irisjax.transport.solution import RESULTS, Absorbed, Solution
from irisjax.transport.solver import AbstractSolver

Estimator = Literal["analog", "weighted", "quasi"]
_LIMIT = 2**31 - 2**20  # counts are int32; lanes look a stride ahead


class Counts(NamedTuple):
    """Photons by fate: `fates` (wavelengths, 5) as in `analog.FATES`, `exits` (wavelengths, exits)
    or `None`, and `photons` sent (wavelengths,). Counts of disjoint blocks of photons add."""

    fates: Int[Array, "wavelengths 5"]
    exits: Int[Array, "wavelengths exits"] | None
    photons: Int[Array, " wavelengths"]


class MonteCarlo(AbstractSolver):
    """Sampling solver; needs a `key`.

    - `n_photons`: photons a wavelength (`"analog"`) or paths shared by all wavelengths (else:
        rounded up to 16·2^k), up to 2.1e9 a call.
    - `estimator`: `"analog"` follows LB06 event by event; `"weighted"` takes expected values in
        place of absorption and Fresnel tests; `"quasi"` feeds that from a randomly shifted lattice.
        The last two treat whole-layer processes that keep directions on reflection.
    - `lanes`: photons under way at once; a matter of speed and memory only (about 100 bytes each).

    Arithmetic is float32 whatever the iris's precision; counts are integers. Where `rays` are given
    (the illuminant's relative power), the photons at each wavelength follow them, at most
    `n_photons`.
    """

    n_photons: int = eqx.field(static=True)
    estimator: Estimator = eqx.field(static=True, default="analog")
    lanes: int = eqx.field(static=True, default=16384)

    def __check_init__(self):
        n = self.n_photons
        if isinstance(n, bool) or not isinstance(n, (int, np.integer)) or not 1 <= n <= _LIMIT:
            raise ValueError(f"n_photons = {n!r} is outside [1, {_LIMIT}]")
        if self.estimator not in get_args(Estimator):
            raise ValueError(
                f"estimator = {self.estimator!r}; known: {', '.join(get_args(Estimator))}"
            )
        if not isinstance(self.lanes, int) or self.lanes < 16:
            raise ValueError(f"lanes = {self.lanes!r}: must be a whole number of at least 16")

    def prepare(self, layers: Callable[[], Layers], process: Process) -> "MonteCarlo":
        """Check that the estimator can treat the process."""
        if self.estimator != "analog" and (process.depth_resolved or process.perturb_on_reflection):
            raise ValueError(
                f'estimator="{self.estimator}" treats whole-layer processes without '
                "perturb_on_reflection; "
                'use estimator="analog"'
            )
        return self

    def solve(
        self,
        layers: Layers,
        process: Process,
        cos_incidence,
        *,
        cos_exit=None,
        azimuth=None,
        key=None,
        rays=None,
    ):
        """Transport of light from direction `cos_incidence` (or `DIFFUSE`); see `Solution`.

        The BRDF is the average over cells of the cosine bounded half-way between the exits asked
        for.
        """
        if self.estimator == "analog":
            counts = self.count(
                layers, process, cos_incidence, cos_exit=cos_exit, key=key, rays=rays
            )
            return self.summarise(counts, layers, process, cos_exit)
        check_key(key)
        if cos_exit is not None:
            raise ValueError('a BRDF by Monte Carlo needs estimator="analog"')
        return self._weighted(layers, process, cos_incidence, key)

    def count(
        self,
        layers,
        process,
        cos_incidence,
        *,
        cos_exit=None,
        key=None,
        rays=None,
        first=0,
        last=None,
    ):
        """Follow photons `first` to `last` (default all) and count their fates; blocks of them add.

        `first` and `last` may be traced. Returns `Counts`.
        """
        check_key(key)
        if cos_exit is not None and process.depth_resolved:
            raise ValueError(
                "the BRDF of depth-resolved transport by Monte Carlo is not offered; use Exact"
            )
        cells = None if cos_exit is None else _cells(cos_exit)
        share = (
            jnp.ones_like(layers.extinction)
            if rays is None
            else jnp.asarray(rays) / jnp.max(jnp.asarray(rays))
        )
        wanted = jnp.maximum(
            jnp.ceil(self.n_photons * share.astype(jnp.result_type(float))), 1
        ).astype(jnp.int32)
        start = jnp.asarray(first, jnp.int32)
        end = wanted if last is None else jnp.minimum(jnp.asarray(last, jnp.int32), wanted)
        mirrored = first_surface(cos_incidence, layers.indices, layers.extinction.dtype)[0]
        incidence = -1.0 if isinstance(cos_incidence, str) else cos_incidence
        return _count(
            key, layers, mirrored, incidence, start, end, cells, scales(), process, self.lanes
        )

    def summarise(
        self, counts: Counts, layers: Layers, process: Process, cos_exit=None
    ) -> Solution:
        """Shares and standard errors from counts; a count of none still has an error (Laplace's
        rule).
        """
        dtype = layers.extinction.dtype
        n = counts.photons.astype(dtype)
        fates = counts.fates.astype(dtype)
        share = fates / n[:, None]
        seen = fates[:, 1] + (fates[:, 0] if process.first_surface else 0)
        brdf = brdf_error = None
        if counts.exits is not None:
            cells = _cells(cos_exit).astype(dtype)
            scale = jnp.pi * (cells[:, 1] ** 2 - cells[:, 0] ** 2)
            brdf = counts.exits / n[:, None] / scale
            brdf_error = _binomial_error(counts.exits.astype(dtype), n[:, None]) / scale
        return Solution(
            reflectance=share[:, 1],
            mirrored=share[:, 0],
            absorbed=Absorbed(abl=share[:, 2], stroma=share[:, 3], ipe=share[:, 4]),
            standard_error=_binomial_error(seen, n),
            brdf=brdf,
            brdf_error=brdf_error,
            result=_result(layers),
        )

    def _weighted(self, layers: Layers, process: Process, cos_incidence, key) -> Solution:
        mirrored, entering = first_surface(cos_incidence, layers.indices, layers.extinction.dtype)
        log2_paths = max(4, math.ceil(math.log2(max(1, self.n_photons / weighted.GROUPS))))
        groups = weighted.run_paths(
            key,
            layers,
            process,
            entering,
            scales(),
            log2_paths=log2_paths,
            quasi=self.estimator == "quasi",
        ).astype(layers.extinction.dtype)
        mean = groups.mean(axis=1)
        return Solution(
            reflectance=mean[0],
            mirrored=mirrored * jnp.ones_like(mean[0]),
            absorbed=Absorbed(abl=mean[1], stroma=mean[2], ipe=mean[3]),
            standard_error=groups[0].std(axis=0, ddof=1) / math.sqrt(weighted.GROUPS),
            brdf=None,
            brdf_error=None,
            result=_result(layers),
        )


def _result(layers: Layers):
    return RESULTS.where(layers.valid(), RESULTS.successful, RESULTS.invalid_input)


def _binomial_error(count, n):
    p = (count + 1) / (n + 2)
    return jnp.sqrt(p * (1 - p) / n)


def _cells(cos_exit):
    """Lower and upper cosine round each exit, half-way to the nearest different ones, (exits,
    2).
    """
    c = jnp.asarray(cos_exit)
    gap = c[None, :] - c[:, None]
    apart = jnp.abs(gap) > 1e-6
    lower = jnp.where(apart & (gap < 0), c[None, :], -jnp.inf).max(1)
    upper = jnp.where(apart & (gap > 0), c[None, :], jnp.inf).min(1)
    low = jnp.where(jnp.isfinite(lower), (c + lower) / 2, 0.0)
    high = jnp.where(jnp.isfinite(upper), (c + upper) / 2, 1.0 + 1e-6)
    return jnp.stack([low, high], -1).astype(jnp.float32)


@partial(jax.jit, static_argnums=(8, 9))
def _count(
    key,
    layers: Layers,
    mirrored,
    incidence,
    first,
    last,
    cells,
    scale,
    process: Process,
    lanes: int,
) -> Counts:
    n_waves = layers.extinction.shape[0]
    devices = jax.devices()
    # Multiples of 16: whole vectors, a lane's loop never falls back to scalars.
    a_wave = max(16, lanes // n_waves // 16 * 16)
    f = jnp.float32
    ok = layers.valid()
    words = jax.random.key_data(jax.vmap(lambda j: jax.random.fold_in(key, j))(jnp.arange(n_waves)))

    def spread(values):
        # Photons in invalid layers would never end: none are sent.
        return jnp.repeat(jnp.where(ok, values, 0).astype(f), a_wave)

    n = layers.indices
    lane_layers = analog.LaneLayers(
        abl=spread(layers.abl_absorption),
        stroma=spread(layers.extinction),
        albedo=spread(layers.albedo),
        mirrored=jnp.asarray(mirrored, f),
        incidence=jnp.asarray(incidence, f),
        n_aqueous=n.aqueous.astype(f),
        n_abl=n.abl.astype(f),
        n_stroma=n.stroma.astype(f),
        n_ipe=n.ipe.astype(f),
    )
    wave_words = (jnp.repeat(words[:, 0], a_wave), jnp.repeat(words[:, 1], a_wave))
    last = jnp.where(ok, jnp.broadcast_to(last, (n_waves,)), 0)
    lane = jnp.tile(jnp.arange(a_wave, dtype=jnp.int32), n_waves)
    stride = jnp.int32(a_wave * len(devices))

    def on_device(place):
        start = first + lane + place * a_wave
        tally = analog.run_lanes(
            wave_words, start, stride, jnp.repeat(last, a_wave), lane_layers, scale, process, cells
        )
        return jax.tree.map(lambda c: c.reshape(n_waves, a_wave, -1).sum(1, dtype=jnp.int32), tally)

    if len(devices) == 1:
        total = on_device(jnp.int32(0))
    else:
        # All that a device needs to know is its place in the deal; every process ends with all
        # counts.
        total = jax.shard_map(
            lambda: jax.lax.psum(
                on_device(jax.lax.axis_index("photons").astype(jnp.int32)), "photons"
            ),
            mesh=jax.make_mesh((len(devices),), ("photons",), devices=devices),
            in_specs=(),
            out_specs=PartitionSpec(),
            check_vma=False,
        )()
    return Counts(*total, photons=jnp.maximum(last - first, 0))
