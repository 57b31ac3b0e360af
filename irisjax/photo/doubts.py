"""What of a clone is doubtful, in sentences: outlines, the camera's place, and a model that cannot
follow the photograph."""

import numpy as np
from jaxtyping import Float

from irisjax.numerics.checks import Range
from irisjax.photo.boundaries import MIN_CONFIDENCE
from irisjax.photo.cloned import Clone, needed
from irisjax.photo.pigments import NAMES, PRIORS, UNITS

DISTANCES = Range(80, 2000, "mm")
"""Of cameras that photograph an iris: from macro lenses near their limit to long ones."""
WINDOWS_OFF = 0.25
"""Root mean square of ln photograph over model in the windows from which on a fit is doubtful, the
channels weighted by their brightness; simulated photographs stay below 0.16, lids and lashes or
not.
"""
PICTURES_OFF = 0.05
"""The same of the pictures' encoded values: what F09 reached."""
UNUSUAL = 3.0
"""Standard deviations of its prior that a parameter may be off."""
LEAST_RESPONSE = 0.1
"""d ln luminance / d ln thickness below which a photograph tells little of the thickness."""


def doubtful_outlines(found: Clone) -> dict[str, float]:
    """Outlines that a clone may not be built on, and the confidence in each."""
    both = {
        "limbus": found.boundaries.limbus_confidence,
        "pupil": found.boundaries.pupil_confidence,
    }
    return {name: c for name, c in both.items() if c < MIN_CONFIDENCE}


def doubts_of(found: Clone, rms: Float[np.ndarray, "3"] | None = None) -> tuple[str, ...]:
    """A sentence for each doubt, none for a clone that may be trusted.

    Args:
        found: As far as it has come.
        rms: Differences of its picture from the photograph per channel, of the full range.
    """
    doubts = [
        f"the {name} is doubtful (confidence {confidence:.2f}); give --{name}"
        for name, confidence in doubtful_outlines(found).items()
    ]
    if doubts:
        doubts.append("nothing after the outlines was done")
    distance = None if found.pose is None else found.pose.distance
    if distance is not None and not DISTANCES.holds(distance):
        doubts.append(
            f"the focal length puts the camera {distance:.0f} mm away, where {DISTANCES} are "
            "usual: it may be wrong; --focal-px is in pixels of this file"
        )
    if found.fit is not None:
        if found.photograph.grey:
            doubts.append("the photograph has no colours: its pigments mean nothing")
        doubts += (odd := misfits(found))
        if odd and found.response is not None:
            doubts.append(
                f"thickness is told as in a usual iris, whose response is {found.response:.2f}"
            )
        elif found.response is not None and found.response < LEAST_RESPONSE:
            doubts.append(
                f"thickness hardly shows in this iris (1 % of it changes the light by "
                f"{max(found.response, 0):.2f} %): the map is little more than an average's"
            )
    if rms is not None and rms.max() > PICTURES_OFF:
        doubts.append(
            f"the clone's picture differs from the photograph by {percent(rms)} % RMS (R, G, B): "
            "a reflection, a shadow or an iris that the model does not have"
        )
    if found.posterior is not None and not found.posterior.chains.converged:
        doubts.append(f"{found.posterior.chains.reason}; raise --max-steps")
    return tuple(doubts)


def misfits(found: Clone) -> list[str]:
    """Sentences on where the model does not follow the photograph, or follows it by what hardly any
    eye has.
    """
    doubts, fit, windows = [], needed(found.fit), needed(found.windows)
    weights = np.maximum(windows.colour[windows.present].mean(0), 0)
    if np.sqrt(np.average(fit.rms**2, weights=weights + 1e-9)) > WINDOWS_OFF:
        doubts.append(
            "the model does not follow the photograph's colours (off by factors of "
            f"{', '.join(f'{f:.2f}' for f in np.exp(fit.rms))} in R, G, B over the iris, RMS): its "
            "pigments may mean little"
        )
    for name, z in zip(NAMES, fit.z, strict=True):
        if abs(z) > UNUSUAL:
            low, high = (float(PRIORS[name].value(s)) for s in (-1.96, 1.96))
            unit = f" {UNITS[name]}" if UNITS[name] else ""
            doubts.append(
                f"{name} is {fit.values[name]:.3g}{unit}, far from what is usual ({low:.2g} to "
                f"{high:.2g}): the model may not fit this photograph"
            )
    if not fit.converged:
        doubts.append("the search for the pigments did not end of itself")
    return doubts


def percent(shares) -> str:
    """Shares of the channels as text."""
    return ", ".join(f"{100 * share:.1f}" for share in shares)
