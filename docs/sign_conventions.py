"""Draws the axes and angles of scenes: `python docs/sign_conventions.py`."""

from pathlib import Path

import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Arc, Circle

from irisjax.anatomy.eye import Cornea, Eye

TARGET = Path(__file__).parent / "how-to" / "sign_conventions.png"
POLAR, AZIMUTH = np.radians([35.0, 120.0])
LAMP, AXIS, EYE, CAMERA = "#d55e00", "#555555", "#0072b2", "#009e73"


def arrow(ax, start, end, colour, words="", shift=(0.0, 0.0), **style):
    """An arrow with words at its head."""
    ax.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": colour, **style})
    ax.text(end[0] + shift[0], end[1] + shift[1], words, color=colour, ha="center", va="center")


def front(ax, eye: Eye):
    """What the viewer and the camera see."""
    pupil, root = float(eye.pupil_radius), float(eye.iris_radius)
    ax.add_patch(Circle((0, 0), root, facecolor="#9db8c4", edgecolor=EYE))
    ax.add_patch(Circle((0, 0), pupil, facecolor="black"))
    arrow(ax, (0, 0), (9.5, 0), AXIS, "+x", (0.7, 0))
    arrow(ax, (0, 0), (0, 9.5), AXIS, "+y", (0, 0.7))
    lamp = 8.5 * np.array([np.cos(AZIMUTH), np.sin(AZIMUTH)])
    arrow(ax, (0, 0), tuple(lamp), LAMP, "lamp\n35, 120", (-1.3, 0.4))
    ax.add_patch(Arc((0, 0), 7.4, 7.4, theta1=0, theta2=120, color=LAMP))
    ax.text(5.2, 4.4, "azimuth", color=LAMP)
    ax.text(0, -7.2, "+z points away from you, into the eye", color=AXIS, ha="center")
    ax.set_title("As the viewer sees it")
    ax.set_xlim(-10, 11)


def side(ax, eye: Eye):
    """From the side, for a lamp in the plane of the drawing."""
    depth, root = float(eye.iris_depth), float(eye.iris_radius)
    pupil = float(eye.pupil_radius)
    cornea = eye.cornea
    assert isinstance(cornea, Cornea)
    y = jnp.linspace(-root, root, 200)
    ax.plot(np.asarray(cornea.anterior.sagitta(jnp.abs(y))), y, color=EYE)
    for sign in (1, -1):
        ax.plot([depth, depth], [sign * pupil, sign * root], color=EYE, lw=4)
    ax.plot(0, 0, "o", color=AXIS, ms=4)
    ax.text(-0.4, -1.3, "front of the\ncornea, z = 0", color=AXIS, ha="right", va="center")
    ax.text(4.3, -3.8, "iris\nz = 3.6 mm", color=EYE, va="center")
    arrow(ax, (-12, 0), (9, 0), AXIS, "+z", (0.8, 0))
    arrow(ax, (0, 0), (0, 9.5), AXIS, "+y", (0, 0.7))
    lamp = 11 * np.array([-np.cos(POLAR), np.sin(POLAR)])
    arrow(ax, (0, 0), tuple(lamp), LAMP, "lamp", (-0.6, 0.8))
    ax.add_patch(Arc((0, 0), 13, 13, theta1=180 - 35, theta2=180, color=LAMP))
    ax.text(-7.1, 1.9, "polar angle", color=LAMP, ha="right")
    ax.plot(-12, 0, "s", color=CAMERA, ms=11)
    ax.text(-12, -1.5, "camera at\npolar 0", color=CAMERA, ha="center", va="top")
    ax.text(-6, -5.0, "z is negative before the eye", color=AXIS, ha="center")
    ax.set_title("From the side")
    ax.set_xlim(-14, 11)


def main():
    """Write the picture."""
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
    for ax, draw in zip(axes, (front, side), strict=True):
        draw(ax, Eye())
        ax.set_ylim(-8, 11)
        ax.set_aspect("equal")
        ax.axis("off")
    figure.savefig(TARGET, dpi=90)


if __name__ == "__main__":
    main()
