"""What a crossed polariser leaves of an iris's light, how polarised that light is itself, and how
ILIT, scalar and polarised radiative transfer differ.
"""

from paper_figs.common import curves, plt, read, save

rows = read("polarised_spectra.csv")
figure, axes = plt.subplots(figsize=(6.0, 3.8))
for i, (level, c) in enumerate(curves(rows, "level").items()):
    for fraction, style in ((0.2, ":"), (0.5, "-"), (0.8, "--")):
        of = c["abl_fraction"] == fraction
        axes.plot(
            c["wavelength_nm"][of], 100 * c["crossed_share_normal"][of], style, color=f"C{i}",
            label=f"{level} pigmentation" if fraction == 0.5 else None,
        )  # fmt: skip
axes.set(
    xlabel="wavelength (nm)",
    ylabel="share that passes the crossed analyser (%)",
    ylim=(0, None),
    title="Radiative transfer, to and fro along the normal (simulated)",
)
axes.legend(title="melanin in the ABL: 20 % dotted, 50 % solid, 80 % dashed", title_fontsize=7,
            loc="upper right")  # fmt: skip
save(figure, "polarisation_crossed")

figure, axes = plt.subplots(1, 3, figsize=(9.0, 3.2), sharey=True)
levels = curves(read("polarised_angles.csv"), "level")
for ax, (level, of_level) in zip(axes, levels.items(), strict=True):
    for i, nm in enumerate((450.0, 550.0, 650.0)):
        of = of_level["wavelength_nm"] == nm
        ax.plot(
            of_level["exit_deg"][of],
            100 * of_level["degree_of_linear_polarisation"][of],
            ("-", "--", ":")[i],
            color=("C0", "C2", "C1")[i],
            label=f"{nm:.0f} nm",
        )
    ax.set(
        xlabel="exit angle (degrees)", title=f"{level} pigmentation", xlim=(0, 85), ylim=(0, None)
    )
axes[0].set(ylabel="degree of linear polarisation (%)")
axes[0].legend()
figure.suptitle("Radiative transfer, unpolarised light along the normal (simulated)", fontsize=9)
figure.tight_layout()
save(figure, "polarisation_angles")

figure, axes = plt.subplots(
    3, 3, figsize=(9.0, 7.0), sharex=True, sharey="row", height_ratios=(2, 1.3, 1.3),
    layout="constrained",
)  # fmt: skip
drawn = {
    "reflectance_ilit": ("C1", "-", "ILIT"),
    "reflectance_scalar": ("C0", "-", "radiative transfer (RT)"),
    "reflectance_polarised": ("k", ":", "polarised RT"),
}
for column, (level, c) in zip(axes.T, curves(read("three_processes.csv"), "level").items(),
                              strict=True):  # fmt: skip
    nm, scalar = c["wavelength_nm"], c["reflectance_scalar"]
    for name, (colour, style, label) in drawn.items():
        column[0].plot(nm, 100 * c[name], style, color=colour, label=label)
    column[1].plot(nm, c["reflectance_ilit"] / scalar, color="C1")
    column[2].plot(nm, 100 * (c["reflectance_polarised"] / scalar - 1), ":", color="k")
    for ax in column[1:]:
        ax.axhline(float(ax is column[1]), color="C0")
    column[0].set(title=f"{level} pigmentation", yscale="log")
    column[0].yaxis.set_major_formatter("{x:g}")
    column[2].set(xlabel="wavelength (nm)", xlim=(400, 700))
figure.get_layout_engine().set(wspace=0.05)
axes[0, 0].set_yticks((0.5, 1, 2, 5))
axes[0, 0].minorticks_off()
axes[0, 0].set(ylabel="reflectance (%)")
axes[1, 0].set(ylabel="ILIT over RT (ratio)", ylim=(0.9, None))
axes[2, 0].set(ylabel="polarised RT above RT (%)", ylim=(-0.05, None))
axes[0, 2].legend()
figure.suptitle(
    "Light along the normal, half of the melanin in the ABL, first surface counted (simulated)",
    fontsize=9,
)
save(figure, "three_processes")
