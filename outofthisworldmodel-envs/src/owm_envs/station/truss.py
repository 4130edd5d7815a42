"""The unpressurised station: truss, solar arrays, radiators, platforms, instruments and robots."""

from owm_envs.station.modules import SUN
from owm_envs.station.primitives import (
    ESTIMATE,
    EXTENT,
    POSE,
    PUBLISHED,
    Part,
    Vector,
    ball,
    beam,
    box,
    rod,
    sheet,
    tube,
)

_Y, _Z = (-7.0, -3.0), (1.0, 5.0)  # the truss in y and z
_LINE = (-5.0, 3.0)
_LATTICE = "segment length published; lattice and core simplified"
_LONGERON = 0.24


def _segment(label: str, start: float, end: float, bays: int) -> tuple[Part, ...]:
    """A lattice segment along x: a core of trays and boxes, four longerons, frames, a diagonal a face and bay."""
    core = box(f"truss_{label}_core", (start, end), (-6.3, -3.7), (1.7, 4.3), "equipment", _LATTICE)
    inset = 0.5 * _LONGERON
    corners = [(y, z) for y in (_Y[0] + inset, _Y[1] - inset) for z in (_Z[0] + inset, _Z[1] - inset)]
    parts = [core]
    for number, (y, z) in enumerate(corners):
        name = f"truss_{label}_longeron_{number}"
        parts.append(rod(name, (start, y, z), (end, y, z), _LONGERON, "truss", _LATTICE))
    step = (end - start) / bays
    for number in range(bays + 1):
        x = min(max(start + number * step, start + 0.12), end - 0.12)
        frame = ((x - 0.12, x + 0.12), (_Y[0] + 0.06, _Y[1] - 0.06), (_Z[0] + 0.06, _Z[1] - 0.06))
        parts.append(box(f"truss_{label}_frame_{number}", *frame, "truss", _LATTICE))
    faces = [(corners[a], corners[b]) for a, b in ((0, 1), (1, 3), (3, 2), (2, 0))]
    for bay in range(bays):
        ends = (start + bay * step, start + (bay + 1) * step)
        for number, (first, second) in enumerate(faces):
            a, b = (first, second) if (bay + number) % 2 else (second, first)
            name = f"truss_{label}_diagonal_{bay}_{number}"
            parts.append(rod(name, (ends[0], *a), (ends[1], *b), 0.18, "truss", _LATTICE))
    return tuple(parts)


def _joint(label: str, start: float, end: float) -> tuple[Part, ...]:
    """A solar alpha rotary joint between two segments: the race ring and the drum inside."""
    middle = 0.5 * (start + end)
    return (
        tube(f"truss_{label}_drum", "x", (start, end), _LINE, 2.8, 2.8, "metal", ESTIMATE),
        tube(
            f"truss_{label}_race",
            "x",
            (middle - 0.3, middle + 0.3),
            _LINE,
            3.3,
            3.3,
            "truss",
            "ring 3.2 m; place estimated",
        ),
    )


def _electronics(label: str, start: float, end: float) -> tuple[Part, ...]:
    """The integrated equipment assembly of a photovoltaic segment: batteries and power electronics."""
    low, high = min(start, end), max(start, end)
    return (
        box(f"truss_{label}_equipment", (low, high), (-6.9, -3.1), (1.2, 4.8), "blanket", _LATTICE),
        *(
            box(f"truss_{label}_edge_{i}", (low, high), (y - 0.12, y + 0.12), (z - 0.12, z + 0.12), "truss", _LATTICE)
            for i, (y, z) in enumerate((y, z) for y in (-6.88, -3.12) for z in (1.12, 4.88))
        ),
        *(
            box(f"truss_{label}_battery_{i}", (x - 0.45, x + 0.45), (-7.0, -3.0), (1.7, 4.3), "equipment", ESTIMATE)
            for i, x in enumerate(low + (high - low) * f for f in (0.2, 0.5, 0.8))
        ),
    )


def _side(label: str, sign: float) -> tuple[Part, ...]:
    """The truss outboard of S0 on one side: 1, 3, joint, 4, 5, 6."""

    def span(inner: float, outer: float) -> tuple[float, float]:
        return (inner, outer) if sign > 0 else (-outer, -inner)

    return (
        *_segment(f"{label}1", *span(6.7, 20.4), 4),
        *_segment(f"{label}3", *span(20.4, 26.3), 2),
        *_joint(f"{label}3_alpha_joint", *span(26.3, 27.6)),
        *_electronics(f"{label}4", *span(27.6, 34.6)),
        *_segment(f"{label}5", *span(34.6, 37.6), 1),
        *_segment(f"{label}6_spacer", *span(37.6, 44.4), 2),
        *_electronics(f"{label}6", *span(44.4, 51.3)),
    )


def _cradle() -> tuple[Part, ...]:
    """The struts that carry S0 on Destiny."""
    feet = [(0.233 + dx, y, -0.95) for dx in (-1.3, 1.3) for y in (-6.6, -3.6)]
    heads = [(0.233 + dx, y, 1.15) for dx in (-2.7, 2.7) for y in (-6.7, -3.3)]
    pairs = [(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (1, 0), (2, 3), (3, 2)]
    return tuple(
        rod(f"s0_strut_{i}", feet[a], heads[b], 0.2, "truss", "struts from S0 to Destiny; " + ESTIMATE)
        for i, (a, b) in enumerate(pairs)
    )


_TRUSS = (*_segment("s0", -6.7, 6.7, 4), *_cradle(), *_side("p", 1.0), *_side("s", -1.0))

# Solar arrays. Both wings of a pair lie on one line in the y-z plane.
_HUB = (-4.5, 2.5)  # middle of that line: y and z
_HALF_SPAN = 0.5 * 6170.0**0.5
_ROOT = 4.2  # distance from the hub to the inner edge of the blankets [m]


_MAST = "lattice mast, slimmer here than its longerons stand apart (1.1 m)"


def _at(x: float, along: float) -> Vector:
    return (x, _HUB[0] + along * SUN[1], _HUB[1] + along * SUN[2])


def _wing(label: str, x: float, sign: float) -> tuple[Part, ...]:
    """One wing: joint, mast, two blankets between their boxes. Quoted extents: 14 m wide, 35 m long."""
    name = f"array_{label}"
    tip = _HALF_SPAN - 0.06  # so that the rotated end of a box stays within the quoted extent
    parts = [
        rod(f"{name}_beta_joint", _at(x, sign * 1.0), _at(x, sign * 2.6), 1.3, "metal", ESTIMATE),
        rod(f"{name}_canister", _at(x, sign * 2.5), _at(x, sign * 4.4), 1.15, "equipment", ESTIMATE),
        rod(f"{name}_mast", _at(x, sign * (_ROOT + 0.2)), _at(x, sign * (tip - 0.2)), 0.45, "truss", _MAST),
    ]
    for half, side in (("starboard", -1.0), ("port", 1.0)):
        middle = x + side * 3.85
        parts += [
            sheet(
                f"{name}_blanket_{half}",
                _at(middle, sign * (_ROOT + 0.2)),
                _at(middle, sign * (tip - 0.2)),
                6.3,
                0.05,
                "array",
                EXTENT,
                (-sign, 0.0, 0.0),  # local y, the side of the cells, towards forward and zenith
            ),
            *(
                beam(
                    f"{name}_{end}_box_{half}", _at(middle, sign * a), _at(middle, sign * b), 6.3, 0.2, "truss", EXTENT
                )
                for end, a, b in (("root", _ROOT - 0.2, _ROOT + 0.2), ("tip", tip - 0.25, tip))
            ),
        ]
    bar = _at(x - 0.8, sign * _ROOT), _at(x + 0.8, sign * _ROOT)
    parts.append(rod(f"{name}_root_bar", *bar, 0.4, "metal", ESTIMATE))
    return tuple(parts)


_ARRAYS = tuple(
    part
    for label, x in (("p4", 34.0), ("s4", -34.0), ("p6", 50.0), ("s6", -50.0))
    for end, sign in (("zenith", 1.0), ("nadir", -1.0))
    for part in _wing(f"{label}_{end}", x, sign)
)


def _photovoltaic_radiator(label: str, x: float) -> tuple[Part, ...]:
    """Edge on to the Sun, so normal to the blankets; from the truss to aft and nadir."""
    axis = (0.0, SUN[2], -SUN[1])
    start, foot, end = ((x, _LINE[0] + d * axis[1], _LINE[1] + d * axis[2]) for d in (1.6, 2.2, 15.8))
    name = f"photovoltaic_radiator_{label}"
    return (
        sheet(name, foot, end, 3.4, 0.12, "radiator", "13.6 m by 3.4 m; place fitted"),
        beam(f"{name}_base", start, foot, 2.4, 0.7, "equipment", ESTIMATE),
    )


def _truss_radiator(label: str, x: float) -> tuple[Part, ...]:
    """Three panels one above the other in a plane of constant x, on one beam behind the rotary joint."""
    panels = tuple(
        sheet(
            f"radiator_{label}_{i}",
            (x, -2.3, z),
            (x, 21.0, z),
            3.4,
            0.15,
            "radiator",
            "23.3 m by 3.4 m published; place from the quoted extents",
            (0.0, 0.0, 1.0),
        )
        for i, z in enumerate((-2.3, 2.5, 7.3))
    )
    beam_ = box(f"radiator_{label}_beam", (x - 0.45, x + 0.45), (-3.0, -2.3), (-3.9, 8.9), "truss", EXTENT)
    joint = tube(f"thermal_joint_{label}", "y", (-3.8, -2.9), (x, 2.5), 1.5, 1.5, "metal", ESTIMATE)
    return (*panels, beam_, joint)


_TRAILING = (
    sheet(
        "trailing_thermal_radiator",
        (40.2, -2.6, 4.2),
        (40.2, 11.0, 4.2),
        3.4,
        0.12,
        "radiator",
        "P6 trailing thermal control radiator, deployed 2012 to 2015; 13.6 m by 3.4 m; place estimated",
        (1.0, 0.0, 0.0),
    ),
    box("trailing_thermal_radiator_base", (39.2, 41.2), (-3.2, -2.5), (3.6, 4.7), "equipment", ESTIMATE),
    box("starboard_thermal_radiator_stowed", (42.0, 43.2), (-5.7, -2.4), (5.0, 6.1), "radiator", "stowed; " + ESTIMATE),
)

_RADIATORS = (
    *_truss_radiator("p1", 15.0),
    *_truss_radiator("s1", -15.0),
    *(
        part
        for label, x in (("p4", 30.4), ("s4", -30.4), ("p6", 47.0), ("s6", -47.0))
        for part in _photovoltaic_radiator(label, x)
    ),
    *_TRAILING,
)


def _carrier(name: str, x: float, deck: float, up: float, source: str, width: float = 4.5) -> tuple[Part, ...]:
    """A logistics carrier or stowage platform: a deck at height z, three units on it, a mast to the truss."""
    low, high = x, x + width
    foot = 5.0 if up > 0 else 1.0

    def z(a: float, b: float) -> tuple[float, float]:
        return min(deck + up * a, deck + up * b), max(deck + up * a, deck + up * b)

    units = ((0.1, 1.35, -6.5, -4.7, 0.9), (1.5, 2.9, -5.9, -3.5, 0.7), (3.05, width - 0.1, -6.4, -4.1, 1.0))
    return (
        box(f"{name}_deck", (low, high), (-6.6, -3.3), z(0.0, 0.25), "metal", source),
        *(
            box(f"{name}_unit_{i}", (low + a, low + b), (c, d), z(0.25, 0.25 + h), "equipment", "units; " + ESTIMATE)
            for i, (a, b, c, d, h) in enumerate(units)
        ),
        box(
            f"{name}_mount",
            (x + 0.5 * width - 0.4, x + 0.5 * width + 0.4),
            (-5.4, -4.6),
            (min(foot, deck), max(foot, deck)),
            "metal",
            ESTIMATE,
        ),
    )


_CARRIER = "deck about 4.5 m by 3.3 m; site published, place estimated"
_OUTFITTING = (
    *_carrier("elc_1", 20.7, 0.45, -1.0, "ELC-1, P3 nadir; " + _CARRIER),
    *_carrier("elc_3", 20.7, 5.55, 1.0, "ELC-3, P3 zenith; " + _CARRIER),
    *_carrier("elc_4", -24.9, 0.45, -1.0, "ELC-4, S3 nadir inboard; " + _CARRIER),
    *_carrier("elc_2", -29.3, 5.55, 1.0, "ELC-2, S3 zenith outboard; " + _CARRIER),
    *_carrier("stowage_platform_3", -29.3, 0.45, -1.0, "ESP-3, S3 nadir outboard; " + ESTIMATE, 4.0),
    box("ams_02_base", (-24.1, -20.1), (-6.6, -3.4), (5.2, 5.9), "metal", "AMS-02, S3 zenith; " + PUBLISHED),
    tube("ams_02", "z", (5.9, 8.2), (-22.1, -5.0), 3.0, 2.7, "blanket", "AMS-02: 3.1 m tall class; " + ESTIMATE),
    box("ams_02_radiator_forward", (-24.0, -20.2), (-6.75, -6.6), (5.9, 7.9), "radiator", ESTIMATE),
    box("ams_02_radiator_aft", (-24.0, -20.2), (-3.4, -3.25), (5.9, 7.9), "radiator", ESTIMATE),
    *(
        box(f"{name}_tank", (x - 0.9, x + 0.9), (-6.6, -4.6), (5.0, 6.2), "blanket", "tank assembly; " + ESTIMATE)
        for name, x in (("p1_ammonia", 18.0), ("p1_nitrogen", 12.2), ("s1_ammonia", -18.0), ("s1_nitrogen", -12.2))
    ),
    *(
        box(f"{name}_cart", (x - 1.2, x + 1.2), (-8.0, -7.0), (1.6, 4.2), "metal", "CETA cart on its rail; " + ESTIMATE)
        for name, x in (("port", 8.6), ("starboard", -7.2))
    ),
    rod("p1_antenna_mast", (9.5, -5.0, 5.0), (9.5, -5.0, 6.6), 0.12, "metal", ESTIMATE),
    ball("p1_antenna", (9.5, -5.0, 6.7), 0.5, "blanket", ESTIMATE),
    rod("s1_antenna_mast", (-9.5, -5.0, 1.0), (-9.5, -5.0, -0.6), 0.12, "metal", ESTIMATE),
    rod("s1_antenna_dish", (-9.5, -5.0, -0.6), (-9.5, -5.0, -0.9), 0.5, "blanket", ESTIMATE, 0.9),
)

# Mobile base on the forward face of S1, the arm on its starboard fixture, folded forward of the truss.
_SHOULDER, _ELBOW, _WRIST = (-11.3, -10.1, 4.3), (-16.4, -11.2, 9.0), (-20.5, -11.0, 3.35)
_ROBOTS = (
    box(
        "mobile_transporter",
        (-14.2, -11.4),
        (-8.3, -7.0),
        (1.4, 4.6),
        "metal",
        "2.7 m by 2.6 m by 1.0 m class; " + POSE,
    ),
    box("mobile_base", (-15.6, -10.0), (-9.3, -8.3), (1.2, 4.8), "blanket", "5.7 m by 4.5 m by 2.9 m class; " + POSE),
    rod("canadarm2_base", (-11.3, -9.3, 4.0), (-11.3, -10.1, 4.0), 0.6, "metal", POSE),
    ball("canadarm2_shoulder", _SHOULDER, 0.75, "arm", POSE),
    rod("canadarm2_upper_boom", _SHOULDER, _ELBOW, 0.36, "arm", "boom about 7 m; " + POSE),
    ball("canadarm2_elbow", _ELBOW, 0.8, "arm", POSE),
    rod("canadarm2_lower_boom", _ELBOW, _WRIST, 0.36, "arm", "boom about 7 m; " + POSE),
    ball("canadarm2_wrist", _WRIST, 0.75, "arm", POSE),
    rod("canadarm2_effector", _WRIST, (-20.9, -9.9, 3.0), 0.5, "metal", POSE),
    beam("dextre_body", (-15.1, -9.9, 0.6), (-15.1, -9.9, 4.1), 0.9, 0.9, "blanket", "3.5 m tall; " + POSE),
    *(
        part
        for label, side in (("a", -1.0), ("b", 1.0))
        for part in (
            rod(
                f"dextre_{label}_upper",
                (-15.1 + side * 0.5, -10.2, 3.6),
                (-15.1 + side * 1.3, -11.1, 2.2),
                0.25,
                "arm",
                POSE,
            ),
            rod(
                f"dextre_{label}_fore",
                (-15.1 + side * 1.3, -11.1, 2.2),
                (-15.1 + side * 0.7, -10.8, 0.6),
                0.25,
                "arm",
                POSE,
            ),
        )
    ),
)

TRUSS: tuple[Part, ...] = (*_TRUSS, *_RADIATORS, *_ARRAYS, *_OUTFITTING, *_ROBOTS)
