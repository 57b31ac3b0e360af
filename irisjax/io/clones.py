"""What a clone of a photographed eye is written as: numbers, textures, maps and a scene."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from irisjax.io.images import encode_exr, encode_png
from irisjax.io.maps import encode_maps
from irisjax.measure.colour import srgb_encode
from irisjax.photo.cloned import Clone, needed
from irisjax.photo.concentrations import concentrations_of, iris_of
from irisjax.photo.ellipse import Ellipse
from irisjax.photo.picture import Comparison
from irisjax.photo.pigments import UNITS
from irisjax.photo.pose import limbus_spread
from irisjax.photo.unrefracted import HALF_WIDTH
from irisjax.render.environment import Environment

UNREFRACTED, VISIBLE = "unrefracted.png", "visible.png"
"""Of the texture: its picture, and a mask of what shows the iris."""
FILES = (
    "clone.json",
    UNREFRACTED,
    VISIBLE,
    "freckles.png",
    "deconvolved.png",
    "maps.exr",
    "scene.toml",
    "environment.exr",
    "convergence.csv",
)
"""All that `files_of` may write."""
_SHORT = 6  # digits


def files_of(
    clone: Clone,
    settings: Mapping[str, Any],
    timings: Mapping[str, float],
    pictures: Comparison | None = None,
    doubts: Sequence[str] = (),
) -> dict:
    """The files of a clone as far as it has come: bytes by name, `clone.json` among them.

    Args:
        clone: The clone.
        settings: What it was asked with.
        timings: Seconds by the names of stages.
        pictures: Of clone and photograph, compared.
        doubts: Sentences on what is doubtful.
    """
    summary = summary_of(clone, settings, timings) | {"doubts": list(doubts)}
    if pictures is not None:
        summary["picture_rms"] = pictures.rms.tolist()
    found = {"clone.json": _json(summary)}
    if clone.texture is not None:
        found[UNREFRACTED] = _texture(UNREFRACTED, clone.texture.pixels)
        found[VISIBLE] = _mask(VISIBLE, clone.texture.valid)
    if clone.morphology is not None:
        shape = clone.morphology
        found["freckles.png"] = _mask("freckles.png", shape.freckles)
        span = max(float(np.abs(shape.deconvolved).max()), 1e-6)
        grey = np.repeat(0.5 + 0.5 * shape.deconvolved[..., None] / span, 3, -1)
        found["deconvolved.png"] = encode_png("deconvolved.png", grey, remark=_REMARK)[0]
        found["maps.exr"] = encode_maps("maps.exr", shape.maps)
    if clone.fit is not None:
        found["scene.toml"] = scene_text(clone).encode()
        around = clone.scene().environment
        if around is not None and not _is_uniform(around):
            found["environment.exr"] = encode_exr("environment.exr", np.asarray(around.radiance))
        if clone.fit.log:
            found["convergence.csv"] = _log(clone).encode()
    return found


_REMARK = "estimated by irisjax from a photograph"


def summary_of(clone: Clone, settings: Mapping[str, Any], timings: Mapping[str, float]) -> dict:
    """What `clone.json` holds."""
    outlines, pose = clone.boundaries, clone.pose
    mean, spread = limbus_spread()
    found: dict[str, Any] = {
        "photograph": clone.photograph.name,
        "notes": list(clone.photograph.notes),
        "settings": dict(settings),
        "limbus": _ellipse(outlines.limbus) | {"confidence": outlines.limbus_confidence},
        "pupil": _ellipse(outlines.pupil) | {"confidence": outlines.pupil_confidence},
    }
    if pose is not None:
        eye = pose.eye
        found |= {
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
    if clone.second is not None:
        told = clone.second.registration
        found["second"] = {
            "correlation": told.correlation,
            "residual_px": told.residual,
            "scale": told.scale,
            "rotation_deg": math.degrees(told.rotation),
        }
    if clone.morphology is not None and clone.texture is not None:
        shape, valid = clone.morphology, clone.texture.valid
        iris = clone.texture.radius() < clone.texture.iris_radius
        ring = iris & (clone.texture.radius() > clone.texture.pupil_radius)
        found |= {
            "visible_share": float(valid.sum() / ring.sum()),
            "freckles_share": float(shape.freckles.sum() / ring.sum()),
            "clamped_texels": shape.clamped,
            "deconvolution_mm": shape.sigma_mm,
            "stroma_thickness_mm": {
                name: float(q)
                for name, q in zip(
                    ("q2.5", "median", "q97.5"),
                    np.quantile(shape.thickness[valid], [0.025, 0.5, 0.975]),
                    strict=True,
                )
            },
        }
    if clone.fit is not None and clone.base is not None:
        iris = iris_of(clone.fit.values, clone.base)
        found |= {
            "lamps_found": needed(clone.lighting).found,
            "thickness_response": clone.response,
            "estimate": {n: clone.fit.values[n] for n in clone.fit.values}
            | concentrations_of(iris),
            "units": UNITS,
            "windows_rms": clone.fit.rms.tolist(),
            "steps": clone.fit.steps,
            "converged": clone.fit.converged,
        }
    if clone.posterior is not None:
        chains = clone.posterior.chains
        effective = min(chains.ess_bulk.min(), chains.ess_tail.min())
        found |= {
            "posterior": {
                name: {
                    "median": e.median,
                    "sd": e.sd,
                    "q2.5": e.low,
                    "q97.5": e.high,
                    "contraction": e.contraction,
                    "unit": UNITS[name],
                }
                for name, e in clone.posterior.estimates.items()
            },
            "chain": {
                "converged": chains.converged,
                "reason": chains.reason,
                "steps": chains.steps,
                "autocorrelation_steps": float(np.max(chains.tau)),
                "r_hat": float(np.max(chains.rhat)),
                "effective_samples": effective,
            },
        }
    return found | {"seconds": dict(timings)}


def scene_text(clone: Clone, maps: str = "maps.exr") -> str:
    """A scene file of the eye as it was photographed; `maps` is the name of the file of maps."""
    scene = clone.scene()
    eye, camera, iris, lights = scene.eye, scene.camera, scene.tissue, scene.lights
    cornea = needed(eye.cornea)
    exposure = float(np.clip(needed(clone.exposure)[1], 1e-6, 1e6))
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
        f"file = {json.dumps(maps)}",
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
        f'integrator = "{_integrator(clone)}"',
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


def _integrator(clone: Clone) -> str:
    from irisjax.render.integrators import integrator_name

    return integrator_name(clone.integrator)


def _number(value) -> str:
    return repr(float(f"{float(value):.{_SHORT}g}"))


def _log(clone: Clone) -> str:
    log = needed(clone.fit).log
    rows = [",".join(log[0])]
    rows += [",".join(f"{value:.6g}" for value in row.values()) for row in log]
    return "\n".join(rows) + "\n"


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
    """Numbers of few digits, and `null` for those that are none."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(f"{float(value):.8g}") if math.isfinite(value) else None
    return _plain(value.item()) if hasattr(value, "item") else value
