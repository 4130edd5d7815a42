"""Anomalies, universal variables, element sets, mean elements and special orbits."""

import brahe
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from astrojax import orbits
from astrojax.constants import GM_EARTH, J2, OMEGA_EARTH, R_EARTH

RADIANS = brahe.AngleFormat.RADIANS


@pytest.mark.parametrize("e", [0.0, 1e-3, 0.5, 0.9, 0.99, 0.999, 0.9999])
def test_keplers_equation_of_ellipses(e, rng, quick, x64):
    m = np.concatenate([rng.uniform(-20.0, 20.0, 2000), 10.0 ** rng.uniform(-9.0, 0.0, 2000)])
    ecc, back, nu, again = quick(
        jax.vmap(
            lambda m: (
                x := orbits.mean_to_eccentric(m, e),
                orbits.eccentric_to_mean(x, e),
                orbits.mean_to_true(m, e),
                orbits.true_to_mean(orbits.mean_to_true(m, e), e),
            )
        )
    )(m)
    np.testing.assert_allclose(back, m, rtol=5e-15, atol=1e-14)
    np.testing.assert_allclose(again, m, rtol=1e-9, atol=1e-12)
    reference = [brahe.anomaly_eccentric_to_true(x % (2 * np.pi), e, angle_format=RADIANS) for x in map(float, ecc)]
    off = (np.asarray(nu) - reference + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(off, 0.0, rtol=0, atol=2e-12)


@pytest.mark.parametrize("e", [1.0001, 1.01, 1.5, 3.0, 100.0])
def test_keplers_equation_of_hyperbolas(e, rng, quick, x64):
    m = 10.0 ** rng.uniform(-9.0, 12.0, 2000) * rng.choice([-1.0, 1.0], 2000)
    h, back = quick(jax.vmap(lambda m: (x := orbits.mean_to_hyperbolic(m, e), orbits.hyperbolic_to_mean(x, e))))(m)
    np.testing.assert_allclose(back, m, rtol=1e-14)
    h = np.asarray(h)[np.abs(h) < 3.0]
    again = quick(jax.vmap(lambda h: orbits.true_to_hyperbolic(orbits.hyperbolic_to_true(h, e), e)))(h)
    np.testing.assert_allclose(again, h, rtol=1e-12)


def test_barkers_equation(rng, quick, x64):
    m = 10.0 ** rng.uniform(-6.0, 6.0, 500) * rng.choice([-1.0, 1.0], 500)
    again = quick(jax.vmap(lambda m: orbits.true_to_parabolic_mean(orbits.parabolic_mean_to_true(m))))(m)
    np.testing.assert_allclose(again, m, rtol=1e-10, atol=1e-15)


def conics(rng, e, count):
    """States with a perigee of 7000 km, anywhere short of the asymptotes."""
    most = np.pi if e < 1 else 0.97 * np.arccos(-1.0 / e)
    columns = [np.full(count, 7e6 * (1 + e)), np.full(count, e), rng.uniform(0.1, 3.0, count)]
    elements = np.stack([*columns, *rng.uniform(0, 6.28, (2, count)), rng.uniform(-most, most, count)], axis=1)
    return elements, np.asarray(jax.vmap(orbits.conic_to_cartesian)(jnp.asarray(elements)))


def two_body(t, y):
    return np.concatenate([y[3:], -GM_EARTH * y[:3] / np.linalg.norm(y[:3]) ** 3])


CONICS = [0.0, 0.5, 0.9, 0.999, 0.9999, 1.0, 1.0001, 1.1, 2.0, 10.0]


@pytest.fixture(scope="module")
def there_and_back():
    """One program: after a time, back again, the elements found, and gradients."""

    @jax.jit
    @jax.vmap
    def program(state, dt):
        after = orbits.propagate_universal(state, dt)
        gradient = jax.jacrev(orbits.propagate_universal, argnums=(0, 1))(state, dt)
        return after, orbits.propagate_universal(after, -dt), orbits.cartesian_to_conic(state), gradient

    return program


@pytest.mark.parametrize("e", CONICS)
def test_universal_variables(e, rng, there_and_back, x64):
    elements, states = conics(rng, e, 1000)
    dt = 10.0 ** rng.uniform(0.0, 6.5, 1000) * rng.choice([-1.0, 1.0], 1000)
    after, back, found, gradient = there_and_back(states, dt)
    after, back = np.asarray(after), np.asarray(back)
    size = np.maximum(np.linalg.norm(after[:, :3], axis=1), np.linalg.norm(states[:, :3], axis=1))
    # A passage of the perigee from far away amplifies rounding by the distance over the perigee's.
    worst = np.linalg.norm(back[:, :3] - states[:, :3], axis=1) / size
    assert np.max(worst) < 1e-9 and np.median(worst) < 1e-14
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))
    found = np.asarray(found)
    np.testing.assert_allclose(found[:, 0], elements[:, 0], rtol=1e-11)
    np.testing.assert_allclose(found[:, 1:3], elements[:, 1:3], rtol=0, atol=1e-12)


@pytest.mark.parametrize("e", [0.3, 0.9, 1.0, 1.5])
def test_universal_variables_against_numerical_integration(e, rng, there_and_back, x64):
    _, states = conics(rng, e, 1000)
    dt = np.full(1000, 9000.0)
    after = np.asarray(there_and_back(states, dt)[0])
    for k in range(3):
        y = solve_ivp(two_body, (0.0, 9000.0), states[k], "DOP853", rtol=1e-13, atol=1e-9).y[:, -1]
        np.testing.assert_allclose(after[k, :3], y[:3], rtol=0, atol=2e-2)


def test_element_sets(rng, quick, x64):
    """Keplerian, equinoctial and Cartesian agree; against brahe's equinoctial e and node vectors."""
    kep = np.stack([rng.uniform(6.7e6, 4e7, 200), rng.uniform(0, 0.9, 200), rng.uniform(0, 3, 200),
                    *rng.uniform(0, 6.28, (3, 200))], axis=1)  # fmt: skip
    equinoctial, back, state, of_state, again = quick(
        jax.vmap(
            lambda k: (
                q := orbits.keplerian_to_equinoctial(k),
                orbits.equinoctial_to_keplerian(q),
                s := orbits.equinoctial_to_cartesian(q),
                orbits.cartesian_to_equinoctial(s),
                orbits.keplerian_to_cartesian(k),
            )
        )
    )(kep)
    np.testing.assert_allclose(back[:, :3], kep[:, :3], rtol=1e-10)
    off = (np.asarray(back)[:, 3:] - kep[:, 3:] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(off * kep[:, 1:2], 0.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(state, again, rtol=0, atol=1e-5)
    np.testing.assert_allclose(of_state[:, :5], equinoctial[:, :5], rtol=1e-12, atol=1e-12)
    reference = brahe.state_koe_to_equinoctial(kep, RADIANS)
    np.testing.assert_allclose(equinoctial[:, [2, 1]], reference[:, 1:3], rtol=0, atol=1e-14)
    np.testing.assert_allclose(equinoctial[:, [4, 3]], reference[:, 3:5], rtol=1e-13, atol=1e-13)


def with_j2(t, y):
    r = np.linalg.norm(y[:3])
    z = 5.0 * (y[2] / r) ** 2
    pull = 1.5 * J2 * GM_EARTH * R_EARTH**2 / r**5
    return np.concatenate([y[3:], -GM_EARTH * y[:3] / r**3 + pull * y[:3] * np.array([z - 1, z - 1, z - 3])])


@pytest.mark.parametrize(
    "mean", [[7e6, 0.05, 1.2, 1, 0.7, 0.3], [8e6, 0.15, 0.5, 1, 0.7, 0.3], [7.2e6, 1e-3, 1.7, 1, 2, 3]]
)
def test_mean_elements_of_a_numerical_orbit_hardly_move(mean, x64):
    """Twenty revolutions under J2: mean elements vary some 500 times less than osculating ones."""
    start = jax.jit(lambda m: orbits.keplerian_to_cartesian(orbits.mean_to_osculating(m)))(jnp.asarray(mean, float))
    t = np.linspace(0.0, 1.2e5, 200)
    y = solve_ivp(with_j2, (0.0, t[-1]), start, "DOP853", t, rtol=1e-12, atol=1e-6).y.T

    @jax.jit
    @jax.vmap
    def both(state):
        osculating = orbits.cartesian_to_keplerian(state)
        return osculating, orbits.osculating_to_mean(osculating)

    osculating, found = map(np.asarray, both(y))
    node, total = np.unwrap(found[:, 3]), np.unwrap(found[:, 3:].sum(axis=1))
    assert np.ptp(osculating[:, 0]) > 5e3
    assert np.std(found[:, 0]) < 15.0
    assert np.std(found[:, 1]) < 1e-6
    assert np.std(found[:, 2]) < 3e-7
    for angle in (node, total):
        assert np.std(angle - np.polyval(np.polyfit(t, angle, 1), t)) < 2e-6
    rates = np.asarray(orbits.secular_rates_j2(jnp.asarray(mean, float)))
    assert np.polyfit(t, node, 1)[0] == pytest.approx(rates[3], rel=3e-3)


def test_mean_elements_against_brahe(rng, quick, x64):
    """The same theory: semi-major axis and eccentricity. Its angles are not compared: taken along a numerical orbit,
    its mean node moves ten times as much as the osculating one, ours a thousandth of that (the test above)."""
    mean = np.stack([rng.uniform(6.8e6, 2e7, 100), rng.uniform(0, 0.3, 100), rng.uniform(1.2, 3, 100),
                     *rng.uniform(0, 6.28, (3, 100))], axis=1)  # fmt: skip
    mean = mean[np.abs(mean[:, 2] - orbits.CRITICAL_INCLINATION) * np.abs(mean[:, 2] - 2.03) > 0.02]
    ours = np.asarray(quick(jax.vmap(orbits.mean_to_osculating))(mean))
    back = np.asarray(quick(jax.vmap(orbits.osculating_to_mean))(ours))
    for m, o in zip(mean, ours):
        theirs = brahe.state_koe_mean_to_osc(m, brahe.MeanElementMethod.BROUWER_LYDDANE, RADIANS)
        assert o[0] == pytest.approx(theirs[0], abs=1e-6)
        assert o[1] == pytest.approx(theirs[1], abs=2e-6)
    np.testing.assert_allclose(back[:, :3], mean[:, :3], rtol=1e-10)
    off = (back[:, 3:] - mean[:, 3:] + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(off * mean[:, 1:2], 0.0, rtol=0, atol=1e-10)


def test_mean_elements_at_their_edges(quick, x64):
    """Circular, equatorial, critical: finite, gradients too."""
    edges = np.array(
        [[7e6, 0.0, 1.0, 1, 1, 1], [7e6, 0.01, 0.0, 1, 1, 1], [7e6, 0.01, orbits.CRITICAL_INCLINATION, 1, 1, 1]], float
    )
    for convert in (orbits.mean_to_osculating, orbits.osculating_to_mean):
        for leaf in quick(jax.vmap(lambda m, f=convert: (f(m), jax.jacrev(f)(m))))(edges):
            assert np.all(np.isfinite(leaf))


def test_special_orbits(x64):
    for a, e in [(6.8e6, 0.0), (7.2e6, 0.01), (8e6, 0.1)]:
        inc = float(orbits.inclination_sun_synchronous(a, e))
        assert inc == pytest.approx(brahe.sun_synchronous_inclination(a, e, angle_format=RADIANS), abs=1e-5)
        rate = orbits.secular_rates_j2(jnp.array([a, e, inc, 0.0, 0.0, 0.0]))[3]
        assert float(rate) * 365.242190402 * 86400 == pytest.approx(2 * np.pi, rel=1e-12)
    assert float(orbits.inclination_sun_synchronous(2e7, 0.0)) == np.pi
    assert np.isfinite(jax.grad(orbits.inclination_sun_synchronous)(2e7, 0.0))
    assert float(orbits.radius_geostationary()) == pytest.approx(brahe.geo_sma(), abs=0.1)
    assert orbits.CRITICAL_INCLINATION == pytest.approx(np.radians(63.4349488), abs=1e-9)
    elements = jnp.array([2.6e7, 0.7, orbits.CRITICAL_INCLINATION, 0.0, 4.7, 0.0])
    assert abs(float(orbits.secular_rates_j2(elements)[4])) < 1e-22
    assert float(orbits.eccentricity_frozen(7.153e6, np.radians(98.5))) == pytest.approx(1.04e-3, abs=2e-5)


@pytest.mark.parametrize("revolutions, days, e, inc", [(15, 1, 0.0, 1.7), (43, 3, 0.01, 0.9), (127, 10, 1e-3, 1.152)])
def test_repeat_ground_track(revolutions, days, e, inc, x64):
    """In the time of so many revolutions from node to node the Earth turns a whole number of times below the node."""
    a = orbits.semimajor_axis_repeat(revolutions, days, e, inc)
    rates = orbits.secular_rates_j2(jnp.array([a, e, inc, 0.0, 0.0, 0.0]))
    draconic = 2 * np.pi / (orbits.mean_motion(a) + rates[4] + rates[5])
    assert float(revolutions * draconic * (OMEGA_EARTH - rates[3])) == pytest.approx(2 * np.pi * days, rel=1e-12)


@given(st.floats(-50.0, 50.0), st.floats(0.0, 0.9999))
@settings(max_examples=100, deadline=None)
def test_anomalies_are_inverse(m, e):
    with jax.enable_x64(True):
        assert float(_round_trip(m, e)) == pytest.approx(m, rel=1e-13, abs=1e-13)


_round_trip = jax.jit(lambda m, e: orbits.eccentric_to_mean(orbits.mean_to_eccentric(m, e), e))
