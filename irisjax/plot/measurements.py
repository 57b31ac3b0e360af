"""Figures of spectra and of BRDFs: a principal plane, or the hemisphere."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from irisjax.plot.pictures import PALETTE, bare_axes, figure_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from irisjax.measure.measurement import Reading
    from irisjax.measure.photometers import Brdf

_LINES = ("-", "--", "-.", ":")
_MOST_LINES, _MOST_DISCS = 8, 6


def spectra_figure(measurements: "Mapping[str, Reading]", title: str = "") -> "Figure":
    """Draw spectra by name, with a band of one standard error where they are sampled."""
    figure = figure_of(6.4, 4.0)
    ax = figure.add_subplot()
    first = next(iter(measurements.values()))
    for i, (name, m) in enumerate(measurements.items()):
        x, y = np.asarray(m.wavelengths), np.asarray(m.values)
        colour = PALETTE[i % len(PALETTE)]
        line = _LINES[i // len(PALETTE) % len(_LINES)]
        ax.plot(x, y, line, color=colour, label=name, marker="o" if x.size == 1 else "")
        if m.standard_error is not None:
            error = np.asarray(m.standard_error)
            ax.fill_between(x, y - error, y + error, color=colour, alpha=0.3, linewidth=0)
            if x.size == 1:
                ax.errorbar(x, y, error, color=colour, capsize=3)
    label = f"{first.quantity} ({first.unit})" if first.unit else first.quantity
    if any(m.standard_error is not None for m in measurements.values()):
        label += ", band: ± 1 standard error"
    ax.set(xlabel="wavelength (nm)", ylabel=label)
    ax.set_ylim(bottom=0)
    if first.wavelengths.size > 1:
        ax.margins(x=0)
    if len(measurements) > 1:
        ax.legend(frameon=False)
    ax.set_title(title, fontsize=9)
    bare_axes(ax)
    return figure


def brdf_figure(result: "Brdf", title: str = "") -> "Figure":
    """Draw a BRDF as polar plots: half a disc for a principal plane, or a shaded disc for each
    wavelength of a hemisphere.
    """
    azimuth = np.asarray(result.azimuth)
    in_plane = np.isclose(np.sin(azimuth), 0, atol=1e-6).all()
    return _principal_plane(result, title) if in_plane else _hemisphere(result, title)


def _principal_plane(result: "Brdf", title: str) -> "Figure":
    from matplotlib.ticker import MaxNLocator

    figure = figure_of(6.4, 3.8)
    ax: Any = figure.add_subplot(projection="polar")
    ax.set_theta_zero_location("N")
    ax.set_theta_direction(-1)
    forward = np.cos(np.asarray(result.azimuth)) > 0
    angle = np.arccos(np.clip(np.asarray(result.cos_exit), 0, 1)) * np.where(forward, 1, -1)
    order = np.argsort(angle)
    values = np.asarray(result.values)[:, order]
    grid = np.asarray(result.wavelengths)
    shown = _spread(grid.size, _MOST_LINES)
    for i, k in enumerate(shown):
        mark, colour = "o" if angle.size == 1 else "", PALETTE[i]
        ax.plot(angle[order], values[k], color=colour, label=f"{grid[k]:g} nm", marker=mark)
        if result.standard_error is not None:
            error = np.asarray(result.standard_error)[k, order]
            band = np.maximum(values[k] - error, 0), values[k] + error
            ax.fill_between(angle[order], *band, color=colour, alpha=0.3, linewidth=0)
    top = 1.08 * float(values[shown].max()) or 1.0
    incidence = -np.arccos(np.clip(float(result.cos_incidence), 0, 1))
    # The light comes in on the negative side; its mirror direction is where `values` leave out a
    # delta.
    arrow = {"arrowstyle": "-|>", "color": "0.35"}
    ax.annotate("", (incidence, 0.72 * top), (incidence, top), arrowprops=arrow)
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


def _hemisphere(result: "Brdf", title: str) -> "Figure":
    polar = np.arccos(np.clip(np.asarray(result.cos_exit), 0, 1))
    azimuth = np.asarray(result.azimuth)
    grid, values = np.asarray(result.wavelengths), np.asarray(result.values)
    shown = _spread(grid.size, _MOST_DISCS)
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = figure_of(1.2 + 3.6 * columns, 0.9 + 3.4 * rows)
    light = [np.degrees(np.arccos(np.clip(float(result.cos_incidence), 0, 1)))]
    axes, shade = [], None
    top = float(values[shown].max())
    # One cell round each direction, no smoothing over what was not computed.
    a, column = np.unique(np.round(azimuth, 6), return_inverse=True)
    r, row = np.unique(np.round(np.degrees(polar), 6), return_inverse=True)
    rings = np.concatenate([[0], (r[1:] + r[:-1]) / 2, [90]])
    sectors = np.concatenate([[a[-1] - 2 * np.pi], a, [a[0] + 2 * np.pi]])
    sectors = (sectors[1:] + sectors[:-1]) / 2
    for i, k in enumerate(shown):
        ax: Any = figure.add_subplot(rows, columns, i + 1, projection="polar")
        field = np.full((r.size, a.size), np.nan)
        field[row, column] = values[k]
        shade = ax.pcolormesh(
            sectors, rings, field, cmap="cividis", vmin=0, vmax=top, rasterized=True
        )
        ax.grid(alpha=0.3)
        ax.plot([np.pi], light, "v", color=PALETTE[1], markeredgecolor="white", label="light")
        ax.plot([0], light, "o", mfc="none", color="white", label="mirror direction")
        ax.set_rlim(0, 90)
        ax.set_rticks([30, 60], ["30°", "60°"])
        ax.tick_params(axis="y", colors="white")
        ax.set_title(f"{grid[k]:g} nm", fontsize=9)
        axes.append(ax)
    assert shade is not None
    figure.colorbar(shade, ax=axes, label="BRDF (1/sr)", shrink=0.8)
    figure.suptitle(f"{title}\nradius: exit angle; ▼ light, ○ mirror direction".strip(), fontsize=9)
    return figure


def _spread(n: int, most: int) -> list[int]:
    """At most `most` of n places, evenly spread."""
    return sorted({round(i) for i in np.linspace(0, n - 1, min(n, most))})
