"""Conformance cases of time, frames and ephemerides, and the lines of the conformance page."""

import functools

import jax.numpy as jnp
import numpy as np

from astrojax import ephemeris, frames, time

HOST = {
    "epoch_from_datetime",
    "epoch_from_iso",
    "epoch_to_datetime",
    "epoch_to_iso",
    "load_eop",
    "no_orientation",
    "planet_status",
    "pole_table",
    "read_spk",
    "tai_minus_utc_of_days",
    "utc_status",
}
"""Loaders, text, and what answers with a whole number: tests of their own."""

MODELS = [
    (
        "time", "UTC, TAI, TT, GPS by leap seconds", "IERS Bulletin C 72; drift before 1972",
        "ERFA `dat`, `utctai`", "5e-15 s; 3e-11 s", "1960 to 2027",
    ),
    (
        "time", "TDB - TT, 243 terms", "Fairhead & Bretagnon 1990",
        "ERFA `dtdb` (787 terms)", "25 ns", "1850 to 2150",
    ),
    (
        "time", "Epoch in two parts", "Knuth vol. 2, sec. 4.2.2",
        "exact fractions", "2 ns, float32 too", "1972 to 2100",
    ),
    (
        "time", "Earth rotation angle", "IERS TN 36 eq. 5.15",
        "exact fractions; ERFA `era00`", "4e-15 rad; 1e-13 rad", "1962 to 2050",
    ),
    (
        "time", "GMST of 1982", "Aoki et al. 1982",
        "ERFA `gmst82`", "2e-13 rad", "1962 to 2050",
    ),
    (
        "frames", "X, Y, s of IAU 2006/2000A", "IERS TN 36 ch. 5; MHB2000",
        "ERFA `xys06a`", "1e-15 rad", "1962 to 2050",
    ),
    (
        "frames", "GCRF to ITRF", "IERS TN 36 eq. 5.1",
        "ERFA; with exact rotation angle", "1e-13 rad; 5e-15 rad, 0.3 um at GEO; float32 2e-6 rad", "1962 to 2050",
    ),
    (
        "frames", "series of 600, 300, 100, 30, 10, 0 terms", "the same",
        "ERFA", "1.1e-10, 4.2e-10, 2.7e-9, 2e-8, 1.5e-7, 5e-5 rad", "1962 to 2050",
    ),
    (
        "frames", "table of the pole, half-day nodes", "Lagrange, ten nodes",
        "the series", "1e-14 rad", "2025",
    ),
    (
        "frames", "equinox path, GAST, mean and true of date", "Wallace & Capitaine 2006",
        "ERFA `gst06a`, `pnm06a`, `pmat06`", "1e-13 rad; 2e-15; 1e-15", "1962 to 2050",
    ),
    (
        "frames", "TEME to ITRF, to GCRF", "Vallado et al. 2006",
        "ERFA as astropy has it; over ITRF", "1e-12 rad; 2e-10 rad", "1962 to 2050",
    ),
    (
        "frames", "Earth orientation, C04 and finals", "IERS",
        "astropy's reader", "1e-6 arcsec, 0.1 us", "1972 to 2026",
    ),
    (
        "frames", "WGS84 geodetic both ways", "Fukushima 2006",
        "ERFA `gc2gd`, `gd2gc`", "1e-15 rad, 8 ulp of height; float32 4 m", "-5000 km to 1e6 km, poles included",
    ),
    (
        "frames", "ENU, SEZ, azimuth, elevation, range", "Montenbruck & Gill eq. 2.93",
        "brahe", "2e-8 m, 1e-13 rad", "1000 km around",
    ),
    (
        "frames", "covariance in RTN", "Alfriend et al. ch. 2",
        "derivative of the conversion; brahe", "1e-14", "LEO",
    ),
    (
        "ephemeris", "planets, short table", "Standish table 1",
        "ERFA `plan94`, `epv00`; DE421", "25 arcsec (Earth) to 740 (Saturn)", "1800 to 2050",
    ),
    (
        "ephemeris", "planets, long table", "Standish tables 2a, 2b",
        "ERFA `plan94`; DE421", "36 arcsec (Mercury) to 1470 (Saturn)", "1000 to 3000",
    ),
    (
        "ephemeris", "SPK types 2 and 3", "NAIF SPK Required Reading",
        "NumPy's Chebyshev series; jplephem", "1e-6 m; 1e-5 m", "-",
    ),
]  # fmt: skip

A = np.array
DAY = 61253  # a whole number, apart from what is differentiated
T = A(43210.0)
STATE = A([-3.9e6, 4.4e6, 3.4e6, -5.1e3, -5.3e3, 1.7e3])
R = STATE[:3]
STATION = A([0.8, -1.2, 350.0])
ENU = A([3e5, -4e5, 6e5])


def _orientation(x):
    """An orientation of numbers in x's dtype."""
    return frames.EarthOrientation(0.7e-6 * x, 1.5e-6 * x, 0.1 * x, 1e-9 * x, -1e-9 * x, 1e-3 * x, np.int32(0))


def _on(fn, **how):
    """A frame's function of the seconds and a factor of the orientation."""
    return lambda seconds, x: fn(DAY, seconds, orientation=_orientation(x), **how)


SHORT = {"pole": frames.PoleSeries(30)}
"""The series' length changes no property that is tested here, only the time it takes."""


def _state(fn, **how):
    return lambda seconds, state, x: fn(DAY, seconds, state, _orientation(x), **how)


def _epoch(seconds):
    later = time.epoch(DAY, seconds) + 12.5
    tdb = later.to("tdb")
    return later - time.epoch(DAY - 3, 0.0 * seconds), tdb.seconds


# One is added where numbers far below one are differences of such of its size: their rounding is that of one.
def _eop(seconds):
    return jnp.stack(frames.load_eop().at(DAY, seconds)[:-1]) + 37.0


def _pole(seconds):
    return jnp.stack(frames.celestial_pole(DAY, seconds)[:3]) + 1.0


def _angles(x):
    return jnp.stack(frames.pole_angles(0.26 + 1e-3 * x, 100)) + 1.0


def _cirs(x, y, s):
    return frames.rotation_gcrf_to_cirs(frames.CelestialPole(x, y, s, np.int32(0)))


def _apart(fn):
    """A function of three numbers of different units, each an argument."""
    return lambda *numbers: fn(jnp.stack(numbers))


def _covariance(fn, state, root):
    return fn(state, root[:, None] * root[None, :], rotating=True)


def cases(case):
    rotation = functools.partial(case, rtol32=1e-5, gradient_rtol32=1e-2)
    one = A(1.0)
    return [
        case("tai_minus_utc", functools.partial(time.tai_minus_utc, 39000), (T,), gradient_rtol32=1e-2),
        case("tai_from_utc", time.tai_from_utc, (A(57753.0), T), rtol32=1e-4),
        case("utc_from_tai", functools.partial(time.utc_from_tai, 57754), (A(20.0),), (T,), rtol32=1e-4),
        case("utc_day_length", lambda seconds: time.utc_day_length(DAY + 0.0 * seconds) + seconds, (T,)),
        case("centuries_tt", functools.partial(time.centuries_tt, DAY), (T,)),
        case("tdb_minus_tt", functools.partial(time.tdb_minus_tt, DAY), (T,), rtol32=2e-4, gradient_rtol32=1e-2),
        case("earth_rotation_angle", functools.partial(time.earth_rotation_angle, DAY), (T,)),
        case("gmst82", functools.partial(time.gmst82, DAY), (T,)),
        case("gmst82_minus_era", functools.partial(time.gmst82_minus_era, DAY), (T,)),
        case("epoch", _epoch, (T,)),
        case("EOP.at", _eop, (T,), rtol32=1e-4, gradient_rtol32=1e-1),
        case("celestial_pole", _pole, (T,), gradient_rtol32=1e-1),
        case("pole_angles", _angles, (A(1.0),), gradient_rtol32=2e-1),
        rotation("rotation_gcrf_to_cirs", _cirs, (A(1e-3), A(-2e-5), A(1e-8))),
        rotation("rotation_tirs_to_itrf", frames.rotation_tirs_to_itrf, (A(0.26), A(1e-6), A(2e-6))),
        rotation("rotation_gcrf_to_itrf", _on(frames.rotation_gcrf_to_itrf), (T, one)),
        rotation("rotation_gcrf_to_itrf/short", _on(frames.rotation_gcrf_to_itrf, **SHORT), (T, one)),
        rotation("rotation_and_rate_gcrf_to_itrf", _on(frames.rotation_and_rate_gcrf_to_itrf, **SHORT), (T, one)),
        rotation("rotation_gcrf_to_itrf_equinox", _on(frames.rotation_gcrf_to_itrf_equinox, terms=30), (T, one)),
        rotation("state_gcrf_to_itrf", _state(frames.state_gcrf_to_itrf, **SHORT), (T, STATE, one)),
        rotation("state_itrf_to_gcrf", _state(frames.state_itrf_to_gcrf, **SHORT), (T, STATE, one)),
        rotation("rotation_gcrf_to_mod", functools.partial(frames.rotation_gcrf_to_mod, DAY), (T,)),
        rotation("rotation_gcrf_to_tod", functools.partial(frames.rotation_gcrf_to_tod, DAY, terms=30), (T,)),
        rotation("gast", _on(frames.gast, terms=30), (T, one)),
        case("state_gcrf_to_eme2000", frames.state_gcrf_to_eme2000, (STATE,)),
        case("state_eme2000_to_gcrf", frames.state_eme2000_to_gcrf, (STATE,)),
        rotation("rotation_teme_to_itrf", _on(frames.rotation_teme_to_itrf), (T, one)),
        rotation("rotation_teme_to_gcrf", _on(frames.rotation_teme_to_gcrf, **SHORT), (T, one)),
        rotation("state_teme_to_itrf", _state(frames.state_teme_to_itrf), (T, STATE, one)),
        rotation("state_itrf_to_teme", _state(frames.state_itrf_to_teme), (T, STATE, one)),
        rotation("state_teme_to_gcrf", _state(frames.state_teme_to_gcrf, **SHORT), (T, STATE, one)),
        rotation("state_gcrf_to_teme", _state(frames.state_gcrf_to_teme, **SHORT), (T, STATE, one)),
        case("position_geodetic_to_ecef", _apart(frames.position_geodetic_to_ecef), (A(0.8), A(-1.2), A(4e5))),
        case(
            "position_ecef_to_geodetic",
            frames.position_ecef_to_geodetic,
            (R,),
            (-R,),
            rtol32=1e-5,
            gradient_rtol32=1e-2,
        ),
        case("position_ecef_to_geocentric", frames.position_ecef_to_geocentric, (R,), (-R,)),
        case("position_geocentric_to_ecef", _apart(frames.position_geocentric_to_ecef), (A(0.7), A(-2.0), A(7e6))),
        case("geocentric_latitude", frames.geocentric_latitude, (A(0.8),)),
        case("rotation_ecef_to_enu", frames.rotation_ecef_to_enu, (A(0.8), A(-1.2))),
        case("rotation_ecef_to_sez", frames.rotation_ecef_to_sez, (A(0.8), A(-1.2))),
        case("position_ecef_to_enu", frames.position_ecef_to_enu, (STATION, R)),
        case("position_enu_to_ecef", frames.position_enu_to_ecef, (STATION, ENU)),
        case("position_ecef_to_sez", frames.position_ecef_to_sez, (STATION, R)),
        case("position_sez_to_ecef", frames.position_sez_to_ecef, (STATION, ENU)),
        case("state_ecef_to_enu", frames.state_ecef_to_enu, (STATION, STATE)),
        case("state_enu_to_ecef", frames.state_enu_to_ecef, (STATION, STATE)),
        case("enu_to_azimuth_elevation_range", frames.enu_to_azimuth_elevation_range, (ENU,), (-ENU,)),
        case("azimuth_elevation_range_to_enu", _apart(frames.azimuth_elevation_range_to_enu), (A(1.0), A(0.5), A(7e5))),
        case("azimuth_elevation_range", frames.azimuth_elevation_range, (STATION, R)),
        case("jacobian_eci_to_rtn", functools.partial(frames.jacobian_eci_to_rtn, rotating=True), (STATE,)),
        *(
            case(fn.__name__, functools.partial(_covariance, fn), (STATE, A([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])))
            for fn in (frames.covariance_eci_to_rtn, frames.covariance_rtn_to_eci)
        ),
        *(
            case(
                f"planet_position/{body}",
                functools.partial(lambda body, table, s: ephemeris.planet_position(body, DAY, s, table), body, table),
                (T,),
                rtol32=1e-5,
                gradient_rtol32=1e-2,
            )
            for body, table in (("mercury", "1800-2050"), ("earth", "1800-2050"), ("saturn", "3000BC-3000AD"))
        ),
        case("planet_state", lambda s: ephemeris.planet_state("mars", DAY, s), (T,), rtol32=1e-5, gradient_rtol32=1e-2),
        case(
            "planet_position_geocentric",
            lambda s: ephemeris.planet_position_geocentric("mars", DAY, s),
            (T,),
            rtol32=1e-5,
            gradient_rtol32=1e-2,
        ),
    ]
