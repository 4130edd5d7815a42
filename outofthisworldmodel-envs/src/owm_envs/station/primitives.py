"""The vocabulary of the table of parts: five solid primitives, a palette of materials, and ways to place them.

Every primitive is convex. Frame of a part: local z along `axis`, local x along `side`.
"""

import math
from typing import Literal, NamedTuple

Vector = tuple[float, float, float]
Pair = tuple[float, float]


class Material(NamedTuple):
    """A surface of metallic-roughness shading; the figures are chosen by eye from photographs."""

    colour: Vector
    """sRGB, 0 to 1."""
    metallic: float
    roughness: float


MATERIALS: dict[str, Material] = {
    "shield": Material((0.84, 0.84, 0.83), 0.15, 0.50),  # aluminium debris shields of the US segment
    "blanket": Material((0.88, 0.87, 0.84), 0.0, 0.75),  # white multi-layer insulation
    "russian": Material((0.70, 0.69, 0.635), 0.0, 0.80),  # grey-beige insulation of the Russian segment
    "russian_white": Material((0.80, 0.80, 0.77), 0.0, 0.80),  # its younger modules
    "adapter": Material((0.27, 0.27, 0.28), 0.1, 0.60),  # the dark cones between two docking standards
    "metal": Material((0.58, 0.59, 0.60), 0.6, 0.45),  # docking rings, joints
    "berth": Material((0.72, 0.73, 0.74), 0.3, 0.50),  # berthing rings
    "hatch": Material((0.74, 0.74, 0.72), 0.0, 0.60),
    "drogue": Material((0.22, 0.22, 0.21), 0.2, 0.55),  # the receiving cone of a Russian port
    "petal": Material((0.78, 0.72, 0.55), 0.3, 0.45),  # guides of a docking ring
    "dark": Material((0.20, 0.21, 0.23), 0.2, 0.60),
    "black": Material((0.06, 0.06, 0.07), 0.0, 0.60),
    "white": Material((0.95, 0.95, 0.94), 0.0, 0.60),
    "red": Material((0.75, 0.10, 0.12), 0.0, 0.60),
    "truss": Material((0.88, 0.88, 0.86), 0.1, 0.60),
    "foil": Material((0.83, 0.68, 0.42), 0.6, 0.40),  # golden insulation
    "equipment": Material((0.80, 0.80, 0.78), 0.0, 0.70),
    "radiator": Material((0.96, 0.96, 0.97), 0.0, 0.50),
    "array": Material((0.70, 0.54, 0.32), 0.3, 0.40),  # gold-brown blankets of the large arrays
    "array_back": Material((0.86, 0.70, 0.42), 0.1, 0.50),  # their reverse: film with the cells behind
    "array_blue": Material((0.30, 0.31, 0.38), 0.3, 0.30),  # frames of the Russian arrays and the chaser's
    "glass": Material((0.05, 0.07, 0.10), 0.0, 0.10),
    "arm": Material((0.93, 0.92, 0.88), 0.0, 0.55),
    "dragon": Material((0.93, 0.93, 0.92), 0.0, 0.55),  # painted cork of the capsule
    "trunk": Material((0.86, 0.87, 0.88), 0.0, 0.45),  # it carries the chaser's radiators
    "heat_shield": Material((0.25, 0.19, 0.15), 0.0, 0.90),
}


class Part(NamedTuple):
    """One part: a solid primitive with its pose, its material, and where its figures come from."""

    name: str
    primitive: Literal["box", "panel", "cylinder", "cone", "sphere"]
    position: Vector
    """Centre [m]."""
    axis: Vector
    """Unit vector of local z: the long axis of a cylinder, cone or panel."""
    side: Vector
    """Unit vector of local x, across `axis`."""
    dimensions: Vector
    """box, panel: extents along local x, y, z; a panel is thin along y. cylinder: diameter, diameter, length.
    cone: diameter at the -axis end, at the +axis end, length. sphere: diameter three times. All [m]."""
    material: str
    """A key of `MATERIALS`."""
    source: str


X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)

# What a figure rests on; `source` of a part is one of these, or one with a remark.
PUBLISHED = "length and diameter: NASA, Reference Guide to the International Space Station, NP-2015-05-022-JSC"
PORTS = "ends at the mating planes of the ports table; diameters estimated"
EXTENT = "fitted to the quoted extents of the 2015 station in this frame"
ESTIMATE = "estimated from photographs; no figure published that we used"
POSE = "lengths: Canadian Space Agency and NASA fact sheets; pose chosen, clear of every corridor"


def _unit(vector: Vector) -> Vector:
    norm = math.sqrt(sum(v * v for v in vector))
    return tuple(v / norm for v in vector)


def _across(axis: Vector) -> Vector:
    """Some unit vector normal to an axis: in the plane of the frame axis that is most nearly normal to it."""
    least = min(range(3), key=lambda i: (round(abs(axis[i]), 9), i))
    return _unit(tuple((i == least) - axis[least] * axis[i] for i in range(3)))


def box(name: str, x: Pair, y: Pair, z: Pair, material: str, source: str) -> Part:
    """A box along the frame axes, by its ranges."""
    centre = tuple(0.5 * (a + b) for a, b in (x, y, z))
    return Part(name, "box", centre, Z, X, tuple(b - a for a, b in (x, y, z)), material, source)


def tube(name: str, axis: str, span: Pair, place: Pair, d0: float, d1: float, material: str, source: str) -> Part:
    """A cylinder or cone along a frame axis; `place` holds the other two coordinates in frame order."""
    index = "xyz".index(axis)
    start, end = ((*place[:index], end, *place[index:]) for end in span)
    return rod(name, start, end, d0, material, source, d1)


def rod(
    name: str,
    start: Vector,
    end: Vector,
    diameter: float,
    material: str,
    source: str,
    end_diameter: float | None = None,
) -> Part:
    """A cylinder or cone between two points."""
    d1 = diameter if end_diameter is None else end_diameter
    centre = tuple(0.5 * (a + b) for a, b in zip(start, end))
    axis = _unit(tuple(b - a for a, b in zip(start, end)))
    kind = "cylinder" if d1 == diameter else "cone"
    return Part(name, kind, centre, axis, _across(axis), (diameter, d1, math.dist(start, end)), material, source)


def ball(name: str, centre: Vector, diameter: float, material: str, source: str) -> Part:
    """A sphere."""
    return Part(name, "sphere", centre, Z, X, (diameter, diameter, diameter), material, source)


def sheet(
    name: str, start: Vector, end: Vector, width: float, thickness: float, material: str, source: str, side: Vector = X
) -> Part:
    """A thin plate between the middles of two opposite edges, its width along `side`."""
    centre = tuple(0.5 * (a + b) for a, b in zip(start, end))
    axis = _unit(tuple(b - a for a, b in zip(start, end)))
    return Part(name, "panel", centre, axis, side, (width, thickness, math.dist(start, end)), material, source)


def beam(
    name: str, start: Vector, end: Vector, width: float, depth: float, material: str, source: str, side: Vector = X
) -> Part:
    """A box between the middles of two opposite faces, its width along `side`."""
    return sheet(name, start, end, width, depth, material, source, side)._replace(primitive="box")


def module(
    name: str, axis: str, span: Pair, place: Pair, diameter: float, material: str, source: str, ends: Pair = (0.5, 0.5)
) -> tuple[Part, ...]:
    """A pressurised barrel with an end cone of the given depth on either side (none where the depth is 0)."""
    low, high = span
    barrel = tube(name, axis, (low + ends[0], high - ends[1]), place, diameter, diameter, material, source)
    neck = 0.62 * diameter
    cones = []
    if ends[0]:
        cones.append(tube(f"{name}_cone_low", axis, (low, low + ends[0]), place, neck, diameter, material, source))
    if ends[1]:
        cones.append(tube(f"{name}_cone_high", axis, (high - ends[1], high), place, diameter, neck, material, source))
    return (barrel, *cones)
