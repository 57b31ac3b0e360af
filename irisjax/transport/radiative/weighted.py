"""Weighted Monte Carlo of radiative transfer, with next-event estimates of radiance.

What light does before it is scattered has a closed form; what follows is sampled (`packets`).
"""

import math
from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.sharding import Mesh, PartitionSpec

from irisjax.numerics.checks import check_whole
from irisjax.numerics.sharding import laid_out_as
from irisjax.numerics.streams import check_key
from irisjax.optics.phase import AbstractPhase
from irisjax.tissue.indices import Order, RefractiveIndices
from irisjax.tissue.layers import Layers
from irisjax.transport.incidence import DIFFUSE, beams_of, exits_of
from irisjax.transport.pointwise import by_wavelength
from irisjax.transport.process import RadiativeTransfer
from irisjax.transport.radiative.directions import from_outside
from irisjax.transport.radiative.fates import before, course
from irisjax.transport.radiative.flights import Medium, view
from irisjax.transport.radiative.orders import single_scattering, ways
from irisjax.transport.radiative.packets import Beams, follow
from irisjax.transport.solution import RESULTS, Absorbed, Solution
from irisjax.transport.solver import AbstractSolver, checked_process

_REPLICATES = 512  # most independent sums whose scatter is the standard error
_BEAMS = 48  # directions of diffuse light
_LIMIT = 2**31 - 2**20


class RadiativeWeighted(AbstractSolver):
    """Expected values in place of tests, for scalar radiative transfer; needs a `key`.

    BRDFs are in the very directions asked for: light scattered once in closed form, oftener by
    next-event estimates. Standard errors come from the scatter of up to 512 independent sums.

    - `n_packets`: packets a wavelength, rounded up to a multiple of those sums. Where `rays` are
        given (the illuminant's relative power), the packets at each wavelength follow them.
    - `mesh`: devices to deal the packets to, or `None` for where the program runs; see
        `photon_mesh`.

    Derivatives, forward and reverse, are unbiased, and about as precise as the values; those by
    indices have heavy tails near critical angles: `RadiativeExact` has them to rounding. In a film
    (depth 1e-3 and less) what is scattered twice is carried by few packets that it guides.
    """

    n_packets: int = eqx.field(static=True)
    mesh: Mesh | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        check_whole("n_packets", self.n_packets, 1, _LIMIT)

    def prepare(self, layers: Callable[[], Layers], process) -> "RadiativeWeighted":
        """Check that the process is one that it treats."""
        checked_process(self, process, RadiativeTransfer)
        return self

    def solve(
        self,
        layers: Layers,
        process,
        cos_incidence,
        *,
        cos_exit=None,
        azimuth=None,
        key=None,
        rays=None,
    ):
        """See `AbstractSolver.solve`.

        **Raises:** `ValueError` for a BRDF under diffuse light.
        """
        process = checked_process(self, process, RadiativeTransfer, layers)
        check_key(key)
        dtype = layers.extinction.dtype
        numbers = [] if isinstance(cos_incidence, str) else [jnp.asarray(cos_incidence, dtype)]
        exits, azimuths = exits_of(cos_incidence, cos_exit, azimuth, dtype)
        if exits is not None and azimuths is not None:
            numbers += [*exits, *azimuths]
        n, ok = layers.indices, layers.valid()
        depths = layers.abl_absorption, layers.stroma_absorption, layers.stroma_scattering
        # In layers that are not valid a packet might never end: theirs are empty.
        depths = tuple(jnp.where(ok, x, 0.0) for x in depths)
        run = partial(_shares, self, process.phase_function)
        shares = laid_out_as(
            layers.extinction,
            3,
            lambda *x: jnp.moveaxis(by_wavelength(run, *x), -1, 0),
            *((key, rays), depths, (n.aqueous, n.abl, n.stroma, n.ipe, *numbers)),
        )
        mean, replicates = shares.mean(axis=2), shares.shape[2]
        error = shares[:, 1].std(axis=1, ddof=1) / math.sqrt(replicates)
        brdf_error = None
        if cos_exit is not None:
            brdf_error = shares[:, 5:].std(axis=2, ddof=1) / math.sqrt(replicates)
        return Solution(
            reflectance=mean[:, 1],
            mirrored=mean[:, 0],
            absorbed=Absorbed(abl=mean[:, 2], stroma=mean[:, 3], ipe=mean[:, 4]),
            standard_error=error,
            total_error=error,
            brdf=None if cos_exit is None else mean[:, 5:],
            brdf_error=brdf_error,
            status=RESULTS.where(ok, RESULTS.successful, RESULTS.invalid_input),
        )


def _shares(solver: RadiativeWeighted, phase: AbstractPhase, how, depths, shared):
    """Mirrored, reflected, absorbed in ABL, stroma and IPE, and the BRDF at each exit: one value
    for each of the replicates, shape (shares, replicates, wavelengths).
    """
    key, rays = how
    aqueous, abl, stroma, ipe, *numbers = shared
    absorbing, absorption, scattering = depths
    indices = RefractiveIndices(aqueous, abl, stroma, ipe)
    layers = Layers(absorbing, absorption, scattering, indices, Order())
    dtype = layers.extinction.dtype
    outside, power = beams_of(numbers[0] if numbers else DIFFUSE, _BEAMS, indices, dtype)
    beams = from_outside(layers, outside)
    abl, depth = layers.abl_absorption, layers.extinction
    first = jax.vmap(before, (0, 0, None))(abl, depth, beams)
    lost = first.lost @ power
    dark = lost <= 0
    part = first.lost * power[None] / jnp.where(dark, 1.0, lost)[:, None]
    back = jax.vmap(course, (0, 0, None))(abl, depth, beams).back
    light = Beams(beams.cosine, part, back / (1 + back))
    medium = Medium(
        *(x[:, None] for x in (abl, depth, layers.albedo, layers.coalbedo)), indices=indices
    )
    seen, single = None, jnp.zeros((0, lost.size, 1), dtype)
    if len(numbers) > 1:
        cosine, azimuth = (jnp.stack(x) for x in _halves(numbers[1:]))
        exits = from_outside(layers, cosine)
        seen = jax.vmap(view, (0, 0, None, None, None))(abl, depth, exits, azimuth, indices)
        seen = jax.tree.map(lambda x: x.T[..., None], seen)

        def once(abl, depth, albedo):
            glow = single_scattering(abl, depth, albedo, beams, exits, azimuth)
            return glow * ways(abl, depth, exits, indices).outside

        single = jax.vmap(once)(abl, depth, layers.albedo).T[..., None]
    wanted = jnp.ones_like(lost)
    if rays is not None:
        wanted = jnp.asarray(rays, dtype) / jnp.asarray(rays, dtype).max()
    replicates = min(_REPLICATES, 1 << max(4, math.ceil(math.log2(solver.n_packets))))
    rounds = jnp.ceil(solver.n_packets * wanted / replicates).astype(jnp.int32)
    rounds = jnp.maximum(rounds, 1)[:, None]
    run = partial(follow, phase, replicates)
    short = jax.tree.map(lambda x: x.astype(jnp.float32), (medium, light, seen))
    sums = _dealt(run, solver.mesh, replicates, key, rounds, *short).astype(dtype)
    found = (lost[:, None] / rounds.astype(dtype))[None] * sums
    unscattered = [first.reflected, first.abl, jnp.zeros_like(first.lost), first.passed]
    unscattered = jnp.stack([x @ power for x in unscattered])[..., None]
    mirrored = jnp.broadcast_to((first.mirrored @ power)[:, None], found.shape[1:])
    found = jnp.concatenate([mirrored[None], found[:4] + unscattered, found[4:] + single])
    return jnp.moveaxis(found, 1, -1)


def _halves(numbers):
    return numbers[: len(numbers) // 2], numbers[len(numbers) // 2 :]


def _dealt(run, mesh: Mesh | None, replicates: int, *arguments):
    """`run(lanes, ...)` for all lanes, in an order that does not depend on the devices."""
    if mesh is None:
        return run(jnp.arange(replicates, dtype=jnp.int32), *arguments)
    axes = mesh.axis_names
    # Multiples of 16: whole vectors, a lane's loop never falls back to scalars.
    each = -(-replicates // (16 * mesh.size)) * 16

    def on_device(*arguments):
        first = lax.axis_index(axes).astype(jnp.int32) * each
        found = run(first + jnp.arange(each, dtype=jnp.int32), *arguments)
        return lax.all_gather(found, axes, axis=2, tiled=True)

    dealt = jax.shard_map(
        on_device, mesh=mesh, in_specs=PartitionSpec(), out_specs=PartitionSpec(), check_vma=False
    )
    return dealt(*arguments)[:, :, :replicates]
