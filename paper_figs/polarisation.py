"""What a crossed polariser leaves of an iris's light, and how polarised that light is itself."""

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
