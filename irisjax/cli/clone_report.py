"""Report of `irisjax clone` about its result."""

import sys
from pathlib import Path

import numpy as np

from irisjax.photo.clone import Fitted, Outlined, Posed, Sampled
from irisjax.photo.posterior import PigmentPosterior


def report(found: Outlined, cross_polarised: bool, folder: Path, doubts: tuple[str, ...]) -> None:
    """Print what was found, and on standard error what is doubtful."""
    for doubt in doubts:
        tell(f"WARNING: {doubt}")
    if isinstance(found, Posed):
        pose = found.pose
        where = "" if pose.distance is None else f", {pose.distance:.0f} mm away"
        low, high = np.degrees(pose.tilt_interval)
        print(
            f"camera: {np.degrees(pose.tilt):.1f} ({low:.1f} to {high:.1f}) degrees off the "
            f"eye's axis{where}; pupil {2 * float(pose.eye.pupil_radius):.2f} mm wide, lengths for "
            f"a limbus of {2 * float(pose.eye.limbus_radius):.1f} mm"
        )
        if pose.distance is None:
            tell("no focal length in the file: the distance is not known; give --focal-px")
    if isinstance(found, Fitted):
        if cross_polarised:
            tell(
                "WARNING: the model's iris keeps 98 % and more of the light's polarisation, so "
                "crossed polarisers would make it black; the pigments are those of an iris that "
                "depolarises"
            )
        if found.lighting.found == 0:
            tell("no highlight on the cornea shows a lamp: light from all round is assumed")
    if isinstance(found, Sampled):
        print(_table(found.posterior))
        print("the intervals allow for a thickness and shading unlike the model's")
    print(f"written: {folder}")


def tell(text: str) -> None:
    """Print a line on standard error."""
    print(f"irisjax: {text}", file=sys.stderr)


def _table(posterior: PigmentPosterior) -> str:
    rows = [f"{'parameter':<20}{'median':>10}{'95 %':>22}{'contraction':>13}"]
    for name, e in posterior.estimates.items():
        span = f"{e.low:.3g} to {e.high:.3g}"
        rows.append(f"{name:<20}{e.median:>10.3g}{span:>22}{e.contraction:>13.2f}")
    return "\n".join(rows)
