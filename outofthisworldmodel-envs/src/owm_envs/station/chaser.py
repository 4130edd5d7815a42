"""The chaser, a Dragon of the first kind: its own table, in its body frame (nose +z, camera's up +y).

The origin is the centre of the 2.25 m bounding sphere. Capsule and berthing ring lie inside the sphere; the trunk
behind the heat shield and the two arrays stick out of it, and nothing that collides knows of them.
"""

from owm_envs.station.primitives import ESTIMATE, Part, box, rod, sheet, tube

_DRAGON = "SpaceX, Dragon cargo spacecraft overview: capsule 3.66 m wide, 2.9 m tall; trunk 2.3 m; arrays 16.5 m"

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
            "dark",
            "four Draco pods; " + ESTIMATE,
        )
        for name, x, y in (("px", 1.15, 1.05), ("nx", -1.15, 1.05), ("pu", 1.15, -1.05), ("nu", -1.15, -1.05))
    ),
    tube("trunk", "z", (-3.72, -1.42), (0.0, 0.0), 3.66, 3.66, "trunk", _DRAGON),
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
