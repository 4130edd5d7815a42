"""Pictures of how safe flights are: what safety costs, where coasts clear the hull, and where no way out is left."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure

from owm.report.plots import VIEWS
from owm.scores.coasting import COAST, FAR, Coasts
from owm_envs.figures import AXES, FAINT, INK, PALETTE, silhouette, tidy
from owm_envs.station import hull_boxes

RANGES = (0.0, 3.0, 10.0, 20.0, 40.0, 80.0, np.inf)
"""m of clearance, between which instants are counted."""
_DRAWN = (VIEWS[0], VIEWS[2])


def front_figure(rows: Mapping[str, Mapping[str, float]]) -> Figure:
    """Share of far coasts that clear the hull against median time and against median delta-v, a point a policy.

    Args:
        rows: of each policy: `far` and `contact`, shares; `time`, s; `delta_v`, m/s.
    """
    figure = Figure(figsize=(11, 4.6), layout="constrained", facecolor="white")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (name, label) in zip(panels, (("time", "median time, s"), ("delta_v", "median delta-v, m/s"))):
        for color, (policy, row) in zip(PALETTE, rows.items()):
            full = row["contact"] > 0.99
            face = color if full else "white"
            axes.scatter(row[name], 100 * row["far"], s=90, facecolor=face, edgecolor=color, lw=1.8, label=policy)
        axes.axhline(99, color=FAINT, lw=1, zorder=0)
        axes.set(xlabel=label)
        tidy(axes)
    panels[1].legend(loc=(0.03, 0.5), frameon=False, fontsize=9)
    panels[0].set(ylabel=f"coasts of {COAST:.0f} s beyond {FAR:.0f} m that clear the hull, %", ylim=(50, 102))
    panels[0].set_title("filled: contact as the docking standard asks", loc="left", fontsize=10, color=INK)
    return figure


def coast_figure(flown: Mapping[str, Coasts]) -> Figure:
    """Share of instants whose coast clears the hull, by clearance; and where one is lost.

    Lost are far instants whose coast does not clear, and nearer ones from which no small impulse leads away.
    """
    figure = Figure(figsize=(14, 4.8), layout="constrained", facecolor="white")
    shares, *views = figure.subplots(1, 3, width_ratios=(1, 1.2, 1.2))
    names = [f"{low:g}-{high:g}" if np.isfinite(high) else f"{low:g}+" for low, high in pairwise(RANGES)]
    for axes, (name, i, j, sign) in zip(views, _DRAWN):
        silhouette(axes, hull_boxes(), i, j, sign)
        axes.set(xlabel=AXES[i], ylabel=AXES[j], xlim=(-110, 110), ylim=(-90, 90))
        axes.set_aspect("equal")
        axes.set_title(f"where a way out is missing, {name}", loc="left", fontsize=10, color=INK)
        tidy(axes)
    for color, (policy, coasts) in zip(PALETTE, flown.items()):
        shares.plot(names, _by_range(coasts), "o-", color=color, label=policy)
        lost = coasts.states[np.where(coasts.far, ~coasts.clear, ~coasts.avoidable)]
        for axes, (_, i, j, _) in zip(views, _DRAWN):
            axes.scatter(lost[:, i], lost[:, j], s=5, color=color, lw=0, alpha=0.7)
    shares.set(xlabel="clearance of the hull, m", ylabel=f"coasts of {COAST:.0f} s that clear it, %", ylim=(0, 102))
    shares.legend(frameon=False, fontsize=9)
    tidy(shares)
    return figure


def _by_range(coasts: Coasts) -> Sequence[float]:
    """Percent that clear between each two of `RANGES`, NaN where there are no instants."""
    within = np.digitize(coasts.gap, RANGES[1:-1])
    return [100 * coasts.clear[within == i].mean() if (within == i).any() else np.nan for i in range(len(RANGES) - 1)]
