"""The forces' example calls for the conformance tests, and their rows of its table."""

import jax.numpy as jnp
import numpy as np

from astrojax import ephemeris, forces

A = np.array
STATE = A([-3.9e6, 4.4e6, 3.4e6, -5.1e3, -5.3e3, 1.7e3])
SUN = A([-9.4e10, 1.09e11, 4.7e10])
MOON = A([3.58e8, -1.49e8, -6.0e7])
DIRECTION = A([0.5, -0.7, 0.4, 1e-3, -2e-3, 5e-4])
MODEL = forces.ForceModel(
    (forces.PointMass(), forces.Zonal(4), forces.ThirdBody("sun"), forces.ThirdBody("moon"), forces.Drag())
)
NO_DRAG = forces.ForceModel(MODEL.forces[:-1])

# Decorators, files, what takes names; and a function of but two values, whose tests are its own.
HOST = {"force", "static", "environment_at", "gravity_field", "load_gfc", "polyhedron", "solid_angle_polyhedron"}


def _world(dtype):
    return forces.Environment(jnp.asarray(SUN, dtype), jnp.asarray(MOON, dtype))


def _accel(state, mass):
    spacecraft = forces.Spacecraft(mass, 50.0, 2.2)
    return MODEL.accel(0.0, state[:3], state[3:], spacecraft, _world(state.dtype))


def _derivative(state, gm):
    model = forces.ForceModel((forces.PointMass(gm), *NO_DRAG.forces[1:]))
    return model.derivative(0.0, state, forces.Spacecraft(), _world(state.dtype))


def _relative(chief, separation, mass):
    station, own = forces.Spacecraft(4.2e5, 1500.0, 2.2), forces.Spacecraft(mass, 50.0, 2.2)
    chief, separation = (chief[:3], chief[3:]), (separation[:3], separation[3:])
    return MODEL.relative(0.0, *chief, *separation, station, own, _world(mass.dtype))


def _plain_difference(chief, separation, mass):
    station, own = forces.Spacecraft(4.2e5, 1500.0, 2.2), forces.Spacecraft(mass, 50.0, 2.2)
    orbits = chief[:3], chief[3:], separation[:3], separation[3:]
    return forces.relative_acceleration(forces.Drag(), 0.0, *orbits, station, own, _world(mass.dtype))


def _field_difference(r, rho):
    return forces.field_difference(lambda x: forces.accel_zonal(x, 3), r, rho)


def _weighted(state, mass, weights):
    model = forces.ForceModel(MODEL.forces, weights)
    return model.accel(0.0, state[:3], state[3:], forces.Spacecraft(mass, 50.0, 2.2), _world(state.dtype))


def _rotation(seconds):
    return forces.earth_rotation(61253, seconds)


FIELD = forces.gravity_field("EGM2008", 12)
CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * [900.0, 500.0, 300.0]
SQUARES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
BOX = forces.polyhedron(CORNERS, np.array([t for a, b, c, d in SQUARES for t in ((a, b, c), (a, c, d))]))


def _harmonics(r, gm, radius):
    field = forces.GravityField(gm, radius, FIELD.c, FIELD.s)
    return forces.accel_spherical_harmonics(r, field, 12, 9)


def _harmonics_potential(r, gm):
    field = forces.GravityField(gm, FIELD.radius, FIELD.c, FIELD.s)
    return forces.potential_spherical_harmonics(r, field, 5)


def _plates(r, sun, mass, normals, areas, specular, diffuse):
    return forces.accel_radiation_plates(r, sun, mass, forces.Plates(normals, areas, specular, diffuse))


PLATES = (np.eye(3) * [[1], [-1], [1]], A([3.0, 4.0, 5.0]), A([0.2, 0.3, 0.1]), A([0.3, 0.4, 0.2]))
GM, RADIUS = A(3.986e14), A(6378136.3)
LEO = STATE[:3]
POLE = A([0.0, 0.0, 6.9e6])
NEAR, FAR, WITHIN = A([950.0, 200.0, -100.0]), A([-900.0, 1500.0, 2000.0]), A([100.0, -200.0, 120.0])


def _on_polyhedron(fn):
    return lambda r, density: fn(r, BOX, density)


SUN_WARD = SUN / np.linalg.norm(SUN)


def _shadow(r, sun):
    return ephemeris.illumination_cylindrical(r, sun)


def cases(case):
    return [
        case("accel_spherical_harmonics", _harmonics, *((r, GM, RADIUS) for r in (LEO, POLE, -POLE)), rtol32=1e-5),
        case("potential_spherical_harmonics", _harmonics_potential, *((r, GM) for r in (LEO, POLE)), rtol32=1e-5),
        case(
            "accel_polyhedron",
            _on_polyhedron(forces.accel_polyhedron),
            *((r, A(2400.0)) for r in (NEAR, FAR, WITHIN)),
            rtol32=3e-5,
        ),
        case(
            "potential_polyhedron",
            _on_polyhedron(forces.potential_polyhedron),
            *((r, A(2400.0)) for r in (NEAR, FAR, WITHIN)),
            rtol32=3e-5,
        ),
        case("accel_radiation", forces.accel_radiation, (STATE[:3], SUN, A(1e3), A(12.0), A(1.7), A(4.5e-6))),
        case("accel_radiation_plates", _plates, (STATE[:3], SUN, A(1e3), *PLATES)),
        case("accel_schwarzschild", forces.accel_schwarzschild, (STATE[:3], STATE[3:], GM)),
        case("accel_lense_thirring", forces.accel_lense_thirring, (STATE[:3], STATE[3:], A([0.0, 1e8, 9.8e8]), GM)),
        case(
            "solid_tide_coefficients",
            forces.solid_tide_coefficients,
            (MOON, A(4.9e12), GM, RADIUS),
            (SUN, A(1.327e20), GM, RADIUS),
        ),
        # Constant but for a jump: lit, in shadow, and beside it
        case("illumination_cylindrical", _shadow, *((r, SUN) for r in (7e6 * SUN_WARD, -7e6 * SUN_WARD, POLE))),
        case("ForceModel.accel", _accel, (STATE, A(1.2e4))),
        case("ForceModel.accel/weights", _weighted, (STATE, A(1.2e4), A([1.0, 1.0, 0.5, 0.0, 1.0]))),
        case("ForceModel.derivative", _derivative, (STATE, A(3.986e14))),
        case(
            "ForceModel.relative",
            _relative,
            *((STATE, s * DIRECTION, A(1.2e4)) for s in (200.0, 1e3, 5e3)),  # nearer, 1e-17 m/s2 of rounding shows
            rtol32=1e-5,
        ),
        case("relative_acceleration", _plain_difference, (STATE, 1e3 * DIRECTION, A(1.2e4)), rtol32=1e-3),
        case("field_difference", _field_difference, (STATE[:3], A([300.0, -500.0, 800.0])), rtol32=1e-4),
        case("earth_rotation", _rotation, (A(43210.0),)),
    ]


# room, model, source, held against, largest error measured, range
MODELS = [
    (
        "forces",
        "spherical harmonics to degree 360",
        "Cunningham 1970; Holmes and Featherstone 2002",
        "60-digit arithmetic; brahe (EGM2008 120x120, GGM05S, JGM3)",
        "4e-15 and 7e-15 relative at degrees 120 and 200 (float32 6e-6, 1e-5); 8e-15 m/s2",
        "100 km to GEO, poles included",
    ),
    (
        "forces",
        "polyhedron of even density",
        "Werner and Scheeres 1996",
        "closed form of a box; a sphere of 5120 faces",
        "6e-14 relative; 2e-6 (the mesh)",
        "in and outside, off the edges",
    ),
    (
        "forces",
        "solid Earth tides, step 1",
        "IERS Conventions 2010, eq. 6.6, 6.7, 6.14",
        "Rodrigues' formula and longitudes; brahe",
        "1e-14 of the coefficients; 6e-4 of the acceleration",
        "low orbit",
    ),
    (
        "forces",
        "Schwarzschild, Lense-Thirring",
        "IERS Conventions 2010, eq. 10.12",
        "its definition; brahe; the advance of perigee",
        "1e-14; 1e-8; 1e-9 relative",
        "-",
    ),
    (
        "forces",
        "radiation pressure, cannonball and plates",
        "Montenbruck and Gill sec. 3.4",
        "brahe; absorber, mirror, white plate, spheres of 20 000 plates",
        "1e-14; 1e-12, 1e-3 (the plates)",
        "-",
    ),
    (
        "forces",
        "cylindrical shadow",
        "Montenbruck and Gill sec. 3.4.2",
        "brahe",
        "equal at 500 places",
        "150 to 5600 km",
    ),
    (
        "forces",
        "Earth rotation angle about the inertial pole",
        "IERS Conventions 2010, eq. 5.5",
        "ERFA",
        "1e-11",
        "1990-2050",
    ),
]
