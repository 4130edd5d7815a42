"""Leap seconds, time scales and epochs against ERFA; what an epoch resolves, in exact arithmetic."""

import datetime
from fractions import Fraction

import erfa
import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax import time

MJD_ZERO = 2400000.5


def exact(epoch):
    """Seconds since MJD 0 of an epoch in its own scale, without rounding."""
    return Fraction(float(epoch.day)) * 86400 + Fraction(float(epoch.seconds)) + Fraction(float(epoch.rest))


def test_leap_seconds_against_erfa(x64):
    """Every day from 1960 on, at noon: the table, and the drift before 1972."""
    days = np.arange(36934.0, 61584.0)
    ours = jax.jit(jax.vmap(time.tai_minus_utc))(jnp.asarray(days), jnp.full(days.shape, 43200.0))
    year, month, day, _ = erfa.jd2cal(MJD_ZERO, days)
    np.testing.assert_allclose(ours, erfa.dat(year, month, day, 0.5), rtol=0, atol=5e-15)
    np.testing.assert_allclose(time.tai_minus_utc_of_days(days), erfa.dat(year, month, day, 0.0), rtol=0, atol=5e-15)


def test_day_lengths(x64):
    """27 days have a leap second; before 1972 UTC jumped by fractions."""
    lengths = np.asarray(jax.vmap(time.utc_day_length)(jnp.arange(36934.0, 70000.0)))
    assert np.sum(lengths == 86401.0) == 27
    assert np.sum((lengths != 86400.0) & (lengths != 86401.0)) == 11
    assert float(time.utc_day_length(57753)) == 86401.0


def test_utc_status():
    assert [int(time.utc_status(day)) for day in (36933, 36934, 61253, time.LEAP_SECONDS_EXPIRE)] == [1, 0, 0, 2]
    held = [float(time.tai_minus_utc(day, 0.0)) for day in (-10000.0, 36934.0)]
    assert held[0] == pytest.approx(held[1], abs=1e-6)  # the first value is held before the table


def test_days_before_the_table_are_refused_on_the_host():
    with pytest.raises(ValueError, match=r"days: expected MJD 36934 \(1960\) or later, got 36933"):
        time.tai_minus_utc_of_days(np.array([36933]))


def test_table_and_constant_offset_agree_since_2017(x64):
    days, seconds = jnp.arange(57754.0, 61253.0, 7.0), jnp.linspace(0.0, 86399.0, 500)
    for table, constant in zip(jax.vmap(time.tai_from_utc)(days, seconds), jax.vmap(time.utc_to_tai)(days, seconds)):
        np.testing.assert_array_equal(table, constant)


@hypothesis.settings(max_examples=50, deadline=None)
@hypothesis.given(st.integers(36934, 62000), st.floats(0.0, 86400.9))
@hypothesis.example(57753, 86400.5)
@hypothesis.example(38333, 86400.05)
def test_utc_and_tai_are_inverse(day, seconds):
    with jax.enable_x64(True):
        seconds = min(seconds, float(time.utc_day_length(float(day))) - 1e-6)
        back = time.utc_from_tai(*time.tai_from_utc(float(day), seconds))
        assert (float(back[0]), float(back[1])) == (day, pytest.approx(seconds, abs=5e-11))


def test_tdb_against_erfa(x64):
    """25 ns from the whole series at the geocentre, 1850 to 2150; float32 0.2 us from float64."""
    days, seconds = np.linspace(-3000, 106000, 3000).round(), np.linspace(0.0, 86399.0, 3000)
    ours = jax.jit(jax.vmap(time.tdb_minus_tt))(jnp.asarray(days), jnp.asarray(seconds))
    theirs = erfa.dtdb(MJD_ZERO + days, seconds / 86400.0, 0.0, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=25e-9)
    narrow = jax.jit(jax.vmap(time.tdb_minus_tt))(jnp.asarray(days, jnp.float32), jnp.asarray(seconds, jnp.float32))
    assert narrow.dtype == jnp.float32
    np.testing.assert_allclose(narrow, ours, rtol=0, atol=2e-7)


def test_rotation_angles(x64):
    """Against exact arithmetic to 4e-15 rad, which ERFA's own value is 8e-14 from; GMST of 1982 against ERFA."""
    rng = np.random.default_rng(1)
    days, parts = rng.integers(37665, 69807, 300), rng.integers(0, 1024, 300)
    angle = jax.jit(jax.vmap(time.earth_rotation_angle))
    ours = np.asarray(angle(jnp.asarray(days, float), jnp.asarray(parts * 84.375)))
    since = [int(d) + Fraction(int(p), 1024) - Fraction("51544.5") for d, p in zip(days, parts)]
    turns = [(Fraction("0.7790572732640") + Fraction("1.00273781191135448") * d) % 1 for d in since]
    reference = 2 * np.pi * np.array([float(t) for t in turns])
    wrapped = lambda angle: np.abs(np.angle(np.exp(1j * angle))).max()
    assert wrapped(ours - reference) < 4e-15
    assert wrapped(ours - erfa.era00(MJD_ZERO + days, parts / 1024)) < 1e-13
    sidereal = jax.jit(jax.vmap(time.gmst82))(jnp.asarray(days, float), jnp.asarray(parts * 84.375))
    assert wrapped(np.asarray(sidereal) - erfa.gmst82(MJD_ZERO + days, parts / 1024)) < 2e-13
    narrow = jax.jit(jax.vmap(time.earth_rotation_angle))(
        jnp.asarray(days, jnp.float32), jnp.asarray(parts * 84.375, jnp.float32)
    )
    assert narrow.dtype == jnp.float32
    assert wrapped(np.asarray(narrow, float) - reference) < 2e-6


INSTANTS = [
    "1960-01-01T00:00:00Z",
    "1965-03-01T00:00:00.05Z",
    "1972-06-30T23:59:60.123456789Z",
    "2016-12-31T23:59:60Z",
    "2017-01-01T00:00:00Z",
    "2026-08-01T12:34:56.987654321Z",
    "2100-01-01T00:00:00.000000001Z",
]


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_epochs_keep_nanoseconds_through_all_scales(x64, dtype):
    """Text to text through TAI, GPS, TT and TDB, compiled, and a step forth and back."""

    @jax.jit
    def around(epoch):
        return epoch.to("tai").to("gps").to("tt").to("tdb").to("ut1", -36.9).to("utc", -36.9)

    @jax.jit
    def forth_and_back(epoch):
        return (epoch + 12345.678) - 12345.678

    for text in INSTANTS:
        epoch = time.epoch_from_iso(text, dtype=dtype)
        for changed in (around(epoch), forth_and_back(epoch)):
            assert changed.seconds.dtype == dtype
            # Before 1972 the drift is known to a float's digits only.
            assert abs(exact(changed) - exact(epoch)) < (2e-9 if text > "1972" else 2e-6)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_difference_over_centuries(x64, dtype):
    """The two parts of a difference resolve nanoseconds over two centuries; one number resolves what its type does."""
    a = time.epoch_from_iso("1900-01-01T00:00:00.25", "tai", dtype=dtype)
    b = time.epoch_from_iso("2100-06-01T12:00:00.123456789", "tt", dtype=dtype)
    total, rest = jax.jit(lambda b, a: b.since(a))(b, a)
    expected = (exact(b) - Fraction("32.184")) - exact(a)
    assert abs(Fraction(float(total)) + Fraction(float(rest)) - expected) < Fraction("1e-9") + abs(expected) * Fraction(
        float(jnp.finfo(dtype).eps) ** 2
    )
    assert float(b - a) == pytest.approx(float(expected), rel=float(jnp.finfo(dtype).eps))


@pytest.mark.filterwarnings("ignore::erfa.ErfaWarning")  # 2100 is a dubious year to it
def test_scales_against_erfa(x64):
    """Civil time to TT, TDB and UT1 through ERFA's quasi-JD, inside a leap second too."""
    for text in INSTANTS[2:]:
        year, month, day, hour, minute = (int(text[a:b]) for a, b in ((0, 4), (5, 7), (8, 10), (11, 13), (14, 16)))
        tai = erfa.utctai(*erfa.dtf2d("UTC", year, month, day, hour, minute, float(text[17:-1])))
        ours = time.epoch_from_iso(text)
        for scale, (jd1, jd2) in (
            ("tai", tai),
            ("tt", erfa.taitt(*tai)),
            ("ut1", erfa.taiut1(*tai, -36.5)),
            ("tdb", erfa.tttdb(*erfa.taitt(*tai), erfa.dtdb(*erfa.taitt(*tai), 0.0, 0.0, 0.0, 0.0))),
        ):
            theirs = (Fraction(float(jd1)) - Fraction("2400000.5") + Fraction(float(jd2))) * 86400
            assert float(exact(ours.to(scale, -36.5)) - theirs) == pytest.approx(
                0.0, abs=5e-8 if scale == "tdb" else 3e-11
            )


def test_adding_seconds_counts_leap_seconds(x64):
    epoch = time.epoch_from_iso("2016-12-31T23:59:59.5Z")
    assert time.epoch_to_iso(epoch + 1.0, 1) == "2016-12-31T23:59:60.5Z"
    assert time.epoch_to_iso(epoch + 2.0, 1) == "2017-01-01T00:00:00.5Z"
    assert float((epoch + 1e9) - epoch) == 1e9
    assert time.epoch_to_iso((epoch + 2.0) - 2.0, 1) == "2016-12-31T23:59:59.5Z"


def test_many_small_steps_in_float32():
    """A simulated day of 20 Hz steps in float32 ends where it should, to 2 us."""
    start = time.epoch(np.float32(61253.0), np.float32(50000.0))
    step = np.float32(0.05)
    end = jax.jit(lambda e: jax.lax.fori_loop(0, 1_728_000, lambda _, e: e + step, e))(start.to("tai"))
    assert float(exact(end) - exact(start.to("tai")) - 1_728_000 * Fraction(float(step))) == pytest.approx(
        0.0, abs=2e-6
    )


@hypothesis.settings(max_examples=60, deadline=None)
@hypothesis.given(
    st.integers(37000, 88000), st.integers(0, 86399), st.integers(0, 10**9 - 1), st.sampled_from(time.SCALES)
)
def test_text_round_trip(day, second, nanosecond, scale):
    date = datetime.date.fromordinal(day + 678576)
    text = f"{date}T{second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}.{nanosecond:09d}"
    text += "Z" * (scale == "utc")
    if scale == "utc" and second + nanosecond * 1e-9 >= float(time.utc_day_length(np.float64(day))) - 1e-3:
        return  # a day in 1961 that ended early
    for dtype in (np.float64, np.float32):
        epoch = time.epoch_from_iso(text, scale, dtype=dtype)
        back = time.epoch_to_iso(epoch)
        if dtype == np.float64:
            assert back == text
        else:  # 0.3 ns of rounding may fall under the last digit
            assert abs(exact(time.epoch_from_iso(back, scale, dtype=np.float64)) - exact(epoch)) < 2e-9


def test_datetimes(x64):
    when = datetime.datetime(2026, 8, 1, 14, 0, 0, 250000, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))
    epoch = time.epoch_from_datetime(when)
    assert time.epoch_to_iso(epoch, 2) == "2026-08-01T12:00:00.25Z"
    assert time.epoch_to_datetime(epoch.to("tt")) == when
    naive = time.epoch_from_datetime(datetime.datetime(2026, 8, 1), "tt")
    assert (float(naive.day), naive.scale) == (61253.0, "tt")
    with pytest.raises(ValueError, match="datetime has no leap seconds"):
        time.epoch_to_datetime(time.epoch_from_iso("2016-12-31T23:59:60Z"))
    with pytest.raises(ValueError, match="zone is for UTC only"):
        time.epoch_from_datetime(when, "tt")


@pytest.mark.parametrize(
    "text, scale, message",
    [
        ("yesterday", "utc", "text: expected an ISO 8601"),
        ("2026-02-30", "utc", "text: day"),
        ("2015-12-31T23:59:60Z", "utc", "no such time"),
        ("2016-12-31T23:59:60", "tai", "no such time"),
        ("2016-12-31T12:59:60Z", "utc", "no such time"),
        ("2026-01-01T24:00:00", "tt", "no such time"),
        ("2026-01-01T00:00:00Z", "tt", "offset is for UTC only"),
        ("2026-01-01", "TCB", "scale: expected one of"),
    ],
)
def test_text_that_names_no_instant(text, scale, message):
    with pytest.raises(ValueError, match=message):
        time.epoch_from_iso(text, scale)


def test_errors_of_epochs():
    epoch = time.epoch(61253.0, 0.0)
    with pytest.raises(ValueError, match=r"ut1_minus_tai: .* got None"):
        epoch.to("ut1")
    with pytest.raises(ValueError, match=r"scale: expected one of .* got 'et'"):
        epoch.to("et")
    with pytest.raises(ValueError, match="scale: expected one of"):
        time.epoch(61253.0, 0.0, "et")
    with pytest.raises(TypeError, match="cannot be added"):
        epoch + epoch
    with pytest.raises(ValueError, match="ut1_minus_tai"):
        epoch.to("ut1", -36.9) - epoch


def test_epochs_are_pytrees_to_batch_and_differentiate(x64):
    batch = jax.vmap(lambda s: (time.epoch(61253.0, s) + 0.5).to("tdb"))(jnp.arange(4.0))
    assert batch.seconds.shape == (4,) and batch.scale == "tdb"
    slope = jax.grad(lambda s: time.epoch(61253.0, 0.0) + s - time.epoch(61250.0, 0.0))(86500.0)
    assert float(slope) == pytest.approx(1.0, abs=1e-12)
