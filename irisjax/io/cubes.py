"""Hyperspectral cubes, read by rows, and maps of their pixels in NetCDF."""

import contextlib
import logging
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from irisjax.infer.pixels import PixelFlag
from irisjax.io.formats import UNITS, read_spectral_table
from irisjax.io.measured import reflectance_unit
from irisjax.io.tables import first_line, naming

_TO_NM = {"nm": 1.0, "um": 1e3}
_BAND_AXES = ("wavelength", "wavelengths", "wl", "band", "bands", "lambda", "channel", "channels")
_WIDTHS = ("fwhm", "bandwidth", "bandwidths")
_SUFFIXES = ".hdr (ENVI), .nc (NetCDF), .zarr"
_XARRAY = (".nc", ".nc4", ".cdf", ".h5", ".zarr")
_INTERLEAVES = ("bsq", "bil", "bip")
_Block = Float[np.ndarray, "rows columns bands"]
Rows = Callable[[int, int], np.ndarray]
"""Returns something of the rows from the first up to the last."""


@dataclass(frozen=True)
class Cube:
    """A cube in a file, of which `read` returns rows.

    Attributes:
        path: The file.
        shape: Rows, columns and bands.
        wavelengths: Centres of the bands, nm, increasing; `None` where the file has none.
        fwhm: Full widths at half maximum, nm, or `None`.
        ceiling: The largest number that the file's type of whole numbers can hold, as `read`
            returns it; `None` for other types.
        counts: Whether the values are whole numbers without a factor that makes them reflectances.
        header: Texts of the header.
        read: Returns the rows from the first up to the last, (rows, columns, bands), in the order
            of `wavelengths`; NaN where the file says that there is no value.
    """

    path: Path
    shape: tuple[int, int, int]
    wavelengths: Float[np.ndarray, " bands"] | None
    fwhm: Float[np.ndarray, " bands"] | None
    ceiling: float | None
    counts: bool
    header: Mapping[str, str]
    read: Rows


def read_cube(
    path: str | Path, *, variable: str | None = None, wavelength_unit: str | None = None
) -> Cube:
    """Open a hyperspectral cube: ENVI (`.hdr` beside its data), NetCDF or Zarr.

    Args:
        path: The header, file or folder.
        variable: Name of the variable of a NetCDF or Zarr file that has several of three axes.
        wavelength_unit: `"nm"` or `"um"`, where the file does not say.

    Raises:
        ValueError: Naming the file and what is wrong with it, such as data of another size than
            the header says.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(2, "No such file or directory", str(path))
    with naming(path):
        if path.suffix.lower() != ".hdr" and path.is_file():
            headers = [path.with_suffix(".hdr"), path.with_name(path.name + ".hdr")]
            path = next((p for p in headers if p.exists()), path)
        if path.suffix.lower() == ".hdr":
            return _sorted(_envi(path, wavelength_unit))
        if path.suffix.lower() in _XARRAY:
            return _sorted(_xarray(path, variable, wavelength_unit))
        raise ValueError(f"unknown kind of cube; known: {_SUFFIXES}")


def read_reference(path: str | Path, cube: Cube, **how: str | None) -> Rows:
    """Open a white or dark reference of a cube: a function of the first and last row that returns
    what the standard gave, (1 or rows, 1 or columns, bands).

    It is a cube of the same size; one of the same columns (a line camera's), or of one column,
    whose mean over the rows is used; or a table of wavelengths and values, interpolated.
    """
    path = Path(path)
    _, columns, bands = cube.shape
    if path.suffix.lower() not in (".hdr", *_XARRAY):
        with naming(path):
            if cube.wavelengths is None:
                raise ValueError("a table of a reference needs a cube with wavelengths")
            table = read_spectral_table(path)
            grid, values = table.values[np.argsort(table.values[:, 0])].T[:2]
            for nm in grid[~np.isfinite(values)][:1]:
                raise ValueError(f"has no value at {nm:g} nm")
            low, high = cube.wavelengths[[0, -1]]
            if grid[0] > low or grid[-1] < high:
                raise ValueError(
                    f"has {grid[0]:g} to {grid[-1]:g} nm, the cube {low:g} to {high:g} nm"
                )
            value = np.interp(cube.wavelengths, grid, values)[None, None]
        return lambda first, last: value
    white = read_cube(path, **how)
    with naming(path):
        if white.shape[2] != bands or white.shape[1] not in (1, columns):
            message = f"is {_by(white.shape)} (rows, columns, bands), the cube is {_by(cube.shape)}"
            raise ValueError(f"{message}: need the same bands, and the same columns or one")
        if white.shape == cube.shape:
            return white.read
        mean = np.mean([white.read(i, i + 1)[0] for i in range(white.shape[0])], axis=0)[None]
        return lambda first, last: mean


@dataclass(frozen=True)
class Reflectances:
    """Reflectances of a cube, and what is wrong with its pixels.

    Attributes:
        cube: The cube.
        white, dark: References; without a white one the cube has reflectances.
        white_reflectance: Reflectance of the white standard.
        factor: Factor on all, such as 0.01 for per cent.
        ceiling: Stored value from which a band is saturated, or `None`.
        keep: Function of the first and last row that returns which pixels are used, or `None`.
        brightness: Least and largest mean reflectance of the pixels that are used, or `None`.
        bands: Places of the bands that are used; `None` for all.
    """

    cube: Cube
    white: Rows | None = None
    dark: Rows | None = None
    white_reflectance: float = 1.0
    factor: float = 1.0
    ceiling: float | None = None
    keep: Rows | None = None
    brightness: tuple[float, float] | None = None
    bands: np.ndarray | None = None

    def read(self, first: int, last: int) -> tuple[_Block, np.ndarray]:
        """Return reflectances of some rows, and flags (rows, columns), sums of `PixelFlag`."""
        used = slice(None) if self.bands is None else self.bands
        raw = self.cube.read(first, last)[..., used]
        flags = np.zeros(raw.shape[:2], np.uint8)
        if self.ceiling is not None:
            flags[(raw >= self.ceiling).any(-1)] |= np.uint8(PixelFlag.SATURATED)
        dark = 0.0 if self.dark is None else self.dark(first, last)[..., used]
        values = self.factor * (raw - dark)
        if self.white is not None:
            span = self.white(first, last)[..., used] - dark
            values = self.white_reflectance * values / np.where(span > 0, span, np.nan)
        flags[~np.isfinite(values).all(-1)] |= np.uint8(PixelFlag.NOT_A_NUMBER)
        if self.keep is not None:
            flags[~self.keep(first, last)] |= np.uint8(PixelFlag.MASKED)
        if self.brightness is not None:
            low, high = self.brightness
            mean = values.mean(-1)  # NaN is neither
            flags[(mean < low) | (mean > high)] |= np.uint8(PixelFlag.MASKED)
        return values, flags

    def in_fractions(
        self, sample: Float[np.ndarray, "pixels bands"], unit: str | None, notes: list[str]
    ) -> "Reflectances":
        """Return the same with the factor of the unit, which the caller or the file states; an
        assumption is added to `notes`.

        Raises:
            ValueError: Valid pixels of the cube (pixels, bands) are no fractions, and nothing says
                what they are.
        """
        if self.white is not None:
            return self
        to_do = "give --white (and --dark), or a factor in the header"
        if self.cube.counts:
            raise ValueError(f"{self.cube.path}: has counts, no reflectances: {to_do}")
        if (middle := float(np.median(sample))) <= 100 or unit is not None:
            with naming(self.cube.path):
                found = reflectance_unit(sample.T, unit, "", self.cube.header, notes)
            if found == "fraction" or not notes:  # per cent is not guessed from some pixels
                return replace(self, factor=0.01 if found == "percent" else 1.0)
        raise ValueError(
            f"{self.cube.path}: its median value is {middle:.4g}, no reflectance: {to_do}; "
            "of per cent, --unit percent"
        )


@contextlib.contextmanager
def writing_maps(
    path: str | Path,
    shape: tuple[int, int],
    variables: Mapping[str, tuple[tuple[str, ...], Any, Mapping[str, Any]]],
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, str],
) -> Iterator[Callable[[str, int, np.ndarray], None]]:
    """Write maps to a NetCDF file by rows: the context gives a function of a map's name, the first
    row and an array of rows.

    Args:
        path: The file.
        shape: Rows and columns.
        variables: For each map the names of its further axes, its type and its attributes.
        coordinates: Values along these axes, and along `row` and `column`.
        attributes: Attributes of the file.
    """
    import h5netcdf
    import h5py

    along = {"row": np.arange(shape[0]), "column": np.arange(shape[1]), **coordinates}
    with h5netcdf.File(path, "w") as file:
        file.attrs.update({"created_with": "irisjax", **attributes})
        for name, values in along.items():
            file.dimensions[name] = len(values)
            texts = isinstance(values[0], str)
            kind = {"dtype": h5py.string_dtype()} if texts else {}
            file.create_variable(
                name, (name,), data=np.asarray(values, object if texts else None), **kind
            )
        for name, (axes, dtype, labels) in variables.items():
            variable = file.create_variable(name, ("row", "column", *axes), dtype=dtype)
            variable.attrs.update(labels)

        def write(name: str, first: int, array: np.ndarray) -> None:
            variable: Any = file[name]
            variable[first : first + len(array)] = array

        yield write


def read_map(path: str | Path, name: str, step: int = 1) -> np.ndarray:
    """Read a map of a file, every `step`th row and column of it."""
    import h5netcdf

    with h5netcdf.File(path, "r") as file:
        return np.asarray(file[name][::step, ::step])


def _envi(path: Path, unit: str | None) -> Cube:
    from spectral.io import envi

    logging.getLogger("spectral").setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            header = envi.read_envi_header(path)
            for key in ("samples", "lines", "bands"):
                if not header[key].isdigit():
                    raise ValueError(f"{key} = {header[key]} is no whole number")
            image: Any = envi.open(path)
        stored = np.dtype(image.dtype)
        rows, columns, bands = image.nrows, image.ncols, image.nbands
        interleave = header["interleave"]
        factor = float(header.get("reflectance scale factor", 1.0))
        ignored = header.get("data ignore value")
        ignored = None if ignored is None else float(ignored)
        grid, widths = (
            None if k not in header else np.asarray(header[k], float)
            for k in ("wavelength", "fwhm")
        )
        good = None if "bbl" not in header else np.asarray(header["bbl"], float)
    except OSError:
        raise
    except Exception as error:  # the library raises errors of its own, KeyError and TypeError too
        raise ValueError(f"no ENVI header that can be read ({first_line(error)})") from None
    size, offset = Path(image.filename).stat().st_size, int(image.offset)
    length = offset + rows * columns * bands * stored.itemsize
    if size != length:
        layout = f"{rows} lines of {columns} samples in {bands} bands of {stored.name}"
        raise ValueError(f"describes {length} bytes ({layout}), but {image.filename} has {size}")
    if str(interleave).lower() not in _INTERLEAVES:
        raise ValueError(f"interleave = {interleave}; it must be {', '.join(_INTERLEAVES)}")
    if not factor > 0:
        raise ValueError(f"reflectance scale factor = {factor:g}; it must be > 0")
    _check_count(grid, (rows, columns, bands))
    _check_widths(widths, bands)
    if good is not None and good.shape != (bands,):
        raise ValueError(f"bbl (good bands) has {good.size} entries for {bands} bands")
    image.scale_factor = 1.0
    use = np.arange(bands) if good is None else np.flatnonzero(good > 0)

    def read(first: int, last: int) -> _Block:
        block = image.read_subregion((first, last), (0, columns), use_memmap=False)[..., use]
        values = block.astype(np.float64)
        if ignored is not None:
            values[block == ignored] = np.nan
        return values / factor

    if grid is not None:
        to_nm = _to_nm(grid, unit or header.get("wavelength units"))
        widths = None if widths is None else to_nm * widths[use]
        grid = to_nm * grid[use]
    whole = stored.kind in "iu"
    ceiling = np.iinfo(stored).max / factor if whole else None
    texts = {k: v for k, v in header.items() if isinstance(v, str)}
    counts = whole and "reflectance scale factor" not in header
    return Cube(path, (rows, columns, len(use)), grid, widths, ceiling, counts, texts, read)


def _xarray(path: Path, variable: str | None, unit: str | None) -> Cube:
    import xarray

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            how: dict[str, Any] = {"engine": "zarr"} if path.suffix.lower() == ".zarr" else {}
            data = xarray.open_dataset(path, **how)
    except (OSError, ModuleNotFoundError):
        raise
    except Exception as error:  # each of the libraries that xarray uses raises errors of its own
        raise ValueError(f"cannot be read ({first_line(error)})") from None
    cubes = [str(n) for n, v in data.data_vars.items() if v.ndim == 3]
    if variable is not None and variable not in cubes:
        raise ValueError(f"has no variable {variable!r} of three axes; it has {', '.join(cubes)}")
    if variable is None and len(cubes) != 1:
        text = f"{len(cubes)} variables of three axes ({', '.join(cubes)}); name one by --variable"
        raise ValueError(text if cubes else "has no variable of three axes")
    cube = data[variable or cubes[0]]
    axes = [d for d in cube.dims if str(d).lower() in _BAND_AXES]
    if len(axes) != 1:
        names = ", ".join(map(str, cube.dims))
        raise ValueError(
            f"which axis are the bands? {names}; one must be called wavelength or band"
        )
    cube = cube.transpose(*(d for d in cube.dims if d != axes[0]), axes[0])
    coordinates = {str(n).lower(): v for n, v in data.variables.items() if v.dims == (axes[0],)}
    grid = next((v for n, v in coordinates.items() if n in _BAND_AXES[:3]), None)
    stated = next((v for n, v in coordinates.items() if n in _WIDTHS), None)
    widths = None
    if grid is not None:
        nodes, unit = np.asarray(grid, float), unit or grid.attrs.get("units")
        grid = _to_nm(nodes, unit) * nodes
        if stated is not None:  # in a unit of their own, or in that of the wavelengths
            widths = _to_nm(nodes, stated.attrs.get("units", unit)) * np.asarray(stated, float)
            _check_widths(widths, nodes.size)
    stored = np.dtype(cube.encoding.get("dtype", cube.dtype))
    scale = cube.encoding.get("scale_factor")
    integer = stored.kind in "iu"
    ceiling = None
    if integer:
        ceiling = np.iinfo(stored).max * (scale or 1.0) + cube.encoding.get("add_offset", 0.0)
    texts = {str(k): str(v) for k, v in data.attrs.items()}
    texts |= {"unit": str(cube.attrs["units"])} if "units" in cube.attrs else {}

    def read(first: int, last: int) -> _Block:
        return np.asarray(cube[first:last].values, np.float64)

    shape: Any = cube.shape
    return Cube(path, shape, grid, widths, ceiling, integer and scale is None, texts, read)


def _sorted(cube: Cube) -> Cube:
    """The cube with its bands in the order of their wavelengths."""
    grid = cube.wavelengths
    if min(cube.shape) < 1:
        raise ValueError(f"is {_by(cube.shape)}, empty")
    if grid is None or (np.diff(grid) > 0).all():
        return cube
    order = np.argsort(grid, kind="stable")
    for i in np.flatnonzero(np.diff(grid[order]) == 0)[:1]:
        raise ValueError(
            f"has two bands at {grid[order[i]]:g} nm; leave one out (by bbl in an ENVI header)"
        )
    widths = None if cube.fwhm is None else cube.fwhm[order]
    by: dict[str, Any] = {"wavelengths": grid[order], "fwhm": widths}
    return replace(cube, **by, read=lambda *rows: cube.read(*rows)[..., order])


def _check_count(grid: np.ndarray | None, shape: tuple[int, int, int]) -> None:
    if grid is None or grid.size == shape[2]:
        return
    message = f"has {grid.size} wavelengths for {shape[2]} bands"
    if axis := {shape[1]: "samples", shape[0]: "lines"}.get(grid.size):
        message += f"; there are as many {axis}: is the cube transposed? "
        message += "Check interleave, lines, samples and bands"
    raise ValueError(message)


def _check_widths(widths: np.ndarray | None, bands: int) -> None:
    if widths is not None and (widths.shape != (bands,) or not (widths > 0).all()):
        least = f" from {widths.min():g}" if widths.size else ""
        raise ValueError(
            f"fwhm has {widths.size} entries{least} for {bands} bands; it must be > 0 for each band"
        )


def _to_nm(grid: np.ndarray, unit: object) -> float:
    """Factor from the unit of wavelengths to nm; without a unit those below 100 are µm."""
    named = (factor for name, factor in _TO_NM.items() if UNITS[name].search(str(unit or "")))
    return next(named, 1e3 if np.median(grid) < 100 else 1.0)


def _by(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape))
