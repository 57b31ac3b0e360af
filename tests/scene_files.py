"""Scene files that tests share."""

BARE = """
[iris]
level = "low"
eumelanin = 0.05

[maps]
uniform = true

[eye]
cornea = "none"

[camera]
size = [8, 6]

[[light]]
polar_deg = 30
azimuth_deg = 10

[[light]]
position = [10, 20, -40]
irradiance = 1.5
"""
