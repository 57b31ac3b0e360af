"""Spectra as people and instruments write them: every layout is read, every fault is named.

Examples by hand after the layouts that makers document: no measured file is in the project.
"""

from pathlib import Path

import numpy as np
import pytest

from irisjax import io

X = np.array([400.0, 450.0, 500.0, 550.0, 600.0, 650.0])
Y = np.array([0.031, 0.042, 0.038, 0.03, 0.025, 0.02])
COUNTS = 1000 + 30000 * Y


def rows(separator, *columns, decimal="."):
    return "\n".join(
        separator.join(f"{v:.6g}".replace(".", decimal) for v in row)
        for row in zip(*columns, strict=True)
    )


EXAMPLES = Path(__file__).parents[2] / "docs" / "how-to" / "files"
BEGIN = ">>>>>Begin Spectral Data<<<<<\n"
OCEAN_VIEW = (EXAMPLES / "oceanview.txt").read_text().split(BEGIN)[0] + BEGIN + "{rows}\n"
SPECTRA_SUITE = """SpectraSuite Data File
++++++++++++++++++++++++++++++++++++
Dark Spectrum Present: Yes
Number of Sampled Component Spectra: 1
Integration Time (usec): 100000 (USB2000)
>>>>>Begin Processed Spectral Data<<<<<
{rows}
>>>>>End Processed Spectral Data<<<<<
"""
AVASOFT = """Integration time [ms]:   50,00
Averaging Nr. [scans]: 20
Data measured with spectrometer [name]: 0912086U1
Wave   ;Sample   ;Dark     ;Reference;Reflectance
[nm]   ;[counts] ;[counts] ;[counts]  ;[%]

{rows}
"""
VIEW_SPEC = """Text conversion of header file iris00000.asd
The instrument number was 18000/1
New ASD spectrum file: Program version = 6.00
Wavelength\tiris00000.asd
{rows}
"""
SPECTRA_MAGIC = """Instrument Name,CM-700d
Measurement Area,SAV
No.,Name,Illuminant,{}
1,left eye,D65,{}
2,left eye,D65,{}
"""
AVANTES = rows(";", X, COUNTS, 0 * X + 1000, 0 * X + 31000, 100 * Y, decimal=",")
LAYOUTS = {
    "OceanView": OCEAN_VIEW.format(rows=rows("\t", X, 100 * Y)),
    "OceanView, German": OCEAN_VIEW.format(rows=rows("\t", X, 100 * Y, decimal=",")),
    "SpectraSuite": SPECTRA_SUITE.format(rows=rows("\t", X, 100 * Y)),
    "AvaSoft": AVASOFT.format(rows=AVANTES),
    "ViewSpec": VIEW_SPEC.format(rows=rows("\t", X, Y)),
    "SpectraMagic": SPECTRA_MAGIC.format(
        ",".join(f"{x:.0f}nm" for x in X), rows(",", *zip(99 * Y)), rows(",", *zip(101 * Y))
    ),
    "a number first": "no,wavelength (nm),reflectance (%)\n" + rows(",", np.arange(6), X, 100 * Y),
}


def written(tmp_path, text, encoding="utf-8", name="s.txt"):
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_of_instruments(tmp_path, name):
    found = io.read_measured(written(tmp_path, LAYOUTS[name]))
    np.testing.assert_allclose(found.wavelengths, X)
    np.testing.assert_allclose(found.values, Y, rtol=1e-5)


@pytest.mark.parametrize("encoding", ["cp1252", "utf-16"])
def test_encodings_of_offices(tmp_path, encoding):
    text = "Wellenlänge;Remission (%)\r\n" + rows(";", X, 100 * Y, decimal=",")
    found = io.read_measured(written(tmp_path, text, encoding))
    np.testing.assert_allclose(found.values, Y, rtol=1e-5)


def test_what_the_tables_do_not_cover_is_left_out(tmp_path):
    x = np.arange(300.0, 1091.0, 10)
    path = written(tmp_path, "nm,R %\n" + rows(",", x[::-1], 2 + x / 1000))
    found = io.read_measured(path)
    assert (found.wavelengths[0], found.wavelengths[-1], found.wavelengths.size) == (350, 800, 46)
    assert "34 of 80 wavelengths left out: only 350 to 800 nm" in found.notes[0]
    found = io.read_measured(path, wavelengths=(400, 700))
    assert (found.wavelengths[0], found.wavelengths[-1]) == (400, 700)
    with pytest.raises(ValueError, match="900 to 1000 nm are asked for; the pigment tables have"):
        io.read_measured(path, wavelengths=(900, 1000))


def test_missing_values_are_skipped_and_counted(tmp_path):
    text = "nm,R %\n400,3\n410,\n420,NaN\n430,#N/A\n440,3.1\n"
    found = io.read_measured(written(tmp_path, text))
    np.testing.assert_array_equal(found.wavelengths, [400, 440])
    assert "3 of 5 wavelengths without a value skipped" in found.notes


JCAMP = """##TITLE=iris
##JCAMP-DX=4.24
##XUNITS={unit}
##YUNITS={y}
##FIRSTX={x[0]}
##LASTX={x[2]}
##NPOINTS=3
##XFACTOR=1.0
##YFACTOR=1.0
##XYPOINTS=(XY..XY)
{rows}
##END=
"""


def jcamp(y, values, unit="NANOMETERS", x=X[:3]):
    return JCAMP.format(unit=unit, y=y, x=x, rows=rows(", ", x, values[:3]))


@pytest.mark.parametrize(
    ("unit", "x", "y", "scale"),
    [
        ("MICROMETERS", X[:3] / 1000, "REFLECTANCE", 1),
        ("1/CM", 1e7 / X[:3], "REFLECTANCE", 1),
        ("NANOMETERS", X[:3], "% REFLECTANCE", 100),
    ],
)
def test_jcamp(tmp_path, unit, x, y, scale):
    found = io.read_measured(written(tmp_path, jcamp(y, scale * Y[:3], unit, x), name="s.jdx"))
    np.testing.assert_allclose(found.wavelengths, X[:3], rtol=1e-5)
    np.testing.assert_allclose(found.values, Y[:3], rtol=1e-5)
    with pytest.raises(ValueError, match="XUNITS"):
        io.read_measured(written(tmp_path, jcamp("R", Y, "ARBITRARY")))


def test_absorbance_and_kubelka_munk_are_converted(tmp_path):
    r = Y[:3]
    absorbance, ks = -np.log10(r), (1 - r) ** 2 / (2 * r)
    for text, said in (
        (jcamp("ABSORBANCE", absorbance), "absorbance"),
        ("nm,Absorbance\n" + rows(",", X[:3], absorbance), "absorbance"),
        ("nm,log(1/R)\n" + rows(",", X[:3], absorbance), "absorbance"),
        ("nm,K/S\n" + rows(",", X[:3], ks), "kubelka-munk"),
        (jcamp("KUBELKA-MUNK", ks), "kubelka-munk"),
    ):
        found = io.read_measured(written(tmp_path, text))
        np.testing.assert_allclose(found.values, r, rtol=1e-4)
        assert said in found.notes[0] and "converted" in found.notes[0]
    bare = written(tmp_path, rows(",", X[:3], absorbance))
    np.testing.assert_allclose(io.read_measured(bare, quantity="absorbance").values, r, rtol=1e-4)


@pytest.mark.parametrize(("quantity", "y"), [("absorbance", 1.5), ("kubelka-munk", 14.0)])
def test_standard_deviations_are_converted_too(tmp_path, quantity, y):
    def read(value):
        text = f"nm,y,sd\n500,{value:.9g},0.01\n510,{y},0.01\n"
        return io.read_measured(written(tmp_path, text), quantity=quantity)

    slope = (read(y - 1e-4).values[0] - read(y + 1e-4).values[0]) / 2e-4
    assert read(y).sd.shape == (2,)
    np.testing.assert_allclose(read(y).sd, 0.01 * slope, rtol=1e-4)


BOTH = ",".join(f"{kind} {x:.0f}nm" for kind in ("SCI", "SCE") for x in X)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (rows(",", X, COUNTS), "no reflectances, neither fractions nor per cent; are they counts"),
        ("nm,counts\n" + rows(",", X, COUNTS), "column 'counts' holds counts, not a reflectance"),
        ("nm,R\n" + rows(",", X, -Y), "zero or negative"),
        ("nm,R\n" + rows(",", X, 20 * Y), "give --unit percent or --unit fraction"),
        ("nm,radiance\n" + rows(",", X, Y), "give --quantity radiance"),
        ("nm,Transmittance\n" + rows(",", X, Y), "holds a transmittance"),
        ("nm,irradiance (µW/cm²)\n" + rows(",", X, Y), "holds irradiance, not a reflectance"),
        (jcamp("ARBITRARY UNITS", Y), "holds arbitrary units, not a reflectance"),
        (jcamp("COUNTS", COUNTS), "holds counts"),
        (f"No.,{BOTH}\n1{',3.1' * 12}", "several kinds"),
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
        ("cm-1,R\n25000,0.1\n0,0.1\n", "line 3: a wavenumber of 0"),
    ],
)
def test_what_is_no_spectrum_is_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message) as caught:
        io.read_measured(written(tmp_path, text))
    assert str(caught.value).startswith(str(tmp_path / "s.txt"))
    assert "\n" not in str(caught.value)


def test_what_no_iris_does_is_doubted(tmp_path):
    bright = written(tmp_path, "nm,R\n" + rows(",", X, 20 * Y))
    assert "brighter than any iris" in io.read_measured(bright, unit="fraction").doubts[0]
    assert io.read_measured(bright, unit="percent").doubts == ()
    dark = written(tmp_path, "nm,R %\n" + rows(",", X, Y))
    assert "darker than any iris" in io.read_measured(dark).doubts[0]


def test_a_table_of_eyes(tmp_path):
    text = "nm,a,b,c\n" + rows(",", X, 100 * Y, -Y, 50 * Y) + "\n700,,1,3\n"
    found = io.read_eyes(written(tmp_path, text))
    np.testing.assert_allclose(found["a"].values, Y, rtol=1e-5)
    assert isinstance(found["b"], ValueError)
    assert found["c"].wavelengths.size == 7
    text = "nm,eye,radiance,sd,counts\n" + rows(",", X, Y, Y, Y, Y)
    found = io.read_eyes(written(tmp_path, text))
    refused = {name: str(error) for name, error in found.items() if name != "eye"}
    assert "give --quantity radiance" in refused["radiance"]
    assert "need one spectrum" in refused["sd"]
    assert "holds counts" in refused["counts"]


@pytest.mark.parametrize("name", ["cm-1", "wavenumber (cm^-1)", "1/cm", "Wavenumber [cm⁻¹]"])
def test_wavenumbers(tmp_path, name):
    found = io.read_measured(written(tmp_path, f"{name},R\n" + rows(",", 1e7 / X, Y)))
    np.testing.assert_allclose(found.wavelengths, X, rtol=1e-5)
    np.testing.assert_allclose(found.values, Y, rtol=1e-5)
    bare = written(tmp_path, "x,R\n" + rows(",", 1e7 / X, Y))
    np.testing.assert_allclose(io.read_measured(bare, wavelength_unit="1/cm").wavelengths, X, 1e-5)


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
    np.testing.assert_allclose(found.wavelengths, [400, 500, 600], rtol=1e-12)
    np.testing.assert_allclose(found.values, [0.02, 0.03, 0.015], rtol=1e-12)
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
