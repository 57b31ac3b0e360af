"""Files of a clone: numbers, textures, maps and a scene."""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from irisjax.infer.importance import DRAWS
from irisjax.io.images import encode_exr, encode_png
from irisjax.io.maps import encode_maps
from irisjax.io.scenes import scene_text
from irisjax.io.sections import json_of
from irisjax.io.tables import csv_of
from irisjax.measure.colour import srgb_encode
from irisjax.photo.clone import (
    Coloured,
    Fitted,
    Flat,
    Outlined,
    PictureDifference,
    Posed,
    Sampled,
    Shaped,
)
from irisjax.photo.doubts import DOUBTS, Doubt
from irisjax.photo.overlay import draw_overlay
from irisjax.photo.photograph import Ellipse
from irisjax.photo.pigments import PIGMENT_UNITS, iris_of_concentrations
from irisjax.photo.pose import Pose, limbus_spread
from irisjax.photo.texels import NAMES
from irisjax.photo.texture import HALF_WIDTH
from irisjax.tissue.iris import Iris

UNREFRACTED_PICTURE, VISIBLE_MASK = "unrefracted.png", "visible.png"
"""Names of the texture's picture, and of the mask of texels that show the iris."""
OVERLAY = "outlines.png"
"""Name of the photograph with what was found in it."""
CLONE_FILES = (
    *("clone.json", OVERLAY, UNREFRACTED_PICTURE, VISIBLE_MASK, "freckles.png", "deconvolved.png"),
    *("maps.exr", "deviations.exr", "scene.toml", "environment.exr", "convergence.csv"),
)
"""Names of all files that `files_of` may write."""
_REMARK = "estimated by irisjax from a photograph"
_OF_ESTIMATE = "median", "sd", "q2.5", "q97.5", "contraction"  # fields of an `Estimate`


def files_of(
    clone: Outlined,
    settings: Mapping[str, object],
    timings: Mapping[str, float],
    pictures: PictureDifference | None,
    doubts: Sequence[Doubt],
) -> dict[str, bytes]:
    """Return the files, by name, of a clone up to the last stage that it has reached, with options
    of the command, seconds by the names of stages, and what is doubtful.
    """
    summary = summary_of(clone, settings, timings, doubts)
    if pictures is not None:
        summary["picture_rms"] = pictures.rms
        summary["picture_rms_of_pigments"] = pictures.rms_of_pigments
    files = {"clone.json": json_of(summary, 8), OVERLAY: overlay_of(clone)}
    if isinstance(clone, Flat):
        encoded = np.clip(np.asarray(srgb_encode(clone.texture.pixels)), 0, 1)
        sides = f"; x, y from -{HALF_WIDTH:g} to {HALF_WIDTH:g} mm, row 0 at the top"
        files[UNREFRACTED_PICTURE] = _png(encoded, sides)
        files[VISIBLE_MASK] = _png(clone.texture.valid)
    texels = clone.texels if isinstance(clone, Coloured) else None
    if isinstance(clone, Shaped):
        files["freckles.png"] = _png(clone.freckles)
        if texels is None:
            contrast = clone.morphology.deconvolved
            span = max(float(np.abs(contrast).max()), 1e-6)
            files["deconvolved.png"] = _png(0.5 + 0.5 * contrast / span)
        maps = clone.maps() if isinstance(clone, Fitted) else clone.morphology.maps
        files["maps.exr"] = encode_maps("maps.exr", maps)
    if texels is not None:
        layers = np.moveaxis(texels.deviations, 0, -1), texels.hidden[..., None]
        labels = {"comments": "standard deviations of logarithms of maps.exr; 1 in what is hidden"}
        image, names = np.concatenate(layers, -1), (*NAMES, "hidden")
        files["deviations.exr"] = encode_exr("deviations.exr", image, names, labels)
    if isinstance(clone, Fitted):
        scene, exposure = clone.scene(), float(np.clip(clone.exposure[1], 1e-6, 1e6))
        sky = scene.environment
        entries = {"maps": {"file": "maps.exr"}, "picture": {"exposure": exposure}}
        entries["eye"] = {"veins": "clear"}  # a clone has its iris only: the white is drawn clear
        if sky is not None and not sky.is_uniform():
            files["environment.exr"] = encode_exr("environment.exr", np.asarray(sky.radiance))
            entries["environment"] = {"file": "environment.exr"}
        text = scene_text(scene, entries, f"{_REMARK}: {clone.photograph.name}")
        files["scene.toml"] = text.encode()
        if log := clone.fit.log:
            rows = ([f"{value:.6g}" for value in row.values()] for row in log)
            files["convergence.csv"] = csv_of([log[0], *rows]).encode()
    return files


def overlay_of(clone: Outlined) -> bytes:
    """Return the bytes of `OVERLAY`."""
    return encode_png(OVERLAY, draw_overlay(clone), remark=_REMARK)[0]


def summary_of(
    clone: Outlined,
    settings: Mapping[str, object],
    timings: Mapping[str, float],
    doubts: Sequence[Doubt],
) -> dict[str, object]:
    """Return the contents of `clone.json`, but for the comparison of the pictures."""
    outlines, texels = clone.boundaries, clone.texels if isinstance(clone, Coloured) else None
    fields: dict[str, object] = {
        "photograph": clone.photograph.name,
        "notes": clone.photograph.notes,
        "settings": settings,
        "limbus": _ellipse(outlines.limbus) | {"confidence": outlines.limbus_confidence},
        "pupil": _ellipse(outlines.pupil) | {"confidence": outlines.pupil_confidence},
        "eyes_found": outlines.eyes,
        "crop_px": clone.crop(),
    }
    if isinstance(clone, Posed):
        fields |= _pose(clone.pose)
        if clone.second is not None:
            laid = clone.second.registration
            fields["second"] = {
                "correlation": laid.correlation,
                "residual_px": laid.residual,
                "scale": laid.scale,
                "rotation_deg": math.degrees(laid.rotation),
            }
    if isinstance(clone, Shaped):
        texture = clone.texture
        radius = texture.radius()
        ring = (radius > texture.pupil_radius) & (radius < texture.iris_radius)
        fields["visible_share"] = texture.valid.sum() / ring.sum()
        fields["freckles_share"] = clone.freckles.sum() / ring.sum()
        if texels is not None:
            shown, depth = ~texels.hidden, np.asarray(texels.maps.stroma_depth)
            out = (np.arange(depth.shape[1]) + 0.5) / depth.shape[1]
            area = texture.pupil_radius + (texture.iris_radius - texture.pupil_radius) * out
            thickness, weights = depth[shown], np.broadcast_to(area, depth.shape)[shown]
        else:
            shape = clone.morphology
            thickness, weights = shape.thickness[texture.valid], np.ones(texture.valid.sum())
            fields["clamped_texels"], fields["deconvolution_mm"] = shape.clamped, shape.sigma_mm
            fields["thickness_response"] = shape.response
        shares, known = [0.025, 0.5, 0.975], {"weights": weights, "method": "inverted_cdf"}
        low, middle, high = np.quantile(thickness, shares, **known)
        fields["stroma_thickness_mm"] = {"q2.5": low, "median": middle, "q97.5": high}
    if isinstance(clone, Fitted):
        fit = clone.fit
        iris = iris_of_concentrations(fit.values, clone.base)
        fields |= {
            "lamps_found": clone.lighting.found,
            "estimate": fit.values | iris.layer_concentrations() | _by_volume(iris),
            "units": PIGMENT_UNITS | dict.fromkeys(_by_volume(iris), "%"),
            "windows_rms": fit.rms,
            "steps": fit.steps,
            "converged": fit.converged,
        }
    if texels is not None:
        pairs = combinations(range(len(NAMES)), 2)
        fields["texels"] = {
            "medians": texels.iris.layer_concentrations() | _by_volume(texels.iris),
            "scattering_scale": texels.iris.scattering_scale,
            "exposure_factor": texels.gain,
            "outside_share": texels.outside,
            "explained_share": texels.explained,
            "hidden_share": texels.hidden.mean(),
            "common_sd_of_logarithms": dict(zip(NAMES, texels.common, strict=True)),
            "sd_of_logarithms": dict(zip(NAMES, np.median(texels.deviations, (1, 2)), strict=True)),
            "correlations": {f"{NAMES[i]}, {NAMES[j]}": texels.correlation[i, j] for i, j in pairs},
            "table_error": texels.error,
        }
        if isinstance(clone, Coloured) and (melanin := clone.abl_melanin()) is not None:
            values = dict(zip(("mean", "q2.5", "q97.5"), melanin, strict=True))
            fields["texels"]["abl_melanin"] = values | {"unit": "mg/ml"}
    if isinstance(clone, Sampled):
        sampled = clone.posterior
        fields |= {
            "posterior": {
                name: dict(zip(_OF_ESTIMATE, e, strict=True)) | {"unit": PIGMENT_UNITS[name]}
                for name, e in sampled.estimates.items()
            },
            "sampling": {
                "converged": sampled.converged,
                "effective_samples": sampled.effective,
                "draws": sampled.rounds * DRAWS,
            },
        }
    sentences = {kind: [d.sentence for d in doubts if d.kind == kind] for kind in DOUBTS}
    return fields | {"seconds": timings, "doubts": sentences}


def _by_volume(iris: Iris) -> dict[str, float]:
    """Melanins in per cent of volume, of an iris with F09's absorption."""
    return iris.volume_fractions() if iris.absorption == "f09" else {}


def _pose(pose: Pose) -> dict[str, object]:
    """Camera and eye as entries of `clone.json`."""
    eye, (mean, spread) = pose.eye, limbus_spread()
    return {
        "tilt_deg": math.degrees(pose.tilt),
        "tilt_sd_deg": math.degrees(pose.tilt_sd),
        "tilt_95_deg": [math.degrees(t) for t in pose.tilt_interval],
        "azimuth_deg": math.degrees(float(pose.camera.azimuth)),
        "side_from": pose.side,
        "stretched_probability": pose.stretched,
        "distance_mm": pose.distance,
        "distance_sd_mm": None if pose.distance is None else pose.distance * spread / mean,
        "lengths": {
            "limbus_radius_mm": eye.limbus_radius,
            "limbus_width_mm": eye.limbus_width,
            "mean_of_461_people_mm": mean,
            "relative_sd": spread / mean,
            "meaning": "every length is in proportion to the limbus's radius, which is assumed",
        },
        "pupil_radius_mm": pose.pupil_radius,
        "pupil_margin_mm": eye.pupil_margin,
        "iris_radius_mm": eye.iris_radius,
        "pupil_centre_mm": pose.pupil_centre,
        "iris_depth_mm": eye.iris_depth,
    }


def _ellipse(outline: Ellipse) -> dict[str, object]:
    return {
        "centre_px": outline.centre,
        "semi_axes_px": outline.semi_axes,
        "angle_deg": math.degrees(outline.angle),
    }


def _png(values: np.ndarray, remark: str = "") -> bytes:
    """A PNG of encoded colours, or of grey values or a mask."""
    grey = values.ndim == 2
    pixels = np.repeat(values[..., None].astype(float), 3, -1) if grey else values
    return encode_png("clone.png", pixels, remark=_REMARK + remark)[0]
