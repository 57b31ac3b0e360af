"""An independent estimate of the BRDF in given directions: photons with next-event estimation.

Scalar radiative transfer with Rayleigh's law, in NumPy, sharing no code with the package. A photon
is followed in the stroma between its two boundaries; at every collision the radiance that leaves
along each exit is scored in closed form, reflections at both boundaries included.
"""

import numpy as np


def brdf(depths, indices, cos_incidence, cos_exit, azimuth, photons, seed, spot=None):
    """BRDF (1/sr) and its standard error, each of shape (exits,).

    Args:
        depths: Optical depths: of the ABL's absorption, of the stroma's absorption and scattering.
        indices: Refractive indices of aqueous humour, ABL, stroma and IPE.
        cos_incidence: Cosine of the incident light in the aqueous humour.
        cos_exit: Cosines of the exits in the aqueous humour, shape (exits,).
        azimuth: Azimuths of the exits from the forward direction, radians, shape (exits,).
        photons: Number of photons.
        seed: Seed of NumPy's generator.
        spot: Radius of the disc that is lit evenly and from which light is collected, in units of
            the stroma's mean free path; infinite by default. The ABL is thin.
    """
    abl, absorption, scattering = depths
    depth, albedo = absorption + scattering, scattering / (absorption + scattering)
    rng = np.random.default_rng(seed)
    aqueous, _, stroma, _ = indices
    back, through = _roof(abl, indices)

    def floor(cosine):
        return fresnel(cosine, indices[2], indices[3])

    inside = refracted(cos_exit, aqueous, stroma)
    sine = np.sqrt(1 - inside**2)
    seen = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), -inside])
    down = seen * np.array([1, 1, -1])[:, None]
    crossing = np.exp(-depth / inside)
    bounce = floor(inside) * crossing
    bright = through(inside) / (1 - back(inside) * bounce * crossing)
    bright = bright * (aqueous / stroma) ** 2 / inside

    # Transmission of the ABL is the same both ways along one ray.
    start = refracted(np.asarray(cos_incidence), aqueous, stroma)
    weight = np.full(photons, through(start))
    direction = np.tile([np.sqrt(1 - start**2), 0, start], (photons, 1))
    aside = np.zeros((photons, 2))
    at, score = np.zeros(photons), np.zeros((photons, len(inside)))
    alive = np.arange(photons)
    while alive.size:
        mu = direction[alive, 2]
        new = at[alive] - mu * np.log(1 - rng.random(alive.size))
        above, below = new < 0, new > depth
        kept = rng.random(alive.size) < np.where(above, back(np.abs(mu)), floor(np.abs(mu)))
        crossed = above | below
        gone = (np.clip(new, 0, depth) - at[alive]) / mu
        aside[alive] += gone[:, None] * direction[alive, :2]
        at[alive] = np.clip(new, 0, depth)
        direction[alive[crossed], 2] *= -1

        hit = alive[~crossed]
        weight[hit] *= albedo
        here, toward = at[hit, None], direction[hit]
        straight = _rayleigh(toward @ seen) * np.exp(-here / inside)
        mirrored = _rayleigh(toward @ down) * np.exp(-(depth - here) / inside) * bounce
        if spot is not None:
            to_roof, tilt = aside[hit][:, :, None], seen[:2] / inside
            straight = straight * _shared(to_roof + here[..., None] * tilt, spot)
            mirrored = mirrored * _shared(to_roof + (2 * depth - here[..., None]) * tilt, spot)
        score[hit] += weight[hit, None] * bright * (straight + mirrored) / (4 * np.pi)
        direction[hit] = _scattered(toward, rng)
        alive = alive[(~crossed | kept) & (weight[alive] > 1e-6)]
    return score.mean(0), score.std(0, ddof=1) / np.sqrt(photons)


def _shared(aside, radius):
    """Share that two discs have in common whose centres lie apart by `aside`, on its axis 1."""
    x = np.minimum(np.linalg.norm(aside, axis=1) / (2 * radius), 1)
    return 2 / np.pi * (np.arccos(x) - x * np.sqrt(1 - x**2))


def _rayleigh(cosine):
    return 0.75 * (1 + cosine**2)


def _scattered(direction, rng):
    """New directions by rejection from Rayleigh's phase function."""
    new = np.empty_like(direction)
    left = np.arange(len(direction))
    while left.size:
        trial = rng.normal(size=(left.size, 3))
        trial /= np.linalg.norm(trial, axis=1, keepdims=True)
        cosine = (trial * direction[left]).sum(1)
        new[left] = trial
        left = left[rng.random(left.size) * 1.5 > _rayleigh(cosine)]
    return new


def refracted(cosine, here, beyond):
    """Cosine beyond an interface; 0 for total reflection."""
    return np.sqrt(np.maximum(1 - (here / beyond) ** 2 * (1 - cosine**2), 0))


def fresnel(cosine, here, beyond):
    """Reflectance of unpolarised light."""
    other = refracted(cosine, here, beyond)
    across = (here * cosine - beyond * other) / (here * cosine + beyond * other)
    along = (beyond * cosine - here * other) / (beyond * cosine + here * other)
    return (across**2 + along**2) / 2


def _roof(depth, indices):
    """Reflectance and transmittance of the ABL as functions of the cosine in the stroma."""
    aqueous, abl, stroma, _ = indices

    def parts(cosine):
        inner = np.maximum(refracted(cosine, stroma, abl), 1e-9)  # where it is 0, no 0/0
        survival = np.exp(-depth / inner)
        low, high = fresnel(cosine, stroma, abl), fresnel(inner, abl, aqueous)
        series = 1 / (1 - low * high * survival**2)
        back = low + (1 - low) ** 2 * survival**2 * high * series
        return back, (1 - low) * survival * (1 - high) * series

    return lambda c: parts(c)[0], lambda c: parts(c)[1]
