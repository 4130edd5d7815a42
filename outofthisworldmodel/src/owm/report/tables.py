"""What reports and terminals say about flights and predictions, as tables of text."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from owm.report.page import Table
from owm.scores.calibration import Calibration
from owm.scores.flights import TOLERANCES, Flights, join, score, succeeded
from owm.scores.prediction import QUANTITIES, PredictionError
from owm.scores.statistics import Pairs, holm, median_interval, rate, seeded_rate
from owm_envs.station import HELD_OUT_PORTS, PORT_NAMES, TRAIN_PORTS

INTERVALS = "brackets: 95 % Wilson intervals"
SEEDED = f"{INTERVALS}, of rows with several trained seeds bootstrapped over seeds, then flights, if that is wider"
CONTACT = (
    "IDSS: at closest approach within the rates that the docking standard asks for at contact (closing at 0.05 to "
    "0.10 m/s, 0.04 m/s and 0.10 m across, 4 deg, 0.20 deg/s); or slower: its least closing speed left out. "
)
COASTS = (
    "Safe coasts: share of instants, every 2 s of flight, from which 360 s without thrust stay clear of the hull; of "
    "all, and of those beyond 10 m of the hull. Way out: share of the nearer ones from which an impulse of at most "
    "1 m/s, along any five of six directions, leads to such a coast. "
)


def percent(numbers: Mapping[str, float], interval: bool = True) -> str:
    """A rate as "92 % [74, 98]"; a dash without a trial."""
    if not numbers["total"]:
        return "–"
    text = f"{_whole(100 * numbers['rate'])} %"
    return f"{text} [{_whole(100 * numbers['low'])}, {_whole(100 * numbers['high'])}]" if interval else text


def _share(value: float | None) -> str:
    """A share as a percentage; a dash where there is none."""
    return "–" if value is None else f"{_whole(100 * value)} %"


def _whole(value: float) -> str:
    """A percentage, with decimals where a whole number would say none or all."""
    return f"{value:.0f}" if 1 <= value <= 99 or value in (0, 100) else f"{value:.2f}".rstrip("0").rstrip(".")


def docking_table(
    flights: Sequence[Flights | Sequence[Flights]],
    strong: Sequence[str] = (),
    given: Mapping[str, str] | None = None,
    by_split: bool = False,
) -> Table:
    """The headline: success, events and medians of each policy over all ports.

    Args:
        flights: of each policy, or of each of its trained seeds.
        strong: policies to set apart.
        given: what each policy was given, for a column of its own.
        by_split: strict success on train and on held-out ports, too.
    """
    rows, several, coasts = [], False, ""
    for each in flights:
        seeds = [each] if isinstance(each, Flights) else list(each)
        pooled, several = join(seeds), several or len(seeds) > 1
        scores, names = score(pooled), np.array(PORT_NAMES)[seeds[0].port]
        coasts = coasts if scores["safe_share"] is None else COASTS
        strict = [succeeded(one, 0.1, full=True) for one in seeds]
        splits = [[hits[np.isin(names, ports)] for hits in strict] for ports in (TRAIN_PORTS, HELD_OUT_PORTS)]
        rows.append(
            [
                pooled.policy,
                str(len(pooled)) if len(seeds) == 1 else f"{len(seeds)} × {len(seeds[0])}",
                percent(seeded_rate([succeeded(one, 1.0) for one in seeds])),
                percent(seeded_rate(strict)),
                *([" / ".join(percent(seeded_rate(part), False) for part in splits)] if by_split else []),
                percent(seeded_rate([one.collided for one in seeds]), by_split),
                f"{percent(scores['escape'], False)} / {percent(scores['timeout'], False)}",
                f"{percent(scores['idss'], False)} / {percent(scores['idss_or_slower'], False)}",
                "–"
                if scores["safe_share"] is None
                else f"{_share(scores['safe_share'])} / {_share(scores['far_safe_share'])}",
                _share(scores["avoidable_share"]),
                _number(scores["median_time"], "{:.0f}"),
                _number(scores["median_delta_v"], "{:.1f}"),
                _number(scores["least_clearance"], "{:.2f}"),
                f"{1000 * pooled.decision_seconds:.2g}",
                *([] if given is None else [given[pooled.policy]]),
            ]
        )
    columns = [
        "policy",
        "flights",
        "1 m, no collision",
        "strict, no collision",
        *(["strict, train / held out"] if by_split else []),
        "collided",
        "escaped / timed out",
        "IDSS / or slower",
        "safe coasts, all / far",
        "way out, near",
        "time s",
        "Δv m/s",
        "clearance m",
        "ms a decision",
        *([] if given is None else ["given"]),
    ]
    caption = (
        "1 m: closest approach of the chaser's centre to the hold pose; strict: 0.1 m, 0.5 m/s, 5 deg and "
        f"0.5 deg/s there; {SEEDED if several else INTERVALS}. A collision is recorded and the flight goes on, but it "
        f"fails every success column. {CONTACT}{coasts}Time and Δv: medians over the flights of the 1 m column; "
        "clearance: the least of all; ms a decision: mean over all decisions; planned rows replan at every eighth, "
        "scripted rows are computed for all flights at once."
    )
    return Table(columns, rows, caption, [i for i, row in enumerate(rows) if row[0] in strong])


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


def condition_table(
    cells: Mapping[tuple[str, str], Sequence[Flights]], tolerance: float = 0.1, *, full: bool = True
) -> Table:
    """Collision-free success of each policy (rows) under each condition (columns).

    Args:
        cells: flights of each trained seed by policy and condition.
    """
    policies, conditions = (list(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))
    rows = []
    for policy in policies:
        seeds = [cells.get((policy, condition), ()) for condition in conditions]
        hits = [[succeeded(one, tolerance, full=full) for one in some] for some in seeds]
        rows.append([policy, *(percent(seeded_rate(some)) if some else "–" for some in hits)])
    kind, several = "all bounds" if full else "position only", any(len(seeds) > 1 for seeds in cells.values())
    caption = f"Flights within {tolerance:g} m ({kind}) with no collision; {SEEDED if several else INTERVALS}."
    return Table(["policy", *conditions], rows, caption)


def pace_table(cells: Mapping[tuple[str, str], Sequence[Flights]], against: str | None = None) -> Table:
    """Median time of each policy (rows) under each condition (columns), and how much sooner it is than another.

    Args:
        cells: flights of each trained seed by policy and condition.
        against: a policy of them, compared start by start.
    """
    policies, conditions = (list(dict.fromkeys(key[i] for key in cells)) for i in (0, 1))

    def cell(policy: str, condition: str) -> str:
        if (policy, condition) not in cells:
            return "–"
        first = cells[policy, condition]
        text = _number(score(join(first))["median_time"], "{:.0f}")
        if against in (None, policy) or (against, condition) not in cells:
            return text
        later = _docking_times(first[0]), _docking_times(cells[against, condition][0])
        common = sorted(later[0].keys() & later[1].keys())
        middle, low, high = median_interval(np.array([later[0][start] - later[1][start] for start in common]))
        return f"{text}; {middle:+.1f} [{low:+.1f}, {high:+.1f}]" if np.isfinite(low) else text

    caption = "Median time of the flights within 1 m with no collision, s"
    if against is not None:
        caption += f"; then the median difference from {against} on the starts where both did, with a 95 % interval"
    rows = [[policy, *(cell(policy, condition) for condition in conditions)] for policy in policies]
    return Table(["policy", *conditions], rows, f"{caption}.")


def _docking_times(flights: Flights) -> dict[str, float]:
    """Time of each flight within 1 m by the digest of its start."""
    good = succeeded(flights, 1.0)
    return dict(zip(flights.digest[good].tolist(), flights.time[good].tolist()))


def pairs_table(families: Sequence[tuple[str, Sequence[Pairs]]]) -> Table:
    """Paired comparisons, a line for each pair of policies that differ at all: discordant starts and Holm's p-value.

    Args:
        families: what counts as success, and the pairs, the same ones in each.
    """
    adjusted = iter(holm([each.p for _, pairs in families for each in pairs]))
    p = [[next(adjusted) for _ in pairs] for _, pairs in families]
    rows, alike = [], 0
    for i, each in enumerate(families[0][1]):
        if not any(pairs[i].first_only or pairs[i].second_only for _, pairs in families):
            alike += 1
            continue
        cells = []
        for k, (_, pairs) in enumerate(families):
            pair = pairs[i]
            cells += [f"{100 * pair.difference:+.1f}", f"{pair.first_only} : {pair.second_only}", f"{p[k][i]:.2g}"]
        rows.append([each.first, each.second, str(each.total), *cells])
    columns = ["policy", "against", "starts"]
    for name, _ in families:
        columns += [f"{name}: difference, points", "first only : second only", "p"]
    caption = (
        "On the starts that both flew. p: exact two-sided McNemar test, adjusted by Holm over all "
        f"{sum(len(pairs) for _, pairs in families)} tests. Rows with several trained seeds enter with their first."
    )
    if alike:
        caption += f" Left out: {alike} comparisons in which every start ended alike."
    return Table(columns, rows, caption)


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


def to_rich(table: Table, title: str = "") -> Any:
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
