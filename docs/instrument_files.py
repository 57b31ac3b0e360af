"""Writes the example files of the page "Files of instruments"; prints what irisjax says of each.

    python docs/instrument_files.py

The numbers are those of data/spectra/simulated_low.csv, a light eye, and where it says so of
simulated_moderate.csv (both simulated); the layouts are written by
hand after what the makers' programs write. Nothing here was measured.
"""

from pathlib import Path

import numpy as np

import irisjax as ij
from irisjax import io

ROOT = Path(__file__).parent.parent
FOLDER = Path(__file__).parent / "how-to" / "files"
SPECTRA = ROOT / "data" / "spectra"
SLIT = ROOT / "data" / "instruments" / "avasoft_slit_20nm.ttt"
X, R = io.read_measured(SPECTRA / "simulated_low.csv")[:2]
MODERATE = io.read_measured(SPECTRA / "simulated_moderate.csv").values


def rows(separator, *columns, decimal="."):
    """Lines of a table, as many digits as an instrument writes."""
    return "\n".join(
        separator.join(f"{v:.5g}".replace(".", decimal) for v in row)
        for row in zip(*columns, strict=True)
    )


DARK, WHITE = 1000 + 0 * X, 31000 + 0 * X
SAMPLE = DARK + (WHITE - DARK) * R
CLEAN = np.asarray(ij.reflectance(ij.Iris.of_level("low"), X).values)
SCANS = CLEAN * (1 + 0.02 * np.random.default_rng(0).standard_normal((3, X.size)))
WIDE_X = np.arange(1090.0, 299.0, -5.0)  # a whole detector, from long to short wavelengths
COVERED = ij.wavelengths(350, 800, 5)
WIDE_R = np.interp(WIDE_X, COVERED, ij.reflectance(ij.Iris.of_level("low"), COVERED).values)

PREAMBLE = """Data from eye_Reflection_0001.txt Node

Date: Mon Mar 04 10:11:12 CET 2024
User: lab
Spectrometer: FLMS12345
Trigger mode: 0
Integration Time (sec): 1.000000E-1
Scans to average: 10
Electric dark correction enabled: true
XAxis mode: Wavelengths
Number of Pixels in Spectrum: 31
>>>>>Begin Spectral Data<<<<<
"""
SUITE = """SpectraSuite Data File
++++++++++++++++++++++++++++++++++++
Dark Spectrum Present: Yes
Reference Spectrum Present: Yes
Integration Time (usec): 100000 (USB2000)
>>>>>Begin Processed Spectral Data<<<<<
"""
AVASOFT = """Integration time [ms]:   50,00
Averaging Nr. [scans]: 20
Data measured with spectrometer [name]: 0912086U1
Wave   ;Sample   ;Dark     ;Reference;Reflectance
[nm]   ;[counts] ;[counts] ;[counts] ;[%]

"""
VIEW_SPEC = """Text conversion of header file eye00000.asd
The instrument number was 18000/1
New ASD spectrum file: Program version = 6.00
Wavelength\teye00000.asd
"""
JCAMP = """##TITLE=eye, left
##JCAMP-DX=4.24
##DATA TYPE=UV/VIS SPECTRUM
##XUNITS=NANOMETERS
##YUNITS={unit}
##FIRSTX=400
##LASTX=700
##NPOINTS=31
##XFACTOR=1.0
##YFACTOR=1.0
##XYPOINTS=(XY..XY)
"""
IAD = """IAD1  # Must be first four characters
1.336 # Index of refraction of the sample
1.0   # Index of refraction of the top and bottom slides
0.4   # [mm] Thickness of sample
0.0   # [mm] Thickness of slides
3.0   # [mm] Diameter of illumination beam
0.98  # Reflectivity of the calibration standard
1     # Number of spheres used during each measurement
50.8 8.0 6.0 1.0 0.98 # Sphere, its ports [mm], reflectivity of its wall
50.8 8.0 6.0 1.0 0.98 # The same of the sphere for transmission
1     # One measurement, M_R
#lambda M_R
"""


def magic(*kinds):
    """A table of SpectraMagic: two measurements of an eye, a row each."""
    waves = ",".join(f"{kind}{x:.0f}nm" for kind in kinds for x in X)
    share = {"SCE ": 0.9}  # of the light, without its specular component
    first, second = (
        ",".join(f"{v:.4g}" for kind in kinds for v in 100 * share.get(kind, 1) * s)
        for s in SCANS[:2]
    )
    return (
        "Instrument Name,CM-700d\nMeasurement Area,SAV\n"
        f"No.,Name,Illuminant,{waves}\n1,left eye,D65,{first}\n2,left eye,D65,{second}"
    )


FILES = {
    "plain.csv": "wavelength_nm,reflectance\n" + rows(",", X, R),
    "with_sd.csv": "wavelength (nm),reflectance (%),sd\n"
    + rows(",", X, 100 * R, 100 * (0.02 * R + 2e-4)),
    "scans.csv": "nm,R1 (%),R2 (%),R3 (%)\n" + rows(",", X, *(100 * SCANS)),
    "long.csv": "eye,wavelength,reflectance,sd\n"
    + "\n".join(
        f"{eye},{x:g},{v:.5g},{0.02 * v + 2e-4:.5g}"
        for eye, values in (("left", R), ("right", MODERATE))
        for x, v in zip(X, values, strict=True)
    ),
    "excel_german.csv": "Wellenlänge;Remission (%)\r\n" + rows(";", X, 100 * R, decimal=","),
    "excel_unicode.txt": "Wavelength\tReflectance %\r\n" + rows("\t", X, 100 * R),
    "oceanview.txt": PREAMBLE + rows("\t", X, 100 * R),
    "spectrasuite.txt": SUITE + rows("\t", X, 100 * R) + "\n>>>>>End Processed Spectral Data<<<<<",
    "avasoft.txt": AVASOFT + rows(";", X, SAMPLE, DARK, WHITE, 100 * R, decimal=","),
    "viewspec.txt": VIEW_SPEC + rows("\t", X, R),
    "spectramagic.csv": magic(""),
    "eye.jdx": JCAMP.format(unit="REFLECTANCE") + rows(", ", X, R) + "\n##END=",
    "absorbance.jdx": JCAMP.format(unit="ABSORBANCE") + rows(", ", X, -np.log10(R)) + "\n##END=",
    "kubelka_munk.csv": "nm,K/S\n" + rows(",", X, (1 - R) ** 2 / (2 * R)),
    "iad.rxt": IAD + rows(" ", X, R),
    "whole_range.csv": "nm,R %\n" + rows(",", WIDE_X, 100 * WIDE_R),
    "gaps.csv": "nm,R %\n"
    + rows(",", X, 100 * R).replace("\n410,", "\n410,#").replace("\n430,", "\n430,NaN#"),
    # What is refused, or needs a word more.
    "counts.csv": "nm,counts\n" + rows(",", X, SAMPLE),
    "unnamed_counts.csv": rows(",", X, SAMPLE),
    "either.csv": "nm,R\n" + rows(",", X, 50 * MODERATE),
    "bright.csv": "nm,R %\n" + rows(",", X, 1000 * R),
    "dark.csv": "nm,R %\n" + rows(",", X, R),
    "wild.csv": "nm,R %\n" + rows(",", X, np.where(X == 500, 260, 100 * R)),
    "negative.csv": "nm,R\n" + rows(",", X, -R),
    "transmittance.csv": "nm,Transmittance\n" + rows(",", X, R),
    "radiance.csv": "nm,radiance\n" + rows(",", X, R),
    "irradiance.csv": "nm,irradiance (µW/cm²)\n" + rows(",", X, R),
    "arbitrary.jdx": JCAMP.format(unit="ARBITRARY UNITS") + rows(", ", X, R) + "\n##END=",
    "sci_and_sce.csv": magic("SCI ", "SCE "),
    "infrared.csv": "nm,R %\n" + rows(",", X + 600, 100 * R),
    "wavenumber.csv": "cm-1,R %\n" + rows(",", 1e7 / X, 100 * R),
    "letters.csv": "nm,R %\n400,3.1\n410,3.O\n420,3.2",
    "twice.csv": "nm,R %\n400,3.1\n400,3.0\n420,3.2",
    "one_column.csv": "R %\n3.1\n3.0\n3.2",
}
FILES["gaps.csv"] = "\n".join(line.split("#")[0] for line in FILES["gaps.csv"].splitlines())
ENCODINGS = {"excel_german.csv": "cp1252", "excel_unicode.txt": "utf-16"}


def through_a_slit():
    """An iris by radiative transfer through a slit of 20 nm, with noise, as AvaSoft writes it."""
    x = np.arange(400.0, 701.0, 5.0)
    iris = ij.Iris().replace(melanin_load=0.2, abl_fraction=0.4, hemoglobin=0.12, saturation=0.6)
    instrument = ij.Spectrophotometer(x, bands=ij.Passbands.slit(x, 20.0))
    r = np.asarray(ij.observe(iris, instrument, ij.RadiativeExact()).values)
    r = r + (0.01 * r + 5e-5) * np.random.default_rng(5).standard_normal(x.size)
    dark, white = 950 + 0 * x, 950 + 42000 * np.exp(-(((x - 560) / 130) ** 2))
    text = AVASOFT.replace("0912086U1", "0912086U1 (simulated by irisjax, slit of 20 nm)")
    return text + rows(";", x, dark + (white - dark) * r, dark, white, 100 * r, decimal=",") + "\n"


def eight_bands():
    """A light eye by radiative transfer through eight filters, and a table of these."""
    centre = np.array([420.0, 450, 480, 520, 560, 590, 630, 680])
    fwhm = np.array([20.0, 25, 25, 30, 30, 25, 35, 40])
    instrument = ij.Spectrophotometer(centre, bands=ij.Passbands.slit(centre, fwhm))
    values = np.array(ij.observe(ij.Iris.of_level("low"), instrument, ij.RadiativeExact()).values)
    values *= 1 + 0.02 * np.random.default_rng(0).standard_normal(8)
    return (
        "nm,R %\n" + rows(",", centre, 100 * values) + "\n",
        "centre,fwhm\n" + rows(",", centre, fwhm) + "\n",
    )


def blocks():
    """A JCAMP file with two blocks, an eye each."""
    each = [
        JCAMP.format(unit="REFLECTANCE").replace("eye, left", title)
        + rows(", ", X, y)
        + "\n##END=\n"
        for title, y in (("eye, left", R), ("eye, right", MODERATE))
    ]
    head = "##TITLE=both eyes\n##JCAMP-DX=4.24\n##DATA TYPE=LINK\n##BLOCKS=2\n"
    return head + "".join(each) + "##END=\n"


def main():
    """Write all of them; print what reading them says."""
    FOLDER.mkdir(exist_ok=True)
    SLIT.parent.mkdir(exist_ok=True)
    SLIT.write_text(through_a_slit())
    for name, text in zip(("eight_bands.csv", "bands.csv"), eight_bands(), strict=True):
        (SLIT.parent / name).write_text(text)
    (SLIT.parent / "blocks.jdx").write_text(blocks())
    for name, text in FILES.items():
        path = FOLDER / name
        path.write_bytes((text + "\n").encode(ENCODINGS.get(name, "utf-8")))
        try:
            found = io.read_measured(path)
        except ValueError as error:
            print(f"{name}: REFUSED: {str(error).replace(f'{FOLDER}/', '')}")
            continue
        top = 100 * found.values.max()
        sd = "" if found.sd is None else ", with sd"
        print(f"{name}: {found.values.size} values up to {top:.3g} %{sd}")
        for word in (*found.notes, *found.doubts):
            print(f"    {word}")


if __name__ == "__main__":
    main()
