"""Doubts about a clone: each is a sentence that says what is doubtful and what to do about it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from irisjax.numerics.checks import Range
from irisjax.photo import pigments
from irisjax.photo.clone import LEAST_RESPONSE, Coloured, Fitted, Outlined, Posed, Sampled
from irisjax.photo.outlines import MIN_CONFIDENCE

DOUBTS = ("outlines", "light", "model")
"""Kinds of doubt: where the eye is, how it is lit, and what the model makes of its iris."""
_OUTSIDE_SHARE = 0.05  # of an iris with colours that the model cannot make, above which it is said
_DISTANCES = Range(80, 2000, "mm")  # of cameras that photograph an iris, macro to long lenses
_PICTURES_OFF = 0.05  # RMS difference of the encoded pictures above which a clone is doubtful [F09]
_STRETCHED = 0.3  # probability that a file is, above which that is said


class Doubt(NamedTuple):
    """A doubt about a clone: its kind, one of `DOUBTS`, and its sentence."""

    kind: str
    sentence: str


def doubtful_outlines(found: Outlined) -> dict[str, float]:
    """Return the outlines that a clone must not be built on, and the confidence in each."""
    sure = found.boundaries.limbus_confidence, found.boundaries.pupil_confidence
    both = zip(("limbus", "pupil"), sure, strict=True)
    return {name: confidence for name, confidence in both if confidence < MIN_CONFIDENCE}


def doubts_of(found: Outlined, rms: Float[np.ndarray, "3"] | None = None) -> tuple[Doubt, ...]:
    """Return what is doubtful about the last stage that was reached; `rms` has the differences by
    channel, of the full range, of the picture that the pigments make of the photograph.
    """
    light, model = list[str](), list[str]()
    outlines = [
        f"the {name} is doubtful (confidence {confidence:.2f}); give --{name}"
        for name, confidence in doubtful_outlines(found).items()
    ]
    if outlines:
        outlines.append("nothing after the outlines was done")
    outlines += found.boundaries.doubts()
    distance = found.pose.distance if isinstance(found, Posed) else None
    if distance is not None and not _DISTANCES.holds(distance):
        outlines.append(
            f"the focal length puts the camera {distance:.0f} mm away, where {_DISTANCES} are "
            "usual: it may be wrong; give --focal-px in pixels of this file"
        )
    if isinstance(found, Posed) and found.pose.stretched > _STRETCHED:
        wide, high = (e.semi_axes for e in found.boundaries[:2])
        outlines.append(
            f"limbus and pupil are both flat, by {100 * (wide[0] / wide[1] - 1):.0f} and "
            f"{100 * (high[0] / high[1] - 1):.0f} %: the file may be stretched rather than the eye "
            "tilted; resize it to its true proportions"
        )
    own = found.texels if isinstance(found, Coloured) else None
    if isinstance(found, Fitted):
        if (ratios := pigments.strange_white(found.fit, found.windows)) is not None:
            light.append(
                f"the white of the eye is {', '.join(f'{r:.2g}' for r in ratios)} times (R, G, B) "
                "what it usually is in the light of the iris: a tone curve, or light that is not "
                "as inferred; give --light or --environment"
            )
        if found.photograph.grey:
            model.append("the photograph has no colours: the pigments are meaningless")
        model += (odd := pigments.misfits(found.fit, found.windows))
        # A clone whose texels each have a thickness does not use the one by the response.
        response = found.morphology.response if own is None else None
        if odd and response is not None:
            model.append(f"the thickness is that of a usual iris, whose response is {response:.2f}")
        elif response is not None and response < LEAST_RESPONSE:
            model.append(
                f"thickness hardly shows in this iris (1 % of it changes the light by "
                f"{max(response, 0):.2f} %): the map is little more than an average iris's"
            )
    if own is not None and own.gain != 1:
        light.append(
            f"the iris's colours need {own.gain:g} times the exposure that its brightness tells: "
            "its pigments and the strength of its scattering mean little; give --light or "
            "--environment"
        )
    if own is not None and own.outside > _OUTSIDE_SHARE:
        model.append(
            f"{100 * own.outside:.0f} % of the iris has colours that the model cannot make: a "
            "reflection, a lens, saturated colours; the map residual keeps them"
        )
    if rms is not None and rms.max() > _PICTURES_OFF:
        model.append(
            f"the picture that the pigments make differs from the photograph by {per_cent(rms)} % "
            "RMS (R, G, B): a reflection, a shadow or an iris that the model does not have"
        )
    if isinstance(found, Sampled) and not found.posterior.converged:
        model.append(
            f"the intervals of the pigments are rough: their samples count as "
            f"{found.posterior.effective:.0f} independent ones, not as {pigments.EFFECTIVE}; try "
            "another --seed"
        )
    kinds = zip(DOUBTS, (outlines, light, model), strict=True)
    return tuple(Doubt(kind, sentence) for kind, sentences in kinds for sentence in sentences)


def per_cent(shares: Float[np.ndarray, " channels"]) -> str:
    """Return shares of the channels as text, in per cent."""
    return ", ".join(f"{100 * share:.1f}" for share in shares)
