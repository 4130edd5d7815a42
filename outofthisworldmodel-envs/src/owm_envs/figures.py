"""What our figures share: colours, the hull's silhouette, files written whole. Needs matplotlib (the extra `plot`)."""

import os

import numpy as np
from jaxtyping import Float

from owm_envs.files import write_atomically
from owm_envs.words import install

try:
    from matplotlib.axes import Axes
    from matplotlib.collections import PatchCollection
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle
except ImportError as error:
    raise ImportError(f"figures need matplotlib ({error}): {install('plot')}") from error

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#444444", "#8A6FBF")
"""Colours that the colour-blind can tell apart."""
INK, FAINT = "#2b2f36", "#9aa3b0"
AXES = ("x, port side [m]", "y, aft [m]", "z, zenith [m]")


def save_figure(figure: Figure, path: str | os.PathLike, dpi: int = 130) -> None:
    """Write a PNG atomically."""
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=dpi))


def silhouette(axes: Axes, boxes: Float[np.ndarray, "N 2 3"], i: int, j: int, sign: int, **look: float) -> None:
    """Draw keep-out boxes.

    Args:
        boxes: lower and upper corners, m.
        i, j: axes of the station frame that go right and up.
        sign: 1 if the third one points at the viewer, -1 if away.
        look: alpha and zorder.
    """
    # Far boxes first, so that what is near hides them.
    boxes = boxes[np.argsort(sign * boxes.mean(axis=1)[:, 3 - i - j])]
    patches = [Rectangle((b[0, i], b[0, j]), b[1, i] - b[0, i], b[1, j] - b[0, j]) for b in boxes]
    axes.add_collection(PatchCollection(patches, facecolor="#d5dae2", edgecolor="#8c95a3", linewidth=0.3, **look))


def tidy(axes: Axes) -> None:
    """Leave out what tells nothing."""
    axes.grid(color="#e7eaef", lw=0.6, zorder=0)
    axes.set_axisbelow(True)
    axes.tick_params(which="both", labelsize=8, colors=INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
