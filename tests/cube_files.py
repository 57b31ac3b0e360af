"""Small hyperspectral cubes in files."""

import numpy as np

GRID = np.arange(420.0, 700.0, 40.0)
_TYPES = {"uint16": 12, "float32": 4, "float64": 5, "int16": 2}


def envi(path, cube, *, interleave="bil", **header):
    """Write a cube (rows, columns, bands) as ENVI; entries of `header` replace the usual ones."""
    axes = {"bil": (0, 2, 1), "bip": (0, 1, 2), "bsq": (2, 0, 1)}.get(interleave, (0, 1, 2))
    path.with_suffix(".img").write_bytes(np.ascontiguousarray(cube.transpose(axes)).tobytes())
    rows, columns, bands = cube.shape
    lines = {"samples": columns, "lines": rows, "bands": bands, "header offset": 0}
    lines |= {"data type": _TYPES[cube.dtype.name], "interleave": interleave, "byte order": 0}
    lines |= {"wavelength units": "Nanometers", "wavelength": listed(GRID)}
    lines |= {key.replace("_", " "): value for key, value in header.items()}
    text = "".join(f"{key} = {value}\n" for key, value in lines.items() if value is not None)
    path.write_text(f"ENVI\n{text}")
    return path


def listed(values):
    return "{" + ", ".join(f"{v:g}" for v in values) + "}"


def reflectances(rows=6, columns=5, bands=GRID.size):
    """Different numbers everywhere, of the size of an iris's reflectances."""
    row, column, band = np.ogrid[:rows, :columns, :bands]
    return (0.02 + 0.002 * row + 0.001 * column + 0.004 * band).astype(np.float32)
