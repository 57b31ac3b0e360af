"""Doubts about a clone, as sentences."""

from jaxtyping import Float
from numpy import ndarray

from irisjax.numerics.checks import Range
from irisjax.photo.clone import Fitted, Outlined, Posed, Sampled
from irisjax.photo.outlines import MIN_CONFIDENCE
from irisjax.photo.pigments import misfits

_DISTANCES = Range(80, 2000, "mm")  # of cameras that photograph an iris, macro to long lenses
_PICTURES_OFF = 0.05  # RMS difference of the encoded pictures above which a clone is doubtful [F09]
_LEAST_RESPONSE = 0.1  # below it a photograph says little about the thickness


def doubtful_outlines(found: Outlined) -> dict[str, float]:
    """Return the outlines that a clone must not be built on, and the confidence in each."""
    sure = found.boundaries.limbus_confidence, found.boundaries.pupil_confidence
    both = zip(("limbus", "pupil"), sure, strict=True)
    return {name: confidence for name, confidence in both if confidence < MIN_CONFIDENCE}


def doubts_of(found: Outlined, rms: Float[ndarray, "3"] | None = None) -> tuple[str, ...]:
    """Return a sentence for each doubt about the last stage that was reached; `rms` has the
    differences of its picture from the photograph by channel, of the full range.
    """
    doubts = [
        f"the {name} is doubtful (confidence {confidence:.2f}); give --{name}"
        for name, confidence in doubtful_outlines(found).items()
    ]
    if doubts:
        doubts.append("nothing after the outlines was done")
    distance = found.pose.distance if isinstance(found, Posed) else None
    if distance is not None and not _DISTANCES.holds(distance):
        doubts.append(
            f"the focal length puts the camera {distance:.0f} mm away, where {_DISTANCES} are "
            "usual: it may be wrong; give --focal-px in pixels of this file"
        )
    if isinstance(found, Fitted):
        if found.photograph.grey:
            doubts.append("the photograph has no colours: the pigments are meaningless")
        doubts += (odd := misfits(found.fit, found.windows))
        if odd and found.response is not None:
            doubts.append(
                f"the thickness is that of a usual iris, whose response is {found.response:.2f}"
            )
        elif found.response is not None and found.response < _LEAST_RESPONSE:
            doubts.append(
                f"thickness hardly shows in this iris (1 % of it changes the light by "
                f"{max(found.response, 0):.2f} %): the map is little more than an average iris's"
            )
    if rms is not None and rms.max() > _PICTURES_OFF:
        doubts.append(
            f"the clone's picture differs from the photograph by {per_cent(rms)} % RMS (R, G, B): "
            "a reflection, a shadow or an iris that the model does not have"
        )
    if isinstance(found, Sampled) and not found.posterior.chains.converged:
        doubts.append(f"{found.posterior.chains.reason}; raise --max-steps")
    return tuple(doubts)


def per_cent(shares: Float[ndarray, " channels"]) -> str:
    """Return shares of the channels as text, in per cent."""
    return ", ".join(f"{100 * share:.1f}" for share in shares)
