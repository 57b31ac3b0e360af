"""A peer of the polarised solver: photons that are followed as fields of two waves in space.

A path through mirrors and small scatterers turns each field into one field: no Stokes vector is
turned from frame to frame here, and nothing is taken from the deterministic solver. A small
scatterer radiates as a dipole, the field less its part along the new direction; interfaces have
Fresnel's complex amplitudes. The two waves are those of unpolarised light, polarised in the plane
of incidence and across it; their Mueller matrices are kept, so one run serves every polariser.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

_BATCH = 4096  # photons under way at once; results depend on it by rounding
_OUTSIDE, _IN_ABL, _IN_STROMA = 0, 1, 2
MIRRORED, REFLECTED, ABL, STROMA, IPE = range(1, 6)


class Sampled(NamedTuple):
    """Shares of the light by fate (5,), in the order of the codes above; Mueller matrices of all
    that is reflected (4, 4) and of the BRDF as the mean over the cone about each exit (exits, 4,
    4), with the covariances of their 16 numbers.
    """

    fates: jax.Array
    reflected: jax.Array
    reflected_covariance: jax.Array
    brdf: jax.Array
    brdf_covariance: jax.Array


@partial(jax.jit, static_argnames=("n", "aperture"))
def sampled(made, cosine, cos_exit, azimuth, key, *, n: int, aperture: float) -> Sampled:
    """Follow `n` photons through layers of one wavelength, from this cosine in the aqueous humour;
    `aperture` is the half-angle of the cones, radians.
    """
    depths = made.abl_absorption, made.extinction, made.albedo
    medium = PhotonLayers(*(x[0] for x in depths), made.indices)
    sine = jnp.sqrt(1 - cos_exit * cos_exit)
    exits = jnp.stack([sine * jnp.cos(azimuth), sine * jnp.sin(azimuth), cos_exit], -1)

    def batch(first):
        index = first * _BATCH + jnp.arange(_BATCH, dtype=jnp.int32)
        p = jax.vmap(lambda i: follow(jax.random.fold_in(key, i), medium, cosine))(index)
        alive = index < n
        fates = ((p.fate[:, None] == jnp.arange(1, 6)[None]) & alive[:, None]).sum(0)
        out = alive & (p.fate == REFLECTED)
        whole = jax.vmap(lambda f, ray: mueller(seen_through_lens(jones(f, ray), ray)))

        def cone(exit):
            x = jax.vmap(lambda f: mueller(jones(f, exit)))(p.field)
            return _sums(x, out & p.scattered & (p.ray @ exit >= np.cos(aperture)))

        return fates, _sums(whole(p.field, p.ray), out), lax.map(cone, exits)

    tallies = lax.map(batch, jnp.arange(-(-n // _BATCH), dtype=jnp.int32))
    fates, whole, cones = jax.tree.map(lambda x: x.sum(0), tallies)
    (reflected, of_whole), (brdf, of_cones) = (_estimate(x, n) for x in (whole, cones))
    power = jnp.pi * np.sin(aperture) ** 2 * cos_exit
    brdf, of_cones = brdf / power[:, None], of_cones / (power * power)[:, None, None]
    return Sampled(fates / n, reflected.reshape(4, 4), of_whole, brdf.reshape(-1, 4, 4), of_cones)


def _sums(x, counted):
    x = jnp.where(counted[:, None], x, 0.0)
    return x.sum(0), x.T @ x


def _estimate(sums, n: int):
    """Mean, and covariance of the mean."""
    total, products = sums
    mean = total / n
    spread = products / n - mean[..., :, None] * mean[..., None, :]
    return mean, spread / n


class PhotonLayers(NamedTuple):
    """Optical depths of ABL and stroma, the stroma's albedo, and indices, of one wavelength."""

    abl: jax.Array
    stroma: jax.Array
    albedo: jax.Array
    indices: object


class PolarisedPhoton(NamedTuple):
    """Where a photon is and goes: `ray` (3,), upwards positive; `field` (3, 2), complex, of mean
    power 1; `depth` in the stroma; the layer that it is in; whether it has been scattered; its
    fate; its events so far.
    """

    ray: jax.Array
    field: jax.Array
    depth: jax.Array
    layer: jax.Array
    scattered: jax.Array
    fate: jax.Array
    events: jax.Array


def follow(key: jax.Array, medium: PhotonLayers, cosine: jax.Array) -> PolarisedPhoton:
    """A photon of a key to its end, from cosine `cosine` in the aqueous humour (azimuth 0 is where
    it goes).
    """
    sine, zero = jnp.sqrt(jnp.maximum(1 - cosine * cosine, 0)), jnp.zeros_like(cosine)
    waves = jnp.stack([jnp.stack([-cosine, zero, -sine]), jnp.stack([zero, zero + 1, zero])], -1)
    start = PolarisedPhoton(
        ray=jnp.stack([sine, zero, -cosine]),
        field=lax.complex(waves, jnp.zeros_like(waves)),
        depth=zero,
        layer=jnp.int32(_OUTSIDE),
        scattered=jnp.asarray(False),
        fate=jnp.int32(0),
        events=jnp.int32(0),
    )
    return lax.while_loop(lambda p: p.fate == 0, lambda p: _event(p, key, medium), start)


def jones(field: jax.Array, ray: jax.Array) -> jax.Array:
    """Fields (3, 2) along the polar angle and the azimuth of a direction, (2, 2)."""
    across = jnp.hypot(ray[0], ray[1])
    vertical = across == 0
    c, s = (jnp.where(vertical, 1.0 - k, ray[k] / jnp.where(vertical, 1, across)) for k in (0, 1))
    polar = jnp.stack([ray[2] * c, ray[2] * s, -across])
    round_it = jnp.stack([-s, c, jnp.zeros_like(c)])
    return _real(jnp.stack([polar, round_it])) @ field


def seen_through_lens(matrix: jax.Array, ray: jax.Array) -> jax.Array:
    """Fields of `jones`, (2, 2), after a lens that makes all directions parallel: along the plane
    of incidence, and across it.
    """
    azimuth = jnp.arctan2(ray[1], ray[0])
    c, s = jnp.cos(azimuth), jnp.sin(azimuth)
    return _real(jnp.stack([jnp.stack([c, -s]), jnp.stack([s, c])])) @ matrix


def mueller(matrix: jax.Array) -> jax.Array:
    """Mueller matrix (16,) of a Jones matrix: ½ Tr(σ_i J σ_j J†)."""
    real = [[[1, 0], [0, 1]], [[1, 0], [0, -1]], [[0, 1], [1, 0]], [[0, 0], [0, 0]]]
    imaginary = [[[0, 0], [0, 0]]] * 3 + [[[0, 1], [-1, 0]]]
    dtype = jnp.real(matrix).dtype
    basis = lax.complex(jnp.asarray(real, dtype), jnp.asarray(imaginary, dtype))
    product = jnp.einsum("iab,bc,jcd,ad->ij", basis, matrix, basis, jnp.conj(matrix))
    return 0.5 * jnp.real(product).reshape(16)


def _event(p: PolarisedPhoton, key, m: PhotonLayers) -> PolarisedPhoton:
    """One flight: to an interface, or to where the photon is absorbed or scattered."""
    u = jax.random.uniform(jax.random.fold_in(key, p.events), (5,), p.depth.dtype)
    up, mu = p.ray[2] > 0, jnp.maximum(jnp.abs(p.ray[2]), 1e-12)
    in_abl, in_stroma = p.layer == _IN_ABL, p.layer == _IN_STROMA
    room = jnp.where(in_stroma, jnp.where(up, p.depth, m.stroma - p.depth), 0.0)
    room = jnp.where(in_abl, m.abl, room)
    flown = -jnp.log1p(-u[0]) * mu
    stopped = flown < room
    scattered = stopped & in_stroma & (u[1] < m.albedo)
    absorbed = stopped & ~scattered
    n = m.indices
    here = jnp.where(in_stroma, n.stroma, jnp.where(in_abl, n.abl, n.aqueous))
    ahead = jnp.where(in_stroma, jnp.where(up, n.abl, n.ipe), jnp.where(up, n.aqueous, n.stroma))
    ahead = jnp.where(p.layer == _OUTSIDE, n.abl, ahead)
    ray, field, passed = _interface(p.ray, p.field, here, ahead, u[2])
    dipole = _dipole(p.field, u[2:])
    next_layer = p.layer + jnp.where(up, -1, 1).astype(jnp.int32)
    left = passed & ~stopped
    fate = jnp.where(left & (next_layer == _OUTSIDE), REFLECTED, 0)
    fate = jnp.where(left & (next_layer > _IN_STROMA), IPE, fate)
    fate = jnp.where((p.layer == _OUTSIDE) & ~passed, MIRRORED, fate)
    fate = jnp.where(absorbed, jnp.where(in_abl, ABL, STROMA), fate)
    end = jnp.where(up, 0.0, m.stroma)
    entered = jnp.where(up, m.stroma, 0.0)
    moved = jnp.where(stopped, p.depth + jnp.where(up, -flown, flown), end)
    return PolarisedPhoton(
        ray=jnp.where(scattered, dipole[0], ray),
        field=jnp.where(scattered, dipole[1], field),
        depth=jnp.where(in_stroma, moved, entered),
        layer=jnp.where(left, next_layer, p.layer),
        scattered=p.scattered | scattered,
        fate=fate.astype(jnp.int32),
        events=p.events + 1,
    )


def _interface(ray, field, n_here, n_ahead, u):
    """What follows a meeting with a horizontal interface, and whether the photon passed."""
    mu = jnp.abs(ray[2])
    across = jnp.hypot(ray[0], ray[1])
    straight = across < 1e-12
    flat = jnp.where(straight, 1.0, across)
    s_axis = jnp.stack([ray[1] / flat, -ray[0] / flat, jnp.zeros_like(mu)])
    s_axis = jnp.where(straight, jnp.asarray([0.0, 1.0, 0.0], ray.dtype), s_axis)
    ratio = n_here / n_ahead
    rest = 1 - (ratio * across) ** 2
    total = rest <= 0
    real = jnp.where(total, 0.0, jnp.sqrt(jnp.where(total, 1.0, rest)))
    beyond = lax.complex(real, jnp.where(total, jnp.sqrt(jnp.where(total, -rest, 1.0)), 0.0))
    a, b, here, ahead = _real(mu), beyond, _real(n_here), _real(n_ahead)
    r_s = (here * a - ahead * b) / (here * a + ahead * b)
    r_p = (ahead * a - here * b) / (ahead * a + here * b)
    share = jnp.sqrt(n_ahead * real * n_here * mu)
    t_s, t_p = (_real(2 * share) / (x * a + y * b) for x, y in ((here, ahead), (ahead, here)))
    back = ray * jnp.asarray([1.0, 1.0, -1.0], ray.dtype)
    on = jnp.stack([ratio * ray[0], ratio * ray[1], jnp.sign(ray[2]) * real])
    e_s = _real(s_axis) @ field
    e_p = _real(jnp.cross(s_axis, ray)) @ field

    def fields(amplitude_p, amplitude_s, direction):
        axes = _real(jnp.stack([jnp.cross(s_axis, direction), s_axis], -1))
        return axes @ jnp.stack([amplitude_p * e_p, amplitude_s * e_s])

    mirrored, through = fields(r_p, r_s, back), fields(t_p, t_s, on)
    reflectance, passing = _power(mirrored), _power(through)
    passed = ~total & (u * (reflectance + passing) >= reflectance)
    field = jnp.where(passed, through, mirrored)
    return jnp.where(passed, on, back), field / _real(jnp.sqrt(_power(field))), passed


def _dipole(field, u):
    """A direction drawn from the power that the dipole radiates, and its field there.

    The power is that of four real dipoles, the real and imaginary part of either wave; one is
    picked by its share, and its sin² law inverted: sin 3t = 2u − 1 at cosine 2 sin t.
    """
    parts = jnp.concatenate([jnp.real(field), jnp.imag(field)], axis=-1)  # (3, 4)
    share = jnp.cumsum((parts * parts).sum(0))
    pick = jnp.minimum((u[0] * share[-1] >= share).sum(), 3)
    axis = jnp.take(parts, pick, axis=1)
    axis = axis / jnp.sqrt((axis * axis).sum())
    cosine = 2 * jnp.sin(jnp.arcsin(2 * u[1] - 1) / 3)
    turn = 2 * jnp.pi * u[2]
    # Any axis across the dipole's serves.
    least = jnp.argmin(jnp.abs(axis))
    first = jnp.cross(axis, (jnp.arange(3) == least).astype(axis.dtype))
    first = first / jnp.sqrt((first * first).sum())
    second = jnp.cross(axis, first)
    sine = jnp.sqrt(jnp.maximum(1 - cosine * cosine, 0))
    way = cosine * axis + sine * (jnp.cos(turn) * first + jnp.sin(turn) * second)
    way = way / jnp.sqrt((way * way).sum())
    out = _real(way)
    left = field - out[:, None] * (out @ field)[None]
    return way, left / _real(jnp.sqrt(_power(left)))


def _power(field):
    """Mean of both waves' powers."""
    return 0.5 * (jnp.real(field) ** 2 + jnp.imag(field) ** 2).sum()


def _real(x):
    return lax.complex(x, jnp.zeros_like(x))
