"""Wrong input ends in one line and status 2, with nothing written; so do faults and Ctrl-C."""

import sys

import pytest
from refusals import one_line

from irisjax.cli import measure

WRONG = {
    "--eumelanin -1": "eumelanin = -1 mg/ml is outside [0, 2000] mg/ml",
    "--anisotropy 0.99": "anisotropy = 0.99 is outside [-0.9, 0.95]",
    "--lutein much": "--lutein: 'much' is not a number",
    "--melanin-load 2e4": "melanin_load = 20000 ug/mm2 is outside [0, 12000] ug/mm2",
    "--tear-index 0.9": "--tear-index: 0.9 is outside [1, 3]",
    "--wavelengths 300:700:10": "300 nm is outside the pigment tables (350 to 800 nm)",
    "--wavelengths 550,nan": "--wavelengths: nan nm is outside the pigment tables",
    "--wavelengths 700:400:10": "need start <= stop",
    "--wavelengths 400:700:0": "step > 0",
    "--wavelengths 400:700:11": "does not divide the range",
    "--wavelengths 400:700:nan": "--wavelengths: ",
    "--wavelengths 400:700:1e-9": "more than 1000000 wavelengths",
    "--wavelengths 500,450": "wavelengths must increase; 500 nm is followed by 450 nm",
    "--wavelengths 400:700": "'400:700' is not a grid; give start:stop:step",
    "--solver monte-carlo --photons 0": "--photons: 0 is outside [1, 2146435072]",
    "--solver monte-carlo --photons 1.5": "--photons: 1.5 is not a whole number",
    "--photons 100": "--photons means something only with --solver monte-carlo",
    "--process ilit-2007": "--process: unknown 'ilit-2007'",
    "--process depth-resolved --phase lb06": "--phase means something only with",
    "--illuminant D65": "--illuminant means something only with --instrument radiance",
    "--instrument radiance --illuminant moon": "unknown illuminant 'moon'",
    "--instrument radiance --cos-incidence diffuse": "diffuse",
    "--cos-incidence difuse": "--cos-incidence: 'difuse' is not a number in [0, 1]; or write diffuse",
    "--cos-incidence 1 --incidence-deg 0": "not both",
    "-o missing/file.csv": "missing: no such folder",
    "-o .": ".: is a folder",
    "--plot figure.doc": "figure.doc: a picture's name must end in .png or .pdf or .svg",
    "--plot same.png -o same.png": "same file",
    "-o table.xlsx": "table.xlsx: is written as CSV; its name must end in .csv or .txt",
    "--from missing.csv": "missing.csv: No such file",
    "--reduced-scattering 1": "needs --process depth-resolved",
    "--reduced-scattering 1 --polarised": "cannot be combined with polarised light",
    "--process ilit-2006 --polarised": "only with --process depth-resolved",
    "--process ilit-2006 --instrument co-polarised": "needs --process depth",
    "--scalar --process depth-resolved --instrument cross-polarised": "needs",
    "--polarised --solver monte-carlo": "monte-carlo follows unpolarised light",
    "--exit-deg 30": "means something only with --instrument cross-polarised",
    "--instrument cross-polarised --exit-deg 95": "outside [0, 90]",
    "--instrument cross-polarised --cornea inward": "bare iris",
    "--instrument cross-polarised --cos-incidence diffuse": "one direction",
    "--eumelanine 1": "--eumelanine",
    "--eumelanin": "--eumelanin",
    "stray": "stray",
}


@pytest.mark.parametrize("words", WRONG)
def test_wrong_input_is_one_line(irisjax, quick, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    extra = () if "-o" in words.split() else ("-o", "out.csv")
    one_line(irisjax("spectrum", *extra, *words.split()), WRONG[words])
    assert not list(tmp_path.iterdir())


def test_wrong_command_and_wrong_swatch(irisjax, quick, tmp_path):
    for arguments in (
        ("spectra",),
        ("colour", "--swatch", tmp_path / "swatch.jpg"),
        ("colour", "--observer", "x"),
    ):
        one_line(irisjax(*arguments), "")


@pytest.mark.parametrize(
    ("command", "package", "extra"),
    [
        ("render", "OpenImageIO", "images"),
        ("clone", "skimage", "photo"),
        ("export", "trimesh", "mesh"),
        ("paint", "tomlkit", "images"),
        ("view", "viser", "view"),
    ],
)
def test_a_missing_extra_is_one_line(irisjax, monkeypatch, command, package, extra):
    monkeypatch.setitem(sys.modules, package, None)
    status, out, told = irisjax(command, "eye")
    assert (status, out) == (2, "")
    assert told == (
        f"irisjax: this needs {package}, which is not installed: pip install 'irisjax[{extra}]'\n"
    )


def test_a_fault_of_our_own_is_one_line(irisjax, monkeypatch):
    def broken(*_, **__):
        raise TypeError("two\nlines")

    monkeypatch.setattr(measure, "observe", broken)
    status, out, err = irisjax("spectrum")
    assert (status, out) == (1, "")
    assert err == "irisjax: internal error: TypeError: two lines (IRISJAX_DEBUG=1 shows where)\n"


def test_interrupt_is_one_line(irisjax, monkeypatch, tmp_path):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(measure, "observe", interrupted)
    assert irisjax("spectrum", "-o", tmp_path / "out.csv") == (130, "", "irisjax: interrupted\n")
    assert not list(tmp_path.iterdir())
