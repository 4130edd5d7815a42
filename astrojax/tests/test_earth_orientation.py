"""GCRF to ITRF, the equinox's frames and TEME against ERFA and astropy; Earth orientation tables against astropy."""

from fractions import Fraction
from importlib import resources
from pathlib import Path

import erfa
import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from astropy.utils import iers

from astrojax import constants as c
from astrojax import frames, time

MJD_ZERO = 2400000.5
GEO = 4.2164e7
RNG = np.random.default_rng(1962)
DAYS = RNG.integers(37665, 69807, 150).astype(float)  # 1962 to 2050
SECONDS = RNG.integers(0, 1024, 150) * 84.375
TABLES = Path(str(resources.files("astropy_iers_data") / "data"))


def orientation_of(days, seconds, dtype="float64", **how):
    at = jax.jit(jax.vmap(lambda eop, d, s: eop.at(d, s, **how), in_axes=(None, 0, 0)))
    return at(frames.load_eop(), jnp.asarray(days, dtype), jnp.asarray(seconds, dtype))


def tt(days, seconds):
    offset = np.asarray(jax.vmap(time.tai_minus_utc)(jnp.asarray(days), jnp.asarray(seconds)))
    return MJD_ZERO + days, (seconds + offset + c.TT_MINUS_TAI) / 86400.0


def ut1(days, seconds, orientation):
    return MJD_ZERO + days, (seconds + np.asarray(orientation.ut1_minus_utc)) / 86400.0


def exact_rotation_angle(days, seconds_ut1):
    """The Earth rotation angle without ERFA's rounding, which is 3 um at the height of GEO."""
    since = [Fraction(float(d)) - Fraction("51544.5") + Fraction(float(s)) / 86400 for d, s in zip(days, seconds_ut1)]
    turns = [(Fraction("0.7790572732640") + Fraction("1.00273781191135448") * d) % 1 for d in since]
    return 2.0 * np.pi * np.array([float(t) for t in turns])


@pytest.fixture(scope="module")
def earth():
    """Orientation, and ERFA's rotations of the test's epochs with its own angle and with the exact one."""
    with jax.enable_x64(True):
        o = orientation_of(DAYS, SECONDS)
        o = frames.EarthOrientation(*(np.asarray(x) for x in o))
        x, y, s = erfa.xys06a(*tt(DAYS, SECONDS))
        pole = erfa.c2ixys(x + o.dx, y + o.dy, s)
        wobble = erfa.pom00(o.x, o.y, erfa.sp00(*tt(DAYS, SECONDS)))
        own = erfa.c2tcio(pole, erfa.era00(*ut1(DAYS, SECONDS, o)), wobble)
        return o, own, erfa.c2tcio(pole, exact_rotation_angle(DAYS, SECONDS + o.ut1_minus_utc), wobble)


def test_pole_against_erfa(x64, quick):
    """X, Y and s of IAU 2006/2000A over 1962 to 2050, to 1e-15."""
    ours = quick(jax.vmap(frames.celestial_pole))(jnp.asarray(DAYS), jnp.asarray(SECONDS))
    for a, b in zip(ours, erfa.xys06a(*tt(DAYS, SECONDS))):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-15)


def test_gcrf_to_itrf_against_erfa(x64, earth):
    """Rotations to 1e-13 of ERFA as it is; positions at GEO to 0.3 um of ERFA with its rotation angle exact."""
    o, own, exact = earth
    ours = np.asarray(jax.jit(jax.vmap(frames.rotation_gcrf_to_itrf))(jnp.asarray(DAYS), jnp.asarray(SECONDS), o))
    assert np.abs(ours - own).max() < 1e-13
    assert np.abs(ours - exact).max() < 5e-15
    r = RNG.normal(size=(len(DAYS), 3))
    r *= GEO / np.linalg.norm(r, axis=1, keepdims=True)
    moved = lambda m: np.einsum("nij,nj->ni", m, r)
    assert np.linalg.norm(moved(ours) - moved(exact), axis=1).max() < 3e-7
    assert np.linalg.norm(moved(ours) - moved(own), axis=1).max() < 4e-6
    no_offsets = o._replace(dx=0 * o.dx, dy=0 * o.dy)
    rotation = jax.jit(jax.vmap(frames.rotation_gcrf_to_itrf))
    plain = erfa.c2t06a(*tt(DAYS, SECONDS), *ut1(DAYS, SECONDS, o), o.x, o.y)
    assert np.abs(np.asarray(rotation(jnp.asarray(DAYS), jnp.asarray(SECONDS), no_offsets)) - plain).max() < 1e-13


def test_gcrf_to_itrf_in_float32(x64, earth):
    o = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32) if x.dtype == float else x, earth[0])
    rotation = jax.jit(jax.vmap(frames.rotation_gcrf_to_itrf))
    ours = rotation(jnp.asarray(DAYS, jnp.float32), jnp.asarray(SECONDS, jnp.float32), o)
    assert ours.dtype == jnp.float32
    assert np.abs(np.asarray(ours) - earth[2]).max() < 2e-6


@pytest.mark.parametrize(
    "terms, error", [(600, 1.2e-10), (300, 4.5e-10), (100, 3e-9), (30, 2.2e-8), (10, 1.6e-7), (0, 6e-5)]
)
def test_shorter_series(x64, quick, earth, terms, error):
    """The error that `PoleSeries` states; and that it states no more than twice too much."""
    rotation = quick(jax.vmap(lambda d, s, o: frames.rotation_gcrf_to_itrf(d, s, o, frames.PoleSeries(terms))))
    largest = np.abs(np.asarray(rotation(jnp.asarray(DAYS), jnp.asarray(SECONDS), earth[0])) - earth[2]).max()
    assert 0.5 * error < largest < error


def test_pole_table(x64, quick):
    """Ten nodes half a day apart: 1e-14 of the series, and a status outside the span."""
    table = frames.pole_table(61000, 60)
    seconds = RNG.uniform(0.0, 86400.0, 100)
    days = RNG.integers(61000, 61059, 100).astype(float)
    looked_up = quick(jax.vmap(table.at))(jnp.asarray(days), jnp.asarray(seconds))
    summed = quick(jax.vmap(frames.celestial_pole))(jnp.asarray(days), jnp.asarray(seconds))
    for a, b in zip(looked_up, summed):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)
    edges = [table.at(day, 0.0) for day in (60999.0, 61060.0, 61001.0)]
    assert [int(edge.status) for edge in edges] == [1, 1, 0]
    assert all(np.isfinite(edge.x) for edge in edges)
    with pytest.raises(ValueError, match="days: expected 9 steps"):
        frames.pole_table(61000, 2)


def test_equinox_path(x64, quick, earth):
    """The other path to the same rotation; its matrices and sidereal time against ERFA."""
    o = earth[0]
    days, seconds = jnp.asarray(DAYS), jnp.asarray(SECONDS)
    ours = quick(jax.vmap(frames.rotation_gcrf_to_itrf_equinox))(days, seconds, o)
    assert np.abs(np.asarray(ours) - earth[2]).max() < 5e-12
    bare = quick(jax.vmap(frames.rotation_gcrf_to_itrf_equinox))(days, seconds)
    other = quick(jax.vmap(frames.rotation_gcrf_to_itrf))(days, seconds)
    np.testing.assert_allclose(bare, other, rtol=0, atol=4e-15)
    mean = quick(jax.vmap(frames.rotation_gcrf_to_mod))(days, seconds)
    np.testing.assert_allclose(mean, erfa.pmat06(*tt(DAYS, SECONDS)), rtol=0, atol=1e-15)
    true = quick(jax.vmap(frames.rotation_gcrf_to_tod))(days, seconds)
    np.testing.assert_allclose(true, erfa.pnm06a(*tt(DAYS, SECONDS)), rtol=0, atol=2e-15)
    angle = np.asarray(quick(jax.vmap(frames.gast))(days, seconds, o))
    error = np.angle(np.exp(1j * (angle - erfa.gst06a(*ut1(DAYS, SECONDS, o), *tt(DAYS, SECONDS)))))
    assert np.abs(error).max() < 1e-13


def test_eme2000(x64):
    np.testing.assert_allclose(frames.GCRF_TO_EME2000, erfa.bp06(2451545.0, 0.0)[0], rtol=0, atol=2e-16)
    state = jnp.asarray([7e6, -1e6, 2e6, 1e3, 7e3, -2e3])
    back = frames.state_eme2000_to_gcrf(frames.state_gcrf_to_eme2000(state))
    np.testing.assert_allclose(back, state, rtol=1e-15)


def test_teme_against_astropy(x64, quick, earth):
    """TEME to ITRS as astropy builds it (1e-12 rad), and to GCRF over ITRF (2e-10 rad, the terrestrial locator)."""
    o = earth[0]
    days, seconds = jnp.asarray(DAYS), jnp.asarray(SECONDS)
    ours = np.asarray(quick(jax.vmap(frames.rotation_teme_to_itrf))(days, seconds, o))
    astropy = erfa.c2tcio(np.eye(3), erfa.gmst82(*ut1(DAYS, SECONDS, o)), erfa.pom00(o.x, o.y, 0.0))
    assert np.abs(ours - astropy).max() < 1e-12
    direct = np.asarray(quick(jax.vmap(frames.rotation_teme_to_gcrf))(days, seconds, o))
    assert np.abs(direct - earth[2].transpose(0, 2, 1) @ ours).max() < 2e-10
    # The mean equinox: TEME is the true equator of date, turned by the equation of the equinoxes.
    pole = direct[:, :, 2]
    x, y, _ = erfa.xys06a(*tt(DAYS, SECONDS))
    np.testing.assert_allclose(pole[:, :2], np.stack([x + o.dx, y + o.dy], axis=1), rtol=0, atol=1e-15)


def test_teme_state_against_vallado(x64):
    """The worked example of Vallado et al. 2006, app. C: 8 cm apart, by small terms of that paper's sidereal time."""
    day, seconds = time.mjd_from_calendar("2004-04-06T07:51:28.386009Z")
    o = frames.no_orientation()._replace(
        x=jnp.asarray(-0.140682 * c.ARCSECOND),
        y=jnp.asarray(0.333309 * c.ARCSECOND),
        ut1_minus_utc=jnp.asarray(-0.4399619),
        lod=jnp.asarray(0.0015563),
    )
    teme = 1e3 * jnp.asarray([5094.18010720, 6127.64470520, 6380.34453270, -4.746131487, 0.785818041, 5.531931288])
    itrf = 1e3 * np.array([-1033.47938300, 7901.29527540, 6380.35659580, -3.225636520, -2.872451450, 5.531924446])
    ours = np.asarray(frames.state_teme_to_itrf(day, seconds, teme, o))
    assert np.abs(ours[:3] - itrf[:3]).max() < 0.1
    assert np.abs(ours[3:] - itrf[3:]).max() < 1e-4


def test_velocities_are_derivatives(x64, quick):
    """The state's velocity against the positions a quarter of a second apart, 3e-7 m/s at GEO; a site's is zero."""
    day, seconds, h = 61253.0, 43210.0, 0.25
    r, v = np.array([3.0e7, -2.5e7, 1.5e7]), np.array([1200.0, 2500.0, -700.0])
    eop = frames.load_eop()
    state = quick(lambda s, x: frames.state_gcrf_to_itrf(day, s, x, eop.at(day, s)))
    o = [eop.at(day, seconds + k * h) for k in (-2, -1, 1, 2)]
    at = [
        np.asarray(frames.rotation_gcrf_to_itrf(day, seconds + k * h, q)) @ (r + v * k * h)
        for k, q in zip((-2, -1, 1, 2), o)
    ]
    slope = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h)
    ours = np.asarray(state(seconds, jnp.concatenate([r, v])))
    assert np.abs(ours[3:] - slope).max() < 3e-5  # the drift of the measured pole, which is left out
    site = jnp.asarray([4e6, 1e6, 4.8e6, 0.0, 0.0, 0.0])
    inertial = frames.state_itrf_to_gcrf(day, seconds, site, eop.at(day, seconds))
    np.testing.assert_allclose(state(seconds, inertial), site, rtol=0, atol=3e-9)
    assert np.linalg.norm(inertial[3:]) == pytest.approx(c.OMEGA_EARTH * np.hypot(4e6, 1e6), rel=1e-4)


@hypothesis.settings(max_examples=25, deadline=None)
@hypothesis.given(st.integers(37665, 75000), st.floats(0.0, 86399.0))
def test_rotations_are_orthonormal_and_states_return(day, seconds):
    with jax.enable_x64(True):
        o = _at(frames.load_eop(), float(day), seconds)
        m = np.asarray(_rotation(float(day), seconds, o))
        assert np.abs(m @ m.T - np.eye(3)).max() < 2e-15
        assert np.linalg.det(m) == pytest.approx(1.0, abs=2e-15)
        state = jnp.asarray([2e7, -3e7, 1e7, 2e3, 1e3, -3e3])
        for there, back in _PAIRS:
            returned = back(float(day), seconds, there(float(day), seconds, state, o), o)
            np.testing.assert_allclose(returned, state, rtol=0, atol=3e-8)


_at = jax.jit(lambda eop, day, seconds: eop.at(day, seconds))
_rotation = jax.jit(frames.rotation_gcrf_to_itrf)
_PAIRS = [
    (jax.jit(frames.state_gcrf_to_itrf), jax.jit(frames.state_itrf_to_gcrf)),
    (jax.jit(frames.state_teme_to_itrf), jax.jit(frames.state_itrf_to_teme)),
    (jax.jit(frames.state_teme_to_gcrf), jax.jit(frames.state_gcrf_to_teme)),
]


def test_bundled_table_against_astropy(x64):
    """Linear interpolation of the measured part against astropy's reader of C04: 1e-6 arcsec, 0.1 us."""
    table = iers.IERS_B.open(str(TABLES / "eopc04.1962-now"))
    days, seconds = RNG.integers(41400, 61300, 200).astype(float), RNG.uniform(0.0, 86399.0, 200)
    ours = orientation_of(days, seconds, method="linear")
    assert set(np.asarray(ours.status)) == {0}
    jd = MJD_ZERO + days, seconds / 86400.0
    x, y = (np.asarray(v.to_value("rad")) for v in table.pm_xy(*jd))
    dx, dy = (np.asarray(v.to_value("rad")) for v in table.dcip_xy(*jd))
    for mine, theirs in ((ours.x, x), (ours.y, y), (ours.dx, dx), (ours.dy, dy)):
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-6 * c.ARCSECOND)
    calm = ~np.isin(days + 1, time.LEAP_SECOND_DAYS)
    theirs = np.asarray(table.ut1_utc(*jd).to_value("s"))
    np.testing.assert_allclose(np.asarray(ours.ut1_minus_utc)[calm], theirs[calm], rtol=0, atol=1e-7)


def test_four_rows_against_two(x64):
    """Lagrange through four rows meets the rows, and differs from the chord by no more than a day's curvature."""
    days = np.arange(60000.0, 60050.0)
    at_rows = orientation_of(days, np.zeros(50))
    chord = orientation_of(days, np.zeros(50), method="linear")
    np.testing.assert_allclose(at_rows.ut1_minus_utc, chord.ut1_minus_utc, rtol=0, atol=1e-13)
    between = (
        orientation_of(days, np.full(50, 43200.0)).x - orientation_of(days, np.full(50, 43200.0), method="linear").x
    )
    assert 0.0 < np.abs(between).max() < 1e-3 * c.ARCSECOND


def test_ut1_does_not_jump_in_a_leap_second(x64):
    """UT1 - TAI runs on through 2016-12-31T23:59:60; UT1 - UTC jumps by the second."""
    eop = frames.load_eop()
    before, inside, after = (eop.at(*when) for when in ((57753.0, 86399.5), (57753.0, 86400.5), (57754.0, 0.5)))
    assert float(inside.ut1_minus_utc - before.ut1_minus_utc) == pytest.approx(0.0, abs=1e-6)
    assert float(after.ut1_minus_utc - before.ut1_minus_utc) == pytest.approx(1.0, abs=1e-6)


def test_epochs_outside_the_table(x64):
    """A status, and the nearest row's values; on the host an error."""
    eop = frames.load_eop()
    last = int(eop.first_day) + len(eop.columns) - 1
    inside = [eop.at(float(eop.first_day), 0.0), eop.at(float(last), 0.0)]
    outside = [eop.at(30000.0, 5.0), eop.at(80000.0, 5.0), eop.at(float(last), 1.0)]
    assert [int(o.status) for o in (*inside, *outside)] == [0, 1, 2, 3, 3]
    for a, b in ((outside[0], inside[0]), (outside[1], inside[1])):
        assert (float(a.x), float(a.y), float(a.lod)) == (float(b.x), float(b.y), float(b.lod))
    assert float(eop.at(61312.0, 0.0).status) == 0.0
    with pytest.raises(ValueError, match=rf"day: expected MJD 37665 to {last}, .* got 30000.0 to 61000.0"):
        eop.require(np.array([30000, 61000]))
    eop.require(61253)


@pytest.mark.parametrize("files", [("eopc04.1962-now",), ("finals2000A.all",), ("eopc04.1962-now", "finals2000A.all")])
def test_loader_of_published_files(x64, files):
    """What the loader makes of the files as published is the bundled table where the two overlap."""
    loaded, bundled = frames.load_eop(*(TABLES / name for name in files)), frames.load_eop()
    start = int(loaded.first_day) - int(bundled.first_day)
    shared = min(len(loaded.columns), len(bundled.columns) - start, 21000)
    mine, ours = loaded.columns[:shared], bundled.columns[start : start + shared]
    tolerance = 1e-9 if files[0].startswith("eop") else 3e-7  # bulletin A against C04
    np.testing.assert_allclose(mine[-9000:, :2], ours[-9000:, :2], rtol=0, atol=max(tolerance, 1e-12))
    np.testing.assert_allclose(mine[-9000:, 2], ours[-9000:, 2], rtol=0, atol=1e-7 if tolerance < 1e-8 else 1e-3)


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "no row of Earth orientation"),
        ("# x\n1962 1 1 0 37665.0 a b c d e f g h\n", "line 2: not a row of a C04 series"),
        ("# x\n" + "2000 1 1 0 51544.0 0 0 0 0 0 0 0 0\n2000 1 3 0 51546.0 0 0 0 0 0 0 0 0\n", "a row for each day"),
        (
            "73 1 2 41684.00 I  0.120733 0.009786  0.13665x 0.015902  I 0.8084178 0.0002710",
            "line 1: not a row of a finals",
        ),
    ],
)
def test_text_that_is_no_table(text, message, tmp_path):
    path = tmp_path / "eop.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        frames.load_eop(path)


def test_static_mistakes():
    eop = frames.load_eop()
    with pytest.raises(ValueError, match="method: expected 'lagrange' or 'linear', got 'cubic'"):
        eop.at(61253.0, 0.0, method="cubic")
    with pytest.raises(ValueError, match="terms: expected 0 to 1322, got 2000"):
        frames.celestial_pole(61253.0, 0.0, 2000)


def test_gradient_of_the_sub_satellite_point(x64, quick):
    """Through the table, the series and the rotation: the Earth turns 15.04 arcsec a second."""
    eop = frames.load_eop()

    def longitude(seconds):
        r = frames.rotation_gcrf_to_itrf(61253.0, seconds, eop.at(61253.0, seconds)) @ jnp.asarray([GEO, 0.0, 0.0])
        return jnp.arctan2(r[1], r[0])

    assert float(quick(jax.grad(longitude))(43210.0)) == pytest.approx(-c.OMEGA_EARTH, rel=1e-4)
