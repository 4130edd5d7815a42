"""Draw the pages' station and frames: `python docs/images/make.py`. `tools/gallery.py` of owm_envs draws the others."""

from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle

from astrojax.attitude import quat_rotate
from owm_envs.camera.schematic import draw_station
from owm_envs.camera.views import camera
from owm_envs.station import CHASER, PORTS, bounds, goal_poses, hull_boxes, port_index

HERE = Path(__file__).parent
RADIUS = 2.25
"""m, of the chaser's bounding sphere."""
INK, STATION, CHASER_INK, BODY, MUTED = "#1c2430", "#c9d1dc", "#e8b04a", "#b4561f", "#5b6778"
AXES = "#1f6fd1"


def station() -> None:
    """The parts, the boxes and the ports."""
    picture = draw_station(camera("station_isometric", width=1120, height=700, samples=2), boxes=hull_boxes())
    cv2.imwrite(str(HERE / "station.png"), picture[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


def frames() -> None:
    """Station frame, body frame and hold pose, seen from the port side: y to the right, z up, x to the viewer."""
    figure, (whole, near) = plt.subplots(1, 2, figsize=(11, 5.2), width_ratios=(1.15, 1), layout="constrained")
    port = PORTS[port_index("zvezda_aft")]
    goal = goal_poses()[port_index("zvezda_aft")]
    hold = goal[1:3]
    for axes in (whole, near):
        _boxes(axes)
        axes.set_aspect("equal")
        axes.set(xlabel="y, aft [m]", ylabel="z, zenith [m]")

    whole.set(xlim=(-55, 65), ylim=(-46, 50), title="Station frame, seen from the port side")
    _triad(
        whole,
        (0, 0),
        {"y  aft": (46, 0), "z  zenith": (0, 34)},
        "x  orbit normal,\n    to the viewer",
        AXES,
        below=(4, -44),
    )
    _arrow(whole, (-22, 34), (-46, 34), MUTED)
    whole.text(-46, 36, "flight direction (-y)", color=MUTED)
    _arrow(whole, (-40, -26), (-40, -39), MUTED)
    whole.text(-38, -38, "Earth (-z)", color=MUTED)
    whole.add_patch(Circle(hold, RADIUS, color=CHASER_INK))
    whole.text(hold[0], hold[1] - 4, "chaser at the hold\npose of Zvezda aft", color=BODY, ha="center", va="top")

    near.set(xlim=(29, 44.5), ylim=(-10.3, 4.9), title="Hold pose at Zvezda aft")
    for part in CHASER:
        (x0, y0, z0), (x1, y1, z1) = bounds(part)
        corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (z0, z1)])
        turned = np.asarray([quat_rotate(goal[3:], corner) for corner in corners])[:, 1:] + hold
        low, high = turned.min(0), turned.max(0)
        near.add_patch(Rectangle(low, *(high - low), facecolor="#f3dcae", edgecolor="none"))
    near.add_patch(Circle(hold, RADIUS, fill=False, edgecolor=CHASER_INK, linestyle="--", linewidth=1.4))
    body = np.asarray([quat_rotate(goal[3:], axis) for axis in np.eye(3)])
    assert body[0, 0] < -0.99, "the picture says that body +x points away from the viewer"
    arms = {"+z  nose": 3.4 * body[2, 1:], "+y  up of the camera": 3.4 * body[1, 1:]}
    _triad(near, hold, arms, "+x  away from\n      the viewer", BODY, cross=True)
    near.plot(*port.interface[1:], "o", color=AXES)
    near.annotate(
        "port: mating plane", port.interface[1:], (29.4, 0.9), color=AXES, arrowprops={"arrowstyle": "-", "color": AXES}
    )
    _measure(near, port.interface[1], hold[0], -8.9, f"stand-off {port.standoff:.2f} m")
    _measure(near, port.interface[1], hold[0] - RADIUS, 2.3, f"clearance {port.standoff - RADIUS:.2f} m")
    _measure(near, hold[0], hold[0] + RADIUS, 2.3, f"sphere {RADIUS} m")
    figure.savefig(HERE / "frames.png", dpi=110, pil_kwargs={"optimize": True})


def _boxes(axes: Axes) -> None:
    """The hull's boxes from the side."""
    for lower, upper in hull_boxes()[:, :, 1:]:
        axes.add_patch(Rectangle(lower, *(upper - lower), facecolor=STATION, edgecolor="#a3aebd", linewidth=0.4))


def _arrow(axes: Axes, start, end, color: str) -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.8})


def _triad(axes: Axes, origin, arms: dict, third: str, color: str, cross: bool = False, below=(9, -9)) -> None:
    """Two axes in the plane of the page, and a third across it: a dot towards the viewer, a cross away."""
    origin = np.asarray(origin, float)
    for name, arm in arms.items():
        arm = np.asarray(arm, float)
        _arrow(axes, origin, origin + arm, color)
        sideways = abs(arm[0]) > abs(arm[1])
        where = origin + (0.8 if sideways else 1) * arm
        up = "bottom" if sideways or arm[1] > 0 else "top"
        axes.annotate(name, where, (0, 4 if up == "bottom" else -4), textcoords="offset points",
                      color=color, ha="center", va=up, fontweight="bold")  # fmt: skip
    axes.plot(*origin, "o", markersize=11, color="white", markeredgecolor=color, markeredgewidth=1.6)
    axes.plot(*origin, "x" if cross else ".", markersize=6, color=color)
    axes.annotate(third, origin, below, textcoords="offset points", color=color, va="top", fontweight="bold")


def _measure(axes: Axes, start: float, end: float, height: float, text: str) -> None:
    """A length along y."""
    style = {"arrowstyle": "<->", "color": INK, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end, height), (start, height), arrowprops=style)
    axes.text((start + end) / 2, height + 0.2, text, color=INK, ha="center", va="bottom", fontsize=9)


if __name__ == "__main__":
    frames()
    station()
