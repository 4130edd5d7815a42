"""Geodetic and topocentric conversions against ERFA and brahe; round trips; covariances in RTN axes."""

import brahe
import erfa
import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax import frames
from astrojax.constants import WGS84_A, WGS84_F

RNG = np.random.default_rng(1984)
HEIGHTS = [(-5e6, -1e6), (-1e6, 0.0), (0.0, 2e6), (2e6, 5e7), (5e7, 1e9)]


def latitudes(n):
    """Uniform over the sphere, then the poles, the equator, and as near to the poles as 1e-12 rad."""
    special = np.pi / 2 - 10.0 ** RNG.uniform(-12, -1, 200)
    return np.concatenate([np.arcsin(RNG.uniform(-1, 1, n)), [np.pi / 2, -np.pi / 2, 0.0], special, -special])


@pytest.mark.parametrize("low, high", HEIGHTS)
def test_geodetic_against_erfa(x64, low, high):
    """Both ways: a unit in the last place of the position, 1e-15 rad of angle."""
    latitude = latitudes(2000)
    longitude, height = RNG.uniform(-np.pi, np.pi, latitude.size), RNG.uniform(low, high, latitude.size)
    geodetic = jnp.asarray(np.stack([latitude, longitude, height], axis=1))
    r = jax.jit(jax.vmap(frames.position_geodetic_to_ecef))(geodetic)
    ulp = np.spacing(WGS84_A + abs(high))
    np.testing.assert_allclose(r, erfa.gd2gc(1, longitude, latitude, height), rtol=0, atol=4 * ulp)
    back = np.asarray(jax.jit(jax.vmap(frames.position_ecef_to_geodetic))(r))
    turned = np.angle(np.exp(1j * (back[:, 1] - longitude))) * np.cos(latitude)
    assert np.abs(back[:, 0] - latitude).max() < 1e-15
    assert np.abs(turned).max() < 1e-15
    assert np.abs(back[:, 2] - height).max() < 8 * ulp


def test_geodetic_in_float32(x64):
    latitude = latitudes(2000)
    geodetic = np.stack([latitude, RNG.uniform(-3, 3, latitude.size), RNG.uniform(0, 1e6, latitude.size)], axis=1)
    r = jnp.asarray(jax.vmap(frames.position_geodetic_to_ecef)(jnp.asarray(geodetic)), jnp.float32)
    narrow = jax.jit(jax.vmap(frames.position_ecef_to_geodetic))(r)
    wide = jax.jit(jax.vmap(frames.position_ecef_to_geodetic))(r.astype(jnp.float64))
    assert narrow.dtype == jnp.float32
    error = np.abs(np.asarray(narrow) - np.asarray(wide)).max(axis=0)
    assert np.all(error < [4e-7, 4e-7, 4.0])


@pytest.mark.parametrize(
    "r", [(0, 0, 6.4e6), (0, 0, -6.4e6), (6.4e6, 0, 0), (-6.4e6, 0, 0), (0, 0, 0), (1, 0, 0), (0, 0, 1)]
)
@pytest.mark.parametrize("fn", [frames.position_ecef_to_geodetic, frames.position_ecef_to_geocentric])
def test_special_points_are_finite(x64, fn, r):
    """On the axis, on the equator, in the centre: values and derivatives."""
    for dtype in (jnp.float64, jnp.float32):
        point = jnp.asarray(r, dtype)
        assert np.all(np.isfinite(fn(point)))
        assert np.all(np.isfinite(jax.jacrev(fn)(point)))


def test_height_at_the_poles(x64):
    b = WGS84_A * (1.0 - WGS84_F)
    for sign in (1.0, -1.0):
        latitude, longitude, height = frames.position_ecef_to_geodetic(jnp.asarray([0.0, 0.0, sign * (b + 1234.5)]))
        assert float(latitude) == pytest.approx(sign * np.pi / 2, abs=1e-15)
        assert (float(longitude), float(height)) == (0.0, pytest.approx(1234.5, abs=2e-9))


_there, _back = jax.jit(frames.position_ecef_to_geodetic), jax.jit(frames.position_geodetic_to_ecef)


@hypothesis.settings(max_examples=100, deadline=None)
@hypothesis.given(st.floats(-1, 1), st.floats(-np.pi, np.pi), st.floats(1.5e6, 1e9))
def test_geodetic_round_trip(sine, longitude, radius):
    with jax.enable_x64(True):
        flat = np.sqrt(1.0 - sine * sine)
        r = radius * np.array([flat * np.cos(longitude), flat * np.sin(longitude), sine])
        np.testing.assert_allclose(_back(_there(jnp.asarray(r))), r, rtol=0, atol=5e-15 * (radius + WGS84_A))


def test_geocentric_round_trip_and_latitude(x64):
    r = jnp.asarray([4e6, -3e6, 5e6])
    np.testing.assert_allclose(
        frames.position_geocentric_to_ecef(frames.position_ecef_to_geocentric(r)), r, rtol=0, atol=2e-9
    )
    latitude = jnp.asarray(0.8)
    on_ellipsoid = frames.position_geodetic_to_ecef(jnp.stack([latitude, latitude, 0.0 * latitude]))
    expected = frames.position_ecef_to_geocentric(on_ellipsoid)[0]
    assert float(frames.geocentric_latitude(latitude)) == pytest.approx(float(expected), abs=1e-15)


STATION = np.array([0.8, -1.2, 350.0])


def test_topocentric_against_brahe(x64):
    """ENU, SEZ and azimuth-elevation-range of targets all around: 1e-8 m, 1e-13 rad."""
    site = np.asarray(frames.position_geodetic_to_ecef(jnp.asarray(STATION)))
    convert = jax.jit(frames.position_ecef_to_enu), jax.jit(frames.position_ecef_to_sez)
    seen = jax.jit(frames.enu_to_azimuth_elevation_range)
    kind = brahe.EllipsoidalConversionType.GEODETIC
    for offset in RNG.normal(size=(50, 3)) * 1e6:
        enu, sez = (np.asarray(f(jnp.asarray(STATION), jnp.asarray(site + offset))) for f in convert)
        np.testing.assert_allclose(enu, brahe.relative_position_ecef_to_enz(site, site + offset, kind), atol=2e-8)
        np.testing.assert_allclose(sez, brahe.relative_position_ecef_to_sez(site, site + offset, kind), atol=2e-8)
        theirs = brahe.position_enz_to_azel(enu, brahe.AngleFormat.RADIANS)
        np.testing.assert_allclose(seen(jnp.asarray(enu)), theirs, rtol=1e-14, atol=1e-13)


@hypothesis.settings(max_examples=60, deadline=None)
@hypothesis.given(st.floats(-np.pi / 2, np.pi / 2), st.floats(-np.pi, np.pi), st.tuples(*[st.floats(-4e7, 4e7)] * 3))
def test_topocentric_round_trips(latitude, longitude, offset):
    with jax.enable_x64(True):
        station, r = jnp.asarray([latitude, longitude, 100.0]), jnp.asarray(offset)
        m = np.asarray(frames.rotation_ecef_to_enu(station[0], station[1]))
        assert np.abs(m @ m.T - np.eye(3)).max() < 1e-15
        for there, back in (
            (frames.position_ecef_to_enu, frames.position_enu_to_ecef),
            (frames.position_ecef_to_sez, frames.position_sez_to_ecef),
        ):
            np.testing.assert_allclose(back(station, there(station, r)), r, rtol=0, atol=5e-8)
        seen = frames.enu_to_azimuth_elevation_range(r)
        assert 0.0 <= float(seen[0]) <= 2 * np.pi
        np.testing.assert_allclose(frames.azimuth_elevation_range_to_enu(seen), r, rtol=0, atol=5e-8)
        np.testing.assert_allclose(
            frames.azimuth_elevation_range(station, frames.position_enu_to_ecef(station, r))[2], seen[2], atol=5e-8
        )


@pytest.mark.parametrize("enu", [(0, 0, 5e5), (0, 0, -5e5), (0, 0, 0), (0, -1e5, 0), (1e5, 0, 0)])
def test_zenith_and_horizon(x64, enu):
    """The azimuth is 0 in the zenith; values and derivatives are finite everywhere."""
    for dtype in (jnp.float64, jnp.float32):
        point = jnp.asarray(enu, dtype)
        seen = frames.enu_to_azimuth_elevation_range(point)
        assert np.all(np.isfinite(seen))
        assert np.all(np.isfinite(jax.jacrev(frames.enu_to_azimuth_elevation_range)(point)))
    if enu[:2] == (0, 0):
        assert float(seen[0]) == 0.0


def test_velocity_of_a_target_in_enu(x64):
    state = jnp.asarray([2e6, -3e6, 5.5e6, 3e3, 5e3, -2e3])
    ours = frames.state_ecef_to_enu(jnp.asarray(STATION), state)
    slope = jax.jvp(lambda r: frames.position_ecef_to_enu(jnp.asarray(STATION), r), (state[:3],), (state[3:],))[1]
    np.testing.assert_allclose(ours[3:], slope, rtol=1e-14)
    np.testing.assert_allclose(frames.state_enu_to_ecef(jnp.asarray(STATION), ours), state, rtol=0, atol=5e-9)


CHIEF = np.array([-3.9e6, 4.4e6, 3.4e6, -5.1e3, -5.3e3, 1.7e3])


@pytest.mark.parametrize("rotating", [False, True])
def test_covariance_in_rtn(x64, rotating):
    """The Jacobian is that of the conversion itself; brahe's rotation; a covariance returns, symmetric and positive."""
    root = RNG.normal(size=(6, 6)) * np.repeat([100.0, 0.1], 3)[:, None]
    covariance, chief, accel = root @ root.T, jnp.asarray(CHIEF), jnp.asarray([1e-3, -8.0, 2e-2])
    there = np.asarray(frames.covariance_eci_to_rtn(chief, jnp.asarray(covariance), accel, rotating=rotating))
    back = frames.covariance_rtn_to_eci(chief, jnp.asarray(there), accel, rotating=rotating)
    np.testing.assert_allclose(back, covariance, rtol=0, atol=1e-11 * np.abs(covariance).max())
    np.testing.assert_allclose(there, there.T, rtol=0, atol=1e-11 * np.abs(there).max())
    assert np.linalg.eigvalsh(there).min() > 0.0
    jacobian = np.asarray(frames.jacobian_eci_to_rtn(chief, accel, rotating=rotating))
    if rotating:
        slope = jax.jacfwd(lambda x: frames.state_eci_to_rtn(chief, x, accel))(chief + 1.0)
        np.testing.assert_allclose(jacobian, slope, rtol=0, atol=1e-15)
    else:
        np.testing.assert_allclose(jacobian[:3, :3], brahe.rotation_eci_to_rtn(CHIEF), rtol=0, atol=1e-14)
        np.testing.assert_array_equal(jacobian[:3, :3], jacobian[3:, 3:])
        assert not jacobian[3:, :3].any()
