"""`irisjax map` and `irisjax simulate-cube`: files, flags, wrong input. Transport is `Quick`'s."""

from unittest.mock import Mock

import h5netcdf
import numpy as np
import pytest
from refusals import one_line

from cube_files import GRID, envi, listed, reflectances
from irisjax import io
from irisjax.cli import map as command
from irisjax.plot import flags_figure, maps_figure
from scene_files import without_growth

FREE = ("--free", "melanin_load,abl_fraction,hemoglobin")
OUTLINES = "--limbus 7.5,7.5,7.68,7.68,0 --pupil 7.5,7.5,2.56,2.56,0"


@pytest.fixture
def few_starts(quick, monkeypatch):
    monkeypatch.setattr("irisjax.infer.pixels._DRAWS", 256)
    monkeypatch.setattr(command, "picture", lambda figure, suffix: b"a picture")
    monkeypatch.setattr(command, "maps_figure", lambda *_: None)
    monkeypatch.setattr(command, "flags_figure", lambda *_: None)


def test_a_cube_and_its_maps(done, few_starts, tmp_path, monkeypatch):
    """A simulated cube of 16 by 16 pixels, by the command that is printed for it."""
    without_growth(monkeypatch)
    made, out, grid = tmp_path / "cube", tmp_path / "maps", ",".join(f"{x:g}" for x in GRID)
    size = ("--process", "depth-resolved", "--size", 16, "--wavelengths", grid)
    line, err = done("simulate-cube", "-o", made, *size, "--relative-noise", 0.005)
    references = f"--white {made}/white.csv --dark {made}/dark.csv"
    assert (line, err) == (f"irisjax map {made}/cube.hdr {references} {OUTLINES}\n", "")
    given = (*line.split()[1:], *FREE, "--fix", "gain=1")
    printed, err = done(*given, "-o", out)
    assert "melanin_load" in printed
    assert "256 pixels: " in err and "masked" in err
    names = {path.name for path in out.iterdir()}
    assert names == {
        "maps.nc", "maps.exr", "scene.toml", "overview.png", "flag.png", "abl_melanin.png",
        "reduced_chi_square.png", *(f"{n}.png" for n in FREE[1].split(",")),
    }  # fmt: skip
    with h5netcdf.File(out / "maps.nc") as maps, h5netcdf.File(made / "truth.nc") as truth:
        flags, good = maps["flag"][...], maps["flag"][...] == 0
        inside = np.isfinite(truth["melanin_load"][...])
        assert 60 < good.sum() <= inside.sum()
        assert not good[7, 7] and flags[7, 7] == 1  # the pupil
        assert np.isnan(maps["melanin_load"][...][~inside]).all()
        assert maps["melanin_load"].attrs["units"] == "ug/mm2"
        meanings = maps["flag"].attrs["flag_meanings"]
        assert meanings.startswith("masked no_number_in_a_band saturated")
        assert maps.attrs["process"] == "depth-resolved"  # by which the cube was simulated
        assert "of a grown iris" in maps.attrs["simulated"]
        covariance = maps["covariance"][...][good]
        sd = maps["abl_fraction_sd"][...][good]
        np.testing.assert_allclose(np.sqrt(covariance[:, 1, 1]), sd, rtol=1e-5)
    scene = io.read_scene(out / "scene.toml").scene()
    assert scene.maps is not None and np.isfinite(np.asarray(scene.maps.eumelanin)).all()


CUBE = reflectances()
STRIPES = CUBE.copy()
STRIPES[::2] = np.nan
COUNTS = np.rint(CUBE * 1e4).astype(np.uint16)


def test_a_cube_of_oxygenated_blood_alone_is_refused(irisjax, quick, tmp_path):
    """It was an internal error; the prior of a saturation ends before 1."""
    given = ("--size", 16, "--process", "ilit-2006", "--saturation", 1)
    said = "saturation = 1 is outside of its prior"
    one_line(irisjax("simulate-cube", "-o", tmp_path / "made", *given), said)
    assert not (tmp_path / "made").exists()


def test_figures_of_maps(tmp_path):
    some = np.where(np.eye(4, dtype=bool), np.nan, np.geomspace(0.01, 1, 16).reshape(4, 4))
    figure = maps_figure({"melanin_load": (some, "ug/mm2"), "gain": (some * 0 + 1, "")}, (8, 8))
    assert figure.axes[0].get_title() == "melanin load"
    assert figure.axes[0].get_xlim() == (-0.5, 7.5)
    figure = flags_figure(np.array([[0, 5], [1, 0]]), {1: "masked", 4: "saturated"})
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["1: masked", "5: masked, saturated"]


def test_stripes_and_saturation_are_flagged(irisjax, few_starts, tmp_path):
    path, maps = envi(tmp_path / "a.hdr", STRIPES), tmp_path / "maps" / "maps.nc"
    maps.parent.mkdir()
    maps.write_text("of before")
    given = ("map", path, *FREE, "--ceiling", "0.0541", "-o", maps.parent)
    one_line(irisjax(*given), "maps: has maps; --overwrite starts again")
    assert irisjax(*given, "--overwrite")[0] == 0
    flags = io.read_map(maps, "flag")
    assert (flags[::2] == 2).all()
    assert (flags[1::2] & 4).tolist() == [[0] * 5, [0] * 5, [0, 4, 4, 4, 4]]
    assert np.isnan(io.read_map(maps, "hemoglobin")[::2]).all()


def test_a_coarse_level_gives_the_starts_of_large_cubes(irisjax, few_starts, tmp_path, monkeypatch):
    path = envi(tmp_path / "a.hdr", reflectances(16, 12))
    given = ("map", path, *FREE, "--fix", "gain=1")
    monkeypatch.setattr(command, "_CHUNK", 50)  # three rows at a time
    assert irisjax(*given, "-o", tmp_path / "one")[0] == 0
    monkeypatch.setattr(command, "_SAMPLE", 32)
    assert irisjax(*given, "-o", tmp_path / "two")[0] == 0
    one, two, sd = (
        io.read_map(tmp_path / folder / "maps.nc", name)
        for folder, name in (("one", "hemoglobin"), ("two", "hemoglobin"), ("one", "hemoglobin_sd"))
    )
    flags = io.read_map(tmp_path / "one" / "maps.nc", "flag")
    assert (np.abs(one - two) < 0.15 * sd)[flags == 0].all()


@pytest.mark.parametrize(
    ("cube", "header", "options", "said"),
    [
        (CUBE, {"wavelength": None}, (), "has no wavelengths of its bands; give --bands FILE"),
        (CUBE, {"wavelength": listed(GRID[:6])}, (), "are as many lines: is the cube transposed?"),
        (COUNTS, {}, (), "has counts, no reflectances: give --white"),
        (CUBE * 100, {}, (), "median value is 3.9, no reflectance"),
        (np.full_like(CUBE, np.nan), {}, (), "no pixel is left to fit: 30 no number in a band"),
        (CUBE, {}, ("--ceiling", "0.01"), "no pixel is left to fit: 30 saturated"),
        (CUBE, {}, ("--brightness", "0.3:0.4"), "no pixel is left to fit: 30 masked"),
        (CUBE, {}, ("--brightness", "0.3"), "--brightness: '0.3': write two reflectances"),
        (CUBE, {}, ("--flows", "flows"), "--flows means something only with --posterior"),
        (CUBE, {}, ("--limbus", "2,2,2,2,0"), "--pupil and --limbus go together"),
        (CUBE, {}, ("--wavelengths", "700:800"), "none is within"),
    ],
)
def test_wrong_input_is_one_line_and_writes_nothing(
    irisjax, few_starts, tmp_path, cube, header, options, said
):
    path = envi(tmp_path / "a.hdr", cube, **header)
    one_line(irisjax("map", path, "-o", tmp_path / "maps", *options), said)
    assert not (tmp_path / "maps").exists()


def test_a_mask_of_another_size(irisjax, few_starts, tmp_path):
    path = envi(tmp_path / "a.hdr", CUBE)
    io.write_png(tmp_path / "mask.png", np.ones((5, 6, 3)))
    result = irisjax("map", path, "--mask", tmp_path / "mask.png", "-o", tmp_path / "maps")
    one_line(result, "mask.png: is 6 x 5 pixels, the cube 5 x 6")


def test_a_stopped_run_is_continued(irisjax, few_starts, tmp_path, monkeypatch):
    """It fits only what is left, and ends in the bytes of a run that was not stopped."""
    path, folder = envi(tmp_path / "a.hdr", CUBE), tmp_path / "maps"
    monkeypatch.setattr(command, "_CHUNK", 10)  # two rows of five pixels
    fitted, fit, most = [], command._fit_rows, [1]

    def counted(values, *rest):
        if len(fitted) == most[0]:
            raise KeyboardInterrupt
        fitted.append(len(values))
        return fit(values, *rest)

    assert irisjax("map", path, *FREE, "-o", tmp_path / "whole")[0] == 0
    monkeypatch.setattr(command, "_fit_rows", counted)
    assert irisjax("map", path, *FREE, "-o", folder)[0] == 130
    assert [f.name for f in folder.iterdir()] == ["maps.part"]
    most[0] = 99
    again = ("map", path, *FREE, "-o", folder)
    one_line(irisjax(*again), "has unfinished maps; --resume continues them, --overwrite starts")
    other = irisjax(*again, "--resume", "--relative-noise", 0.03)
    one_line(other, "maps.part: made from other data or settings; it cannot be resumed with these")

    assert irisjax(*again, "--resume")[0] == 0
    assert fitted == [2, 2, 2]
    files = sorted(f.name for f in (tmp_path / "whole").iterdir())
    assert sorted(f.name for f in folder.iterdir()) == files
    assert (folder / "maps.nc").read_bytes() == (tmp_path / "whole/maps.nc").read_bytes()


def test_nothing_is_left_of_a_run_that_did_nothing(irisjax, few_starts, tmp_path, monkeypatch):
    monkeypatch.setattr(command, "_fit_rows", Mock(side_effect=KeyboardInterrupt))
    path = envi(tmp_path / "a.hdr", CUBE)
    assert irisjax("map", path, *FREE, "-o", tmp_path / "maps")[0] == 130
    assert not (tmp_path / "maps").exists()
