"""Sunlight, tides and relativity against brahe, closed forms and independent arithmetic."""

import brahe
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax import constants, ephemeris, forces
from astrojax.forces import Plates, Relativity, SolarRadiation, SolidTides, Spacecraft

SUN = np.array([-9.4e10, 1.09e11, 4.7e10])
MOON = np.array([3.58e8, -1.49e8, -6.0e7])
R = np.array([-3.9e6, 4.4e6, 3.4e6])
V = np.array([-5.1e3, -5.3e3, 1.7e3])
WORLD = forces.Environment(SUN, MOON)
C = 299792458.0


def unit(a):
    return a / np.linalg.norm(a)


# --- sunlight ---


def test_cannonball_against_brahe(rng, x64):
    """1e-14 relative at the same pressure."""
    for r in rng.normal(size=(10, 3)) * 1e7:
        ours = forces.accel_radiation(jnp.asarray(r), jnp.asarray(SUN), 1000.0, 12.0, 1.7, 4.56e-6)
        theirs = brahe.accel_solar_radiation_pressure(r, SUN, 1000.0, 1.7, 12.0, 4.56e-6)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-14 * np.linalg.norm(theirs))


def test_cylindrical_shadow_against_brahe(rng, quick, x64):
    points = rng.normal(size=(500, 3))
    points = points / np.linalg.norm(points, axis=1, keepdims=True) * rng.uniform(6.6e6, 1.2e7, (500, 1))
    lit = quick(jax.vmap(lambda r: ephemeris.illumination_cylindrical(r, jnp.asarray(SUN))))(jnp.asarray(points))
    expected = np.array([brahe.eclipse_cylindrical(r, SUN) for r in points])
    np.testing.assert_array_equal(lit, expected)
    assert 0 < expected.mean() < 1


@pytest.mark.parametrize("shadow", ["conical", "cylindrical", "none"])
def test_sunlight_as_a_force(shadow, x64):
    craft = Spacecraft(mass=1000.0, srp_area=12.0, reflectivity=1.7)
    force, world = SolarRadiation(shadow=shadow), forces.Environment(jnp.asarray(SUN))
    lit, dark = 7e6 * unit(SUN), -7e6 * unit(SUN)
    expected = forces.accel_radiation(jnp.asarray(lit), jnp.asarray(SUN), 1000.0, 12.0, 1.7)
    np.testing.assert_array_equal(force.accel(0.0, jnp.asarray(lit), jnp.asarray(V), craft, world), expected)
    behind = np.linalg.norm(force.accel(0.0, jnp.asarray(dark), jnp.asarray(V), craft, world))
    assert behind == pytest.approx(np.linalg.norm(expected) if shadow == "none" else 0.0, rel=1e-3)
    with pytest.raises(ValueError, match=r"shadow: expected one of .* got 'dual'"):
        SolarRadiation(shadow="dual")


def test_plates_in_closed_form(x64):
    """Facing the Sun: absorbing 1, mirror 2, white 5/3 of the light's push; a sphere of plates: 1 + 4/9 diffuse."""
    sun, mass = jnp.asarray(SUN), 100.0
    base = float(np.linalg.norm(forces.accel_radiation(jnp.asarray(R), sun, mass, 1.0, 1.0)))
    towards = unit(SUN - R)

    def push(normals, areas, specular, diffuse):
        n = len(areas)
        plates = Plates(jnp.asarray(normals), jnp.asarray(areas), jnp.full(n, specular), jnp.full(n, diffuse))
        return np.asarray(forces.accel_radiation_plates(jnp.asarray(R), sun, mass, plates)) / base

    for specular, diffuse, factor in ((0.0, 0.0, 1.0), (1.0, 0.0, 2.0), (0.0, 1.0, 5.0 / 3.0)):
        np.testing.assert_allclose(push([towards], [1.0], specular, diffuse), -factor * towards, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(push([-towards], [1.0], specular, diffuse), 0.0)
    across = unit(np.cross(towards, [0.3, 0.2, 0.9]))
    mirror = unit(towards + across)  # at 45 degrees: light leaves along `across`, cos 45 of it meets the plate
    expected = -np.sqrt(0.5) * (towards + across)
    np.testing.assert_allclose(push([mirror], [1.0], 1.0, 0.0), expected, rtol=0, atol=1e-12)
    k = np.arange(20000) + 0.5
    z, turn = 1 - 2 * k / 20000, np.pi * (1 + np.sqrt(5)) * k
    sphere = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    areas = np.full(20000, 4.0 / 20000)  # cross-section one
    np.testing.assert_allclose(push(sphere, areas, 1.0, 0.0), -towards, rtol=0, atol=1e-3)  # a mirror ball: 1
    np.testing.assert_allclose(push(sphere, areas, 0.0, 1.0), -(1 + 4 / 9) * towards, rtol=0, atol=1e-3)


def test_plates_turn_with_the_spacecraft(x64):
    quaternion = jnp.asarray(unit(np.array([0.3, -0.4, 0.5, 0.7])))
    plates = Plates(jnp.asarray([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [-1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]]),
                    jnp.arange(1.0, 7.0), jnp.full(6, 0.2), jnp.full(6, 0.3))  # fmt: skip
    world = forces.Environment(jnp.asarray(SUN))
    craft = Spacecraft(mass=500.0, plates=plates, attitude=quaternion)
    w, x, y, z = np.asarray(quaternion)
    matrix = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                       [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                       [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])  # fmt: skip
    turned = plates._replace(normals=jnp.asarray(plates.normals @ matrix.T))
    ours = SolarRadiation(shadow="none").accel(0.0, jnp.asarray(R), jnp.asarray(V), craft, world)
    expected = forces.accel_radiation_plates(jnp.asarray(R), jnp.asarray(SUN), 500.0, turned)
    np.testing.assert_allclose(ours, expected, rtol=1e-12)


# --- relativity ---


def test_relativity_against_brahe_and_its_definition(x64):
    ours = forces.accel_schwarzschild(jnp.asarray(R), jnp.asarray(V))
    theirs = brahe.accel_relativity(np.concatenate([R, V]))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-8 * np.linalg.norm(theirs))
    gm, r = constants.GM_EARTH, np.linalg.norm(R)
    exact = gm / (C**2 * r**3) * ((4 * gm / r - V @ V) * R + 4 * (R @ V) * V)
    np.testing.assert_allclose(ours, exact, rtol=0, atol=1e-14 * np.linalg.norm(exact))
    spin = np.array([0.0, 0.0, 9.8e8])
    drag = 2 * gm / (C**2 * r**3) * (3 / r**2 * np.cross(R, V) * (R @ spin) + np.cross(V, spin))
    both = Relativity(lense_thirring=True).accel(0.0, jnp.asarray(R), jnp.asarray(V), Spacecraft(), WORLD)
    np.testing.assert_allclose(both - ours, drag, rtol=0, atol=1e-13 * np.linalg.norm(exact))
    assert 1e-3 < np.linalg.norm(drag) / np.linalg.norm(exact) < 0.1


def test_perigee_advances_by_relativity(x64):
    """6 pi gm / (c^2 a (1 - e^2)) a revolution, by averaging the force over a Kepler orbit (Gauss)."""
    a, e, gm = 2.66e7, 0.4, constants.GM_EARTH
    p = a * (1 - e * e)
    nu = (np.arange(400) + 0.5) * (2 * np.pi / 400)
    r = p / (1 + e * np.cos(nu))
    positions = np.stack([r * np.cos(nu), r * np.sin(nu), 0 * nu], axis=1)
    velocities = np.sqrt(gm / p) * np.stack([-np.sin(nu), e + np.cos(nu), 0 * nu], axis=1)
    accel = np.asarray(jax.vmap(forces.accel_schwarzschild)(jnp.asarray(positions), jnp.asarray(velocities)))
    radial = np.sum(accel * positions, axis=1) / r
    along = (positions[:, 0] * accel[:, 1] - positions[:, 1] * accel[:, 0]) / r
    rate = np.sqrt(p / gm) / e * (-radial * np.cos(nu) + along * (1 + r / p) * np.sin(nu))
    seconds = r * r / np.sqrt(gm * p)
    advance = np.mean(rate * seconds) * 2 * np.pi
    assert advance == pytest.approx(6 * np.pi * gm / (C**2 * p), rel=1e-9)


# --- tides ---


def legendre(n, m, u):
    """Normalised associated Legendre function, from Rodrigues' formula."""
    legendre = np.polynomial.legendre.Legendre.basis(n).deriv(m) if m else np.polynomial.legendre.Legendre.basis(n)
    factor = np.prod([float(k) for k in range(n - m + 1, n + m + 1)])
    return np.sqrt((2 - (m == 0)) * (2 * n + 1) / factor) * (1 - u * u) ** (m / 2) * legendre(u)


def test_tidal_coefficients_against_their_definition(x64):
    """IERS 2010 eq. 6.6 and 6.7 with Legendre functions and longitudes, 1e-15 of the tide."""
    k = {(2, 0): 0.30190, (2, 1): 0.29830 - 0.00144j, (2, 2): 0.30102 - 0.00130j,
         (3, 0): 0.093, (3, 1): 0.093, (3, 2): 0.093, (3, 3): 0.094}  # fmt: skip
    plus = (-0.00089, -0.00080, -0.00057)
    for body, gm in ((SUN, constants.GM_SUN), (MOON, constants.GM_MOON)):
        c, s = forces.solid_tide_coefficients(jnp.asarray(body), gm)
        d, u, longitude = np.linalg.norm(body), body[2] / np.linalg.norm(body), np.arctan2(body[1], body[0])
        expected = np.zeros((5, 5), complex)
        for (n, m), love in k.items():
            size = gm / constants.GM_EARTH * (constants.R_EARTH / d) ** (n + 1) * legendre(n, m, u)
            expected[n, m] = love / (2 * n + 1) * size * np.exp(-1j * m * longitude)
            if n == 2:
                expected[4, m] = plus[m] / 5 * size * np.exp(-1j * m * longitude)
        np.testing.assert_allclose(c, expected.real, rtol=0, atol=1e-14 * np.abs(expected).max())
        np.testing.assert_allclose(s, -expected.imag, rtol=0, atol=1e-14 * np.abs(expected).max())


def test_the_tide_is_that_of_a_yielding_earth(x64):
    """To 2 %: k2 times the tidal potential of the Moon, carried outwards as r^-3: along the Moon's direction."""
    moon = np.array([0.0, 3.844e8, 0.0])
    world = forces.Environment(sun=jnp.asarray(SUN) * 1e6, moon=jnp.asarray(moon), rotation=jnp.eye(3))
    r = 7e6
    accel = SolidTides().accel(0.0, jnp.asarray([0.0, r, 0.0]), jnp.asarray(V), Spacecraft(), world)
    expected = -3 * 0.30 * constants.GM_MOON * constants.R_EARTH**5 / (3.844e8**3 * r**4)
    assert accel[1] == pytest.approx(expected, rel=0.02)
    assert 1e-7 < abs(expected) < 1e-6


def test_tide_against_brahe(x64):
    """1e-3 of the tide (6e-4 measured): what it changes of the velocity over 10 s; brahe has its own Sun and Moon."""
    state, seconds, ends = np.concatenate([R, V]), 10.0, []
    epoch = brahe.Epoch.from_mjd(61253.0, brahe.TimeSystem.UTC)
    config = brahe.NumericalPropagationConfig.with_method(brahe.IntegrationMethod.RK4)
    config = config.with_initial_step(seconds).with_max_step(seconds)
    solid = brahe.TidesConfiguration(brahe.PermanentTideConfig.OFF, solid=brahe.SolidTideConfig(False, False))
    for tides in (None, solid):
        peer = brahe.ForceModelConfig(
            gravity=brahe.GravityConfiguration(degree=4, order=4),
            frame_transform=brahe.FrameTransformationModel.EARTH_ROTATION_ONLY,
            tides=tides,
        )
        propagator = brahe.NumericalOrbitPropagator(epoch, state, config, peer)
        propagator.propagate_to(epoch + seconds)
        ends.append(propagator.current_state())
    model = forces.ForceModel((SolidTides(),))
    ours = np.mean(
        [
            model.accel(0.0, *jnp.split(jnp.asarray(y), 2), Spacecraft(), model.environment(61253, t))
            for t, y in ((0.0, state), (seconds, ends[0]))
        ],
        axis=0,
    )
    theirs = (ends[1] - ends[0])[3:] / seconds
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-3 * np.linalg.norm(theirs))


def test_the_permanent_tide(x64):
    """A zero-tide field has it in C20 already: eq. 6.14."""
    world = forces.Environment(jnp.asarray(SUN), jnp.asarray(MOON), rotation=jnp.eye(3))
    given = (0.0, jnp.asarray(R), jnp.asarray(V), Spacecraft(), world)
    gap = SolidTides().accel(*given) - SolidTides(tide_system="zero_tide").accel(*given)
    c = np.zeros((3, 3))
    c[2, 0] = -4.4228e-8 * 0.31460 * 0.30190
    field = forces.GravityField(constants.GM_EARTH, constants.R_EARTH, c, np.zeros((3, 3)))
    expected = forces.accel_spherical_harmonics(jnp.asarray(R), field, 2)
    np.testing.assert_allclose(gap, expected, rtol=0, atol=1e-21 + 1e-9 * np.linalg.norm(expected))
    with pytest.raises(ValueError, match=r"tide_system: expected one of .* got 'mean'"):
        SolidTides(tide_system="mean")
