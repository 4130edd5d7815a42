"""How a training went: losses and validation errors against steps and time, beside models that need none."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from owm_envs.figures import FAINT, INK, PALETTE, tidy

LOSSES = {"flow_loss": "flow", "decode_loss": "decode", "round_trip_loss": "round trip (not trained)"}
ERRORS = {
    "score": "validation score",
    "position_m": "position [m]",
    "velocity_mps": "velocity [m/s]",
    "attitude_deg": "attitude [deg]",
    "rate_degps": "body rate [deg/s]",
}


def learning_figure(
    lines: Sequence[Mapping[str, float]], bars: Mapping[str, Mapping[str, float]], horizon: str = "16 s ahead"
) -> Figure:
    """Draw losses, and validation errors with a level line for each model that is not trained.

    Args:
        lines: in the order of training, each with `step` and `seconds`, and what of `LOSSES` and `ERRORS` it has.
        bars: the `ERRORS` of other models by their names.
        horizon: at which the errors are taken.
    """
    figure = Figure(figsize=(14, 7), layout="constrained", facecolor="white")
    panels = figure.subplots(2, 3).ravel()
    steps, minutes = (np.asarray([line[name] for line in lines], float) for name in ("step", "seconds"))
    minutes = minutes / 60.0
    for number, (name, label) in enumerate(LOSSES.items()):
        _line(panels[0], lines, name, PALETTE[number], label)
    panels[0].set_title("training loss", loc="left", fontsize=10, color=INK)
    panels[0].legend(fontsize=8, frameon=False)
    for axes, (name, label) in zip(panels[1:], ERRORS.items()):
        _line(axes, lines, name, PALETTE[0], "in training")
        for (other, errors), style in zip(bars.items(), ("--", ":", "-.")):
            axes.axhline(errors[name], color=INK, lw=1.2, ls=style, label=other)
        title = label if name == "score" else f"{label}, {horizon}"
        axes.set_title(title, loc="left", fontsize=10, color=INK)
    panels[1].legend(fontsize=8, frameon=False)
    for axes in panels:
        axes.set(yscale="log", xlabel="optimisation step", xlim=(0, steps[-1]))
        tidy(axes)
    for axes in panels[:3]:
        top = axes.secondary_xaxis(
            "top", functions=(lambda x: np.interp(x, steps, minutes), lambda x: np.interp(x, minutes, steps))
        )
        whole = np.arange(0.0, minutes[-1], max(1, round(minutes[-1] / 5)))
        top.set_xticks(whole, [f"{minute:g}" for minute in whole])
        top.set_xlabel("minutes", fontsize=8, color=INK)
        top.tick_params(labelsize=8, colors=INK)
        top.spines["top"].set_color(FAINT)
    return figure


def _line(axes, lines: Sequence[Mapping[str, float]], name: str, color: str, label: str) -> None:
    points = [(line["step"], line[name]) for line in lines if name in line]
    axes.plot(*zip(*points), "o-", ms=3, lw=1.4, color=color, label=label)
