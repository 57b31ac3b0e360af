"""Spectra as people and instruments write them: every layout is read, every fault is named.

Examples by hand after the layouts that makers document: no measured file is in the project.
"""

import re
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
JCAMP = """##TITLE=iris
##JCAMP-DX=4.24
##XUNITS={unit}
##YUNITS={y}
##FIRSTX={x[0]}
##LASTX={x[5]}
##NPOINTS=6
##XFACTOR=1.0
##YFACTOR=1.0
##XYPOINTS=(XY..XY)
{rows}
##END=
"""


def jcamp(y, values, unit="NANOMETERS", x=X):
    return JCAMP.format(unit=unit, y=y, x=x, rows=rows(", ", x, values))


OFFICE = "Wellenlänge;Remission (%)\r\n" + rows(";", X, 100 * Y, decimal=",")
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
    "JCAMP, micrometres": jcamp("REFLECTANCE", Y, "MICROMETERS", X / 1000),
    "JCAMP, wavenumbers": jcamp("REFLECTANCE", Y, "1/CM", 1e7 / X),
    "JCAMP, per cent": jcamp("% REFLECTANCE", 100 * Y),
    "cp1252": OFFICE,
    "utf-16": OFFICE,
    "utf-16-le": OFFICE,
} | {
    name: f"{name},R\n" + rows(",", 1e7 / X, Y)
    for name in ("cm-1", "wavenumber (cm^-1)", "1/cm", "Wavenumber [cm⁻¹]")
}


def written(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "s.txt"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("name", LAYOUTS)
def test_layouts_of_instruments(tmp_path, name):
    text = LAYOUTS[name]
    encoding = name if name.startswith(("cp", "utf")) else "utf-8"
    found = io.read_measured(written(tmp_path, text, encoding))
    np.testing.assert_allclose(found.wavelengths, X, rtol=1e-5)
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


def test_jcamp_in_differences_with_repetitions(tmp_path):
    # 31, 31, 12 times 33, 30, 30: the first value of a line repeats the last one.
    lines = ("##XYDATA=(X++(Y..Y))", "400C1%K%S1", "413C3lT")
    text = jcamp("REFLECTANCE", Y).replace("##NPOINTS=6", "##NPOINTS=16")
    text = text.replace("YFACTOR=1.0", "YFACTOR=0.001").replace("LASTX=650.0", "LASTX=415.0")
    text = re.sub(r"##XYPOINTS.*\n##END", "\n".join([*lines, "##END"]), text, flags=re.S)
    found = io.read_measured(written(tmp_path, text))
    np.testing.assert_allclose(1000 * found.values, [31, 31] + 12 * [33] + [30, 27])
    with pytest.raises(ValueError, match=r"damaged .* Y-Check failed"):
        io.read_measured(written(tmp_path, text.replace("413C3", "413C4")))


@pytest.mark.parametrize(("quantity", "y"), [("absorbance", 1.5), ("kubelka-munk", 14.0)])
def test_standard_deviations_are_converted_too(tmp_path, quantity, y):
    def read(value):
        text = f"nm,y,sd\n500,{value:.9g},0.01\n510,{y},0.01\n"
        return io.read_measured(written(tmp_path, text), quantity=quantity)

    slope = (read(y - 1e-4).values[0] - read(y + 1e-4).values[0]) / 2e-4
    assert read(y).sd.shape == (2,)
    np.testing.assert_allclose(read(y).sd, 0.01 * slope, rtol=1e-4)


GRID = np.arange(400.0, 701.0, 10)
R = np.interp(GRID, [400, 450, 550, 700], [0.034, 0.042, 0.026, 0.018])
SD = 0.03 * R
ABSORBANCE, KS = -np.log10(R), (1 - R) ** 2 / (2 * R)
BLOCK = """##TITLE={title}
##JCAMP-DX=5
##DATA TYPE=UV/VIS SPECTRUM
##XUNITS=NANOMETERS
##YUNITS={y}
##XYPOINTS=(XY..XY)
{rows}
##END=
"""


def blocks(*each):
    body = "".join(
        BLOCK.format(title=title, y=y, rows=rows(", ", GRID, values)) for title, y, values in each
    )
    return f"##TITLE=eye\n##JCAMP-DX=5\n##DATA TYPE=LINK\n##BLOCKS={len(each)}\n{body}##END=\n"


def cary(*samples, below=""):
    names = ",".join(f"{name}," for name, _ in samples)
    titles = ",".join(["Wavelength (nm),%R"] * len(samples))
    columns = [c for _, values in samples for c in (GRID, 100 * values)]
    return f"{names}\n{titles}\n{rows(',', *columns)}\n{below}"


AVASOFT_OF_LIGHT = """eye\0\0
Wave   ;Dark     ;Ref      ;Sample   ;Transmittance
[nm]   ;[counts] ;[counts] ;[counts] ;[% transmittance]
{rows}\0
"""
CGATS = """CGATS.17
BEGIN_DATA_FORMAT
SAMPLE_ID\tSAMPLE_NAME\t{names}
END_DATA_FORMAT
NUMBER_OF_SETS\t1
BEGIN_DATA
1\t"left eye"\t{values}
END_DATA
"""
PERKIN_ELMER = "PE UV  SUBTECH\n-1\neye.asc\n\nnm\n{unit}\n1.0\n0.0\n#DATA\n{rows}"
IAD = """IAD1 # Must be first four characters
1.34  # Index of refraction of the sample
{slides}  # Index of refraction of the slides
1.0 1.0 5.0 0.98 # Thickness of sample and slides, beam, standard
{spheres} # spheres
203.2 25.4 12.7 1.00 0.96
203.2 25.4 12.7 1.00 0.96
{legend} # columns
#lambda M_R M_T
{rows}
"""


def table(names, *columns, sep=",", **how):
    return names + "\n" + rows(sep, GRID, *columns, **how)


def each(form, separator="\n"):
    """A text for each wavelength x of its reflectance y, standard deviation s and percentage p."""
    numbers = zip(GRID, R, SD, 100 * R, strict=True)
    return separator.join(
        form.format(i=i, x=x, y=y, s=s, p=p) for i, (x, y, s, p) in enumerate(numbers, 1)
    )


def role(text, said="", **asked):
    """Make a case: a file, what is said of it, and how it is read."""
    return text, said, asked


ABSORBED = "absorbance log10(1/R) converted to reflectance"
REMITTED = "kubelka-munk (1 - R)²/2R converted to reflectance"
PERCENT, ZERO = 100 * R, 0 * R
SVC = "/*** Spectra Vista SIG Data ***/\nunits= Radiance, Radiance\ndata="
EVOLUTION = "Version: 2.2\nUnits: W/m^2\nColumns [4]:\nData:\n"
EVOLUTION += "Wvl\tRad. (Ref.)\tRad. (Target)\tReflect. %"
DIFFERENCES = "Wavelength [nm],Sample,Dark,Reference,Absorbance [A.U.]"
JASCO = "試料\t右眼\nXUNITS\tNANOMETERS\nYUNITS\tABSORBANCE\nXYDATA\n{}\n[コメント情報]\n"
LIBRARY = "X Units: Wavelength (micrometers)\nY Units: Reflectance (percent)\n"
USGS = "  wavelength   reflectance    standard deviation\n\niris AREF\ncopy of splib05a r 4000\n"
FORTRAN = "nm R\n" + each("{x:.4E} {y:.6E}").replace("E", "D")
FRENCH = "Longueur d'onde;Réflectance (%);écart-type"
PORTUGUESE = "Comprimento de onda (nm);Refletância (%);Desvio padrão"
NUMBERED = {"names": each("SPECTRAL_NM_{x:.0f}", "\t"), "values": each("{y:.6g}", "\t")}
COUNTED = rows(";", GRID, 3 + ZERO, 64 + R, 12 + R, PERCENT)
TWO_SAMPLES = "\n".join(
    rows("\t", i + ZERO, GRID, scale * PERCENT, 100 * scale * SD) for i, scale in ((1, 2), (2, 1))
)
TWO_KINDS = ";".join(f"{x:.0f} nm ({kind})" for kind in ("SCI", "SCE") for x in GRID)
LONG_SCANS = "\n".join(
    f"{scan};{x};{name};{f * y:.6g}"
    for x, y in zip(GRID, R, strict=True)
    for scan, f in ((1, 0.9), (2, 1.1))
    for name, f in (("reflectance", f), ("transmittance", 0.2))
)
WITHOUT_SD = {
    "blocks": role(
        blocks(("a", "REFLECTANCE", R), ("a", "VARIANCE", SD**2)), "'VARIANCE' left out"
    ),
    "a linked standard": role(
        blocks(("PROCESSED", "Reflection (%)", PERCENT), ("DARK", "Reflection (%)", 0.1 + R)),
        "'DARK: Reflection (%)' left out",
    ),
    "blanks in labels": role(
        blocks(("a", "REFLECTANCE", R)).replace("##XYPOINTS=", "## XY_DATA = ")
    ),
    "SVC": role(table(SVC, 34 + R, 34 * R, PERCENT, sep="  "), "'radiance' left out"),
    "Spectral Evolution": role(table(EVOLUTION, 1 + R, R, PERCENT, sep="\t")),
    "Cary": role(cary(("Sample 1", R), below="\nSample 1\nY Mode   %R\n"), "2 lines below"),
    "Cary, one of a pair": role(
        cary(("Baseline", 30 * R), ("eye", R), ("iris", 2 * R)), "'eye %R' used", column="eye"
    ),
    "JASCO": role(JASCO.format(rows("\t", GRID, ABSORBANCE)), ABSORBED),
    "Shimadzu": role('"eye"\n"Wavelength nm.","R%"\n' + each('"{x:.2f}","{p:.5f}"')),
    "PerkinElmer": role(PERKIN_ELMER.format(unit="%R", rows=rows("\t", GRID, PERCENT))),
    "a library of spectra": role(
        LIBRARY + rows("\t", [*GRID / 1000, 14.0], [*PERCENT, 2.0]), "1 of 32 wavelengths left out"
    ),
    "IAD, a number of columns": role(
        IAD.format(slides=1.5, spheres=1, legend="2", rows=rows(" ", GRID, R, 0.5 * R)),
        "--fix gain=0.920",
    ),
    "IAD, letters": role(
        IAD.format(slides=1, spheres=0, legend="LtrR", rows=rows(" ", GRID, R / 2, R, 0.99 + ZERO)),
        "'M_R' used, 'M_T' left out",
    ),
    "CGATS": role(CGATS.format(**NUMBERED)),
    "light beside counts": role(
        AVASOFT_OF_LIGHT.format(rows=COUNTED),
        "'Ref [counts]'",
        column="Transmittance",
        quantity="reflectance",
    ),
    "JAZ": role(
        table("W\tD\tR\tS\tP", 900 + ZERO, 900 + 3e4 + R, 900 + 3e4 * R, PERCENT, sep="\t"),
        "'reflectance (%)' used",
    ),
    "ENVI": role(table("Column 1: Wavelength\nColumn 2: iris~~1##255,0,0", R, sep="  ")),
    "deviations of zero": role(table("nm,R,sd", R, ZERO), "of zero are none"),
    "quartiles": role(table("nm,median,Q1,Q3,95% CI", R, 0.9 * R, 1.1 * R, R), "'Q1', 'Q3'"),
    "minus a logarithm": role(table("nm,-log10(R)", ABSORBANCE), ABSORBED),
    "a logarithm": role(table("nm,log(1/R)", ABSORBANCE), ABSORBED),
    "absorbance by its option": role(rows(",", GRID, ABSORBANCE), ABSORBED, quantity="absorbance"),
    "K/S": role(table("nm,K/S", KS), REMITTED),
    "a block of Kubelka and Munk's": role(blocks(("a", "KUBELKA-MUNK", KS)), REMITTED),
    "absorbance units": role(
        table(DIFFERENCES, 900 + R, 900 + ZERO, 3e4 + R, ABSORBANCE), ABSORBED
    ),
    "a ratio": role(table("nm,eye,white,eye/white", 0.5 * R, 0.5 + ZERO, R), "'eye/white' used"),
    "a wavelength in two units": role(
        table("Wavelength;Wavenumber;Dark;%R", 1e7 / GRID, 900 + R, PERCENT, sep=";")
    ),
    "decimal commas in quotes": role('"nm","R%"\n' + each('"{x}","{p:.6g}"').replace(".", ",")),
    "a unit in each cell": role(
        "Name;Wellenlänge;Remission\n" + each("eye;{x:.0f} nm;{p:.6g} %").replace(".", ",")
    ),
    "R's names of rows": role('"wavelength" "value"\n' + each('"{i}" {x} {y:.6g}')),
    "exponents of Fortran": role(FORTRAN),
    "a row with a unit in each cell": role(
        "Data Name,Time," + each("SCE {x:.0f}[nm]", ",") + "\neye,10:11," + each("{p:.6g}%", ",")
    ),
    "SCI and SCE behind the wavelengths": role(
        f"Name;{TWO_KINDS}\neye;" + ";".join(f"{p:.6g}" for p in (*1.4 * PERCENT, *PERCENT)),
        "'eye SCE' used",
        column="SCE",
    ),
    "remarks beside values": role(
        "time,wavelength,R,remark\n" + each("10:11:{i:02},{x},{y:.6g},") + "blink"
    ),
    "names two lines above": role(
        table("file,a.asd,b.asd\nunit,Reflectance,Reflectance", R, 2 * R),
        "'a.asd Reflectance' used",
        column="a.asd",
    ),
}
WITH_SD = {
    "sd in a name": role(table("wavelength,reflectance,reflectance_sd", R, SD)),
    "StdDev": role(table("wavelength,reflectance,StdDev", R, SD)),
    "dR": role(table("lambda;R;dR", R, SD, decimal=",", sep=";")),
    "u(R)": role(table("nm,R,u(R)", R, SD)),
    "French": role(table(FRENCH, PERCENT, 100 * SD, sep=";")),
    "Portuguese": role(table(PORTUGUESE, PERCENT, 100 * SD, decimal=",", sep=";")),
    "a comment of numpy.savetxt": role(table("# wavelength reflectance sd", R, SD, sep=" ")),
    "mean, least and largest": role(
        table("nm,mean,min,max,std", R, 0.9 * R, 1.1 * R, SD), "'min', 'max'"
    ),
    "sd by its name": role(table("nm,R,x", R, SD), column="R", sd="x"),
    "relative": role(table("nm,R,rel. sd (%)", R, 3 + ZERO)),
    "k = 2": role(table("nm,R,u (k=2)", R, 2 * SD)),
    "columns listed in a preamble": role(
        USGS + rows("   ", GRID / 1000, R, SD) + "\n 0.71  -1.23e34  0.0",
        "1 of 32 wavelengths without a value",
    ),
    "a sample in a long table": role(
        '"","sample","date","wavelength","value","sd"\n'
        + each('"{i}","eye, left","2024-03-04",{x},{y:.6g},{s:.6g}')
    ),
    "one of the samples of a long table": role(
        f"id\twavelength\tR (%)\tsd\n{TWO_SAMPLES}", "'1 R (%)', '1 R (%) sd' left out", column="2"
    ),
    "scans and their mean": role(
        table("nm,scan 1,scan 2,mean", 1.05 * R, 0.95 * R, 1.5 * R), "'mean' left out"
    ),
    "scans of a numbered eye": role(
        table("nm,eye1 0001,eye1 0002", 1.1 * R, 0.9 * R), "mean of 2 scans"
    ),
    "scans of a long table": role(
        f"scan;wavelength;quantity;value\n{LONG_SCANS}", "mean of 2 scans"
    ),
}


@pytest.mark.parametrize("kind", WITHOUT_SD | WITH_SD)
def test_columns_have_roles(tmp_path, kind):
    text, said, how = (WITHOUT_SD | WITH_SD)[kind]
    encoding = "cp932" if kind == "JASCO" else "utf-8"
    found = io.read_measured(written(tmp_path, text, encoding), **how)
    np.testing.assert_allclose(found.wavelengths, GRID)
    np.testing.assert_allclose(found.values, R, rtol=1e-4)
    assert said in " ".join(found.notes)
    assert (found.sd is not None) == (kind in WITH_SD)
    if kind in WITH_SD and "scans" not in kind:
        np.testing.assert_allclose(found.sd, SD, rtol=1e-4)


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ("Dark", "holds dark signal, not a reflectance"),
        ("Transm", "a transmittance; where it is the light sent back, give --quantity reflectance"),
        ("radiance", "holds a radiance; give --quantity radiance"),
    ],
)
def test_a_column_that_is_chosen_is_not_taken_for_a_reflectance(tmp_path, column, message):
    names = "nm,Dark [counts],Transmittance [%],radiance\n"
    path = written(tmp_path, names + rows(",", GRID, 3 + R, 100 * R, R))
    with pytest.raises(ValueError, match=message):
        io.read_measured(path, column=column)
    found = io.read_measured(path, column="Transm", quantity="reflectance")
    np.testing.assert_allclose(found.values, R, rtol=1e-4)


def test_rows_of_one_name_are_scans(tmp_path):
    titles = ",".join(f"{kind} {x:.0f}nm" for kind in ("SCI", "SCE") for x in GRID)
    lines = [
        ",".join(f"{v:.6g}" for share in (1, 0.5) for v in share * scale * 100 * R)
        for scale in (1.01, 0.99)
    ]
    path = written(tmp_path, f"Name,{titles}\nleft,{lines[0]}\nleft,{lines[1]}\n")
    for kind, scale in (("SCI", 1), ("SCE", 0.5)):
        found = io.read_measured(path, column=kind)
        np.testing.assert_allclose(found.values, scale * R, rtol=1e-4)
        assert "mean of 2 scans; their scatter is the noise" in found.notes


def test_an_excel_file_holds_one_table(tmp_path):
    import openpyxl

    book, path = openpyxl.Workbook(), tmp_path / "eye.xlsx"
    book.create_sheet("remarks").append(["a remark"])
    for row in [
        ["Wavelength (nm)", "Reflectance (%)", "SD"],
        *np.stack([GRID, 100 * R, 100 * SD], 1),
    ]:
        book.worksheets[0].append(list(row))
    book.save(path)
    found = io.read_measured(path)
    np.testing.assert_allclose(found.values, R)
    np.testing.assert_allclose(found.sd, SD)
    book.worksheets[1].append([400, 3.0])
    book.save(path)
    with pytest.raises(ValueError, match="tables in 2 sheets"):
        io.read_measured(path)


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("eye.asd", b"ASD\0\1\2", "ASD's binary format is not read; .* ASCII Export"),
        ("eye.spc", b"\0\x4b\0\1", "binary format SPC is not read; .* JCAMP-DX"),
        ("eye.xls", b"\xd0\xcf\x11\xe0\0\1", "Excel's old format"),
        ("eye.ods", b"PK" + bytes(28) + b"mimetypeapplication/vnd.oasis", "OpenDocument"),
        ("eye.h5", b"\x89HDF\r\n", "HDF5 is not read"),
        ("eye.mat", b"MATLAB 5.0 MAT-file", "MATLAB's binary format"),
        ("eye.dat", b"\0\1\2\3", "not a text file; export the spectrum as text"),
        ("eye.xlsx", b"PK\3\4\0", "not readable as an Excel file"),
    ],
)
def test_binary_formats_are_named(tmp_path, name, data, message):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ValueError, match=message):
        io.read_measured(tmp_path / name)


NAMES, VALUES = each("{x:.0f}nm", ","), each("{y:.6g}", ",")


@pytest.mark.parametrize(
    "text",
    [
        table("nm,left,right", R, 1.1 * R),
        table("nm,Sample 1,Sample 2", R, 0.7 * R),
        table("nm,R SCI,R SCE", R, R),
        rows(" ", GRID, R, SD),
        cary(("Sample 1", R), ("Sample 2", 2 * R)),
        table("nm,R raw,R smoothed", R, R),
        table("nm,R 0°,R 15°", R, 1.1 * R),
        table("nm,scan 1,scan 2", R, 3 * R),
        table("nm,P01,P01_sd,P02,P02_sd", R, SD, 1.1 * R, SD),
        f"Name,Specular,{NAMES}\neye,SCI,{VALUES}\neye,SCE,{VALUES}",
    ],
)
def test_columns_of_several_things_are_no_scans(tmp_path, text):
    path = written(tmp_path, text)
    with pytest.raises(ValueError, match=r"no scans of one spectrum.*--column NAME"):
        io.read_measured(path)


def test_columns_that_noise_alone_tells_apart_are_scans(tmp_path):
    rng = np.random.default_rng(0)
    scans = R[:, None] * (1 + 0.02 * rng.normal(size=(R.size, 2)))
    found = io.read_measured(written(tmp_path, table("nm,left,right", *scans.T)))
    np.testing.assert_allclose(found.values, scans.mean(1), rtol=1e-4)


def test_a_wild_pixel_decides_no_unit_and_is_doubted(tmp_path):
    for at in (0, 15):
        values = R.copy()
        values[at] = 2.6
        found = io.read_measured(written(tmp_path, table("nm,R", values)))
        np.testing.assert_allclose(np.delete(found.values, at), np.delete(R, at), rtol=1e-4)
        (doubt,) = found.doubts
        assert doubt.startswith(f"at {GRID[at]:.0f} nm far from the neighbouring values")
    assert not io.read_measured(written(tmp_path, table("nm,R", R))).doubts


def test_eyes_with_their_standard_deviations(tmp_path):
    text = table("nm,left,left_sd,right,SD right", R, SD, 0.8 * R, 2 * SD)
    found = io.read_eyes(written(tmp_path, text))
    assert list(found) == ["left", "right"]
    np.testing.assert_allclose(found["left"].sd, SD, rtol=1e-4)
    np.testing.assert_allclose(found["right"].sd, 2 * SD, rtol=1e-4)
    text = table("nm,left mean,left SEM", R, SD)
    (eye,) = io.read_eyes(written(tmp_path, text)).values()
    np.testing.assert_allclose(eye.sd, SD, rtol=1e-4)


def test_scans_of_eyes_have_their_mean(tmp_path):
    """Rows of one name, the right eye's among them, and lines of one eye in a long table."""
    scans = ((0, 1, 1.01 * R), (0, 2, 0.99 * R), (1, 1, 0.8 * R))
    rows_of, lines_of = ("OD", "OS"), ("leaf1", "leaf2")
    wide = [f"{n},{rows_of[eye]},{','.join(map(str, scan))}" for eye, n, scan in scans]
    long = [
        f"{lines_of[eye]} {n} {x} {y:.6g}"
        for eye, n, scan in scans
        for x, y in zip(GRID, scan, strict=True)
    ]
    for names, lines in (
        (rows_of, [f"No.,Name,{NAMES}", *wide]),
        (lines_of, ["eye scan wavelength R", *long]),
    ):
        found = io.read_eyes(written(tmp_path, "\n".join(lines)))
        assert tuple(found) == names
        np.testing.assert_allclose(found[names[0]].values, R, rtol=1e-4)


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
        (
            IAD.format(slides=1, spheres=0, legend="L t", rows=rows(" ", X, Y)),
            "'M_T' holds a transmittance",
        ),
        (
            IAD.format(slides=1, spheres=0, legend="2", rows=rows(" ", Y, Y)),
            "line 10: 2 columns, 3 stated, the wavelength among them",
        ),
        (IAD.split("{spheres}")[0].format(slides="glass"), "IAD: .*'glass' among the parameters"),
        ("nm,irradiance (µW/cm²)\n" + rows(",", X, Y), "holds irradiance, not a reflectance"),
        (jcamp("ARBITRARY UNITS", Y), "holds arbitrary units, not a reflectance"),
        (jcamp("COUNTS", COUNTS), "holds counts"),
        (jcamp("R", Y, "ARBITRARY"), "XUNITS"),
        (f"No.,{BOTH}\n1{',3.1' * 6}{',2.9' * 6}", "'SCI' .*'SCE' .* choose with --column NAME"),
        ("", "no rows of numbers"),
        ("only,a,header\n", "no rows of numbers"),
        ("THz,R\n" + rows(",", X, Y), "column 'THz' is no wavelength; convert it to one of nm"),
        ("pixel,R\n" + rows(",", X, Y), "column 'pixel' is no wavelength"),
        ("nm,eye,white\n" + rows(",", X, Y, 1 + Y), "beside 'white' the others may be counts"),
        ("nm,ln(1/R)\n" + rows(",", X, -np.log(Y)), "a natural logarithm; divide it by 2.302585"),
        ("nm,OD\n" + rows(",", X, 100 * Y), "an optical density or the right eye; give"),
        ("nm,mu_a (1/mm)\n" + rows(",", X, Y), "holds no reflectance; where it is one, give"),
        ("nm,signal (mV)\n" + rows(",", X, Y), "holds no reflectance"),
        ("nm,BRDF (1/sr)\n" + rows(",", X, Y), "holds no reflectance"),
        ("nm,R,sd (%)\n" + rows(",", X, Y, Y), "'sd \\(%\\)' is beside a fraction"),
        ("nm,R (‰)\n" + rows(",", X, 1000 * Y), "give per cent or fractions"),
        ("eye_Absorbance_1.txt\n" + rows("\t", X, -np.log10(Y)), "'Absorbance': give --quantity"),
        ("400\n500\n", "line 1: one column"),
        ("nm,R\n400,0.1\n410,abc\n", "line 3: 'abc' is not a number"),
        ("nm,R\n400,oops\n410,0.03\n", "line 2: 'oops' is not a number"),
        ("400,oops\n410,0.03\n420,0.03\n", "line 1: 'oops' is not a number"),
        ("nm,R\n400,0.1\n410\n", "line 3: 1 values, 2"),
        ("nm,R\n400,0.1\n410,inf\n", "line 3: inf is not a finite number"),
        ("nm,R\n400,\n410,nan\n", "no wavelength has a value"),
        ("nm,R\n200,0.1\n210,0.1\n", "none is within 350 to 800 nm"),
        ("nm,R\n400,0.1\n400,0.2\n", "line 3: 400 nm appears twice"),
        ("nm,R,sd\n400,0.1,0.01\n410,0.1,0\n", "line 3: standard deviation 0"),
        ("nm,R,sd,sigma\n400,0.1,0.01,1\n", "two standard deviations; choose with --sd NAME"),
        ("cm-1,R\n25000,0.1\n0,0.1\n", "line 3: a wavenumber of 0"),
        ("nm,R\n400,3.1%\n410,0.032\n", "line 3: '0.032' has no unit .* before have %"),
        (f"Name,{BOTH}\neye{',3.1%' * 11},2.9", "column SCE 650nm: '2.9' has no unit"),
        ("nm,R,sd\n400,3.1%,0.01\n", "column 'sd \\[1\\]' is beside a percent"),
        ("eye,nm,R\na,400,.1\na,410,.1\nb,400,.1\nb,4lO,.1", "line 5: '4lO' is not a number"),
        ("eye,nm,R\n1,400,.03\n2,400,.03\n", "'1 R' .*'2 R' .* choose with --column NAME"),
        ("eye,nm,R\na,400,.03\na,400,.03\n", "a wavelength of 'a R' appears twice"),
        ("eye,nm,A\nT,400,.5\nT,410,abs\n", "line 3: 'abs' is not a number"),
        (jcamp("REFLECTANCE", Y).replace("\n", "\n##NTUPLES=N\n", 1), "NTUPLES is not read"),
        ('<?xml version="1.0"?>\n<CxF/>', "XML, such as CxF, is not read"),
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
    assert list(found) == ["eye", "radiance", "counts"]
    np.testing.assert_allclose(found["eye"].sd, Y, rtol=1e-5)
    assert "give --quantity radiance" in str(found["radiance"])
    assert "holds counts" in str(found["counts"])


@pytest.mark.parametrize(
    "text",
    [
        "400,0.02\n500,0.03\n600,0.015\n",
        "\ufeffwavelength,reflectance\r\n600,0.015\r\n500,0.03\r\n400,0.02\r\n",
        "# a note\n# level: low\nwavelength (nm),R\n400,0.02\n\n500,0.03\n600,0.015\n",
        "wavelength_um,reflectance\n0.4,0.02\n0.5,0.03\n0.6,0.015\n",
        "0.4,0.02\n0.5,0.03\n0.6,0.015\n",
        "nm,R,\n400,0.02,\n500,0.03,\n600,0.015,\n",
    ],
    ids=["bare", "bom-crlf-reversed", "comments", "um", "um-by-size", "trailing"],
)
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
    bare = written(tmp_path, "x,R\n" + rows(",", 1e7 / X, Y))
    np.testing.assert_allclose(io.read_measured(bare, wavelength_unit="1/cm").wavelengths, X, 1e-5)


def test_repeated_scans(tmp_path):
    rng = np.random.default_rng(0)
    scans = 0.02 + 0.001 * rng.normal(size=(300, 5))
    lines = "\n".join(f"{400 + i},{','.join(map(str, row))}" for i, row in enumerate(scans))
    found = io.read_measured(written(tmp_path, lines))
    np.testing.assert_allclose(found.values, scans.mean(1))
    assert found.sd is not None
    assert np.sqrt((found.sd**2).mean()) == pytest.approx(0.001 / np.sqrt(5), rel=0.06)
    assert any("mean of 5 scans" in note for note in found.notes)
