"""The examples at small sizes: what the guide claims of each holds, and its picture is drawn."""

import importlib.util
import math
from pathlib import Path

import jax
import matplotlib
import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import ITRS, TEME, AltAz, CartesianRepresentation, EarthLocation, get_body
from astropy.time import Time, TimeDelta
from astropy.utils import iers
from scipy.integrate import solve_ivp
from sgp4.api import Satrec

from astrojax import constants, orbits

matplotlib.use("Agg")
pytestmark = pytest.mark.slow  # each compiles a program or two


def example(name: str):
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).parents[1] / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def run(tmp_path):
    """What the `main` of an example returns; it must have drawn its picture."""

    def run(module, *options):
        found = module.main([*options, "--out", str(tmp_path)])
        assert (tmp_path / f"{module.__name__}.png").stat().st_size > 10_000
        return found

    return run


def test_the_node_drifts_as_the_formula_says(run):
    found = run(example("propagate"), "--hours", "4")
    assert found["apart"] < 1.0
    assert found["J2 alone"] == pytest.approx(1.0, abs=2e-3) and found["all forces"] == pytest.approx(1.0, abs=5e-3)
    assert found["J2 alone"] != found["all forces"]


def test_passes_against_sgp4_and_astropy(run, monkeypatch):
    monkeypatch.setattr(iers.conf, "auto_download", False)
    module = example("stations")
    found = run(module, "--hours", "12")
    assert len(found) >= 4
    _, *lines = module.TLE.splitlines()
    theirs = Satrec.twoline2rv(*lines)
    epoch = Time(theirs.jdsatepoch, theirs.jdsatepochF, format="jd", scale="utc")
    latitude, longitude, height = module.STATION
    station = EarthLocation.from_geodetic(longitude * u.rad, latitude * u.rad, height * u.m)
    up = [math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude), math.sin(latitude)]

    def elevation(minutes):
        when = epoch + TimeDelta(60.0 * minutes, format="sec")
        error, r, _ = theirs.sgp4(when.jd1, when.jd2)
        assert error == 0
        fixed = TEME(CartesianRepresentation(r * u.km), obstime=when).transform_to(ITRS(obstime=when))
        away = (fixed.cartesian - station.get_itrs(when).cartesian).xyz.to_value(u.m)
        return math.degrees(math.asin(away @ up / np.linalg.norm(away)))

    for each in found:
        rise, top, fall = each.minutes
        assert elevation(rise) == pytest.approx(10.0, abs=1e-3) and elevation(fall) == pytest.approx(10.0, abs=1e-3)
        highest = elevation(top)
        assert highest == pytest.approx(math.degrees(each.sights[1].elevation), abs=1e-3)
        assert highest > max(elevation(top - 0.1), elevation(top + 0.1))
        when = epoch + TimeDelta(60.0 * top, format="sec")
        sun = get_body("sun", when, station).transform_to(AltAz(obstime=when, location=station))
        assert sun.alt.rad == pytest.approx(each.sights[1].sun, abs=1e-3)
    lit = {sight.sunlit > 0.5 for each in found for sight in each.sights}
    assert lit == {True, False}


def test_a_filter_knows_its_own_error(run):
    runs = run(example("orbit_determination"), "--runs", "16", "--steps", "160", "--filters", "ekf")["ekf"]
    looks = np.isfinite(runs.nis).sum()
    assert looks > 500
    # Three standard deviations of a mean of chi squares of 3 and of 6 degrees of freedom.
    assert np.nanmean(runs.nis) == pytest.approx(3.0, abs=3.0 * math.sqrt(6.0 / looks))
    assert runs.nees[:, -1].mean() == pytest.approx(6.0, abs=3.0 * math.sqrt(12.0 / 16.0))
    assert runs.expected[:, -1].max() < 0.5 * runs.expected[:, 0].min()


def test_screening_misses_nothing_that_brute_force_finds(run):
    options = ("--objects", "600", "--hours", "0.05", "--threshold", "100", "--checked", "200")
    rows, checked, missed, apart = run(example("conjunction"), *options)
    assert rows and checked >= 5 and missed == 0
    assert apart < 5.0  # metres: brute force passes on straight lines


def test_what_is_kept_about_a_turning_asteroid(run):
    module = example("asteroid")
    found, field = run(module, "--days", "0.6", "--subdivisions", "2", "--points", "300")
    along, against = found["with the rotation"], found["against it"]
    for flight in (along, against):
        assert np.ptp(flight.jacobi) < 1e-7 * abs(flight.jacobi[0])
        assert np.abs(flight.angle).max() < 1e-6  # never inside
    assert np.ptp(along.energy) > 3.0 * np.ptp(against.energy) > 1e-4 * abs(against.energy[0])
    assert 20 < field.inside.sum() < 280
    np.testing.assert_allclose(field.angle, np.where(field.inside, 4.0 * np.pi, 0.0), rtol=0, atol=1e-9)
    poisson = -4.0 * np.pi * module.GRAVITATIONAL_CONSTANT * module.DENSITY
    np.testing.assert_allclose(field.laplacian / poisson, field.inside, rtol=0, atol=1e-9)


def test_displacements_of_a_sweep(run):
    module = example("sweep")
    found = run(module, "--hours", "2")  # which compares a flight with a model without weights itself
    assert all(0.0 < least <= others <= most for least, most, others in found.values())

    def derivative(t, y, j2):
        r, z = y[:3], y[2]
        square = r @ r
        pull = 1.5 * j2 * (constants.R_EARTH**2 / square)
        shape = 1.0 + pull * (1.0 - 5.0 * z * z / square + np.array([0.0, 0.0, 2.0]))
        return np.concatenate([y[3:], -constants.GM_EARTH * r / square**1.5 * shape])

    with jax.enable_x64(True):
        state = np.asarray(orbits.keplerian_to_cartesian(jax.numpy.array(module.ELEMENTS)))
    ends = [
        solve_ivp(derivative, (0.0, 7200.0), state, "DOP853", rtol=1e-11, atol=1e-6, args=(j2,)).y[:3, -1]
        for j2 in (constants.J2, 0.0)
    ]
    least, most, _ = found["J2"]
    alone = np.linalg.norm(ends[0] - ends[1])
    assert least - 1.0 < alone < most + 1.0 and most - least < 0.01 * most


def test_diffrax_solves_the_same_equation():
    example("diffrax_bridge").main()
