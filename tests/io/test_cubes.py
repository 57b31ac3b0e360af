"""Hyperspectral cubes: formats, references, flags."""

import h5netcdf
import numpy as np
import pytest
import xarray

from cube_files import GRID, envi, listed, reflectances
from irisjax import io
from irisjax.infer.pixels import PixelFlag

CUBE = reflectances()


def whole(cube):
    return cube.read(0, cube.shape[0])


@pytest.mark.parametrize("interleave", ["bil", "bip", "bsq"])
def test_envi_by_rows_in_every_interleave(tmp_path, interleave):
    cube = io.read_cube(envi(tmp_path / "a.hdr", CUBE, interleave=interleave, simulated="yes"))
    assert cube.shape == CUBE.shape
    np.testing.assert_array_equal(cube.wavelengths, GRID)
    np.testing.assert_array_equal(whole(cube), CUBE)
    np.testing.assert_array_equal(cube.read(2, 4), CUBE[2:4])
    assert cube.header["simulated"] == "yes"
    assert cube.fwhm is None
    assert not cube.counts
    assert io.read_cube(tmp_path / "a.img").shape == CUBE.shape  # by its data, too


def test_envi_units_widths_bad_bands_and_factors(tmp_path):
    stored = np.rint(CUBE * 1e4).astype(np.uint16)[..., ::-1]
    stored[1, 2, 0] = 9
    header = {
        "wavelength": listed(GRID[::-1] / 1e3), "wavelength_units": "Micrometers",
        "fwhm": listed(np.full(GRID.size, 0.012)), "reflectance_scale_factor": 10000,
        "bbl": "{1, 1, 0, 1, 1, 1, 1}", "data_ignore_value": 9,
    }  # fmt: skip
    cube = io.read_cube(envi(tmp_path / "a.hdr", stored, **header))
    good = np.flatnonzero(GRID[4] != GRID)
    np.testing.assert_allclose(cube.wavelengths, GRID[good])
    np.testing.assert_allclose(cube.fwhm, 12.0)
    expected = CUBE[..., good].astype(float)
    expected[1, 2, -1] = np.nan
    np.testing.assert_allclose(whole(cube), expected, atol=5.1e-5)
    assert not cube.counts
    assert cube.ceiling == pytest.approx(6.5535)


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_netcdf_and_zarr(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    axes = ("wavelength", "y", "x")
    data = xarray.Dataset(
        {"reflectance": (axes, CUBE.transpose(2, 0, 1)), "mask": (("y", "x"), CUBE[..., 0])},
        {
            "wavelength": ("wavelength", GRID / 1e3, {"units": "um"}),
            "fwhm": ("wavelength", 0 * GRID + 9, {"units": "nm"}),
        },
        {"process": "depth-resolved"},
    )
    if suffix == ".nc":
        data.to_netcdf(path, engine="h5netcdf")
    else:
        data.to_zarr(path, consolidated=False, zarr_format=2)
    cube = io.read_cube(path)
    np.testing.assert_allclose(cube.wavelengths, GRID)
    np.testing.assert_array_equal(cube.fwhm, 9)
    np.testing.assert_array_equal(cube.read(1, 3), CUBE[1:3])
    assert cube.header["process"] == "depth-resolved"
    with pytest.raises(ValueError, match="no variable 'R' of three axes; it has reflectance"):
        io.read_cube(path, variable="R")


def test_references_flags_and_brightness(tmp_path):
    white = 50_000.0 + 100 * np.arange(GRID.size)
    dark = np.full((3, *CUBE.shape[1:]), 500.0) + np.arange(3)[:, None, None]
    counts = np.rint(501 + CUBE * (white - 501)).astype(np.uint16)
    counts[0, 1, 3] = 65535
    cube = io.read_cube(envi(tmp_path / "a.hdr", counts))
    assert cube.counts
    table = "\n".join(f"{x:g},{v:g}" for x, v in zip(GRID, white, strict=True))
    (tmp_path / "white.csv").write_text(f"wavelength,white\n{table}\n")
    envi(tmp_path / "dark.hdr", dark)
    read = {n: io.read_reference(tmp_path / f, cube) for n, f in
            (("white", "white.csv"), ("dark", "dark.hdr"))}  # fmt: skip
    keep = np.ones(CUBE.shape[:2], bool)
    keep[2, 2] = False
    source = io.Reflectances(
        cube, **read, ceiling=cube.ceiling, keep=lambda a, b: keep[a:b], brightness=(0.03, 0.044)
    )
    values, flags = source.read(0, 4)
    valid = flags == 0
    np.testing.assert_allclose(values[valid], CUBE[:4][valid], atol=2e-5)
    assert flags[0, 1] & PixelFlag.SATURATED
    assert flags[2, 2] == PixelFlag.MASKED
    mean = values.mean(-1)
    others = (np.ones_like(valid) & keep[:4]).astype(bool)
    others[0, 1] = False
    np.testing.assert_array_equal(valid[others], ((mean >= 0.03) & (mean <= 0.044))[others])
    broken = counts.astype(np.float32)
    broken[1] = np.nan
    _, flags = io.Reflectances(io.read_cube(envi(tmp_path / "b.hdr", broken)), **read).read(0, 3)
    np.testing.assert_array_equal(flags[:, 0], [0, PixelFlag.NOT_A_NUMBER, 0])


def test_references_of_another_size_are_refused(tmp_path):
    cube = io.read_cube(envi(tmp_path / "a.hdr", CUBE))
    envi(tmp_path / "white.hdr", reflectances(columns=4))
    with pytest.raises(ValueError, match=r"white\.hdr: is 6 x 4 x 7 .* the cube is 6 x 5 x 7"):
        io.read_reference(tmp_path / "white.hdr", cube)
    (tmp_path / "white.csv").write_text("wavelength,white\n500,1\n600,2\n700,2\n")
    with pytest.raises(ValueError, match=r"white\.csv: has 500 to 700 nm, the cube 420 to 660 nm"):
        io.read_reference(tmp_path / "white.csv", cube)
    (tmp_path / "white.csv").write_text("wavelength,white\n400,1\n600,nan\n700,2\n")
    with pytest.raises(ValueError, match=r"white\.csv: has no value at 600 nm"):
        io.read_reference(tmp_path / "white.csv", cube)


def test_per_cent_is_stated_or_refused(tmp_path):
    """Of 0.7 to 1.7 % maps were drawn before as if they were fractions, without a word."""
    sample, notes = CUBE.reshape(-1, GRID.size), []
    for scale, attributes in ((1, {}), (1, {"units": "1"}), (100, {"units": "%"})):
        data = xarray.Dataset({"reflectance": (("y", "x", "wavelength"), scale * CUBE, attributes)})
        data.coords["wavelength"] = ("wavelength", GRID, {"units": "nm"})
        data.to_netcdf(tmp_path / f"{scale}{len(attributes)}.nc", engine="h5netcdf")
        source = io.Reflectances(io.read_cube(tmp_path / f"{scale}{len(attributes)}.nc"))
        source = source.in_fractions(scale * sample, None, notes)
        np.testing.assert_allclose(source.read(0, 2)[0], CUBE[:2])
        assert len(notes) == (not attributes)
        notes.clear()
    dark = io.Reflectances(io.read_cube(envi(tmp_path / "a.hdr", 30 * CUBE)))
    with pytest.raises(ValueError, match=r"a\.hdr: its median value is 1.* of per cent, --unit"):
        dark.in_fractions(30 * sample, None, [])
    assert dark.in_fractions(30 * sample, "percent", []).factor == 0.01


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ({"lines": 7}, "a.hdr: describes 980 bytes .* but .*a.img has 840"),
        ({"bands": "seven"}, r"a.hdr: no ENVI header that can be read \(bands = seven is no whole"),
        ({"wavelength": listed(GRID[:5])}, "5 wavelengths for 7 bands; there are as many samples"),
        ({"wavelength": listed(GRID[:4])}, "4 wavelengths for 7 bands$"),
        ({"wavelength": listed(np.minimum(GRID, 620))}, "a.hdr: has two bands at 620 nm"),
        ({"fwhm": listed(GRID[:6])}, "fwhm has 6 entries from 420 for 7 bands; it must be > 0"),
        ({"fwhm": listed(0 * GRID)}, "fwhm has 7 entries from 0 for 7 bands; it must be > 0"),
        ({"bbl": "{1, 0, 1}"}, r"bbl \(good bands\) has 3 entries for 7 bands"),
        ({"interleave": "bxx"}, "interleave = bxx; it must be bsq, bil, bip"),
        ({"reflectance scale factor": 0}, "reflectance scale factor = 0; it must be > 0"),
    ],
)
def test_broken_headers(tmp_path, header, said):
    with pytest.raises(ValueError, match=said):
        io.read_cube(envi(tmp_path / "a.hdr", CUBE, **header))


def test_files_that_are_no_cubes(tmp_path):
    with pytest.raises(FileNotFoundError):
        io.read_cube(tmp_path / "none.hdr")
    (tmp_path / "a.mat").write_text("")
    with pytest.raises(ValueError, match=r"a\.mat: unknown kind of cube; known: .hdr \(ENVI\)"):
        io.read_cube(tmp_path / "a.mat")
    xarray.Dataset({"a": (("y", "x", "z"), CUBE)}).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    with pytest.raises(ValueError, match="which axis are the bands"):
        io.read_cube(tmp_path / "a.nc")
    (tmp_path / "b.nc").write_bytes(b"no NetCDF")
    with pytest.raises(ValueError, match=r"b\.nc: cannot be read"):
        io.read_cube(tmp_path / "b.nc")


def test_maps_are_written_by_rows(tmp_path):
    said = {"load": ((), "f4", {"units": "ug/mm2"}), "covariance": (("parameter",), "f4", {})}
    with io.writing_maps(tmp_path / "m.nc", (4, 3), said, {"parameter": ["a", "b"]}, {}) as write:
        for first in (0, 2):
            write("load", first, np.full((2, 3), 1.0 + first))
            write("covariance", first, np.zeros((2, 3, 2)))
    np.testing.assert_array_equal(io.read_map(tmp_path / "m.nc", "load", 2), [[1, 1], [3, 3]])
    with h5netcdf.File(tmp_path / "m.nc") as file:
        assert [name.decode() for name in file["parameter"][...]] == ["a", "b"]
        assert file["load"].attrs["units"] == "ug/mm2"
    xarray.open_dataset(tmp_path / "m.nc").close()
