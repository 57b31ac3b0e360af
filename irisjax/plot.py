"""Figures of spectra and BRDFs. Nothing is imported from matplotlib until a figure is asked for."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from irisjax.measure.goniophotometer import Brdf
from irisjax.measure.measurement import Measurement

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.projections.polar import PolarAxes

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
"""Colours that colour-blind readers tell apart [Okabe & Ito 2008], the palest last."""

SUFFIXES = (".png", ".pdf", ".svg")
"""Kinds of picture that can be written."""

_LINES = ("-", "--", "-.", ":")
_MOST_LINES, _MOST_DISCS = 8, 6


def spectra_figure(measurements: Mapping[str, Measurement], title: str = "") -> "Figure":
    """Spectra by name, with a band of one standard error where they are sampled."""
    figure = _figure(6.4, 4.0)
    ax = figure.add_subplot()
    first = next(iter(measurements.values()))
    sampled = False
    for i, (name, m) in enumerate(measurements.items()):
        x, y = np.asarray(m.wavelengths), np.asarray(m.values)
        colour = PALETTE[i % len(PALETTE)]
        ax.plot(
            x,
            y,
            _LINES[i // len(PALETTE) % len(_LINES)],
            color=colour,
            label=name,
            marker="o" if x.size == 1 else "",
        )
        if m.standard_error is not None:
            error = np.asarray(m.standard_error)
            ax.fill_between(x, y - error, y + error, color=colour, alpha=0.3, linewidth=0)
            if x.size == 1:
                ax.errorbar(x, y, error, color=colour, capsize=3)
            sampled = True
    ax.set_xlabel("wavelength (nm)")
    label = f"{first.quantity} ({first.unit})" if first.unit else first.quantity
    ax.set_ylabel(label + (", band: ± 1 standard error" if sampled else ""))
    ax.set_ylim(bottom=0)
    if first.wavelengths.size > 1:
        ax.margins(x=0)
    ax.grid(alpha=0.25)
    if len(measurements) > 1:
        ax.legend(frameon=False)
    ax.set_title(title, fontsize=9)
    ax.spines[["top", "right"]].set_visible(False)
    return figure


def brdf_figure(result: Brdf, title: str = "") -> "Figure":
    """BRDF as a polar plot: half a disc a principal plane, a shaded disc a wavelength for a
    hemisphere.
    """
    azimuth = np.asarray(result.azimuth)
    in_plane = np.isclose(np.sin(azimuth), 0, atol=1e-6).all()
    return _principal_plane(result, title) if in_plane else _hemisphere(result, title)


def fit_figure(observations, simulated, models) -> "Figure":
    """Measured spectra with the posterior predictive band, and their residuals in standard
    deviations below.

    `observations`: tuples (name, quantity, is_colour, wavelengths, values); `simulated`, `models`:
    draws (draws, data) of each, with and without noise.
    """
    n = len(observations)
    figure = _figure(1.4 + 5.0 * n, 5.2)
    axes = figure.subplots(2, n, squeeze=False, sharex="col", height_ratios=(3, 1))
    for k, (name, quantity, is_colour, grid, values) in enumerate(observations):
        x = np.arange(values.size) if is_colour else grid
        top, below = axes[0, k], axes[1, k]
        # Many points go behind what they would hide.
        many = values.size > 500
        mark = {
            "marker": "o",
            "markersize": 1 if many else 3,
            "linestyle": "none",
            "zorder": 0.5 if many else 2,
        }
        for low, high, alpha in ((2.5, 97.5, 0.2), (16, 84, 0.35)):
            band = np.percentile(simulated[k], [low, high], axis=0)
            label = f"simulated, {'95' if low < 10 else '68'} %"
            if is_colour:
                top.errorbar(
                    x,
                    band.mean(0),
                    np.diff(band, axis=0)[0] / 2,
                    fmt="none",
                    color=PALETTE[0],
                    alpha=alpha * 2,
                    lw=6,
                )
            else:
                top.fill_between(x, *band, color=PALETTE[0], alpha=alpha, linewidth=0, label=label)
        if not is_colour:
            top.plot(
                x,
                np.median(models[k], axis=0),
                color=PALETTE[0],
                linewidth=1,
                label="model, median",
            )
        top.plot(x, values, color=PALETTE[1], label="data", **mark)
        spread = np.std(simulated[k] - models[k], axis=0)
        below.axhspan(-2, 2, color="0.9", linewidth=0)
        below.axhline(0, color="0.5", linewidth=0.8)
        below.plot(
            x,
            (values - np.median(models[k], axis=0)) / np.where(spread > 0, spread, 1),
            color=PALETTE[1],
            **mark,
        )
        widest = max(
            3.0,
            1.1
            * float(
                np.abs(
                    (values - np.median(models[k], axis=0)) / np.where(spread > 0, spread, 1)
                ).max()
            ),
        )
        below.set_ylim(-widest, widest)
        top.set_ylabel(quantity)
        below.set_ylabel("residual (sd)")
        if is_colour:
            below.set_xticks(
                x,
                {"Lab": ("L*", "a*", "b*"), "XYZ": ("X", "Y", "Z")}.get(quantity, ("R", "G", "B")),
            )
        else:
            below.set_xlabel("wavelength (nm)")
            top.legend(frameon=False, fontsize=8)
        top.set_title(name, fontsize=9)
        for ax in (top, below):
            ax.grid(alpha=0.25)
            ax.spines[["top", "right"]].set_visible(False)
    return figure


def corner_figure(samples: Mapping[str, np.ndarray]) -> "Figure":
    """Every pair of parameters: samples by label, each of shape (n,); contours hold 68 and 95 %."""
    from corner import corner

    n = len(samples)
    figure = _figure(1.6 * n + 0.6, 1.6 * n + 0.6)
    figure.set_layout_engine(None)
    corner(
        np.stack(list(samples.values()), axis=1),
        labels=list(samples),
        fig=figure,
        levels=(0.68, 0.95),
        quantiles=(0.16, 0.5, 0.84),
        color=PALETTE[0],
        plot_datapoints=False,
        smooth=0.8,
        max_n_ticks=4,
        label_kwargs={"fontsize": 9},
        range=[0.998] * n,
    )
    return figure


def picture(figure: "Figure", suffix: str) -> bytes:
    """The figure as the bytes of a file; equal figures give equal bytes.

    **Raises:** `ValueError` for a suffix not in `SUFFIXES`.
    """
    check_suffix(f"picture{suffix}")
    from matplotlib import rc_context

    # Left to itself, matplotlib stamps PDF and SVG with the hour and random names.
    undated = {".png": None, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}[suffix.lower()]
    out = io.BytesIO()
    with rc_context({"svg.hashsalt": "irisjax"}):
        figure.savefig(out, format=suffix[1:].lower(), metadata=undated, bbox_inches="tight")
    return out.getvalue()


def swatch(srgb8: tuple[int, int, int], remark: str = "", size: int = 256) -> bytes:
    """PNG of one 8-bit sRGB colour; the remark goes into its description."""
    from matplotlib.image import imsave

    out = io.BytesIO()
    pixels = np.broadcast_to(np.asarray(srgb8, np.uint8), (size, size, 3))
    imsave(out, pixels, format="png", metadata={"Description": remark, "Software": "irisjax"})
    return out.getvalue()


def check_suffix(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> None:
    """Raise `ValueError` unless the name says what kind of picture it is."""
    if Path(path).suffix.lower() not in suffixes:
        raise ValueError(f"{path}: a picture's name must end in {' or '.join(suffixes)}")


def _principal_plane(result: Brdf, title: str) -> "Figure":
    from matplotlib.ticker import MaxNLocator

    figure = _figure(6.4, 3.8)
    ax = _polar(figure, 1, 1, 1)
    forward = np.cos(np.asarray(result.azimuth)) > 0
    angle = np.arccos(np.clip(np.asarray(result.cos_exit), 0, 1)) * np.where(forward, 1, -1)
    order = np.argsort(angle)
    values = np.asarray(result.values)[:, order]
    grid = np.asarray(result.wavelengths)
    shown = _spread(grid.size, _MOST_LINES)
    for i, k in enumerate(shown):
        ax.plot(
            angle[order],
            values[k],
            color=PALETTE[i],
            label=f"{grid[k]:g} nm",
            marker="o" if angle.size == 1 else "",
        )
        if result.standard_error is not None:
            error = np.asarray(result.standard_error)[k, order]
            low = np.maximum(values[k] - error, 0)
            ax.fill_between(
                angle[order], low, values[k] + error, color=PALETTE[i], alpha=0.3, linewidth=0
            )
    top = 1.08 * float(values[shown].max()) or 1.0
    incidence = -np.arccos(np.clip(float(result.cos_incidence), 0, 1))
    # The light comes in on the negative side; its mirror direction is where `values` leave out a
    # delta.
    ax.annotate(
        "",
        (incidence, 0.72 * top),
        (incidence, top),
        arrowprops={"arrowstyle": "-|>", "color": "0.35"},
    )
    ax.plot([-incidence] * 2, [0, top], ":", color="0.35", linewidth=1)
    ax.set_thetamin(-90)
    ax.set_thetamax(90)
    ax.set_thetagrids(np.arange(-90, 91, 30), [f"{a}°" for a in range(-90, 91, 30)])
    ax.set_rlim(0, top)
    # Four rings, labelled below the base line, the power of ten left to the axis label.
    rings = np.asarray(MaxNLocator(4).tick_values(0, top))
    rings = rings[(rings > 0) & (rings <= top)]
    power = int(np.floor(np.log10(top)))
    ax.set_rgrids(list(rings), [f"{ring / 10.0**power:.3g}" for ring in rings], angle=90)
    unit = "1/sr" if power == 0 else f"$10^{{{power}}}$/sr"
    ax.set_xlabel(f"BRDF ({unit}); arrow: light, dotted: mirror direction", labelpad=-42)
    if len(shown) > 1:
        figure.legend(frameon=False, fontsize=8, loc="upper right", bbox_to_anchor=(0.99, 0.86))
    else:
        title = f"{title}, {grid[0]:g} nm"
    # matplotlib leaves room for the lower half of the disc, above and below: move into it.
    ax.set_title(title, fontsize=9, y=0.86)
    return figure


def _hemisphere(result: Brdf, title: str) -> "Figure":
    polar = np.arccos(np.clip(np.asarray(result.cos_exit), 0, 1))
    azimuth = np.asarray(result.azimuth)
    grid, values = np.asarray(result.wavelengths), np.asarray(result.values)
    shown = _spread(grid.size, _MOST_DISCS)
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = _figure(1.2 + 3.6 * columns, 0.9 + 3.4 * rows)
    incidence = np.arccos(np.clip(float(result.cos_incidence), 0, 1))
    axes, shade = [], None
    top = float(values[shown].max())
    for i, k in enumerate(shown):
        ax = _polar(figure, rows, columns, i + 1)
        ax.set_theta_zero_location("E")
        ax.set_theta_direction(1)
        # One cell round each direction, no smoothing over what was not computed.
        a, column = np.unique(np.round(azimuth, 6), return_inverse=True)
        r, row = np.unique(np.round(np.degrees(polar), 6), return_inverse=True)
        field = np.full((r.size, a.size), np.nan)
        field[row, column] = values[k]
        rings = np.concatenate([[0], (r[1:] + r[:-1]) / 2, [90]])
        sectors = np.concatenate([[a[-1] - 2 * np.pi], a, [a[0] + 2 * np.pi]])
        sectors = (sectors[1:] + sectors[:-1]) / 2
        shade = ax.pcolormesh(
            sectors, rings, field, cmap="cividis", vmin=0, vmax=top, rasterized=True
        )
        ax.grid(alpha=0.3)
        ax.plot(
            [np.pi],
            [np.degrees(incidence)],
            "v",
            color=PALETTE[1],
            markeredgecolor="white",
            label="light",
        )
        ax.plot(
            [0], [np.degrees(incidence)], "o", mfc="none", color="white", label="mirror direction"
        )
        ax.set_rlim(0, 90)
        ax.set_rticks([30, 60], ["30°", "60°"])
        ax.tick_params(axis="y", colors="white")
        ax.set_title(f"{grid[k]:g} nm", fontsize=9)
        axes.append(ax)
    assert shade is not None
    figure.colorbar(shade, ax=axes, label="BRDF (1/sr)", shrink=0.8)
    figure.suptitle(f"{title}\nradius: exit angle; ▼ light, ○ mirror direction".strip(), fontsize=9)
    return figure


def _figure(width: float, height: float) -> "Figure":
    # Figure itself and not pyplot: no window system, nothing global to clean up.
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=150, layout="constrained")


def _polar(figure: "Figure", rows: int, columns: int, index: int) -> "PolarAxes":
    ax = figure.add_subplot(rows, columns, index, projection="polar")
    ax.set_theta_zero_location("N")  # pyright: ignore[reportAttributeAccessIssue]  (Axes by its stub)
    ax.set_theta_direction(-1)  # pyright: ignore[reportAttributeAccessIssue]
    return ax  # pyright: ignore[reportReturnType]


def _spread(n: int, most: int) -> list[int]:
    """At most `most` of n places, evenly spread."""
    return sorted({round(i) for i in np.linspace(0, n - 1, min(n, most))})
