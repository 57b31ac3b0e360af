"""The sliders of the viewer's page, by folder."""

SLIDERS: dict[str, dict[str, tuple[str, float, float, float, str]]] = {
    "Iris": {
        "eumelanin": ("eumelanin", 0, 4, 0.005, "mg/ml over the whole iris"),
        "pheomelanin": ("pheomelanin", 0, 2, 0.005, "mg/ml over the whole iris"),
        "abl_fraction": (
            "ABL fraction",
            0,
            1,
            0.005,
            "share of the melanin in the anterior border layer",
        ),
        "stroma": (
            "stroma",
            0.3,
            2,
            0.01,
            "thickness relative to the preset's, at equal concentrations",
        ),
        "hemoglobin": ("blood", 0, 1, 0.002, "haemoglobin in the stroma, mmol/l"),
        "saturation": ("oxygen", 0, 1, 0.01, "saturation of the haemoglobin"),
        "pupil_radius": ("pupil", 0.5, 4.5, 0.05, "radius, mm"),
    },
    "Light": {
        "light_polar": ("lamp angle", 0, 90, 1, "degrees from the eye's axis"),
        "light_azimuth": ("lamp azimuth", -180, 180, 1, "degrees from the right over the top"),
        "irradiance": ("lamp power", 0, 10, 0.05, "irradiance; π lights a white sheet white"),
        "strength": ("surround ×", 0, 3, 0.05, "factor on the environment"),
        "exposure": ("exposure ×", 0.25, 4, 0.05, "factor on the picture"),
    },
}
"""By name of the setting: label, lowest and highest value, step, hint."""
