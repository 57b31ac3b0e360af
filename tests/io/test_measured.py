"""Spectra as people have them: every layout is read, every fault is named with its row."""

import numpy as np
import pytest

from irisjax import io

X = np.array([400.0, 500.0, 600.0])
Y = np.array([0.02, 0.03, 0.015])


def written(tmp_path, text, name="s.csv"):
    path = tmp_path / name
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize(
    "text",
    [
        "wavelength_nm,reflectance\n400,0.02\n500,0.03\n600,0.015\n",
        "400,0.02\n500,0.03\n600,0.015\n",
        "nm\tR\n400\t0.02\n500\t0.03\n600\t0.015\n",
        "400 0.02\n500 0.03\n600 0.015\n",
        "Wellenlänge;R\n400;0,02\n500;0,03\n600;0,015\n",
        "\ufeffwavelength,reflectance\r\n600,0.015\r\n500,0.03\r\n400,0.02\r\n",
        "# a note\n# level: low\nwavelength (nm),R\n400,0.02\n\n500,0.03\n600,0.015\n",
        "wavelength_um,reflectance\n0.4,0.02\n0.5,0.03\n0.6,0.015\n",
        "0.4,0.02\n0.5,0.03\n0.6,0.015\n",
        "nm,R (%)\n400,2\n500,3\n600,1.5\n",
        "nm,R,\n400,0.02,\n500,0.03,\n600,0.015,\n",
    ],
    ids=["plain", "bare", "tabs", "blanks", "german", "bom-crlf-reversed", "comments", "um", "um-by-size", "percent", "trailing"],
)  # fmt: skip
def test_layouts(tmp_path, text):
    found = io.read_measured(written(tmp_path, text))
    np.testing.assert_allclose(found.wavelengths, X, rtol=1e-12)
    np.testing.assert_allclose(found.values, Y, rtol=1e-12)
    assert found.sd is None


def test_what_is_guessed_is_said(tmp_path):
    notes = io.read_measured(written(tmp_path, "0.4,4\n0.5,5\n")).notes
    assert [n.partition(" (the file does not say")[0] for n in notes] == [
        "wavelengths read as µm",
        "values read as per cent",
    ]
    (note,) = io.read_measured(written(tmp_path, "400,0.04\n500,0.05\n")).notes
    assert note.startswith("values read as fractions (the file does not say")
    # What the file or the reader says is not assumed.
    assert io.read_measured(written(tmp_path, "nm,R (%)\n400,4\n500,5\n")).notes == ()
    said = {"unit": "percent", "wavelength_unit": "um"}
    found = io.read_measured(written(tmp_path, "0.4,0.7\n0.5,0.8\n"), **said)
    assert found.notes == ()
    np.testing.assert_allclose(found.values, [0.007, 0.008])


def test_standard_deviations_and_repeated_scans(tmp_path):
    found = io.read_measured(written(tmp_path, "nm,R %,SD\n400,2,0.1\n500,3,0.2\n"))
    np.testing.assert_allclose(found.sd, [0.001, 0.002])
    rng = np.random.default_rng(0)
    scans = 0.02 + 0.001 * rng.normal(size=(300, 5))
    lines = "\n".join(f"{400 + i},{','.join(map(str, row))}" for i, row in enumerate(scans))
    found = io.read_measured(written(tmp_path, lines))
    np.testing.assert_allclose(found.values, scans.mean(1))
    assert found.sd is not None
    assert np.sqrt((found.sd**2).mean()) == pytest.approx(0.001 / np.sqrt(5), rel=0.06)
    assert any("mean of 5 scans" in note for note in found.notes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no numbers"),
        ("only,a,header\n", "no numbers"),
        ("400\n500\n", "line 1: one column"),
        ("nm,R\n400,0.1\n410,abc\n", "line 3: 'abc' is not a number"),
        ("nm,R\n400,0.1\n410\n", "line 3: 1 values, 2"),
        ("nm,R\n400,0.1\n410,inf\n", "line 3: inf is not a finite number"),
        ("nm,R\n400,\n410,nan\n", "no wavelength has a value"),
        ("nm,R\n200,0.1\n210,0.1\n", "none is within 350 to 800 nm"),
        ("nm,R\n400,0.1\n400,0.2\n", "line 3: 400 nm appears twice"),
        ("nm,R,sd\n400,0.1,0.01\n410,0.1,0\n", "line 3: standard deviation 0"),
        ("nm,R,sd,sigma\n400,0.1,0.01,1\n", "need one spectrum"),
    ],
)
def test_faults_are_named(tmp_path, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        io.read_measured(written(tmp_path, text))
    assert "s.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_binary_is_refused(tmp_path):
    path = tmp_path / "b.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR")
    with pytest.raises(ValueError, match="not a text file"):
        io.read_measured(path)


JCAMP = """##TITLE=iris
##JCAMP-DX=4.24
##DATA TYPE=UV/VIS SPECTRUM
##XUNITS={unit}
##YUNITS={y}
##FIRSTX={x[0]}
##LASTX={x[2]}
##NPOINTS=3
##XFACTOR=1.0
##YFACTOR=1.0
##XYPOINTS=(XY..XY)
{x[0]}, {v[0]}
{x[1]}, {v[1]}
{x[2]}, {v[2]}
##END=
"""


@pytest.mark.parametrize(
    ("unit", "x", "y", "scale"),
    [
        ("NANOMETERS", (400, 500, 600), "REFLECTANCE", 1),
        ("MICROMETERS", (0.4, 0.5, 0.6), "REFLECTANCE", 1),
        ("1/CM", (25000, 20000, 16666.666666666668), "REFLECTANCE", 1),
        ("NANOMETERS", (400, 500, 600), "% REFLECTANCE", 100),
    ],
)
def test_jcamp(tmp_path, unit, x, y, scale):
    text = JCAMP.format(unit=unit, x=x, y=y, v=[scale * v for v in Y])
    found = io.read_measured(written(tmp_path, text, "s.jdx"))
    np.testing.assert_allclose(found.wavelengths, X, rtol=1e-9)
    np.testing.assert_allclose(found.values, Y, rtol=1e-9)


def test_jcamp_without_units_is_refused(tmp_path):
    with pytest.raises(ValueError, match="XUNITS"):
        io.read_measured(
            written(tmp_path, JCAMP.format(unit="ARBITRARY", x=X, y="R", v=Y), "s.jdx")
        )


def test_posterior_file_opens_in_arviz(tmp_path):
    import arviz as az

    path = tmp_path / "p.nc"
    draws = np.random.default_rng(0).normal(size=(4, 50))
    groups = {
        "posterior": {"load": draws},
        "log_likelihood": {"data": np.random.default_rng(1).normal(size=(4, 50, 7))},
    }
    io.write_posterior(path, groups, {"note": "simulated"}, {"reflectance": np.arange(7.0)})
    found = az.from_netcdf(path)
    np.testing.assert_array_equal(found["posterior"]["load"], draws)
    assert found["observed_data"]["reflectance"].shape == (7,)
    assert found["posterior"].attrs["note"] == "simulated"
    assert list(tmp_path.iterdir()) == [path]
