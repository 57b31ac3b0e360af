"""Analogue Monte Carlo: photons one event at a time, in lanes that never wait.

What an event is, a process says (`ilit.analog`, `radiative.analog`).

A lane belongs to one wavelength and takes that wavelength's next photon when its own dies; chains
are never cut, and fates are counted in integers, lane by lane. Photon i at wavelength j owns the
key `fold_in(fold_in(key, j), i)`, and its event k reads the bits of `fold_in(photon key, k)` and
nothing else: counts do not depend on lanes, blocks or devices.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax.numpy as jnp
from jax import Array, lax

from irisjax.numerics.interpolation import horner
from irisjax.numerics.sharding import vary_alike
from irisjax.numerics.streams import fold_in_words, uniform
from irisjax.optics.fresnel import refract
from irisjax.optics.mixture import PhaseMixture

FATES = ("mirrored", "reflected", "abl", "stroma", "ipe", "behind")
"""Names of the places where photons end, in the order of the counts; no photon gets behind a black
pigment epithelium."""

MIRRORED, REFLECTED, ABL, STROMA, IPE, BEHIND, RESTING = range(1, 8)  # as coded; 0 is alive
FRESH, SCATTERED, KEPT = 0, 1, 2  # how the direction of the coming flight comes about

Words: TypeAlias = tuple[Array, Array]
"""Random words of each lane."""
Scale: TypeAlias = tuple[Array, ...]
"""Steps of uniform numbers, and a traced 1."""


class LaneLayers(NamedTuple):
    """Layers of each lane: depths and albedo at its wavelength (lanes,), indices, entry."""

    abl: Array
    stroma: Array
    albedo: Array
    mirrored: Array  # probability of the first surface, where the direction inside is redrawn
    incidence: Array  # cosine in the aqueous humour
    n_aqueous: Array
    n_abl: Array
    n_stroma: Array
    n_ipe: Array
    ipe: Array | None = None  # depth of a pigment epithelium that is not black
    phase: PhaseMixture | None = None  # of the lane's wavelength, where it is not the process's own


class Photon(NamedTuple):
    """A lane's photon between events.

    `code` packs all that is not a real number: fate (3 bits), in the ABL (1), how the coming
    direction comes about (2), in the pigment epithelium (1), events so far (24), turned round by a
    mirror (sign). One integer is one kernel on CPU; six would be six, each redoing the physics.
    """

    direction: Array  # signed cosine, positive into the eye
    depth: Any  # optical depth below the stroma's top; `None` in ILIT
    code: Array


class InLayer(NamedTuple):
    """The layer that a photon is in: the ABL, a pigment epithelium that lets light through, or, if
    neither flag is set, the stroma. `in_ipe` is `None` where the epithelium is black.
    """

    in_abl: Array
    in_ipe: Array | None

    @classmethod
    def of(cls, code: Array, layers: LaneLayers) -> "InLayer":
        """Read it from `Photon.code`."""
        return cls((code & 8) > 0, None if layers.ipe is None else (code & 64) > 0)

    def pick(self, abl: Any, stroma: Any, ipe: Any) -> Array:
        """Return, for each photon, the one of three values that belongs to its layer."""
        if self.in_ipe is not None:
            stroma = jnp.where(self.in_ipe, ipe, stroma)
        return jnp.where(self.in_abl, abl, stroma)

    def leaves(self, down: Array) -> Array:
        """Whether a photon that passes the interface ahead leaves all layers."""
        if self.in_ipe is None:
            return self.in_abl ^ down
        return (self.in_abl & ~down) | (self.in_ipe & down)

    def beyond(self, down: Array, layers: LaneLayers) -> Array:
        """Index on the far side of the interface ahead."""
        above = self.pick(layers.n_aqueous, layers.n_abl, layers.n_stroma)
        return jnp.where(down, self.pick(layers.n_stroma, layers.n_ipe, layers.n_aqueous), above)

    def fate(self, leaves: Array, absorbed: Array, mirrored: Array) -> Array:
        """Fate of photons that leave the layers, are absorbed in one, or mirrored before them."""
        fate = jnp.where(absorbed, self.pick(ABL, STROMA, IPE), 0)
        fate = jnp.where(leaves, self.pick(REFLECTED, IPE, BEHIND), fate)
        return jnp.where(mirrored, MIRRORED, fate)

    def pack(
        self, fate: Any, passes: Array, down: Array, mode: Any, reverses: Any, events: Any
    ) -> Array:
        """`Photon.code` of photons that stay here or pass into the next layer."""
        code = fate | mode << 4 | reverses.astype(jnp.int32) << 31 | events << 7
        if self.in_ipe is None:
            return code | (self.in_abl ^ passes).astype(jnp.int32) << 3
        in_stroma = ~self.in_abl & ~self.in_ipe
        in_abl = jnp.where(passes, in_stroma & ~down, self.in_abl)
        in_ipe = jnp.where(passes, in_stroma & down, self.in_ipe)
        return code | in_abl.astype(jnp.int32) << 3 | in_ipe.astype(jnp.int32) << 6


def run_lanes(
    event: Callable[..., Photon],
    wave_words: tuple[Array, Array],
    start: Array,
    stride: Array,
    last: Array,
    layers: LaneLayers,
    scale: Scale,
    *,
    deep: bool,
    cells: Array | None,
) -> tuple[Array, Array | None]:
    """Run lanes to exhaustion; lane l owns photons start[l], start[l] + stride, ... below last[l].

    `wave_words` hold each lane's wavelength key, `cells` bounds of the cosines (exits, 2) in which
    to count photons that leave. Returns counts of fates (lanes, 5 or 6), and of cells (lanes,
    exits).
    """
    newborn = jnp.int32(8 | FRESH << 4)
    nothing = jnp.zeros_like(start)
    zero = jnp.zeros_like(layers.abl)

    def body(state):
        k0, k1, i, photon, tally, cell_tally = state
        fate = photon.code & 7
        tally = tuple(
            count + (fate == code).astype(count.dtype) for code, count in enumerate(tally, 1)
        )
        if cells is not None:
            # A photon that left has no further use for its direction: it holds the cosine outside.
            exits, cosine = fate == REFLECTED, photon.direction
            cell_tally = tuple(
                count + (exits & (cosine >= low) & (cosine < high)).astype(count.dtype)
                for count, (low, high) in zip(cell_tally, cells, strict=True)
            )
        direction = jnp.where(photon.code < 0, -photon.direction, photon.direction)
        code = photon.code & 0x7FFFFFFF
        starts = (fate > 0) & (i < last)
        b0, b1 = fold_in_words(wave_words[0], wave_words[1], i.astype(jnp.uint32))
        k0, k1 = jnp.where(starts, b0, k0), jnp.where(starts, b1, k1)
        i = jnp.where(starts, i + stride, i)
        direction = jnp.where(starts, 1.0, direction)
        alive = starts | (fate == 0)
        code = jnp.where(starts, newborn, code)
        words = fold_in_words(k0, k1, (code >> 7).astype(jnp.uint32))
        update = event(Photon(direction, photon.depth, code), words, layers, scale)
        if cells is not None:
            emerges = update.code & 7 == REFLECTED
            outside = refract(jnp.abs(update.direction), layers.n_abl, layers.n_aqueous)
            update = update._replace(direction=jnp.where(emerges, outside, update.direction))
        update = update._replace(code=jnp.where(alive, update.code, RESTING))
        return k0, k1, i, update, tally, cell_tally

    def active(state):
        return jnp.any((state[3].code & 7 != RESTING) | (state[2] < last))

    resting = Photon(jnp.ones_like(zero), zero if deep else None, nothing + RESTING)
    cell_tally = None if cells is None else (nothing,) * cells.shape[0]
    fates = len(FATES) - (layers.ipe is None)
    state = (*wave_words, start, resting, (nothing,) * fates, cell_tally)
    state = vary_alike(state, last, layers, cells)
    *_, tally, cell_tally = lax.while_loop(active, body, state)
    return jnp.stack(tally, -1), None if cell_tally is None else jnp.stack(cell_tally, -1)


def draws(words: Words, scale: Scale) -> tuple[Array, Array, Array]:
    """Two uniforms of 23 bits, and the cosine of a uniform azimuth from the 18 bits that are
    left.
    """
    # Cosine of π(1 − v), v in (0, 1): −sin(π/2·(2v − 1))'s odd polynomial up to sign, to 3e-9.
    x = 2.0 * uniform((words[0] & 511) << 9 | (words[1] & 511), scale[1]) - 1.0
    turn = x * horner(x * x, (1.57079629, -0.64596336, 0.07968847, -0.00467222, 0.00015082))
    return uniform(words[0] >> 9, scale[0]), uniform(words[1] >> 9, scale[0]), turn


def deflect(direction: Array, cosine: Array, azimuth: Array) -> Array:
    """Cosine to the normal after a turn by a polar angle and a cosine of azimuth."""
    across = (1.0 - direction * direction) * (1.0 - cosine * cosine)
    return direction * cosine + azimuth * jnp.sqrt(across)


def guided(mu: Array, n_here: Any, n_ahead: Any, n_behind: Any) -> Array:
    """Whether a ray is totally reflected at both faces of its layer.

    In a layer that does not scatter, such a ray is absorbed after any number of crossings, also in
    the limit of no absorption; it is counted as absorbed at once.
    """
    return (1.0 - mu * mu) * jnp.square(n_here / jnp.maximum(n_ahead, n_behind)) >= 1.0
