"""Pictures of flights, scores and predictions, drawn without a display."""

import os
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from owm.scores.calibration import Calibration
from owm.scores.flights import TOLERANCES, Flights, speed_by_range, succeeded
from owm.scores.prediction import PredictionError
from owm.scores.statistics import rate
from owm_envs.files import write_atomically
from owm_envs.station import HELD_OUT_PORTS, PORT_NAMES, PORTS, TRAIN_PORTS, goal_poses, hull_boxes

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#444444", "#8A6FBF")
"""Colours that the colour-blind can tell apart."""
ENDS = {
    "docked": "#009E73",
    "within 1 m": "#56B4E9",
    "missed": "#E69F00",
    "collided": "#D55E00",
}
"""What became of a flight, worst last, and its colour."""
_INK, _FAINT = "#2b2f36", "#9aa3b0"
_VIEWS = (("seen from port side", 1, 2, 1), ("seen from ahead", 0, 2, -1), ("seen from below", 1, 0, -1))
"""Name, horizontal and vertical axis, and whether the third axis points at (1) or away from the viewer."""
_AXES = ("x, port side [m]", "y, aft [m]", "z, zenith [m]")


def end_of(flights: Flights) -> np.ndarray:
    """A key of `ENDS` for each flight."""
    ends = np.where(succeeded(flights, 1.0), "within 1 m", "missed").astype(object)
    ends[(flights.outcome == "docked") & ~flights.collided] = "docked"
    ends[flights.collided] = "collided"
    return ends


def hull_distance(positions: Float[np.ndarray, "... 3"], radius: float = 0.0) -> Float[np.ndarray, "..."]:
    """Distance of a sphere's surface to the nearest hull box, m; NaN stays NaN."""
    least = np.full(positions.shape[:-1], np.inf)
    for low, high in hull_boxes():
        gap = np.maximum(np.maximum(low - positions, positions - high), 0)
        least = np.fmin(least, np.sqrt(np.sum(gap * gap, axis=-1)))
    return np.where(np.isnan(positions[..., 0]), np.nan, least - radius)


def save_figure(figure: Figure, path: str | os.PathLike, dpi: int = 130) -> None:
    """Write a PNG atomically."""
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=dpi))


def trajectory_figure(flights: Flights, title: str | None = None, radius: float = 2.25) -> Figure:
    """Three orthogonal views of the flights around the hull, and range, speed and clearance against time.

    Args:
        flights: with trajectories.
        title: what to write on top; policy and ports when None.
        radius: of the chaser's bounding sphere, m.
    """
    if flights.trajectory is None:
        raise ValueError("these flights were recorded without trajectories")
    ports = sorted(set(flights.port.tolist()))
    title = title or f"{flights.policy}: {', '.join(PORT_NAMES[p] for p in ports) if len(ports) < 4 else 'all ports'}"
    ends, single = end_of(flights), len(flights) == 1
    room = hull_distance(flights.trajectory[..., :3], radius)
    figure = Figure(figsize=(14, 8.4), layout="constrained", facecolor="white")
    figure.suptitle(title, fontsize=14, fontweight="bold", color=_INK)
    grid = figure.add_gridspec(2, 3, height_ratios=(1.45, 1))
    low, high = _limits(flights)
    for column, (name, i, j, sign) in enumerate(_VIEWS):
        axes = figure.add_subplot(grid[0, column])
        _station(axes, i, j, sign)
        for port in ports:
            _corridor(axes, port, i, j, label=len(ports) <= 2)
        for n, track in enumerate(flights.trajectory):
            _track(axes, track, room[n], i, j, ENDS[ends[n]], single)
        axes.set(xlim=(low[i], high[i]), ylim=(low[j], high[j]), xlabel=_AXES[i], ylabel=_AXES[j])
        axes.set_aspect("equal")
        axes.set_title(name, loc="left", fontsize=10, color=_INK)
        _tidy(axes)
    _histories(figure, [grid[1, column] for column in range(3)], flights, ends, room)
    return figure


def _limits(flights: Flights):
    station = np.array([[-54.0, -34, -34], [54.0, 36, 39]])
    points = np.concatenate([flights.trajectory[..., :3].reshape(-1, 3), station])
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    if len(flights) > 1:
        # Many flights are drawn for how they end: the first half of the way may leave the picture.
        low, high = np.maximum(low, -110), np.minimum(high, 110)
    # One scale for the three views: equal spans about each axis's middle.
    half, middle = 0.53 * (high - low).max(), 0.5 * (low + high)
    return middle - half, middle + half


def _station(axes: Axes, i: int, j: int, sign: int) -> None:
    boxes = hull_boxes()
    # Far boxes first, so that what is near hides them.
    boxes = boxes[np.argsort(sign * boxes.mean(axis=1)[:, 3 - i - j])]
    patches = [Rectangle((b[0, i], b[0, j]), b[1, i] - b[0, i], b[1, j] - b[0, j]) for b in boxes]
    axes.add_collection(PatchCollection(patches, facecolor="#d5dae2", edgecolor="#aab2be", linewidth=0.3, zorder=1))


def _corridor(axes: Axes, port: int, i: int, j: int, label: bool) -> None:
    normal, interface = np.array(PORTS[port].normal), np.array(PORTS[port].interface)
    goal = goal_poses()[port, :3]
    if abs(normal[i]) + abs(normal[j]) > 0.5:
        side = np.zeros(3)
        side[i if abs(normal[j]) > 0.5 else j] = 1
        reach = 30.0
        corners = [
            interface,
            *(interface + reach * (normal + s * np.tan(np.radians(10)) * side) for s in (1, -1)),
        ]
        cone = Polygon([(c[i], c[j]) for c in corners], closed=True, color="#0072B2", alpha=0.12, lw=0, zorder=2)
        axes.add_patch(cone)
    axes.plot(goal[i], goal[j], "+", color="#0072B2", ms=9, mew=1.6, zorder=5)
    if label:
        axes.annotate(
            PORT_NAMES[port],
            (goal[i], goal[j]),
            (7, 7),
            textcoords="offset points",
            fontsize=8,
            color="#0072B2",
        )


def _track(axes: Axes, track: Float[np.ndarray, "T 13"], room, i: int, j: int, color: str, single: bool) -> None:
    flown = ~np.isnan(track[:, 0])
    track, room = track[flown], room[flown]
    size = 5 if single else 3
    axes.plot(track[:, i], track[:, j], color=color, lw=1.6 if single else 0.9, alpha=0.95, zorder=3)
    axes.plot(track[0, i], track[0, j], "o", color=color, ms=size, mfc="white", zorder=4)
    axes.plot(track[-1, i], track[-1, j], "o", color=color, ms=size, zorder=4)
    if (room <= 0).any():
        first = np.argmax(room <= 0)
        axes.plot(track[first, i], track[first, j], "x", color="#a01818", ms=size + 3, mew=1.8, zorder=6)
    if single:
        some = track[:: max(1, len(track) // 14)]
        nose = _nose(some[:, 6:10])
        axes.quiver(
            some[:, i],
            some[:, j],
            nose[:, i],
            nose[:, j],
            color=_INK,
            width=0.003,
            scale=22,
            headwidth=4,
            zorder=4,
            label="nose",
        )


def _nose(q: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 3"]:
    """Body +z in the station frame."""
    w, x, y, z = q.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _histories(figure: Figure, places, flights: Flights, ends, room) -> None:
    time = np.arange(flights.trajectory.shape[1]) * flights.decision_dt
    goals = goal_poses()[flights.port, :3]
    distance = np.linalg.norm(flights.trajectory[..., :3] - goals[:, None], axis=-1)
    speed = np.linalg.norm(flights.trajectory[..., 3:6], axis=-1)
    names = ("range to goal [m]", "speed [m/s]", "hull clearance of the bounding sphere [m]")
    panels = [figure.add_subplot(place) for place in places]
    for axes, name, values in zip(panels, names, (distance, speed, room)):
        for n in range(len(flights)):
            axes.plot(time, values[n], color=ENDS[ends[n]], lw=1.5 if len(flights) == 1 else 0.8, alpha=0.9)
        axes.set_title(name, loc="left", fontsize=10, color=_INK)
        axes.set_xlim(0, max(float(flights.time.max()), flights.decision_dt))
        axes.set_xlabel("time [s]")
        _tidy(axes)
    panels[0].set_yscale("log")
    panels[0].axhline(1.0, color=_FAINT, lw=0.8, ls="--")
    panels[0].axhline(0.1, color=_FAINT, lw=0.8, ls=":")
    panels[2].set_yscale("symlog", linthresh=1.0)
    panels[2].axhline(0.0, color="#a01818", lw=0.8)
    counts = {end: int(np.sum(ends == end)) for end in ENDS}
    handles = [panels[0].plot([], [], color=color, lw=2)[0] for end, color in ENDS.items() if counts[end]]
    labels = [f"{end}: {counts[end]}" if len(flights) > 1 else end for end in ENDS if counts[end]]
    panels[0].legend(handles, labels, fontsize=8, frameon=False, loc="upper right")


def _tidy(axes: Axes) -> None:
    axes.grid(color="#e7eaef", lw=0.6, zorder=0)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, colors=_INK)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(_FAINT)


def _nested(n: int) -> dict[str, float]:
    """Widths that let a line be seen under those drawn after it."""
    return {"lw": max(1.2, 4.2 - 0.9 * n), "ms": max(3.0, 8.0 - 1.4 * n)}


def tolerance_figure(flights: Sequence[Flights]) -> Figure:
    """Collision-voided success against position tolerance, position only and with all bounds."""
    figure = Figure(figsize=(11, 4.2), layout="constrained", facecolor="white")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, full in zip(panels, (False, True)):
        for n, each in enumerate(flights):
            rates = [rate(succeeded(each, tolerance, full=full))["rate"] * 100 for tolerance in TOLERANCES]
            axes.plot(TOLERANCES, rates, "o-", color=PALETTE[n % len(PALETTE)], label=each.policy, **_nested(n))
        axes.set_xscale("log")
        axes.set_xticks(TOLERANCES, [f"{t:g}" for t in TOLERANCES])
        axes.minorticks_off()
        axes.set(xlabel="tolerance on the closest approach [m]", ylim=(-3, 103))
        kind = "with bounds on speed, attitude and rate" if full else "position only"
        axes.set_title(kind, loc="left", fontsize=10, color=_INK)
        _tidy(axes)
    panels[0].set_ylabel("flights without collision [%]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=9, frameon=False, loc="outside lower center", ncols=min(5, len(labels)))
    return figure


def port_figure(flights: Sequence[Flights], quoted: Mapping[str, Mapping[str, float]] | None = None) -> Figure:
    """Collision-free flights within 1 m by port with Wilson intervals, and quoted percentages as marks.

    Args:
        flights: of each policy.
        quoted: name to percent by port, of others.
    """
    figure = Figure(figsize=(11, 4.2), layout="constrained", facecolor="white")
    axes = figure.subplots()
    order = [*TRAIN_PORTS, *HELD_OUT_PORTS]
    width = 0.84 / len(flights)
    for n, each in enumerate(flights):
        names = np.array(PORT_NAMES)[each.port]
        numbers = [rate(succeeded(each.select(names == port), 1.0)) for port in order]
        shares = np.array([100 * x["rate"] if x["total"] else np.nan for x in numbers])
        errors = np.abs(np.array([[100 * x["low"], 100 * x["high"]] for x in numbers]).T - shares)
        place = np.arange(len(order)) + (n - (len(flights) - 1) / 2) * width
        color = PALETTE[n % len(PALETTE)]
        axes.bar(place, shares, width * 0.9, color=color, label=each.policy, zorder=2)
        axes.errorbar(place, shares, errors, fmt="none", ecolor=_INK, elinewidth=0.7, capsize=1.5, zorder=3)
    for (name, values), mark in zip((quoted or {}).items(), "D^s"):
        places = [i for i, port in enumerate(order) if port in values]
        axes.plot(places, [values[order[i]] for i in places], mark, ms=8, mfc="white", mec="#a01818", mew=1.6,
                  label=name, zorder=4)  # fmt: skip
    axes.axvline(len(TRAIN_PORTS) - 0.5, color=_FAINT, lw=1, ls="--")
    axes.text(len(TRAIN_PORTS) - 0.45, 108, "held out", fontsize=9, color=_INK)
    axes.set_xticks(range(len(order)), [port.replace("_", " ") for port in order])
    axes.set(ylim=(0, 115), ylabel="within 1 m, no collision [%]")
    _tidy(axes)
    axes.grid(visible=False, axis="x")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=9, frameon=False, loc="outside lower center", ncols=min(5, len(labels)))
    return figure


def speed_figure(flights: Sequence[Flights]) -> Figure:
    """Speed against range to the hold pose: medians, and the middle four fifths as bands."""
    figure = Figure(figsize=(11, 4.2), layout="constrained", facecolor="white")
    axes = figure.subplots()
    edges = np.geomspace(0.1, 300.0, 36)
    for n, each in enumerate(flights):
        rows = [row for row in speed_by_range(each, edges) if row["count"] >= 10]
        middle = [np.sqrt(row["from"] * row["to"]) for row in rows]
        color = PALETTE[n % len(PALETTE)]
        axes.plot(middle, [row["p50"] for row in rows], color=color, lw=_nested(n)["lw"], label=each.policy)
        low, high = ([row[key] for row in rows] for key in ("p10", "p90"))
        axes.fill_between(middle, low, high, color=color, alpha=0.12, lw=0)
    axes.axhspan(0.05, 0.10, color=_FAINT, alpha=0.25, lw=0, zorder=0)
    axes.text(280, 0.07, "closing speed of the docking standard", fontsize=8, color=_INK, va="center")
    axes.set(xscale="log", yscale="log", xlabel="range to the hold pose [m]", ylabel="speed [m/s]")
    axes.set_xlim(0.1, 300)
    axes.invert_xaxis()
    _tidy(axes)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=9, frameon=False, loc="outside lower center", ncols=min(5, len(labels)))
    return figure


def loss_figure(
    training: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    validation: Mapping[str, tuple[Sequence[float], Sequence[float]]],
) -> Figure:
    """Training losses and validation scores against the optimisation step: name to (steps, values)."""
    figure = Figure(figsize=(11, 3.8), layout="constrained", facecolor="white")
    panels = figure.subplots(1, 2)
    for axes, curves, title in zip(panels, (training, validation), ("training loss", "validation")):
        for n, (name, (steps, values)) in enumerate(curves.items()):
            color = PALETTE[n % len(PALETTE)]
            values = np.asarray(values, np.float64)
            if len(values) > 200:
                axes.plot(steps, values, color=color, lw=0.4, alpha=0.35)
                width = len(values) // 50
                smooth = np.convolve(values, np.ones(width) / width, mode="valid")
                axes.plot(np.asarray(steps)[width - 1 :], smooth, color=color, lw=1.6, label=name)
            else:
                axes.plot(steps, values, "o-", ms=3, color=color, lw=1.5, label=name)
        if all(np.all(np.asarray(v) > 0) for _, v in curves.values()):
            axes.set_yscale("log")
        axes.set_xlabel("optimisation step")
        axes.set_title(title, loc="left", fontsize=10, color=_INK)
        axes.legend(fontsize=8, frameon=False)
        _tidy(axes)
    return figure


def prediction_figure(groups: Mapping[str, Sequence[PredictionError]]) -> Figure:
    """Mean prediction error against horizon, a row of panels per group of windows."""
    quantities = (("position_m", "m"), ("velocity_mps", "m/s"), ("attitude_deg", "deg"), ("rate_degps", "deg/s"))
    figure = Figure(figsize=(16, 3.4 * len(groups) + 0.5), layout="constrained", facecolor="white")
    panels = figure.subplots(len(groups), 4, squeeze=False, sharex=True, sharey="col")
    names = list(dict.fromkeys(each.name for group in groups.values() for each in group))
    for row, (title, group) in zip(panels, groups.items()):
        for axes, (quantity, unit) in zip(row, quantities):
            for each in group:
                _curve(axes, names, each.name, np.asarray(each.horizons) * each.dt, each.mean(quantity))
            axes.set(yscale="log", ylabel=f"{quantity.split('_')[0]} error [{unit}]")
            _tidy(axes)
        row[0].set_title(title, loc="left", fontsize=10, color=_INK)
    _horizons(figure, panels)
    return figure


def calibration_figure(groups: Mapping[str, Sequence[Calibration]]) -> Figure:
    """Coverage of central intervals (dashed: nominal) and spread over error against horizon, a row per group."""
    groups = {title: group for title, group in groups.items() if group}
    figure = Figure(figsize=(16, 3.4 * len(groups) + 0.5), layout="constrained", facecolor="white")
    panels = figure.subplots(len(groups), 4, squeeze=False, sharex=True, sharey="col")
    names = list(dict.fromkeys(each.name for group in groups.values() for each in group))
    for row, (title, group) in zip(panels, groups.items()):
        for half, (k, quantity) in enumerate(((0, "position"), (2, "attitude"))):
            covered, ratio = row[2 * half], row[2 * half + 1]
            for each in group:
                seconds = np.asarray(each.horizons) * each.dt
                for level, marker in zip(range(len(each.levels)), ("o", "s", "^", "d", "v")):
                    _curve(covered, names, each.name, seconds, 100 * each.coverage[:, k, level], marker, level == 0)
                    covered.axhline(100 * each.levels[level], color=_FAINT, lw=0.8, ls="--", zorder=1)
                _curve(ratio, names, each.name, seconds, each.spread[:, k] / np.maximum(each.error[:, k], 1e-12), "o")
            ratio.axhline(1.0, color=_FAINT, lw=0.8, ls="--", zorder=1)
            covered.set(ylim=(-3, 103), ylabel=f"{quantity} covered [%]")
            low, high = ratio.get_ylim()
            ratio.set(
                yscale="log", ylim=(min(max(low, 0.01), 0.4), max(high, 2.5)), ylabel=f"{quantity} spread / error"
            )
            ratio.set_yticks(*_ticks(ratio.get_ylim(), (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)))
            for axes in (covered, ratio):
                axes.set_xscale("log")
                axes.set_xticks(*_ticks(axes.get_xlim(), (0.25, 0.5, 1, 2, 4, 8, 16, 32)))
                axes.minorticks_off()
                _tidy(axes)
        row[0].set_title(title, loc="left", fontsize=10, color=_INK)
    _horizons(figure, panels)
    return figure


def _curve(axes: Axes, names: Sequence[str], name: str, x, y, marker: str = "", label: bool = True) -> None:
    n = names.index(name)
    style = {"color": PALETTE[n % len(PALETTE)], "ls": "-" if n < len(PALETTE) else "--"}
    axes.plot(
        x, y, marker=marker, ms=4, lw=_nested(n)["lw"] if not marker else 1.4, label=name if label else None, **style
    )


def _ticks(limits: tuple[float, float], ticks: Sequence[float]) -> tuple[list[float], list[str]]:
    """Those of the ticks within the limits, and how to write them."""
    within = [tick for tick in ticks if limits[0] <= tick <= limits[1]]
    return within, [f"{tick:g}" for tick in within]


def _horizons(figure: Figure, panels: np.ndarray) -> None:
    for axes in panels[-1]:
        axes.set_xlabel("horizon [s]")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=9, frameon=False, loc="outside lower center", ncols=min(len(labels), 8))
