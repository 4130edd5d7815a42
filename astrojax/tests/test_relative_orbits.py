"""Relative motion on ellipses, and relative orbital elements under J2."""

import brahe
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astrojax import frames, orbits

RADIANS = brahe.AngleFormat.RADIANS


@pytest.mark.parametrize("e", [0.0, 0.1, 0.5, 0.8])
def test_yamanaka_ankersen_is_the_derivative_of_two_body_motion(e, rng, quick, x64):
    """Exact motion of chief and deputy; its derivative at no separation is the matrix."""
    chief = jnp.array([7e6 / (1 - e), e, 0.9, 1.1, 0.4, 0.7])
    period = 2 * np.pi / float(orbits.mean_motion(chief[0]))

    @quick
    def both(dt):
        start = orbits.keplerian_to_cartesian(chief)
        end = orbits.propagate_universal(start, dt)

        def moved(relative):
            deputy = orbits.propagate_universal(frames.state_rtn_to_eci(start, relative), dt)
            return frames.state_eci_to_rtn(end, deputy)

        small = jnp.array([1.0, -2.0, 0.5, 1e-3, -5e-4, 2e-3])
        return jax.jacfwd(moved)(jnp.zeros(6)), orbits.stm_yamanaka_ankersen(chief, dt), moved(10 * small), small

    unit = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])
    for dt in (0.0, 100.0, -0.3 * period, 0.5 * period, 3.2 * period):
        reference, found, moved, small = map(np.asarray, both(dt))
        scale = np.max(np.abs(reference / unit * unit[:, None]))
        np.testing.assert_allclose((found - reference) / unit * unit[:, None] / scale, 0.0, rtol=0, atol=1e-10)
        # 20 m apart after up to three revolutions: what is not linear is of second order.
        far = np.max(np.abs(moved[:3]))
        np.testing.assert_allclose((found @ (10 * small))[:3], moved[:3], rtol=0, atol=30 * far**2 / 7e6 + 1e-6)


def test_yamanaka_ankersen_of_a_circle_is_hill_clohessy_wiltshire(x64):
    chief = jnp.array([7e6, 0.0, 0.9, 1.1, 0.4, 0.7])
    for dt in (0.1, 900.0, -4000.0):
        hcw = orbits.stm_hcw(orbits.mean_motion(7e6), dt)
        np.testing.assert_allclose(orbits.stm_yamanaka_ankersen(chief, dt), hcw, rtol=1e-9, atol=1e-9)


def close_pair(rng, e):
    chief = np.array([7.1e6, e, 1.2, 0.5, 0.8, 1.9])
    return chief, chief + np.array([30.0, 2e-5, 3e-5, -2e-5, 1e-4, 5e-5]) * rng.normal(size=6)


def test_relative_elements_against_brahe(rng, quick, x64):
    for e in (1e-4, 0.1, 0.7):
        chief, deputy = close_pair(rng, e)
        roe = np.asarray(quick(orbits.keplerian_to_roe)(chief, deputy))
        theirs = brahe.state_oe_to_roe(chief, deputy, RADIANS)  # whose inclination wraps to a whole turn
        np.testing.assert_allclose(roe, (theirs + np.pi) % (2 * np.pi) - np.pi, rtol=0, atol=3e-15)
        back = np.asarray(quick(orbits.roe_to_keplerian)(chief, roe))
        np.testing.assert_allclose(back, brahe.state_roe_to_oe(chief, roe, RADIANS), rtol=1e-12)
        np.testing.assert_allclose(back[:5], deputy[:5], rtol=1e-12)


def drifted(elements, dt):
    """Mean elements after secular J2."""
    rates = orbits.secular_rates_j2(elements)
    return elements + dt * rates.at[5].add(orbits.mean_motion(elements[0]))


@pytest.mark.parametrize("e", [1e-4, 0.1, 0.7])
def test_drift_of_relative_elements_is_the_derivative_of_the_secular_motion(e, quick, x64):
    chief = jnp.array([7.1e6 / (1 - e), e, 1.2, 0.5, 0.8, 1.9])

    @quick
    def both(dt):
        def moved(roe):
            deputy = orbits.roe_to_keplerian(chief, roe)
            return orbits.keplerian_to_roe(drifted(chief, dt), drifted(deputy, dt))

        return jax.jacfwd(moved)(jnp.zeros(6)), orbits.stm_roe_j2(chief, dt)

    for dt in (0.0, 3000.0, 86400.0, -86400.0):
        reference, found = both(dt)
        np.testing.assert_allclose(found, reference, rtol=1e-9, atol=1e-9)


def test_drift_against_numerical_propagation(quick, x64):
    """A day of J2, chief and deputy integrated apart: the mean relative elements end within 1 % of their change."""
    from scipy.integrate import solve_ivp

    from astrojax.constants import GM_EARTH, J2, R_EARTH

    def with_j2(t, y):
        r = np.linalg.norm(y[:3])
        z = 5.0 * (y[2] / r) ** 2
        pull = 1.5 * J2 * GM_EARTH * R_EARTH**2 / r**5
        return np.concatenate([y[3:], -GM_EARTH * y[:3] / r**3 + pull * y[:3] * np.array([z - 1, z - 1, z - 3])])

    chief = jnp.array([7.1e6, 0.02, 1.2, 0.5, 0.8, 1.9])
    roe = jnp.array([0.0, 1e-4, 2e-4, -1e-4, 5e-5, 2e-4])
    deputy = orbits.roe_to_keplerian(chief, roe)
    ends = []
    for mean in (chief, deputy):
        start = np.asarray(orbits.keplerian_to_cartesian(orbits.mean_to_osculating(mean)))
        end = solve_ivp(with_j2, (0.0, 86400.0), start, "DOP853", rtol=1e-13, atol=1e-7).y[:, -1]
        ends.append(orbits.osculating_to_mean(orbits.cartesian_to_keplerian(jnp.asarray(end))))
    numerical = np.asarray(orbits.keplerian_to_roe(*ends))
    predicted = np.asarray(orbits.stm_roe_j2(chief, 86400.0) @ roe)
    assert np.linalg.norm(predicted - np.asarray(roe)) > 1.5e-5
    np.testing.assert_allclose(predicted, numerical, rtol=0, atol=1e-6)  # 7 m


@given(st.tuples(*(st.floats(-1e-3, 1e-3) for _ in range(6))), st.floats(0.01, 0.8), st.floats(0.1, 3.0))
@settings(max_examples=50, deadline=None)
def test_relative_elements_are_inverse(roe, e, inc):
    chief = np.array([7.1e6, e, inc, 0.5, 0.8, 1.9])
    with jax.enable_x64(True):
        back = _round_trip(chief, np.array(roe))
    np.testing.assert_allclose(back, roe, rtol=0, atol=1e-14)


_round_trip = jax.jit(lambda chief, roe: orbits.keplerian_to_roe(chief, orbits.roe_to_keplerian(chief, roe)))
