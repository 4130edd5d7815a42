"""Pictures of flights, scores and predictions, drawn without a display."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from owm.scores.calibration import Calibration
from owm.scores.flights import TOLERANCES, Flights, speed_by_range, succeeded
from owm.scores.prediction import PredictionError
from owm.scores.statistics import rate
from owm_envs.figures import AXES, FAINT, INK, PALETTE, silhouette, tidy
from owm_envs.station import HELD_OUT_PORTS, PORT_NAMES, PORTS, TRAIN_PORTS, goal_poses, hull_boxes
from owm_envs.view import View

ENDS = {
    "docked": "#009E73",
    "within 1 m": "#56B4E9",
    "missed": "#E69F00",
    "collided": "#D55E00",
}
"""What became of a flight, worst last, and its colour."""
VIEWS = (("seen from port side", 1, 2, 1), ("seen from ahead", 0, 2, -1), ("seen from below", 1, 0, -1))
"""Name, horizontal and vertical axis, and whether the third axis points at (1) or away from the viewer."""


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
    # Many flights, the whole way to scale, would hide the station: a second row looks at it closely.
    hull = hull_boxes().reshape(-1, 3)
    spans = {"": np.concatenate([View.of(flights.trajectory).position.reshape(-1, 3), hull])}
    spans |= {} if single else {", close up": hull}
    figure = Figure(figsize=(14, 3.4 + 5 * len(spans)), layout="constrained", facecolor="white")
    figure.suptitle(title, fontsize=14, fontweight="bold", color=INK)
    grid = figure.add_gridspec(len(spans) + 1, 3, height_ratios=(*[1.45] * len(spans), 1))
    views = [[figure.add_subplot(grid[row, column]) for column in range(3)] for row in range(len(spans))]
    for row, (closeness, span) in zip(views, spans.items()):
        low, high = _limits(span)
        for axes, (name, i, j, sign) in zip(row, VIEWS):
            # Over many flights, or they would cover it.
            silhouette(axes, hull_boxes(), i, j, sign, alpha=1 if single else 0.75, zorder=1 if single else 3.15)
            for port in ports:
                _corridor(axes, port, i, j, label=len(ports) <= 2)
            axes.set(xlim=(low[i], high[i]), ylim=(low[j], high[j]), xlabel=AXES[i], ylabel=AXES[j])
            axes.set_aspect("equal")
            axes.set_title(name + closeness, loc="left", fontsize=10, color=INK)
            tidy(axes)
    histories = [figure.add_subplot(grid[-1, column]) for column in range(3)]
    labels = {}
    for layer, (end, color) in enumerate(ENDS.items()):
        some = flights.select(ends == end)
        if len(some) == 0:
            continue
        # The fainter, the more ended alike; the worst on top.
        stroke = {"color": color, "alpha": min(0.95, max(0.15, 40 / len(some))), "lw": 1.6 if single else 0.9,
                  "zorder": 3 + 0.1 * layer}  # fmt: skip
        room = hull_distance(View.of(some.trajectory).position, radius)
        for row in views:
            for axes, (_, i, j, _) in zip(row, VIEWS):
                _tracks(axes, some.trajectory, room, i, j, stroke, single)
        _histories(histories, some, room, stroke)
        labels[end if single else f"{end}: {len(some)}"] = color
    _finish_histories(histories, flights, labels)
    return figure


def _limits(points: Float[np.ndarray, "N 3"]):
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    # One scale for the three views: equal spans about each axis's middle.
    half, middle = 0.55 * (high - low).max(), 0.5 * (low + high)
    return middle - half, middle + half


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


def _tracks(
    axes: Axes, tracks: Float[np.ndarray, "N T 13"], room: np.ndarray, i: int, j: int, stroke: dict, single: bool
) -> None:
    places = tracks[..., [i, j]]
    ends = places[np.arange(len(tracks)), np.sum(np.isfinite(tracks[..., 0]), axis=1) - 1]
    touched = (room <= 0).any(axis=1)
    contacts = places[touched, np.argmax(room[touched] <= 0, axis=1)]
    size, color = 5 if single else 3, stroke["color"]
    axes.add_collection(LineCollection(places, **stroke))
    axes.plot(*places[:, 0].T, "o", color=color, ms=size, mfc="white", zorder=4)
    axes.plot(*ends.T, "o", color=color, ms=size, zorder=4)
    axes.plot(*contacts.T, "x", color="#a01818", ms=size + 1, mew=0.35 * size, zorder=6)
    if single:
        flown = tracks[0][np.isfinite(tracks[0, :, 0])]
        some = flown[:: max(1, len(flown) // 14)]
        nose = _nose(View.of(some).attitude)
        axes.quiver(some[:, i], some[:, j], nose[:, i], nose[:, j], color=INK, width=0.003, scale=22, headwidth=4,
                    zorder=4, label="nose")  # fmt: skip


def _nose(q: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 3"]:
    """Body +z in the station frame."""
    w, x, y, z = q.T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _histories(panels: Sequence[Axes], flights: Flights, room, stroke: dict) -> None:
    time = np.arange(flights.trajectory.shape[1]) * flights.decision_dt
    goals = goal_poses()[flights.port, :3]
    seen = View.of(flights.trajectory)
    distance = np.linalg.norm(seen.position - goals[:, None], axis=-1)
    speed = np.linalg.norm(seen.velocity, axis=-1)
    for axes, values in zip(panels, (distance, speed, room)):
        axes.plot(time, values.T, **stroke)


def _finish_histories(panels: Sequence[Axes], flights: Flights, labels: Mapping[str, str]) -> None:
    names = ("range to goal [m]", "speed [m/s]", "hull clearance of the bounding sphere [m]")
    for axes, name in zip(panels, names):
        axes.set_title(name, loc="left", fontsize=10, color=INK)
        axes.set_xlim(0, max(float(flights.time.max()), flights.decision_dt))
        axes.set_xlabel("time [s]")
        tidy(axes)
    panels[0].set_yscale("log")
    panels[0].axhline(1.0, color=FAINT, lw=0.8, ls="--")
    panels[0].axhline(0.1, color=FAINT, lw=0.8, ls=":")
    panels[2].set_yscale("symlog", linthresh=1.0)
    panels[2].axhline(0.0, color="#a01818", lw=0.8)
    handles = [panels[0].plot([], [], color=color, lw=2)[0] for color in labels.values()]
    panels[0].legend(handles, list(labels), fontsize=8, frameon=False, loc="upper right")


def _nested(n: int) -> float:
    """A width that lets a line be seen under those drawn after it."""
    return max(1.2, 4.2 - 0.9 * n)


def tolerance_figure(flights: Sequence[Flights]) -> Figure:
    """Share of flights with no collision that end within an error, for each of four errors at closest approach.

    Dashed: the bounds of strict success.
    """
    figure = Figure(figsize=(14, 4.2), layout="constrained", facecolor="white")
    speed, attitude, turning = flights[0].bounds
    panels = {
        "distance": (1.0, "m", TOLERANCES[0]),
        "speed": (1.0, "m/s", speed),
        "attitude": (np.degrees(1.0), "deg", np.degrees(attitude)),
        "rate": (np.degrees(1.0), "deg/s", np.degrees(turning)),
    }
    for axes, (label, (scale, unit, bound)) in zip(figure.subplots(1, 4, sharey=True), panels.items()):
        errors = [scale * getattr(each, f"closest_{label}")[~each.collided] for each in flights]
        errors = [np.sort(some[np.isfinite(some)]) for some in errors]
        found = np.concatenate([*errors, [bound]])
        low = min(0.8 * max(found.min(), bound / 100), bound / 4)
        high = 1.25 * min(found.max(), 100 * bound)
        digits = (1, 2, 5) if high / low < 200 else (1,)
        for n, (each, some) in enumerate(zip(flights, errors)):
            shares = 100 * np.arange(len(some) + 1) / max(len(each), 1)
            axes.step([low, *some, high], [*shares, shares[-1]], where="post", color=PALETTE[n % len(PALETTE)],
                      lw=_nested(n), label=each.policy)  # fmt: skip
        axes.axvline(bound, color=INK, lw=0.9, ls="--", zorder=1)
        axes.set(xscale="log", xlim=(low, high), ylim=(-3, 103), xlabel=f"{label} at closest approach [{unit}]")
        axes.set_xticks(*_ticks((low, high), [k * 10.0**e for e in range(-6, 4) for k in digits]))
        axes.minorticks_off()
        tidy(axes)
    figure.axes[0].set_ylabel("flights without collision [%]")
    _legend(figure)
    return figure


def _legend(figure: Figure) -> None:
    """What the colours mean, once, below all panels."""
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=9, frameon=False, loc="outside lower center", ncols=min(5, len(labels)))


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
        axes.errorbar(place, shares, errors, fmt="none", ecolor=INK, elinewidth=0.7, capsize=1.5, zorder=3)
    for (name, values), mark in zip((quoted or {}).items(), "D^s"):
        places = [i for i, port in enumerate(order) if port in values]
        axes.plot(places, [values[order[i]] for i in places], mark, ms=8, mfc="white", mec="#a01818", mew=1.6,
                  label=name, zorder=4)  # fmt: skip
    axes.axvline(len(TRAIN_PORTS) - 0.5, color=FAINT, lw=1, ls="--")
    axes.text(len(TRAIN_PORTS) - 0.45, 108, "held out", fontsize=9, color=INK)
    axes.set_xticks(range(len(order)), [port.replace("_", " ") for port in order])
    axes.set(ylim=(0, 115), ylabel="within 1 m, no collision [%]")
    tidy(axes)
    axes.grid(visible=False, axis="x")
    _legend(figure)
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
        axes.plot(middle, [row["p50"] for row in rows], color=color, lw=_nested(n), label=each.policy)
        low, high = ([row[key] for row in rows] for key in ("p10", "p90"))
        axes.fill_between(middle, low, high, color=color, alpha=0.12, lw=0)
    axes.axhspan(0.05, 0.10, color=FAINT, alpha=0.25, lw=0, zorder=0)
    axes.text(280, 0.07, "closing speed of the docking standard", fontsize=8, color=INK, va="center")
    axes.set(xscale="log", yscale="log", xlabel="range to the hold pose [m]", ylabel="speed [m/s]")
    axes.set_xlim(0.1, 300)
    axes.invert_xaxis()
    tidy(axes)
    _legend(figure)
    return figure


def loss_figure(
    training: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    validation: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    marks: Mapping[str, float] | None = None,
) -> Figure:
    """Training losses and validation scores against the optimisation step: name to (steps, values).

    Args:
        training, validation: a panel each.
        marks: what changed in training, and at which step.
    """
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
        axes.set_title(title, loc="left", fontsize=10, color=INK, pad=16)
        axes.legend(fontsize=8, frameon=False)
        tidy(axes)
    for mark, step in (marks or {}).items():
        panels[0].axvline(step, color=INK, lw=0.9, ls="--", zorder=1)
        panels[0].text(step, 1.01, mark, fontsize=8, color=INK, transform=panels[0].get_xaxis_transform())
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
            tidy(axes)
        row[0].set_title(title, loc="left", fontsize=10, color=INK)
    for axes in panels[-1]:
        axes.set_xlabel("horizon [s]")
    _legend(figure)
    return figure


def calibration_figure(groups: Mapping[str, Sequence[Calibration]]) -> Figure:
    """Coverage of central intervals and spread over error against horizon; dashed: as it should be.

    A row for each group and quantity, a panel for each level: one curve a model.
    """
    rows = [(f"{title}: {quantity}", k, group) for title, group in groups.items() if group
            for k, quantity in ((0, "position"), (2, "attitude"))]  # fmt: skip
    levels = rows[0][2][0].levels
    names = list(dict.fromkeys(each.name for *_, group in rows for each in group))
    figure = Figure(figsize=(16, 2.6 * len(rows) + 0.6), layout="constrained", facecolor="white")
    panels = figure.subplots(len(rows), len(levels) + 1, squeeze=False, sharex=True, sharey="col")
    for row, (title, k, group) in zip(panels, rows):
        for each in group:
            seconds = np.asarray(each.horizons) * each.dt
            for axes, covered in zip(row, each.coverage[:, k].T):
                _curve(axes, names, each.name, seconds, 100 * covered, marked=True)
            ratio = each.spread[:, k] / np.maximum(each.error[:, k], 1e-12)
            _curve(row[-1], names, each.name, seconds, ratio, marked=True)
        for axes, nominal in zip(row, [*(100 * level for level in levels), 1.0]):
            axes.axhline(nominal, color=INK, lw=0.9, ls="--", zorder=4)
            axes.set_xscale("log")
            axes.set_xticks(*_ticks(axes.get_xlim(), (0.25, 0.5, 1, 2, 4, 8, 16, 32)))
            axes.minorticks_off()
            tidy(axes)
        row[0].set_title(title, loc="left", fontsize=10, fontweight="bold", color=INK)
        for axes, level in zip(row, levels):
            axes.set(ylim=(-3, 103), ylabel=f"in the {100 * level:g} % interval [%]")
        row[-1].set_ylabel("spread / error")
    last = panels[0, -1]
    low, high = last.get_ylim()
    last.set(yscale="log", ylim=(min(max(low, 0.01), 0.4), max(high, 2.5)))
    last.set_yticks(*_ticks(last.get_ylim(), (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)))
    last.minorticks_off()
    for axes in panels[-1]:
        axes.set_xlabel("horizon [s]")
    _legend(figure)
    return figure


def _curve(axes: Axes, names: Sequence[str], name: str, x, y, *, marked: bool = False) -> None:
    n = names.index(name)
    style = {"marker": "os^dvP*X"[n % 8], "ms": 4, "lw": 1.4} if marked else {"lw": _nested(n)}
    axes.plot(x, y, color=PALETTE[n % len(PALETTE)], ls="-" if n < len(PALETTE) else "--", label=name, **style)


def _ticks(limits: tuple[float, float], ticks: Sequence[float]) -> tuple[list[float], list[str]]:
    """Those of the ticks within the limits, and how to write them."""
    within = [tick for tick in ticks if limits[0] <= tick <= limits[1]]
    return within, [f"{tick:g}" for tick in within]
