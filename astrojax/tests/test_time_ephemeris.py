"""Time scales against ERFA and astropy; Sun and Moon against ERFA and brahe."""

import datetime

import brahe
import erfa
import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from astropy.time import Time

from astrojax import constants as c
from astrojax import ephemeris, time

MJD_ZERO = 2400000.5
DAYS = np.linspace(45000, 66000, 211).round()  # 1982 to 2039
SECONDS = np.linspace(0.0, 86399.0, 211)


@pytest.mark.parametrize(
    "when", ["2026-08-01T00:00:00Z", "2026-08-01T12:34:56.789012", "1999-12-31T23:59:59.5", "2028-02-29"]
)
def test_calendar_against_astropy(when):
    day, seconds = time.mjd_from_calendar(when)
    expected = Time(when.rstrip("Z"), scale="utc")
    assert (day - (expected.jd1 - MJD_ZERO)) * 86400.0 + seconds == pytest.approx(expected.jd2 * 86400.0, abs=1e-6)
    assert isinstance(day, int)
    assert 0.0 <= seconds < 86400.0


def test_calendar_takes_datetimes_and_offsets():
    zone = datetime.timezone(datetime.timedelta(hours=2))
    assert time.mjd_from_calendar(datetime.datetime(2026, 8, 1, 1, tzinfo=zone)) == (61252, 82800.0)
    assert time.mjd_from_calendar("2026-08-01T01:00:00+02:00") == (61252, 82800.0)
    assert time.mjd_from_calendar(datetime.datetime(2026, 8, 1)) == (61253, 0.0)


def test_calendar_errors_name_the_argument():
    with pytest.raises(ValueError, match=r"when: expected an ISO 8601 .* got 'yesterday'"):
        time.mjd_from_calendar("yesterday")


@hypothesis.settings(max_examples=60, deadline=None)
@hypothesis.given(st.integers(40000, 80000), st.floats(-1e6, 1e6, width=32))
@hypothesis.example(40000, -6.971998048309367e-36)  # underflows when divided by the length of a day
def test_normalize_epoch_keeps_the_instant(day, seconds):
    for dtype, tolerance in (
        (jnp.float32, 0.13),
        (jnp.float64, 1e-9),
    ):  # seconds; 1e6 s in float32 resolve 0.06 s
        with jax.enable_x64(True):
            new_day, new_seconds = time.normalize_epoch(dtype(day), dtype(seconds))
            assert 0.0 <= float(new_seconds) < 86400.0
            assert float(new_day) == int(new_day)
            drift = (float(new_day) - day) * 86400.0 + (float(new_seconds) - seconds)
            assert abs(drift) <= tolerance


def test_epoch_seconds_from_python_numbers():
    day, seconds = time.utc_to_tt(61253, 86400.0 - 69.184)
    assert (float(day), float(seconds)) == (61254.0, pytest.approx(0.0, abs=0.01))


def test_julian_centuries_against_astropy(x64):
    """TT from UTC, to a microsecond, on every date the constant leap second count covers."""
    days = np.linspace(57800, 61500, 50).round()
    ours = jax.vmap(time.julian_centuries_tt)(jnp.asarray(days), jnp.linspace(0.0, 86399.0, 50))
    instants = Time(days, np.linspace(0.0, 86399.0, 50) / 86400.0, format="mjd", scale="utc").tt
    theirs = ((instants.jd1 - 2451545.0) + instants.jd2) / 36525.0
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6 / 86400 / 36525)


@pytest.mark.parametrize("dtype, tolerance", [("float64", 1e-12), ("float32", 2e-6)])  # rad
def test_gmst_against_erfa(x64, dtype, tolerance):
    ours = jax.jit(jax.vmap(time.gmst))(jnp.asarray(DAYS, dtype), jnp.asarray(SECONDS, dtype))
    seconds = np.asarray(SECONDS, dtype).astype(float)  # the rounding of the input is not the function's
    tt = (seconds + c.TT_MINUS_UTC) / 86400.0
    theirs = erfa.gmst06(MJD_ZERO + DAYS, seconds / 86400.0, MJD_ZERO + DAYS, tt)
    error = np.angle(np.exp(1j * (np.asarray(ours, float) - theirs)))
    assert ours.dtype == dtype
    assert np.max(np.abs(error)) < tolerance


def directions(a, b):
    """Angle [rad] between the rows of two arrays, and their relative difference in length."""
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))
    return angle, np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1) - 1.0


def positions(fn, dtype):
    out = jax.jit(jax.vmap(fn))(jnp.asarray(DAYS, dtype), jnp.asarray(SECONDS, dtype))
    assert out.dtype == dtype
    return np.asarray(out, float)


def tdb():
    return MJD_ZERO + DAYS, (SECONDS + c.TT_MINUS_UTC) / 86400.0


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_sun_against_erfa(x64, dtype):
    """Direction within 0.012 deg, distance within 0.01 % of ERFA's Earth ephemeris (epv00), 1982 to 2039."""
    heliocentric, _ = erfa.epv00(*tdb())
    angle, distance = directions(positions(ephemeris.sun_position, dtype), -heliocentric["p"] * c.AU)
    assert np.degrees(angle.max()) < 0.012
    assert np.abs(distance).max() < 1e-4


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_moon_against_erfa(x64, dtype):
    """Direction within 0.1 deg and distance within 600 km of ERFA's Moon (moon98), 1982 to 2039."""
    reference = erfa.moon98(*tdb())["p"] * c.AU
    ours = positions(ephemeris.moon_position, dtype)
    angle, _ = directions(ours, reference)
    assert np.degrees(angle.max()) < 0.1
    assert np.abs(np.linalg.norm(ours, axis=1) - np.linalg.norm(reference, axis=1)).max() < 600e3


@pytest.mark.parametrize(
    "ours, theirs, degrees",
    [
        (ephemeris.moon_position, brahe.moon_position, 0.01),
        (ephemeris.sun_position, brahe.sun_position, 0.14),
    ],
    ids=["moon", "sun"],
)
def test_against_brahe(ours, theirs, degrees, x64):
    """The Moon's series within 0.01 deg; the Sun's apart by the perihelion's motion (0.32 deg a century)."""
    epochs = [brahe.Epoch.from_mjd(d, brahe.TimeSystem.UTC) + s for d, s in zip(DAYS, SECONDS)]
    reference = np.array([theirs(epoch) for epoch in epochs])
    angle, distance = directions(positions(ours, "float64"), reference)
    assert np.degrees(angle.max()) < degrees
    assert np.abs(distance).max() < 1e-4


@pytest.mark.parametrize("fn", [ephemeris.moon_position, time.gmst], ids=["moon", "gmst"])
def test_day_as_constant_or_array_is_the_same(fn):
    """A day known when compiling must not lose float32 digits to constant folding."""
    constant = jax.jit(lambda s: fn(61253, s))(jnp.float32(43210.0))
    traced = jax.jit(fn)(jnp.float32(61253.0), jnp.float32(43210.0))
    whole = jax.jit(fn)(jnp.int32(61253), jnp.float32(43210.0))
    scale = np.max(np.abs(traced))
    np.testing.assert_allclose(constant / scale, traced / scale, atol=3e-6)
    np.testing.assert_array_equal(whole, traced)
