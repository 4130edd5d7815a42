"""The paper's figures for this task, and what keeps them from being a like-for-like comparison."""

from collections.abc import Sequence

import numpy as np

from owm.report.page import Table
from owm.report.tables import percent
from owm.scores.flights import Flights, succeeded
from owm.scores.statistics import seeded_rate
from owm_envs.station import HELD_OUT_PORTS, PORT_NAMES, TRAIN_PORTS

PLANNER_BY_PORT = {
    "harmony_forward": 76,
    "zvezda_aft": 70,
    "unity_nadir": 48,
    "poisk_zenith": 42,
    "harmony_zenith": 30,
}
"""Percent within 1 m with no collision, where the paper's text has it. Source: paper, docking results."""
PPO_BY_PORT = {
    "harmony_nadir": 68,
    "rassvet_nadir": 60,
    "pirs_nadir": 52,
    "unity_nadir": 50,
    "harmony_forward": 0,
    "zvezda_aft": 0,
    "poisk_zenith": 0,
    "harmony_zenith": 0,
}
COLUMNS = (
    "",
    "1 m, all ports",
    "1 m, train ports",
    "1 m, held-out ports",
    "0.1 m, all bounds, train ports",
    "collided, train / held out",
)
ROWS = (
    ("paper: world model in MPPI, camera and state", "53 %", "61 %", "40 %", "3 %", "39 % / 60 %"),
    ("paper: PPO", "29 %", "36 %", "17 %", "11 %", "35 % / 36 %"),
)
"""From the paper's section on results; a flight is a success within 1 m with no collision."""
DIFFERENCES = (
    "**Hull.** The paper's 313 boxes come from a NASA model of the station; ours from published dimensions of "
    "its parts. Ports, hold poses and the chaser's sphere are the paper's.",
    "**Map.** Planners here are given the hull's clearance and, unless a row says plain, a geodesic distance field "
    "around it and a speed profile along that field. The paper's planner is given the goal pose; its docking objective "
    "is not published in full, and 39 to 60 % of its flights touch the station.",
    "**Constants.** Those of our planner and field come from prototypes that flew all eight ports, held-out "
    "ones included, and were checked again on the train ports.",
    "**Inputs.** State alone; the paper's 6.4 million parameters predict latent tokens of state and camera images.",
    "**Correction.** Unless a row says otherwise, our planner feeds the model's last errors back as additive "
    "accelerations; the paper does not mention such a loop.",
    "**Starts.** 100–225 m unless a row says otherwise. The paper's reinforcement-learning shell is 100–125 m.",
    "**Hardware.** Processor here, minutes of training; the paper trains about 24 hours on one NVIDIA H100.",
)
NOT_ALIKE = (
    "The paper's figures are not like for like: another hull of as many boxes, other starts, an unpublished objective "
    "without a map of the hull, camera images beside the state, and 24 h of training on an H100."
)
"""The line below every table and figure that quotes the paper."""


def paper_table(flights: Sequence[Flights | Sequence[Flights]]) -> Table:
    """Rows of the paper's table for some policies, above the paper's own.

    Args:
        flights: of each policy, or of each of its trained seeds.
    """
    rows = []
    for each in flights:
        seeds = [each] if isinstance(each, Flights) else list(each)
        names = np.array(PORT_NAMES)[seeds[0].port]
        splits = (np.isin(names, ports) for ports in (TRAIN_PORTS, HELD_OUT_PORTS))
        train, held_out = ([one.select(mask) for one in seeds] for mask in splits)
        rows.append(
            [
                f"here: {seeds[0].policy}",
                *(percent(seeded_rate([succeeded(one, 1.0) for one in some])) for some in (seeds, train, held_out)),
                percent(seeded_rate([succeeded(one, 0.1, full=True) for one in train])),
                " / ".join(percent(seeded_rate([one.collided for one in some]), False) for some in (train, held_out)),
            ]
        )
    return Table(COLUMNS, [*rows, *map(list, ROWS)], NOT_ALIKE)
