"""What the station is made of: a table of its parts as of February to May 2015, without visiting vehicles.

Leonardo sits at Tranquility's forward port (its place since 27 May 2015), so that Unity's nadir port is free.
Canadarm2, Dextre and their mobile base are left out because they move; so are handrails, antennas and cables.

Station frame: +x port side, +y aft, +z zenith, metres. Lengths and diameters are published figures; places
follow from the mating planes of the eight ports and from the extents quoted for the truss and the arrays.
"""

import math
from typing import Literal, NamedTuple


class Part(NamedTuple):
    """One part: a solid primitive with its pose, and how many collision boxes approximate it."""

    name: str
    primitive: Literal["box", "cylinder", "panel"]
    position: tuple[float, float, float]
    """Centre [m]."""
    axis: tuple[float, float, float]
    """Unit vector of the long axis: a cylinder's is a frame axis, a panel's normal to x; a box ignores it."""
    dimensions: tuple[float, float, float]
    """box: extents along x, y, z. cylinder: length, diameter at the -axis end, diameter at the +axis end.
    panel: length along the axis, width along x, thickness. All [m]."""
    boxes: int
    """cylinder: boxes in a cross-section. panel: tiles along the axis. box: 1."""
    source: str


_Pair = tuple[float, float]

_X, _Y, _Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_US = (0.233, -2.602)  # x and z of the line through Harmony, Destiny and Unity
_RS = (0.233, -1.870)  # x and z of the line through Zarya and Zvezda

_NASA = "NASA, Reference Guide to the International Space Station, NP-2015-05-022-JSC"
_PORTS = "between mating planes of the ports table"
_FOLDED = "Zarya's arrays are folded since 2007; " + _NASA
_EXTENT = "quoted extents of the 2015 station in this frame"


def _tube(name: str, axis: str, span: _Pair, place: _Pair, d0: float, d1: float, n: int, source: str) -> Part:
    """A cylinder or cone along a frame axis; `place` holds the other two coordinates in frame order."""
    index = "xyz".index(axis)
    centre = (*place[:index], 0.5 * (span[0] + span[1]), *place[index:])
    return Part(name, "cylinder", centre, (_X, _Y, _Z)[index], (span[1] - span[0], d0, d1), n, source)


def _box(name: str, x: _Pair, y: _Pair, z: _Pair, source: str) -> Part:
    centre = tuple(0.5 * (a + b) for a, b in (x, y, z))
    return Part(name, "box", centre, _Z, tuple(b - a for a, b in (x, y, z)), 1, source)


_US_MODULES = (
    _tube("pma_2", "y", (-20.84, -18.45), (0.194, -3.15), 1.4, 2.2, 3, _PORTS),
    _tube("harmony", "y", (-18.45, -11.25), _US, 4.4, 4.4, 4, _NASA),
    _tube("destiny", "y", (-11.25, -2.75), _US, 4.3, 4.3, 4, _NASA),
    _tube("unity", "y", (-2.75, 2.75), _US, 4.4, 4.4, 4, _NASA),
    _tube("pma_1", "y", (2.75, 6.30), (0.233, -2.15), 2.4, 1.9, 3, _PORTS),
    _tube("columbus", "x", (-9.0, -2.15), (-15.0, -2.602), 4.4, 4.4, 4, _NASA),
    _tube("columbus_payloads", "x", (-9.7, -9.0), (-15.0, -2.0), 2.6, 2.6, 1, _EXTENT),
    _tube("kibo_pressurised", "x", (2.65, 13.85), (-15.0, -2.602), 4.4, 4.4, 4, _NASA),
    _tube("kibo_logistics", "z", (-0.4, 3.5), (6.4, -15.0), 4.4, 4.4, 4, _NASA),
    _box("kibo_exposed_facility", (14.3, 19.9), (-17.5, -12.5), (-5.2, -1.4), _NASA),
    _box("kibo_payload_forward", (15.4, 18.8), (-19.0, -17.5), (-4.9, -3.3), _EXTENT),
    _box("kibo_payload_outboard", (19.9, 23.0), (-17.2, -14.0), (-4.9, -3.3), _EXTENT),
    _box("kibo_arm", (13.9, 14.9), (-15.6, -14.4), (-1.4, 1.2), _EXTENT),
    _tube("tranquility", "x", (2.65, 9.35), (0.166, -2.602), 4.4, 4.4, 4, _NASA),
    _tube("pma_3", "x", (9.35, 11.7), (0.166, -2.9), 2.2, 1.4, 3, _PORTS),
    _tube("cupola", "z", (-6.45, -4.95), (6.6, 0.166), 2.0, 2.95, 2, _NASA),
    _tube("leonardo", "y", (-8.85, -2.25), (6.6, -2.602), 4.5, 4.5, 4, _NASA),
    _tube("quest_equipment_lock", "x", (-5.2, -2.15), (0.166, -2.602), 4.0, 4.0, 3, _NASA),
    _tube("quest_crew_lock", "x", (-7.7, -5.2), (0.166, -2.602), 2.0, 2.0, 2, _NASA),
    _box("quest_gas_tanks", (-5.0, -2.4), (-1.6, 1.9), (-0.8, 0.4), _NASA),
    _box("external_stowage_platform_2", (-7.4, -4.0), (-3.6, -2.2), (-2.9, 0.4), _EXTENT),
    _box("z1_truss", (-1.6, 2.1), (-1.6, 1.9), (-0.4, 3.6), _NASA),
    _box("z1_antenna_boom", (-0.2, 0.6), (0.0, 1.0), (3.6, 7.2), _NASA),
)

_RUSSIAN_MODULES = (
    _tube("zarya_adapter", "y", (6.30, 8.05), _RS, 2.3, 2.3, 3, _NASA),
    _tube("zarya_body", "y", (8.05, 17.2), _RS, 4.1, 4.1, 4, _NASA),
    _tube("zarya_aft", "y", (17.2, 18.95), _RS, 2.6, 2.6, 3, _NASA),
    _box(
        "zarya_array_port",
        (2.3, 4.4),
        (11.9, 14.7),
        (-2.6, -1.1),
        _FOLDED,
    ),
    _box("zarya_array_starboard", (-3.9, -1.8), (11.9, 14.7), (-2.6, -1.1), _FOLDED),
    _tube("zvezda_transfer", "y", (18.95, 21.3), _RS, 2.2, 2.2, 3, _NASA),
    _tube("zvezda_small", "y", (21.3, 24.8), _RS, 2.9, 2.9, 3, _NASA),
    _tube("zvezda_cone", "y", (24.8, 26.0), _RS, 3.5, 3.5, 3, _NASA),
    _tube("zvezda_large", "y", (26.0, 31.6), _RS, 4.15, 4.15, 4, _NASA),
    _tube("zvezda_aft_drogue", "y", (31.6, 32.55), _RS, 1.9, 1.4, 2, _PORTS),
    _tube("poisk", "z", (-0.8, 3.555), (0.233, 20.129), 2.55, 2.0, 3, _NASA),
    _tube("pirs", "z", (-7.29, -2.95), (0.233, 20.129), 2.0, 2.55, 3, _NASA),
    _tube("rassvet", "z", (-9.267, -3.0), (0.24, 7.161), 2.0, 2.35, 3, _NASA),
    _box("rassvet_airlock_and_radiator", (1.4, 2.9), (6.3, 8.0), (-7.6, -4.4), _NASA),
)

_TRUSS = (
    _tube("truss_s0", "x", (-6.7, 6.7), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _box(
        "s0_struts",
        (-2.6, 3.0),
        (-6.6, -3.4),
        (-0.7, 1.1),
        "struts from S0 down to Destiny's cradle; " + _NASA,
    ),
    _tube("truss_p1", "x", (6.7, 20.4), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _tube("truss_s1", "x", (-20.4, -6.7), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _tube("truss_p3", "x", (20.4, 27.2), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _tube("truss_s3", "x", (-27.2, -20.4), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _tube("truss_p4", "x", (27.2, 34.1), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _tube("truss_s4", "x", (-34.1, -27.2), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _tube("truss_p5", "x", (34.1, 37.5), (-5.0, 3.0), 3.0, 3.0, 1, _NASA),
    _tube("truss_s5", "x", (-37.5, -34.1), (-5.0, 3.0), 3.0, 3.0, 1, _NASA),
    _tube("truss_p6", "x", (37.5, 51.3), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _tube("truss_s6", "x", (-51.3, -37.5), (-5.0, 3.0), 4.0, 4.0, 2, _NASA),
    _box("ams_02", (-24.2, -19.8), (-6.6, -3.4), (5.0, 8.2), "AMS-02 on S3, zenith; " + _NASA),
    _box("elc_1", (22.0, 26.6), (-6.6, -3.2), (-0.6, 0.9), "ELC-1 on P3, nadir; " + _NASA),
    _box("elc_3", (22.0, 26.6), (-6.6, -3.2), (5.0, 6.4), "ELC-3 on P3, zenith; " + _NASA),
    _box("elc_4", (-26.6, -22.0), (-6.6, -3.2), (-0.6, 0.9), "ELC-4 on S3, nadir; " + _NASA),
    _box("elc_2", (-29.4, -24.8), (-6.6, -3.2), (5.0, 6.4), "ELC-2 on S3, zenith; " + _NASA),
    _box("external_stowage_platform_3", (10.8, 14.4), (-8.4, -7.0), (1.6, 4.4), _NASA),
)

# Solar arrays: both wings of a pair lie on one line in the y-z plane through the truss.
_ARRAY_TIPS = ((-25.0, -31.0), (16.0, 36.0))
_ARRAY_ROOT = 4.2  # distance from the truss line to the inner edge of the blankets [m]
_HUB = (0.5 * (_ARRAY_TIPS[0][0] + _ARRAY_TIPS[1][0]), 0.5 * (_ARRAY_TIPS[0][1] + _ARRAY_TIPS[1][1]))
_HALF_SPAN = 0.5 * math.dist(*_ARRAY_TIPS)
_ARRAY_AXIS = (0.0, (_ARRAY_TIPS[1][0] - _HUB[0]) / _HALF_SPAN, (_ARRAY_TIPS[1][1] - _HUB[1]) / _HALF_SPAN)


def _in_array_plane(
    name: str, x: float, start: float, end: float, width: float, thickness: float, n: int, source: str
) -> Part:
    """A panel along the array axis, between two signed distances from the truss line."""
    middle = 0.5 * (start + end)
    centre = (x, _HUB[0] + middle * _ARRAY_AXIS[1], _HUB[1] + middle * _ARRAY_AXIS[2])
    return Part(name, "panel", centre, _ARRAY_AXIS, (abs(end - start), width, thickness), n, source)


def _wing(label: str, x: float, sign: float) -> tuple[Part, ...]:
    root, tip = sign * _ARRAY_ROOT, sign * _HALF_SPAN
    return (
        _in_array_plane(f"array_{label}_mast", x, sign * 1.2, root, 1.4, 1.2, 1, _NASA),
        _in_array_plane(f"array_{label}", x, root, tip, 14.0, 0.05, 12, _EXTENT),
    )


_ARRAYS = tuple(
    part
    for label, x in (("p4", 34.0), ("s4", -34.0), ("p6", 50.0), ("s6", -50.0))
    for end, sign in (("zenith", 1.0), ("nadir", -1.0))
    for part in _wing(f"{label}_{end}", x, sign)
)


def _photovoltaic_radiator(label: str, x: float) -> Part:
    """Edge on to the Sun, so normal to the blankets; 13.6 m by 3.4 m, from the truss to aft and nadir."""
    axis = (0.0, _ARRAY_AXIS[2], -_ARRAY_AXIS[1])
    middle = 2.2 + 0.5 * 13.6
    centre = (x, -5.0 + middle * axis[1], 3.0 + middle * axis[2])
    return Part(f"photovoltaic_radiator_{label}", "panel", centre, axis, (13.6, 3.4, 0.1), 5, _NASA)


def _truss_radiator(label: str, x: float) -> tuple[Part, ...]:
    """Three panels one above the other in a plane of constant x, on one beam at the truss."""
    source = "three 23.3 m by 3.4 m panels; " + _EXTENT
    panels = tuple(
        _box(f"radiator_{label}_{i}", (x - 0.15, x + 0.15), (-2.3, 21.0), (z, z + 4.1), source)
        for i, z in enumerate((-4.0, 0.45, 4.9))
    )
    beam = _box(f"radiator_{label}_beam", (x - 0.6, x + 0.6), (-3.0, -2.3), (-3.6, 8.6), source)
    return (*panels, beam)


_RADIATORS = (
    *_truss_radiator("p1", 15.0),
    *_truss_radiator("s1", -15.0),
    *(_photovoltaic_radiator(label, x) for label, x in (("p4", 30.4), ("s4", -30.4), ("p6", 41.2), ("s6", -41.2))),
)


def _zvezda_array(label: str, inboard: float, outboard: float) -> Part:
    """One wing of Zvezda, turned to the Sun like the large arrays; tiles along the chord."""
    centre = (0.5 * (inboard + outboard), 27.6, -1.870)
    return Part(f"zvezda_array_{label}", "panel", centre, _ARRAY_AXIS, (3.4, outboard - inboard, 0.1), 3, _NASA)


PARTS: tuple[Part, ...] = (
    *_US_MODULES,
    *_RUSSIAN_MODULES,
    *_TRUSS,
    *_RADIATORS,
    *_ARRAYS,
    _zvezda_array("port", 2.3, 15.1),
    _zvezda_array("starboard", -14.6, -1.8),
)
