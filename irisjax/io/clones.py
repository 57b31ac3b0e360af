"""Files of a clone: numbers, textures, maps and a scene."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from irisjax.io.images import encode_exr, encode_png
from irisjax.io.maps import encode_maps
from irisjax.measure.colour import srgb_encode
from irisjax.photo.clone import Fitted, Flat, Outlined, PictureDifference, Posed, Sampled, Shaped
from irisjax.photo.photograph import Ellipse
from irisjax.photo.pigments import PIGMENT_UNITS, concentrations_of, iris_of_concentrations
from irisjax.photo.pose import Pose, limbus_spread
from irisjax.photo.texture import HALF_WIDTH
from irisjax.render.environment import Environment
from irisjax.render.integrators import integrator_name

UNREFRACTED_PICTURE, VISIBLE_MASK = "unrefracted.png", "visible.png"
"""Names of the texture's picture, and of the mask of texels that show the iris."""
CLONE_FILES = (
    "clone.json",
    UNREFRACTED_PICTURE,
    VISIBLE_MASK,
    "freckles.png",
    "deconvolved.png",
    "maps.exr",
    "scene.toml",
    "environment.exr",
    "convergence.csv",
)
"""Names of all files that `files_of` may write."""
_SHORT = 6  # digits


def files_of(
    clone: Outlined,
    settings: Mapping[str, Any],
    timings: Mapping[str, float],
    pictures: PictureDifference | None = None,
    doubts: Sequence[str] = (),
) -> dict[str, bytes]:
    """Return the files of a clone up to the stage that it has reached, by name.

    Args:
        clone: The last stage that was reached.
        settings: Options of the command.
        timings: Seconds by the names of stages.
        pictures: The clone's picture compared with the photograph.
        doubts: Sentences on what is doubtful.
    """
    summary = _summary(clone, settings, timings) | {"doubts": list(doubts)}
    if pictures is not None:
        summary["picture_rms"] = pictures.rms.tolist()
    found = {"clone.json": _json(summary)}
    if isinstance(clone, Flat):
        found[UNREFRACTED_PICTURE] = _texture(UNREFRACTED_PICTURE, clone.texture.pixels)
        found[VISIBLE_MASK] = _mask(VISIBLE_MASK, clone.texture.valid)
    if isinstance(clone, Shaped):
        shape = clone.morphology
        found["freckles.png"] = _mask("freckles.png", shape.freckles)
        span = max(float(np.abs(shape.deconvolved).max()), 1e-6)
        grey = np.repeat(0.5 + 0.5 * shape.deconvolved[..., None] / span, 3, -1)
        found["deconvolved.png"] = encode_png("deconvolved.png", grey, remark=_REMARK)[0]
        found["maps.exr"] = encode_maps("maps.exr", shape.maps)
    if isinstance(clone, Fitted):
        found["scene.toml"] = scene_text(clone).encode()
        around = clone.scene().environment
        if around is not None and not _is_uniform(around):
            found["environment.exr"] = encode_exr("environment.exr", np.asarray(around.radiance))
        if log := clone.fit.log:
            rows = [",".join(log[0]), *(",".join(f"{v:.6g}" for v in r.values()) for r in log)]
            found["convergence.csv"] = ("\n".join(rows) + "\n").encode()
    return found


_REMARK = "estimated by irisjax from a photograph"


def _summary(
    clone: Outlined, settings: Mapping[str, Any], timings: Mapping[str, float]
) -> dict[str, Any]:
    """The contents of `clone.json`."""
    outlines = clone.boundaries
    found: dict[str, Any] = {
        "photograph": clone.photograph.name,
        "notes": list(clone.photograph.notes),
        "settings": dict(settings),
        "limbus": _ellipse(outlines.limbus) | {"confidence": outlines.limbus_confidence},
        "pupil": _ellipse(outlines.pupil) | {"confidence": outlines.pupil_confidence},
    }
    if isinstance(clone, Posed):
        found |= _pose(clone.pose)
        if clone.second is not None:
            laid = clone.second.registration
            found["second"] = {
                "correlation": laid.correlation,
                "residual_px": laid.residual,
                "scale": laid.scale,
                "rotation_deg": math.degrees(laid.rotation),
            }
    if isinstance(clone, Shaped):
        texture, shape = clone.texture, clone.morphology
        radius = texture.radius()
        ring = (radius > texture.pupil_radius) & (radius < texture.iris_radius)
        quantiles = np.quantile(shape.thickness[texture.valid], [0.025, 0.5, 0.975])
        names = "q2.5", "median", "q97.5"
        found |= {
            "visible_share": float(texture.valid.sum() / ring.sum()),
            "freckles_share": float(shape.freckles.sum() / ring.sum()),
            "clamped_texels": shape.clamped,
            "deconvolution_mm": shape.sigma_mm,
            "stroma_thickness_mm": dict(zip(names, quantiles.tolist(), strict=True)),
        }
    if isinstance(clone, Fitted):
        found |= {
            "lamps_found": clone.lighting.found,
            "thickness_response": clone.response,
            "estimate": clone.fit.values
            | concentrations_of(iris_of_concentrations(clone.fit.values, clone.base)),
            "units": PIGMENT_UNITS,
            "windows_rms": clone.fit.rms.tolist(),
            "steps": clone.fit.steps,
            "converged": clone.fit.converged,
        }
    if isinstance(clone, Sampled):
        chains = clone.posterior.chains
        found |= {
            "posterior": {
                name: {
                    "median": e.median,
                    "sd": e.sd,
                    "q2.5": e.low,
                    "q97.5": e.high,
                    "contraction": e.contraction,
                    "unit": PIGMENT_UNITS[name],
                }
                for name, e in clone.posterior.estimates.items()
            },
            "chain": {
                "converged": chains.converged,
                "reason": chains.reason,
                "steps": chains.steps,
                "autocorrelation_steps": float(np.max(chains.tau)),
                "r_hat": float(np.max(chains.rhat)),
                "effective_samples": min(chains.ess_bulk.min(), chains.ess_tail.min()),
            },
        }
    return found | {"seconds": dict(timings)}


def _pose(pose: Pose) -> dict[str, Any]:
    """Camera and eye as entries of `clone.json`."""
    eye, (mean, spread) = pose.eye, limbus_spread()
    return {
        "tilt_deg": math.degrees(pose.tilt),
        "tilt_sd_deg": math.degrees(pose.tilt_sd),
        "tilt_95_deg": [math.degrees(t) for t in pose.tilt_interval],
        "azimuth_deg": math.degrees(float(pose.camera.azimuth)),
        "side_from": pose.side,
        "distance_mm": pose.distance,
        "distance_sd_mm": None if pose.distance is None else pose.distance * spread / mean,
        "lengths": {
            "limbus_radius_mm": float(eye.limbus_radius),
            "limbus_width_mm": float(eye.limbus_width),
            "mean_of_461_people_mm": mean,
            "relative_sd": spread / mean,
            "meaning": "every length is in proportion to the limbus's radius, which is assumed",
        },
        "pupil_radius_mm": float(eye.pupil_radius),
        "pupil_margin_mm": float(eye.pupil_margin),
        "iris_radius_mm": float(eye.iris_radius),
        "pupil_centre_mm": list(pose.pupil_centre),
        "iris_depth_mm": float(eye.iris_depth),
    }


def scene_text(clone: Fitted) -> str:
    """Return a scene file of the eye as it was photographed."""
    scene = clone.scene()
    eye, camera, iris, lights = scene.eye, scene.camera, scene.tissue, scene.lights
    cornea = eye.cornea
    assert cornea is not None
    exposure = float(np.clip(clone.exposure[1], 1e-6, 1e6))
    rows = [
        f"# {_REMARK}: {clone.photograph.name}",
        "[iris]",
        *(
            f"{name} = {_number(getattr(iris, name))}"
            for name in (
                "eumelanin",
                "pheomelanin",
                "abl_fraction",
                "pheomelanin_abl_fraction",
                "stroma_thickness",
                "fibril_radius",
                "scattering_scale",
            )
        ),
        "",
        "[maps]",
        'file = "maps.exr"',
        "",
        "[eye]",
        f"cornea = {json.dumps('f09' if cornea.posterior is None else 'two-surfaces')}",
        f"pupil_radius = {_number(eye.pupil_radius)}",
        f"pupil_margin = {_number(eye.pupil_margin)}",
        f"limbus_width = {_number(eye.limbus_width)}",
        f"iris_depth = {_number(eye.iris_depth)}",
        "",
        "[camera]",
        f"size = [{camera.size[0]}, {camera.size[1]}]",
        f"polar_deg = {_number(np.degrees(camera.polar))}",
        f"azimuth_deg = {_number(np.degrees(camera.azimuth))}",
        f"distance = {_number(camera.distance)}",
        f"width = {_number(camera.width)}",
        "",
        "[picture]",
        f"exposure = {_number(exposure)}",
        f'integrator = "{integrator_name(clone.integrator)}"',
    ]
    if (around := scene.environment) is not None:
        kind = 'kind = "uniform"', f"strength = {_number(around.radiance[0, 0, 0])}"
        rows += ["", "[environment]"]
        rows += kind if _is_uniform(around) else ['file = "environment.exr"']
    if lights is not None:
        towards = np.asarray(lights.towards, np.float64)
        for i, (x, y, z) in enumerate(towards):
            rows += [
                "",
                "[[light]]",
                f"polar_deg = {_number(np.degrees(np.arccos(np.clip(-z, -1, 1))))}",
                f"azimuth_deg = {_number(np.degrees(np.arctan2(y, x)))}",
                f"irradiance = {_number(lights.irradiance[i])}",
                f"radius_deg = {_number(np.degrees(lights.radius[i]))}",
            ]
    return "\n".join(rows) + "\n"


def _is_uniform(around: Environment) -> bool:
    return float(np.ptp(np.asarray(around.radiance))) == 0


def _number(value) -> str:
    return repr(float(f"{float(value):.{_SHORT}g}"))


def _ellipse(outline: Ellipse) -> dict[str, Any]:
    return {
        "centre_px": list(outline.centre),
        "semi_axes_px": list(outline.semi_axes),
        "angle_deg": math.degrees(outline.angle),
    }


def _texture(name: str, pixels: np.ndarray) -> bytes:
    encoded = np.clip(np.asarray(srgb_encode(pixels)), 0, 1)
    remark = f"{_REMARK}; x, y from -{HALF_WIDTH:g} to {HALF_WIDTH:g} mm, row 0 at the top"
    return encode_png(name, encoded, remark=remark)[0]


def _mask(name: str, mask: np.ndarray) -> bytes:
    return encode_png(name, np.repeat(mask[..., None].astype(float), 3, -1), remark=_REMARK)[0]


def _json(values: Mapping[str, Any]) -> bytes:
    return (json.dumps(_plain(values), indent=1, allow_nan=False) + "\n").encode()


def _plain(value):
    """Numbers of few digits, and `null` for infinite and undefined ones."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.8g}") if math.isfinite(value) else None
    return _plain(value.item()) if hasattr(value, "item") else value
