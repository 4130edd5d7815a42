"""What is only looked at: docking mechanisms, windows, hatches. The camera adds it; hull and mesh know nothing of it.

All of it lies on the parts' surfaces or stands out of them by at most 0.6 m, at the ports by at most 0.2 m.
"""

import math

from owm_envs.station.ports import PORTS, Port
from owm_envs.station.primitives import ESTIMATE, Part, Vector, X, Y, Z, rod


def _plus(place: Vector, *steps: tuple[float, Vector]) -> Vector:
    """A place, moved by lengths along directions."""
    return tuple(p + sum(length * way[i] for length, way in steps) for i, p in enumerate(place))


def _minus(a: Vector) -> Vector:
    return tuple(-v for v in a)


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _disc(name: str, centre: Vector, out: Vector, diameter: float, material: str, height: float = 0.02) -> Part:
    """A disc on a surface, raised by its height."""
    return rod(name, _plus(centre, (-0.02, out)), _plus(centre, (height, out)), diameter, material, ESTIMATE)


def _slab(name: str, centre: Vector, out: Vector, up: Vector, size: tuple[float, float, float], material: str) -> Part:
    """A box on a surface: its size across, outwards and along `up`."""
    middle = _plus(centre, (0.5 * size[1] - 0.01, out))
    return Part(name, "box", middle, up, _cross(out, up), size, material, ESTIMATE)


def _axes(port: Port) -> tuple[Vector, Vector, Vector]:
    """Outwards, up and right as a docked chaser has them."""
    out = port.normal
    up = (0.0, -1.0, 0.0) if abs(out[2]) > 0.9 else (0.0, 0.0, -1.0)
    return out, up, _cross(out, up)


def _around(up: Vector, right: Vector, degrees: float) -> Vector:
    angle = math.radians(degrees)
    return tuple(math.cos(angle) * u + math.sin(angle) * r for u, r in zip(up, right))


def _target(name: str, centre: Vector, out: Vector, up: Vector, size: float) -> tuple[Part, ...]:
    """A docking target: a white cross before a black disc."""
    return (
        _disc(f"{name}_disc", centre, out, size, "black", 0.03),
        _slab(f"{name}_bar", _plus(centre, (0.05, out)), out, up, (0.14 * size, 0.04, 0.8 * size), "white"),
        _slab(
            f"{name}_cross", _plus(centre, (0.05, out)), out, _cross(out, up), (0.14 * size, 0.04, 0.8 * size), "white"
        ),
    )


def _androgynous(name: str, centre: Vector, out: Vector, up: Vector, right: Vector) -> tuple[Part, ...]:
    """Adapter: dark tunnel, pale hatch with a target, three guide petals that lean inwards."""
    petals = []
    for number in range(3):
        way = _around(up, right, 60.0 + 120.0 * number)
        lean = math.radians(35.0)
        along = tuple(math.cos(lean) * o - math.sin(lean) * w for o, w in zip(out, way))
        face = tuple(math.sin(lean) * o + math.cos(lean) * w for o, w in zip(out, way))
        middle = _plus(centre, (0.60, way), (0.06, out))
        petals.append(_slab(f"{name}_petal_{number}", middle, face, along, (0.55, 0.04, 0.26), "petal"))
    return (
        _disc(f"{name}_tunnel", centre, out, 1.22, "black", 0.012),
        _disc(f"{name}_hatch", centre, out, 0.86, "hatch", 0.03),
        *_target(f"{name}_target", _plus(centre, (0.03, out)), out, up, 0.36),
        *petals,
    )


def _berthing(name: str, centre: Vector, out: Vector, up: Vector, right: Vector) -> tuple[Part, ...]:
    """Common berthing mechanism: dark tunnel, square hatch with a window, four white covers folded outwards."""
    covers = [
        _slab(f"{name}_cover_{number}", _plus(centre, (1.33, way), (-0.12, out)), out, way, (0.85, 0.05, 0.62), "white")
        for number, way in enumerate(_around(up, right, 45.0 + 90.0 * number) for number in range(4))
    ]
    return (
        _disc(f"{name}_tunnel", centre, out, 1.78, "black", 0.012),
        _slab(f"{name}_hatch", centre, out, up, (1.22, 0.04, 1.22), "white"),
        _disc(f"{name}_window", _plus(centre, (0.03, out)), out, 0.30, "black"),
        *covers,
    )


def _drogue(name: str, centre: Vector, out: Vector, up: Vector, right: Vector, flank: float) -> tuple[Part, ...]:
    """Russian port: the receiving cone, its socket, and beside them a target and an antenna of the Kurs system."""
    way = _around(up, right, flank)
    side = _plus(centre, (1.02, way), (-0.25, out))
    dish = _plus(centre, (-1.15, way), (-0.45, out))
    return (
        _disc(f"{name}_cone", centre, out, 1.12, "drogue", 0.012),
        _disc(f"{name}_socket", centre, out, 0.26, "metal", 0.02),
        *_target(f"{name}_target", side, out, up, 0.60),
        rod(f"{name}_kurs_arm", _plus(centre, (-0.6, way), (-0.5, out)), dish, 0.08, "metal", ESTIMATE),
        rod(f"{name}_kurs", dish, _plus(dish, (0.16, out)), 0.2, "white", ESTIMATE, 0.45),
    )


def _mechanisms() -> tuple[Part, ...]:
    flanks = {"zvezda_aft": 180.0, "poisk_zenith": 90.0, "pirs_nadir": 0.0, "rassvet_nadir": -90.0}
    parts = []
    for port in PORTS:
        out, up, right = _axes(port)
        if port.mechanism == "IDSS":
            parts += _androgynous(port.name, port.interface, out, up, right)
        elif port.mechanism == "CBM":
            parts += _berthing(port.name, port.interface, out, up, right)
        else:
            parts += _drogue(port.name, port.interface, out, up, right, flanks[port.name])
    parts += _androgynous("tranquility_port", (11.7, 0.166, -3.1), X, Z, Y)
    return tuple(parts)


def _cupola() -> tuple[Part, ...]:
    """Six windows around the one that looks down, each in its frame."""
    parts = []
    for number in range(6):
        way = _around(X, Y, 30.0 + 60.0 * number)
        steep = math.atan2(0.75, 0.60)  # of the cone: 0.60 m inwards on 0.75 m of height
        along = tuple(math.cos(steep) * w + math.sin(steep) * z for w, z in zip(way, Z))
        face = tuple(math.sin(steep) * w - math.cos(steep) * z for w, z in zip(way, Z))
        middle = _plus((6.6, 0.166, -5.975), (1.14, way))
        parts.append(_slab(f"cupola_window_{number}", middle, face, along, (0.95, 0.05, 0.66), "glass"))
    return tuple(parts)


def _windows() -> tuple[Part, ...]:
    """Hatches and windows on flanks."""
    return (
        _disc("destiny_window", (0.233, -6.2, -4.752), _minus(Z), 0.75, "glass"),
        _disc("quest_hatch", (-7.7, 0.166, -2.602), _minus(X), 1.3, "hatch"),
        _disc("zvezda_window_nadir", (0.233, 28.2, -3.945), _minus(Z), 0.45, "glass"),
        *(
            _disc(f"{name}_hatch_{side}", (0.233 + sign * 1.275, 20.129, z), (sign, 0.0, 0.0), 1.15, "hatch", 0.06)
            for name, z in (("poisk", 1.3), ("pirs", -5.2))
            for side, sign in (("port", 1.0), ("starboard", -1.0))
        ),
        _disc("kibo_window_forward", (12.2, -17.139, -2.2), _minus(Y), 0.5, "glass"),
        _slab("kibo_flag", (8.2, -17.139, -2.4), _minus(Y), Z, (1.5, 0.02, 1.0), "white"),
        _disc("kibo_flag_sun", (8.2, -17.155, -2.4), _minus(Y), 0.55, "red"),
    )


def _flanks() -> tuple[Part, ...]:
    """What tells the Russian segment's nadir side from its zenith side: Zarya's radiators, boxes on Zvezda."""
    parts = []
    for name, degrees in (("port", 155.0), ("starboard", -155.0)):
        way = _around(Z, X, degrees)
        place = _plus((0.233, 12.8, -1.870), (2.02, way))
        parts.append(_slab(f"zarya_radiator_{name}", place, way, Y, (1.15, 0.08, 6.4), "radiator"))
    return (
        *parts,
        _slab("zvezda_box_forward", (-0.5, 22.4, -0.62), Z, Y, (0.8, 0.45, 0.9), "dark"),
        _slab("zvezda_box_aft", (0.9, 23.7, -0.62), Z, Y, (0.7, 0.35, 0.8), "foil"),
    )


DETAILS: tuple[Part, ...] = (*_mechanisms(), *_cupola(), *_windows(), *_flanks())
