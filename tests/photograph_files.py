"""Files of photographs, made as cameras and programs make them."""

import struct

import numpy as np
import OpenImageIO as oiio
from PIL import Image

SHAPE = (72, 96)


def fixed(*values):
    return b"".join(struct.pack(">i", round(v * 65536)) for v in values)


def profile_of(space, **tags):
    """A display profile [ICC.1:2010-12, sections 7 to 10]."""
    text = b"desc" + struct.pack(">II", 0, 5) + b"Test\0" + bytes(12 + 67)
    tags |= {
        "wtpt": b"XYZ \0\0\0\0" + fixed(0.9642, 1.0, 0.8249),
        "desc": text,
        "cprt": b"text\0\0\0\0none\0",
    }
    table, body, at = struct.pack(">I", len(tags)), b"", 128 + 4 + 12 * len(tags)
    for name, value in tags.items():
        table += name.encode() + struct.pack(">II", at + len(body), len(value))
        body += value + bytes(-len(value) % 4)
    head = struct.pack(
        ">I4xI4s4s4s12x4s", at + len(body), 0x02400000, b"mntr", space, b"XYZ ", b"acsp"
    )
    head += bytes(28) + fixed(0.9642, 1.0, 0.8249)
    return head.ljust(128, b"\0") + table + body


def curve(gamma):
    return b"curv" + struct.pack(">IIH", 0, 1, round(gamma * 256))


def matrix_profile(primaries, gamma):
    colours = {
        f"{c}XYZ": b"XYZ \0\0\0\0" + fixed(*p) for c, p in zip("rgb", primaries, strict=True)
    }
    return profile_of(b"RGB ", **colours, **{f"{c}TRC": curve(gamma) for c in "rgb"})


def steps(dtype=np.uint8, channels=3, seed=3):
    most = np.iinfo(dtype).max
    return np.random.default_rng(seed).integers(0, most, (*SHAPE, channels), dtype, endpoint=True)


def write(path, values, **attributes):
    kind = {"uint8": "uint8", "uint16": "uint16", "float32": "float"}[values.dtype.name]
    spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], kind)
    for name, value in attributes.items():
        if isinstance(value, bytes):
            spec.attribute(
                name, oiio.TypeDesc(f"uint8[{len(value)}]"), np.frombuffer(value, np.uint8)
            )
        else:
            spec.attribute(name, value)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(values) and file.close()
    return path


def smooth():
    """A colour picture that JPEG keeps to within a step or two."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.stack([2 * x, 3 * y, 200 - x], -1).astype(np.uint8)


def exif(orientation=1, **tags):
    names = {
        "film": 41989,
        "focal": 37386,
        "per": 41486,
        "unit": 41488,
        "x": 40962,
        "y": 40963,
        "space": 40961,
    }
    made = Image.Exif()
    made[274] = orientation
    made.get_ifd(0x8769).update({names[k]: v for k, v in tags.items()})
    return made


def jpeg(path, picture=None, **options):
    picture = smooth() if picture is None else picture
    Image.fromarray(picture).save(path, quality=98, subsampling=0, **options)
    return path
