"""A reflectance spectrum for a colour that is known as sRGB alone."""

import numpy as np

from irisjax.measure.colour import tristimulus_matrix

_STEPS = 200  # of Newton's method; about ten are enough but near black and white
_LARGEST = 2.0  # step of z: further off the linear equations mean little
_EXACT = 1e-10
_ENDS = 1e-5  # least reflectance that is asked for, and of 1 − R: z has no end


def smoothest_reflectance(colour: np.ndarray, wavelengths) -> np.ndarray:
    """The reflectance of linear sRGB `colour`, shape (3,), under D65 that is smoothest in z, where
    R = (1 + tanh z)/2: least ∫ (dz/dλ)² dλ, on `wavelengths` (nm), shape (n,).

    One of the many spectra of that colour, and none of a particular pigment; this choice is near
    those of commercial paints in the mean. [Burns 2020, least hyperbolic tangent slope squared]

    **Raises:** `ValueError` for a colour that no such reflectance was found for.
    """
    to_colour, _ = tristimulus_matrix(wavelengths, "linear sRGB")
    wanted = np.clip(np.asarray(colour, np.float64), _ENDS, 1 - _ENDS)
    n = to_colour.shape[1]
    widths = np.diff(np.asarray(wavelengths, np.float64))
    slopes = np.diff(np.eye(n), axis=0) * np.sqrt(widths.mean() / widths)[:, None]
    roughness = 2 * slopes.T @ slopes
    z, multiplier = np.zeros(n), np.zeros(3)
    for _ in range(_STEPS):
        t = np.tanh(z)
        slope = (1 - t * t) / 2
        pull = to_colour.T @ multiplier
        left = np.concatenate([roughness @ z + slope * pull, to_colour @ (1 + t) / 2 - wanted])
        if np.abs(left).max() < _EXACT:
            return (1 + t) / 2
        towards = to_colour * slope
        jacobian = np.block(
            [[roughness - np.diag(2 * slope * t * pull), towards.T], [towards, np.zeros((3, 3))]]
        )
        step = np.linalg.solve(jacobian, -left)
        step *= min(1.0, _LARGEST / np.abs(step[:n]).max())
        z, multiplier = z + step[:n], multiplier + step[n:]
    raise ValueError(f"found no smooth reflectance of linear sRGB {np.round(colour, 4).tolist()}")
