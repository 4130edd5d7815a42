"""What reports and terminals say about flights and predictions, as tables of text."""

from collections.abc import Mapping, Sequence

import numpy as np

from owm.evaluation.calibration import Calibration
from owm.evaluation.flights import TOLERANCES, Flights, rate, score, succeeded
from owm.evaluation.prediction import QUANTITIES, PredictionError
from owm.evaluation.report import Table
from owm_envs.station import HELD_OUT_PORTS, PORT_NAMES, TRAIN_PORTS

INTERVALS = "brackets: 95 % Wilson intervals"


def percent(numbers: Mapping[str, float], interval: bool = True) -> str:
    """A rate as "92 % [74, 98]"; a dash without a trial."""
    if not numbers["total"]:
        return "–"
    text = f"{100 * numbers['rate']:.0f} %"
    return f"{text} [{100 * numbers['low']:.0f}, {100 * numbers['high']:.0f}]" if interval else text


def docking_table(flights: Sequence[Flights], strong: Sequence[str] = ()) -> Table:
    """The headline: success, events and medians of each policy over all ports."""
    rows = []
    for each in flights:
        scores = score(each)
        rows.append(
            [
                each.policy,
                str(len(each)),
                percent(rate(succeeded(each, 1.0))),
                percent(rate(succeeded(each, 0.1, full=True))),
                percent(scores["collision"], False),
                percent(scores["escape"], False),
                percent(scores["timeout"], False),
                _number(scores["median_time"], "{:.0f}"),
                _number(scores["median_delta_v"], "{:.1f}"),
                _number(scores["least_clearance"], "{:.2f}"),
                f"{1000 * each.decision_seconds:.2g}",
            ]
        )
    return Table(
        [
            "policy",
            "flights",
            "1 m, no collision",
            "strict, no collision",
            "collided",
            "escaped",
            "timed out",
            "time s",
            "Δv m/s",
            "clearance m",
            "ms a decision",
        ],
        rows,
        "1 m: closest approach of the chaser's centre to the hold pose; strict: 0.1 m, 0.5 m/s, 5 deg and "
        f"0.5 deg/s there; {INTERVALS}. A collision is recorded and the flight goes on, but it fails every "
        "success column. Time and Δv: medians over the flights of the 1 m column; clearance: the least of all; ms a "
        "decision: mean over all decisions; planned rows replan at every eighth, scripted rows are computed for "
        "all flights at once.",
        [i for i, each in enumerate(flights) if each.policy in strong],
    )


def port_table(flights: Sequence[Flights]) -> Table:
    """Collision-free flights within 1 m by port, and pooled by split."""
    groups = {name: [name] for name in PORT_NAMES}
    groups |= {"train ports": TRAIN_PORTS, "held-out ports": HELD_OUT_PORTS, "all": PORT_NAMES}
    rows, strong = [], []
    for group, ports in groups.items():
        cells = []
        for each in flights:
            some = each.select(np.isin(np.array(PORT_NAMES)[each.port], ports))
            numbers = rate(succeeded(some, 1.0))
            pooled = percent(numbers) if group not in PORT_NAMES else ""
            cells.append(pooled or (f"{numbers['count']}/{numbers['total']}" if numbers["total"] else "–"))
        if all(cell == "–" for cell in cells):
            continue
        if group not in PORT_NAMES:
            strong.append(len(rows))
        rows.append([f"{group} (held out)" if group in HELD_OUT_PORTS else group, *cells])
    caption = f"Flights within 1 m of the hold pose with no collision; {INTERVALS}."
    if any(PORT_NAMES[port] in HELD_OUT_PORTS for each in flights for port in each.port):
        caption += (
            " Held out from training only: the planner's and the field's constants come from prototypes that flew all "
            "eight ports, and the map covers all eight, so these rows test the planner, not the model's generalisation."
        )
    return Table(["port", *(each.policy for each in flights)], rows, caption, strong)


def definitions_table(flights: Sequence[Flights]) -> Table:
    """All fourteen definitions of success, collision-voided and raw."""
    rows = []
    for full in (False, True):
        for tolerance in TOLERANCES:
            cells = []
            for each in flights:
                voided, raw = (
                    percent(rate(succeeded(each, tolerance, full=full, voided=v)), False) for v in (True, False)
                )
                cells.append(voided if voided == raw else f"{voided} ({raw})")
            rows.append([f"{tolerance:g} m, {'all bounds' if full else 'position only'}", *cells])
    return Table(
        ["definition", *(each.policy for each in flights)],
        rows,
        "Collision-voided rates over all ports; in parentheses the raw rate where it differs.",
    )


def failures(flights: Sequence[Flights]) -> Table:
    """Every flight that did not come within 1 m without a collision."""
    rows = []
    for each in flights:
        for i in np.flatnonzero(~succeeded(each, 1.0)):
            rows.append(
                [
                    each.policy,
                    PORT_NAMES[each.port[i]],
                    str(each.seed[i]),
                    str(each.outcome[i]) + (", after a collision" if each.collided[i] else ""),
                    f"{each.closest_distance[i]:.2f}",
                    f"{each.closest_speed[i]:.2f}",
                    f"{np.degrees(each.closest_attitude[i]):.1f}",
                    f"{each.clearance[i]:.2f}",
                    f"{each.time[i]:.0f}",
                ]
            )
    columns = [
        "policy",
        "port",
        "seed",
        "ended as",
        "closest m",
        "at m/s",
        "at deg",
        "least clearance m",
        "after s",
    ]
    return Table(columns, rows, "Flights that collided or never came within 1 m.")


def prediction_table(errors: Sequence[PredictionError], seconds: Sequence[float] = (0.25, 1, 4, 8, 16)) -> Table:
    """Mean position and attitude error of each model at some horizons."""
    rows = []
    for each in errors:
        steps = [round(s / each.dt) for s in seconds]
        cells = []
        for step in steps:
            if step in each.horizons:
                at = each.horizons.index(step)
                cells.append(f"{each.mean('position_m')[at]:.3f} / {each.mean('attitude_deg')[at]:.3f}")
            else:
                cells.append("–")
        rows.append([each.name, *cells])
    return Table(["position m / attitude deg at", *(f"{s:g} s" for s in seconds)], rows)


def error_table(errors: Sequence[PredictionError], seconds: Sequence[float] = (1, 4, 16)) -> Table:
    """Mean errors of all four kinds of each model at some horizons."""
    rows = []
    for each in errors:
        at = [each.horizons.index(round(s / each.dt)) for s in seconds]
        means = np.array([each.mean(quantity) for quantity in QUANTITIES])
        rows.append([each.name, *(" / ".join(f"{mean:.2g}" for mean in means[:, i]) for i in at)])
    return Table(["m / m/s / deg / deg/s at", *(f"{s:g} s" for s in seconds)], rows)


def calibration_table(calibrations: Sequence[Calibration], seconds: Sequence[float] = (0.25, 1, 4, 16)) -> Table:
    """Coverage, CRPS and spread over error of position and attitude at some horizons."""
    rows = []
    for each in calibrations:
        for k, kind, unit in ((0, "position", "m"), (2, "attitude", "deg")):
            for s in seconds:
                i = each.horizons.index(round(s / each.dt))
                cover = " / ".join(f"{100 * c:.0f}" for c in each.coverage[i, k])
                ratio = each.spread[i, k] / max(each.error[i, k], 1e-12)
                cells = [f"{s:g}", cover, f"{each.crps[i, k]:.3g} {unit}", f"{ratio:.2f}"]
                rows.append([f"{each.name} ({each.outcome})", kind, *cells])
    levels = " / ".join(f"{100 * level:g}" for level in calibrations[0].levels)
    return Table(["model (against)", "of", "horizon s", f"coverage of {levels} %", "CRPS", "spread / error"], rows)


def to_rich(table: Table, title: str = ""):
    """The table for a terminal, as the rich library draws it."""
    from rich import box
    from rich.table import Table as Rich

    drawn = Rich(title=title or None, box=box.SIMPLE_HEAD, title_justify="left", caption_justify="left")
    for i, column in enumerate(table.columns):
        justify = "right" if table.is_numeric(i) else "left"
        cells = [column.split(), *([row[i]] for row in table.rows if i == 0)]
        width = max(len(word) for words in cells for word in words)
        drawn.add_column(column, justify=justify, overflow="fold", min_width=width)
    for i, row in enumerate(table.rows):
        drawn.add_row(*row, style="bold" if i in table.strong else None)
    return drawn


def _number(value: float | None, pattern: str) -> str:
    return "–" if value is None else pattern.format(value)
