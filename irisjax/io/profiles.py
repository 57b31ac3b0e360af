"""Embedded ICC profiles: those of three curves and a matrix are applied by OpenColorIO, by way of
OpenImageIO, without loss; other kinds by Little CMS, by way of Pillow, with 8 bits.
"""

import tempfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from irisjax.measure.colour import XYZ_TO_SRGB, srgb_decode

_ROWS = 256  # decoded at once: indices take eight bytes a value


def srgb_to_linear(steps: np.ndarray) -> np.ndarray:
    """Linear float32 values of sRGB-encoded uint8 or uint16 ones, of any shape with rows first."""
    largest = np.iinfo(steps.dtype).max
    table = np.asarray(srgb_decode(np.arange(largest + 1) / largest), np.float32)
    linear = np.empty(steps.shape, np.float32)
    for i in range(0, len(steps), _ROWS):
        linear[i : i + _ROWS] = table[steps[i : i + _ROWS]]
    return linear


def profile_to_linear(values: np.ndarray, profile: bytes) -> tuple[np.ndarray, str]:
    """Convert uint8, uint16 or float values (rows, columns, 1 or 3) under an ICC profile to linear
    sRGB, float32 (rows, columns, 3); also returns the profile's name, with a remark on a loss of
    precision, if any. Colours outside sRGB have negative components; white becomes (1, 1, 1).
    """
    from PIL import ImageCms

    try:
        embedded = ImageCms.ImageCmsProfile(BytesIO(profile))
        name = ImageCms.getProfileName(embedded).strip().split("\n")[0] or "without a name"
        about: Any = embedded.profile
        space = about.xcolor_space.strip()
        if space not in ("RGB", "GRAY"):
            raise ValueError(f"embedded colour profile of {space}, read are RGB and grey ones")
        if space == "GRAY" and values.shape[-1] != 1:
            raise ValueError("a grey colour profile in a picture of colours")
        if space == "RGB" and values.shape[-1] == 1:
            values = np.repeat(values, 3, -1)
        if space == "RGB" and about.is_matrix_shaper:
            linear = _matrix_to_linear(values, profile)
            if linear is not None:
                return linear, name
        steps = _managed_in_8_bits(values, embedded)
    except (ImageCms.PyCMSError, OSError) as error:
        raise ValueError(f"the embedded colour profile is broken ({error})") from None
    lossy = "" if values.dtype == np.uint8 else f", {values.dtype} before"
    return srgb_to_linear(steps), f"{name} (no matrix profile: converted with 8 bits{lossy})"


def _matrix_to_linear(values: np.ndarray, profile: bytes) -> np.ndarray | None:
    if values.dtype.kind == "f":
        xyz = _device_to_xyz(values, profile)
        return None if xyz is None else (xyz @ XYZ_TO_SRGB.T).astype(np.float32)
    largest = np.iinfo(values.dtype).max
    xyz = _device_to_xyz(np.linspace(0, 1, largest + 1)[:, None] * np.eye(3)[:, None], profile)
    if xyz is None:
        return None
    xyz = xyz.astype(np.float64)
    columns = xyz[:, -1] - xyz[:, 0]  # XYZ of each primary
    curves = np.einsum("cnx,cx->nc", xyz, columns) / (columns**2).sum(-1)
    matrix = XYZ_TO_SRGB @ columns.T
    matrix /= matrix.sum(-1, keepdims=True)  # rounding in the profile's numbers tints white
    linear = np.empty(values.shape, np.float32)
    curves, matrix = curves.astype(np.float32), matrix.T.astype(np.float32)
    for i in range(0, len(values), _ROWS):
        band = values[i : i + _ROWS]
        light = np.stack([curves[band[..., c], c] for c in range(3)], -1)
        np.matmul(light, matrix, out=linear[i : i + _ROWS])
    return linear


def _device_to_xyz(values: np.ndarray, profile: bytes) -> np.ndarray | None:
    """XYZ, adapted from D50 to D65 (white at Y = 1); `None` where OpenColorIO refuses."""
    import OpenImageIO as oiio

    image = oiio.ImageBuf(np.ascontiguousarray(values, np.float32))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "embedded.icc")
        file.write_bytes(profile)
        # OpenColorIO's forward direction is to the device.
        if not oiio.ImageBufAlgo.ociofiletransform(image, image, str(file), inverse=True):
            return None
    return np.asarray(image.get_pixels("float")).reshape(values.shape)


def _managed_in_8_bits(values: np.ndarray, profile: Any) -> np.ndarray:
    from PIL import Image, ImageCms

    if values.dtype.kind == "f":
        values = np.clip(values, 0, 1)
    largest = np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1
    steps = np.rint(values * np.float32(255 / largest)).astype(np.uint8)
    image = Image.fromarray(steps[..., 0] if steps.shape[-1] == 1 else steps)
    srgb = ImageCms.createProfile("sRGB")
    return np.asarray(ImageCms.profileToProfile(image, profile, srgb, outputMode="RGB"))
