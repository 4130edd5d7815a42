"""What the ISS is: its parts, collision boxes and docking ports, in the station frame."""

from owm_envs.station.chaser import CHASER
from owm_envs.station.geometry import bounds, nearest_part, sample_surface, signed_distance
from owm_envs.station.hull import HullQuality, build_hull, hull_boxes, hull_quality, load_hull, part_boxes, save_hull
from owm_envs.station.parts import MATERIALS, PARTS, Material, Part
from owm_envs.station.ports import (
    HELD_OUT_PORTS,
    PORT_NAMES,
    PORTS,
    TRAIN_PORTS,
    Port,
    docked_attitude,
    goal_poses,
    port_index,
    port_indices,
)

__all__ = [
    "CHASER",
    "HELD_OUT_PORTS",
    "MATERIALS",
    "PARTS",
    "PORTS",
    "PORT_NAMES",
    "TRAIN_PORTS",
    "HullQuality",
    "Material",
    "Part",
    "Port",
    "bounds",
    "build_hull",
    "docked_attitude",
    "goal_poses",
    "hull_boxes",
    "hull_quality",
    "load_hull",
    "nearest_part",
    "part_boxes",
    "port_index",
    "port_indices",
    "sample_surface",
    "save_hull",
    "signed_distance",
]
