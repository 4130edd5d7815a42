"""The chaser, a Dragon of the first kind: its own table, in its body frame (nose +z, camera's up +y).

The origin is the centre of the 2.25 m bounding sphere. Capsule and berthing ring lie inside the sphere; the trunk
behind the heat shield and the two arrays stick out of it, and nothing that collides knows of them.
"""

import math

from owm_envs.station.primitives import ESTIMATE, Part, Z, box, rod, sheet, tube

_DRAGON = "SpaceX, Dragon cargo spacecraft overview: capsule 3.66 m wide, 2.9 m tall; trunk 2.3 m; arrays 16.5 m"


def _on_cone(name: str, degrees: float, height: float, diameter: float, material: str) -> Part:
    """A disc on the capsule's cone at body z = `height`, turned about z from the camera's up."""
    turn, slope = math.radians(degrees), math.atan2(1.83 - 0.85, 2.65)
    radius = 1.83 - math.tan(slope) * (height + 1.05)
    way = (math.sin(turn), math.cos(turn), 0.0)
    out = tuple(math.cos(slope) * w + math.sin(slope) * z for w, z in zip(way, Z))
    centre = tuple(radius * w + height * z for w, z in zip(way, Z))
    start, end = (tuple(c + d * o for c, o in zip(centre, out)) for d in (-0.04, 0.02))
    return rod(name, start, end, diameter, material, ESTIMATE)


CHASER: tuple[Part, ...] = (
    tube("capsule", "z", (-1.05, 1.60), (0.0, 0.0), 3.66, 1.70, "dragon", _DRAGON + "; place chosen to fit the sphere"),
    tube("capsule_base", "z", (-1.28, -1.05), (0.0, 0.0), 3.45, 3.66, "dragon", _DRAGON),
    tube("heat_shield", "z", (-1.42, -1.28), (0.0, 0.0), 3.0, 3.45, "heat_shield", ESTIMATE),
    tube("berthing_ring", "z", (1.60, 2.05), (0.0, 0.0), 1.70, 1.60, "metal", ESTIMATE),
    tube("hatch", "z", (2.05, 2.10), (0.0, 0.0), 1.25, 1.20, "dark", ESTIMATE),
    *(
        box(
            f"thruster_pod_{name}",
            (x - 0.32, x + 0.32),
            (y - 0.32, y + 0.32),
            (-0.75, 0.05),
            "dragon",
            "four Draco pods; " + ESTIMATE,
        )
        for name, x, y in (("px", 1.15, 1.05), ("nx", -1.15, 1.05), ("pu", 1.15, -1.05), ("nu", -1.15, -1.05))
    ),
    tube("trunk", "z", (-3.72, -1.42), (0.0, 0.0), 3.66, 3.66, "trunk", _DRAGON),
    tube("trunk_opening", "z", (-3.73, -3.70), (0.0, 0.0), 3.40, 3.40, "dark", ESTIMATE),
    _on_cone("side_hatch", 180.0, -0.35, 1.10, "hatch"),
    _on_cone("window_port", 125.0, 0.35, 0.36, "glass"),
    _on_cone("window_starboard", -125.0, 0.35, 0.36, "glass"),
    _on_cone("guidance_bay", 0.0, 0.10, 0.70, "black"),
    _on_cone("grapple", 0.0, -0.80, 0.45, "metal"),
    *(
        part
        for name, side in (("port", 1.0), ("starboard", -1.0))
        for part in (
            rod(f"array_{name}_arm", (side * 1.8, 0.0, -2.6), (side * 2.5, 0.0, -2.6), 0.2, "metal", ESTIMATE),
            sheet(
                f"array_{name}",
                (side * 2.5, 0.0, -2.6),
                (side * 8.25, 0.0, -2.6),
                1.9,
                0.05,
                "array_blue",
                _DRAGON,
                (0.0, 0.0, 1.0),
            ),
        )
    ),
)
"""Parts in the chaser's body frame [m]."""
