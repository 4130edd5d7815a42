"""Elements, forces and their sum against brahe, SciPy and closed forms."""

import decimal

import brahe
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from astrojax import constants, forces, frames, orbits, propagate

ISS = np.array([6795e3, 0.0005, np.radians(51.64), 0.7, 0.3, 1.9])
SUN = np.array([-9.4e10, 1.09e11, 4.7e10])
MOON = np.array([3.58e8, -1.49e8, -6.0e7])
MODEL = forces.ForceModel(
    (forces.PointMass(), forces.Zonal(4), forces.ThirdBody("sun"), forces.ThirdBody("moon"), forces.Drag())
)


def random_positions(rng, count, low=150e3, high=2000e3):
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions * (6378137.0 + rng.uniform(low, high, (count, 1)))


def random_elements(rng, count):
    low, high = [6.7e6, 0.0, 0.05, 0.1, 0.1, 0.1], [4.2e7, 0.7, 3.0, 6.2, 6.2, 6.2]
    return rng.uniform(low, high, (count, 6))


def test_constants_against_brahe():
    for ours, theirs in (
        (constants.GM_EARTH, brahe.GM_EARTH),
        (constants.R_EARTH, brahe.R_EARTH),
        (constants.J2, brahe.J2_EARTH),
        (constants.J3, brahe.J3_EARTH),
        (constants.J4, brahe.J4_EARTH),
        (constants.J5, brahe.J5_EARTH),
        (constants.J6, brahe.J6_EARTH),
        (constants.OMEGA_EARTH, brahe.OMEGA_EARTH),
        (constants.AU, brahe.AU),
        (constants.WGS84_A, brahe.WGS84_A),
        (constants.WGS84_F, brahe.WGS84_F),
    ):
        assert ours == pytest.approx(theirs, rel=1e-9)
    assert constants.GM_SUN == pytest.approx(brahe.GM_SUN, rel=1e-7)
    assert constants.GM_MOON == pytest.approx(brahe.GM_MOON, rel=1e-7)


# --- elements ---


def test_kepler_equation_closes(x64):
    """E - e sin E = M to rounding for every eccentricity up to 0.99, several turns included."""
    e, m = np.meshgrid(np.linspace(0.0, 0.99, 67), np.linspace(-10.0, 10.0, 401))
    ecc = jax.jit(jax.vmap(orbits.solve_kepler))(jnp.asarray(m.ravel()), jnp.asarray(e.ravel()))
    residual = ecc - e.ravel() * np.sin(ecc) - m.ravel()
    turns = residual / (2 * np.pi)
    assert np.max(np.abs(turns - np.round(turns))) < 1e-15 * 10


def test_kepler_second_derivative(quick, x64):
    """d2E/dM2 = -e sin E / (1 - e cos E)^3: the implicit rule holds beyond first order."""
    m, e = 0.7, 0.4
    ecc = float(orbits.solve_kepler(m, e))
    second = quick(jax.grad(jax.grad(orbits.solve_kepler)))(m, e)
    assert float(second) == pytest.approx(-e * np.sin(ecc) / (1 - e * np.cos(ecc)) ** 3, rel=1e-12)


def test_elements_against_brahe(rng, x64):
    """Both directions over 100 random orbits: 1 um and 1e-9 m/s; angles 1e-10 rad."""
    sets = random_elements(rng, 100)
    states = jax.jit(jax.vmap(orbits.keplerian_to_cartesian))(jnp.asarray(sets))
    expected = brahe.state_koe_to_eci(sets, brahe.AngleFormat.RADIANS)
    np.testing.assert_allclose(states[:, :3], expected[:, :3], rtol=0, atol=1e-6)
    np.testing.assert_allclose(states[:, 3:], expected[:, 3:], rtol=0, atol=1e-9)
    back = jax.jit(jax.vmap(orbits.cartesian_to_keplerian))(jnp.asarray(expected))
    reference = brahe.state_eci_to_koe(expected, brahe.AngleFormat.RADIANS)
    np.testing.assert_allclose(back[:, 0], reference[:, 0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(back[:, 1], reference[:, 1], rtol=0, atol=1e-12)
    error = np.angle(np.exp(1j * (np.asarray(back[:, 2:]) - reference[:, 2:])))
    assert np.abs(error[sets[:, 1] > 0.01]).max() < 1e-10


def test_degenerate_orbits_round_trip(quick, x64):
    """State recovered within 10 um and gradients finite where node or perigee is undefined."""
    circular, equatorial = [7e6, 0.0, 0.9, 1.0, 0.0, 2.0], [7e6, 0.1, 0.0, 0.0, 1.0, 2.0]
    both, polar = [7e6, 0.0, 0.0, 0.0, 0.0, 2.0], [7e6, 0.1, np.pi / 2, 1.0, 0.5, 2.0]
    to_cartesian = quick(jax.vmap(orbits.keplerian_to_cartesian))
    states = to_cartesian(jnp.asarray([circular, equatorial, both, polar]))
    back = quick(jax.vmap(orbits.cartesian_to_keplerian))(states)
    np.testing.assert_allclose(to_cartesian(back), states, rtol=0, atol=1e-5)
    gradients = quick(jax.vmap(jax.jacrev(orbits.cartesian_to_keplerian)))(states)
    assert np.all(np.isfinite(gradients))


def test_keplerian_propagation_against_integration(x64):
    """Within 1 mm of an integrated two-body orbit after an orbit and a quarter, forwards and backwards."""
    for dt in (7000.0, -7000.0):
        start = np.asarray(orbits.keplerian_to_cartesian(jnp.asarray(ISS)))

        def two_body(t, y):
            return np.concatenate([y[3:], -constants.GM_EARTH * y[:3] / np.linalg.norm(y[:3]) ** 3])

        end = solve_ivp(two_body, (0.0, dt), start, method="DOP853", rtol=1e-13, atol=1e-6).y[:, -1]
        ours = orbits.keplerian_to_cartesian(orbits.propagate_keplerian(jnp.asarray(ISS), dt))
        np.testing.assert_allclose(ours[:3], end[:3], rtol=0, atol=1e-3)


# --- forces ---


def test_secular_rates_against_closed_forms(x64):
    """Sun-synchronous, critically inclined and polar orbits; and a day of the station's by averaging the force."""
    year = 365.2421897 * 86_400
    sun_synchronous = orbits.secular_rates_j2(jnp.array([7_178_137.0, 0.0, np.radians(98.6), 0.0, 0.0, 0.0]))
    assert sun_synchronous[3] == pytest.approx(2 * np.pi / year, rel=0.01)
    critical = orbits.secular_rates_j2(jnp.array([2.66e7, 0.7, np.arccos(np.sqrt(0.2)), 0.0, 0.0, 0.0]))
    assert abs(critical[4]) < 1e-18
    polar = orbits.secular_rates_j2(jnp.array([7e6, 0.01, np.pi / 2, 0.0, 0.0, 0.0]))
    assert abs(polar[3]) < 1e-18
    n, cos = orbits.mean_motion(ISS[0]), np.cos(ISS[2])
    scale = 1.5 * constants.J2 * (constants.R_EARTH / (ISS[0] * (1 - ISS[1] ** 2))) ** 2 * n
    expected = [0, 0, 0, -scale * cos, scale * (2 - 2.5 * (1 - cos**2)),
                scale * np.sqrt(1 - ISS[1] ** 2) * (1 - 1.5 * (1 - cos**2))]  # fmt: skip
    np.testing.assert_allclose(orbits.secular_rates_j2(jnp.array(ISS)), expected, rtol=1e-12)


def test_the_node_of_an_integrated_orbit_drifts_at_its_secular_rate(x64):
    def rate(_, y):
        return jnp.concatenate([y[3:], forces.accel_two_body(y[:3]) + forces.accel_zonal(y[:3], 2)])

    period = 2 * np.pi / float(orbits.mean_motion(ISS[0]))
    step = jnp.asarray(period / 400)

    @jax.jit
    def node_after(revolutions):
        y = jax.lax.fori_loop(
            0, 400 * revolutions, lambda k, y: propagate.rk4_step(rate, k * step, y, step),
            orbits.keplerian_to_cartesian(jnp.array(ISS)),
        )  # fmt: skip
        return orbits.cartesian_to_keplerian(y)[3]

    drift = float(node_after(15) - ISS[3]) / (15 * period)
    assert drift == pytest.approx(float(orbits.secular_rates_j2(jnp.array(ISS))[3]), rel=0.01)


@pytest.mark.parametrize("degree", [0, 2, 3, 4, 5, 6])
def test_zonal_gravity_against_brahe(degree, rng, x64):
    """Two-body plus zonal within 2e-14 m/s2 (of 9)."""
    positions = random_positions(rng, 50)

    def ours(r):
        return forces.accel_two_body(r) + forces.accel_zonal(r, degree)

    expected = [brahe.accel_earth_zonal_gravity(r, degree) for r in positions]
    np.testing.assert_allclose(jax.jit(jax.vmap(ours))(jnp.asarray(positions)), expected, rtol=0, atol=2e-14)


@pytest.mark.parametrize("degree", [7, -1, True])
def test_zonal_degree_is_checked(degree):
    with pytest.raises(ValueError, match="degree: expected a static integer from 0 to 6"):
        forces.accel_zonal(jnp.asarray([7e6, 0.0, 0.0]), degree)


@pytest.mark.parametrize("body, gm", [(SUN, constants.GM_SUN), (MOON, constants.GM_MOON)], ids=["sun", "moon"])
def test_third_body_against_exact_arithmetic(body, gm, rng, x64):
    """Relative error 1e-13 in float64 and 1e-6 in float32 of the plain difference in 40 digits."""
    decimal.getcontext().prec = 40
    for r in random_positions(rng, 10):
        r = r.astype(np.float32).astype(float)
        s = body.astype(np.float32).astype(float)
        rd, sd = ([decimal.Decimal(float(x)) for x in vector] for vector in (r, s))
        d = [a - b for a, b in zip(rd, sd)]
        d3, s3 = (sum(x * x for x in v).sqrt() ** 3 for v in (d, sd))
        exact = np.array([float(-decimal.Decimal(gm) * (a / d3 + b / s3)) for a, b in zip(d, sd)])
        size = np.linalg.norm(exact)
        for dtype, tolerance in ((jnp.float64, 1e-13), (jnp.float32, 1e-6)):
            ours = forces.accel_third_body(jnp.asarray(r, dtype), jnp.asarray(s, dtype), gm)
            assert np.linalg.norm(ours - exact) < tolerance * size


def test_third_body_against_brahe(x64):
    """Within 1e-12 m/s2 (of 5e-7 and 1e-6) of brahe's Sun and Moon at the same place."""
    epoch = brahe.Epoch.from_date(2026, 8, 1, brahe.TimeSystem.UTC)
    r = np.array([-3.9e6, 4.4e6, 3.4e6])
    for gm, position, theirs in (
        (constants.GM_SUN, brahe.sun_position, brahe.accel_third_body_sun),
        (constants.GM_MOON, brahe.moon_position, brahe.accel_third_body_moon),
    ):
        ours = forces.accel_third_body(jnp.asarray(r), jnp.asarray(position(epoch)), gm)
        np.testing.assert_allclose(ours, theirs(epoch, r), rtol=0, atol=1e-12)


# --- atmosphere and drag ---


def test_geodetic_height_against_brahe(x64):
    """Within 0.1 m from the ground to 2000 km at every latitude."""
    for height in (0.0, 100e3, 400e3, 1000e3, 2000e3):
        latitudes = np.linspace(-np.pi / 2, np.pi / 2, 91)
        geodetic = [np.array([0.3, latitude, height]) for latitude in latitudes]
        points = np.array([brahe.position_geodetic_to_ecef(g, brahe.AngleFormat.RADIANS) for g in geodetic])
        ours = jax.jit(jax.vmap(frames.geodetic_height))(jnp.asarray(points))
        np.testing.assert_allclose(ours, height, rtol=0, atol=0.1)


def test_density_against_brahe(rng, x64):
    """Within 1e-5 relative over 400 random places from 105 to 975 km, by day and by night."""
    positions = random_positions(rng, 400, 125e3, 950e3)
    ours = jax.jit(jax.vmap(lambda r: forces.density_harris_priester(r, jnp.asarray(SUN))))(positions)
    expected = np.array([brahe.density_harris_priester(r, SUN) for r in positions])
    assert np.all(expected > 0)
    np.testing.assert_allclose(ours, expected, rtol=1e-5)


def test_density_outside_the_table(x64):
    """Zero above 1000 km; below 100 km continuous, growing, and about sea-level air at the ground."""

    def density(height):
        r = jnp.stack([6378137.0 + jnp.asarray(height), jnp.zeros(()), jnp.zeros(())])
        return forces.density_harris_priester(r, jnp.asarray(SUN))

    assert float(density(1000.1e3)) == 0.0
    assert float(density(999.9e3)) > 1e-15
    assert float(density(99.999e3)) == pytest.approx(float(density(100.001e3)), rel=1e-3)
    assert float(density(100e3)) == pytest.approx(4.974e-7, rel=1e-3)
    assert 1.0 < float(density(0.0)) < 2.0
    assert float(density(-50e3)) == pytest.approx(float(density(0.0)), rel=1e-6)


@pytest.mark.parametrize("exponent", [2, 6, 4.5])
def test_density_bulge_exponent(exponent, x64):
    """rho = min + (max - min) cos^n(psi / 2), 90 deg from the apex; the table's 400 km row."""
    apex = np.arctan2(SUN[1], SUN[0]) + np.radians(30.0)
    sun = jnp.asarray([np.hypot(SUN[0], SUN[1]) * np.cos(apex - np.radians(30)), SUN[1], 0.0])
    r = (6378137.0 + 400e3) * jnp.asarray([np.cos(apex + np.pi / 2), np.sin(apex + np.pi / 2), 0.0])
    expected = 2.249e-12 + (7.492e-12 - 2.249e-12) * 0.5 ** (exponent / 2)
    assert float(forces.density_harris_priester(r, sun, exponent)) == pytest.approx(expected, rel=1e-6)


def test_drag_against_brahe(rng, x64):
    """Within 1e-8 relative (5e-14 m/s2) of brahe with its true-of-date rotation left out."""
    for r in random_positions(rng, 10):
        v = rng.normal(size=3) * 4e3
        ours = forces.accel_drag(jnp.asarray(r), jnp.asarray(v), 3e-12, 12000.0, 50.0, 2.2)
        expected = brahe.accel_drag(np.concatenate([r, v]), 3e-12, 12000.0, 50.0, 2.2, np.eye(3))
        np.testing.assert_allclose(ours, expected, rtol=1e-8, atol=1e-18)


def test_drag_at_rest_in_the_air_has_finite_gradient(quick, x64):
    r = jnp.asarray([7e6, 0.0, 0.0])
    v = jnp.asarray([0.0, constants.OMEGA_EARTH * 7e6, 0.0])
    gradient = quick(jax.jacrev(forces.accel_drag, argnums=(0, 1)))(r, v, 1e-12, 100.0, 1.0, 2.2)
    assert all(np.all(np.isfinite(g)) for g in gradient)


# --- integrators and their sum ---


def test_rk4_against_brahe(x64):
    """One pendulum step equal to brahe's integrator to 1e-14."""
    ours = propagate.rk4_step(lambda t, y: jnp.stack([y[1], -jnp.sin(y[0]) + t]), 0.3, jnp.asarray([1.0, 0.2]), 0.1)
    theirs = brahe.RK4Integrator(2, lambda t, y: np.array([y[1], -np.sin(y[0]) + t]))
    np.testing.assert_allclose(ours, theirs.step(0.3, np.array([1.0, 0.2]), 0.1), rtol=0, atol=1e-14)


def test_rk4_is_of_fourth_order(x64):
    """Halving the step divides the error of exp(t) by 16, for any pytree."""

    def error(steps):
        y = (jnp.asarray(1.0), {"twin": jnp.asarray([1.0, 2.0])})
        for i in range(steps):
            y = propagate.rk4_step(lambda t, y, k: jax.tree.map(lambda x: k * x, y), i / steps, y, 1 / steps, 1.0)
        assert float(y[1]["twin"][1]) == pytest.approx(2 * float(y[0]), rel=1e-15)
        return abs(float(y[0]) - np.e)

    assert error(8) / error(16) == pytest.approx(16.0, rel=0.1)


def test_propagation_against_brahe_forces(x64):
    """One orbit, every force, bodies held: within 1 cm of brahe's forces integrated by SciPy's DOP853."""
    world = MODEL.environment(61253, 43200.0)
    sun, moon = np.asarray(world.sun), np.asarray(world.moon)
    mass, area, cd, duration, steps = 12000.0, 50.0, 2.2, 5560.0, 1112
    start = np.asarray(orbits.keplerian_to_cartesian(jnp.asarray(ISS)))

    def point_mass(r, body, gm):
        return brahe.accel_point_mass_gravity(r, body, gm)

    def reference(t, y):
        r = y[:3]
        accel = brahe.accel_earth_zonal_gravity(r, 4)
        accel = accel + point_mass(r, sun, constants.GM_SUN) + point_mass(r, moon, constants.GM_MOON)
        density = brahe.density_harris_priester(r, sun)
        return np.concatenate([y[3:], accel + brahe.accel_drag(y, density, mass, area, cd, np.eye(3))])

    end = solve_ivp(reference, (0.0, duration), start, method="DOP853", rtol=1e-11, atol=1e-5).y[:, -1]
    spacecraft = forces.Spacecraft(mass, area, cd)

    @jax.jit
    def flown(state):
        def step(_, y):
            return propagate.rk4_step(MODEL.derivative, 0.0, y, duration / steps, spacecraft, world)

        return jax.lax.fori_loop(0, steps, step, state)

    ours = flown(jnp.asarray(start))
    np.testing.assert_allclose(ours[:3], end[:3], rtol=0, atol=1e-2)
    np.testing.assert_allclose(ours[3:], end[3:], rtol=0, atol=1e-5)
