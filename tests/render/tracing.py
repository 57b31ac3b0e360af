"""Rays through the cornea in numpy, written from Snell's and Fresnel's laws alone."""

from typing import NamedTuple

import numpy as np


class Traced(NamedTuple):
    point: np.ndarray  # on the plane of the iris
    share: np.ndarray  # of the power met
    power: np.ndarray  # per area of the aperture that k covers
    met: list  # at each surface: unit normal, direction before and after, indices before and after
    inside: np.ndarray  # whether the ray meets the posterior cornea and the iris in this order


def _numbers(surface):
    return tuple(float(np.asarray(v)) for v in (surface.radius, surface.shape, surface.apex))


def towards(polar):
    return np.array([np.sin(polar), 0.0, -np.cos(polar)])


def above(surface, k):
    """Points of a conicoid at (x, y), (rays, 3)."""
    radius, p, apex = _numbers(surface)
    return np.column_stack([k, apex + (radius - np.sqrt(radius**2 - p * (k**2).sum(1))) / p])


def normals(surface, point):
    """Unit normals out of the eye at points (…, 3) of a conicoid."""
    radius, p, apex = _numbers(surface)
    normal = (point - [0, 0, apex]) * [1, 1, p] - [0, 0, radius]
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def meet(surface, point, d):
    """Distances along rays (…, 3) to a conicoid, NaN for rays that miss it."""
    radius, p, apex = _numbers(surface)
    o, w = point - [0, 0, apex], np.array([1, 1, p])
    a, b, c = (
        (w * d * d).sum(-1),
        (w * o * d).sum(-1) - radius * d[..., 2],
        (w * o * o).sum(-1) - 2 * radius * o[..., 2],
    )
    with np.errstate(invalid="ignore"):
        return (-b - np.sqrt(b * b - a * c)) / a


def trace(eye, k, light):
    """Light from the unit vector `light`, one for all or one a ray, that enters at k (rays, 2)."""
    cornea = eye.cornea
    surfaces = [
        (cornea.anterior, float(eye.aqueous_index if cornea.posterior is None else cornea.index))
    ]
    if cornea.posterior is not None:
        surfaces.append((cornea.posterior, float(eye.aqueous_index)))
    point = above(cornea.anterior, k)
    d = np.broadcast_to(-np.asarray(light, float), (len(k), 3)).copy()
    share, n_in, met, inside = np.ones(len(k)), 1.0, [], np.ones(len(k), bool)
    with np.errstate(invalid="ignore", divide="ignore"):
        for surface, n_out in surfaces:
            if met:
                t = meet(surface, point, d)
                inside &= t > 0
                point = point + t[:, None] * d
            normal = normals(surface, point)
            cos_in = -(d * normal).sum(1)
            along = (d + cos_in[:, None] * normal) * (n_in / n_out)
            cos_out = np.sqrt(1 - (along**2).sum(1))
            r_s = (n_in * cos_in - n_out * cos_out) / (n_in * cos_in + n_out * cos_out)
            r_p = (n_out * cos_in - n_in * cos_out) / (n_out * cos_in + n_in * cos_out)
            share = np.where(cos_in > 0, share * (1 - (r_s**2 + r_p**2) / 2), 0.0)
            if not met:
                shown = np.maximum(cos_in, 0) / -normal[:, 2]
            after = along - cos_out[:, None] * normal
            met.append((normal, d, after, n_in, n_out))
            d, n_in = after, n_out
        t = (float(eye.iris_depth) - point[:, 2]) / d[:, 2]
    return Traced(point + t[:, None] * d, share, share * shown, met, inside & (t > 0))


def disc(radius, number):
    """Points that cover a disc evenly, (number, 2), and the area each stands for."""
    i = np.arange(number)
    r, angle = radius * np.sqrt((i + 0.5) / number), i * np.pi * (3 - np.sqrt(5))
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)]), np.pi * radius**2 / number


def soft_edge(r, limbus, soft=0.15):
    t = np.clip((limbus + soft - r) / (2 * soft), 0, 1)
    return t**2 * (3 - 2 * t)
