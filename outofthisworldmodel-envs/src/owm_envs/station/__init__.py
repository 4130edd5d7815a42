"""What the ISS is: its parts, collision boxes and docking ports, in the station frame."""

from owm_envs.station.hull import hull_boxes, part_boxes
from owm_envs.station.parts import PARTS, Part
from owm_envs.station.ports import (
    HELD_OUT_PORTS,
    PORT_NAMES,
    PORTS,
    TRAIN_PORTS,
    Port,
    docked_attitude,
    goal_poses,
    port_index,
)

__all__ = [
    "HELD_OUT_PORTS",
    "PARTS",
    "PORTS",
    "PORT_NAMES",
    "TRAIN_PORTS",
    "Part",
    "Port",
    "docked_attitude",
    "goal_poses",
    "hull_boxes",
    "part_boxes",
    "port_index",
]
