"""Light and sky: where things stand, against ERFA and closed forms; what the sky shows, against geography."""

import erfa
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.compilation import compiler_options
from astrojax.constants import GM_EARTH, R_EARTH, R_SUN
from astrojax.orbits import keplerian_to_cartesian
from astrojax.time import mjd_from_calendar
from owm_envs.camera import sky
from owm_envs.camera.light import Heavens, heavens
from owm_envs.camera.sky import BLOCK, load_sky, sky_radiance, splat_stars
from owm_envs.dynamics import DYNAMICS, PhysicalState, station_orbit
from owm_envs.env import DockingEnv

ELEMENTS = np.array([6_795_000.0, 0.0005, np.radians(51.64), 0.3, 0.2, 1.0])
EPOCHS = ["2026-08-01T00:00:00Z", "2026-08-05T17:20:31Z", "2020-01-15T06:00:00Z", "2035-12-21T23:59:00Z"]
SHOW = jax.jit(sky_radiance, compiler_options=compiler_options())
TO_CARTESIAN = jax.jit(jnp.vectorize(lambda x: keplerian_to_cartesian(x, GM_EARTH), signature="(n)->(n)"))
FOOTPRINT = jnp.float32(0.003)


def at(epoch, state, dtype=np.float64):
    """The heavens, as NumPy arrays of float64."""
    with jax.enable_x64(True):
        args = (jnp.asarray(x, dtype) for x in (epoch, state[:3], state[3:]))
        return jax.tree.map(lambda x: np.asarray(x, np.float64), jax.jit(heavens)(*args))


def orbit(elements=ELEMENTS):
    with jax.enable_x64(True):
        return np.asarray(TO_CARTESIAN(jnp.asarray(elements)))


def axes_of(state):
    """Rows: orbit normal, aft, zenith."""
    r, v = state[:3], state[3:]
    zenith, normal = r / np.linalg.norm(r), np.cross(r, v) / np.linalg.norm(np.cross(r, v))
    return np.stack([normal, -np.cross(normal, zenith), zenith])


def degrees_between(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), np.dot(a, b)))


def above(latitude, longitude, epoch, heading=(0.0, 1.0)):
    """The heavens 400 km over a geocentric place, flying to (north, east)."""
    probe = at(epoch, orbit())
    eci_from_fixed = probe.icrf_from_station @ probe.earth_from_station.T
    lat, lon = np.radians([latitude, longitude])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    way = heading[0] * np.cross(up, east) + heading[1] * east
    return at(epoch, np.concatenate([eci_from_fixed @ up * (R_EARTH + 4e5), eci_from_fixed @ way * 7.67e3]))


def shown(above, directions, sky=None):
    """Radiance along up to 512 directions, all by one program."""
    rays = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (512, 1))
    rays[: len(directions)] = directions
    light = SHOW(load_sky() if sky is None else sky, as_float32(above), jnp.asarray(rays), FOOTPRINT)
    return np.asarray(light)[: len(directions)]


def as_float32(above):
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), above)


# --- where things stand ---


@pytest.mark.parametrize("when", EPOCHS)
def test_the_sun_stands_where_erfa_puts_it(when):
    day, second = mjd_from_calendar(when)
    state = orbit()
    heliocentric, _ = erfa.epv00(2_400_000.5, day + (second + 69.184) / 86_400)
    to_sun = -heliocentric["p"] * 149_597_870_700.0 - state[:3]
    seen = at((day, second), state)
    assert degrees_between(seen.sun, axes_of(state) @ to_sun) < 0.015
    assert seen.sun_radius == pytest.approx(R_SUN / np.linalg.norm(to_sun), rel=1e-3)
    beta = np.degrees(np.arcsin(axes_of(state)[0] @ to_sun / np.linalg.norm(to_sun)))
    assert np.degrees(np.arcsin(seen.sun[0])) == pytest.approx(beta, abs=0.015)


@pytest.mark.parametrize("when", EPOCHS)
def test_float32_inputs_cost_less_than_a_thousandth_of_a_degree(when):
    epoch, state = mjd_from_calendar(when), orbit()
    exact, rough = at(epoch, state), at(epoch, state, np.float32)
    assert degrees_between(exact.sun, rough.sun) < 1e-3
    assert degrees_between(exact.moon, rough.moon) < 1e-3
    assert np.abs(exact.earth_from_station - rough.earth_from_station).max() < 2e-5
    assert np.linalg.norm(exact.earth - rough.earth) < 10.0


@pytest.mark.parametrize("when", EPOCHS)
def test_the_earth_turns_as_erfa_says(when):
    day, second = mjd_from_calendar(when)
    seen = at((day, second), orbit())
    utc, tt = day + second / 86_400, day + (second + 69.184) / 86_400
    expected = erfa.c2t06a(2_400_000.5, tt, 2_400_000.5, utc, 0.0, 0.0)
    np.testing.assert_allclose(seen.earth_from_station @ seen.icrf_from_station.T, expected, atol=2e-4)


def test_full_and_new_moon():
    """12 August 2026: total eclipse of the Sun; 28 August: partial eclipse of the Moon."""
    state = orbit()
    new, full = (at(mjd_from_calendar(f"2026-08-{x}:00Z"), state) for x in ("12T17:46", "28T04:13"))
    assert degrees_between(new.sun, new.moon) < 2.0
    assert degrees_between(full.sun, full.moon) > 177.0
    away = full._replace(earth=np.array([0.0, 0.0, -1e9]))  # the Earth out of the way
    bright = shown(away, [away.moon])
    side = np.cross(away.moon, [0.1, 0.2, 0.97]) / np.linalg.norm(np.cross(away.moon, [0.1, 0.2, 0.97]))
    limbs = [away.moon + sign * 0.5 * away.moon_radius * side for sign in (1, -1)]
    lit, unlit = shown(away._replace(sun=side, sunlight=np.array(0.0)), limbs / np.linalg.norm(limbs, axis=1)[:, None])
    eclipsed = away._replace(sun=away.moon, sun_radius=0.9 * away.moon_radius, sunlight=np.array(0.0))
    dark = shown(eclipsed, [away.moon])
    assert 0.08 < bright.mean() < 0.2
    assert lit.min() > 0.03 and unlit.max() < 1e-3
    assert dark.max() < 1e-3


def test_night_falls_when_the_cones_of_shadow_say():
    """Entry and exit over one orbit against the angles between the discs' edges, worked out here."""
    day, _ = mjd_from_calendar(EPOCHS[0])
    heliocentric, _ = erfa.epv00(2_400_000.5, day + 0.02)
    sun = -heliocentric["p"] * 149_597_870_700.0
    elements = np.tile(ELEMENTS, (2001, 1))
    elements[:, 5] = np.linspace(0, 2 * np.pi, 2001)
    states = orbit(elements)
    with jax.enable_x64(True):
        epochs = jnp.tile(jnp.asarray([day, 0.02 * 86_400]), (len(states), 1))
        lit = np.asarray(jax.jit(jax.vmap(heavens))(epochs, states[:, :3], states[:, 3:]).sunlight)
    to_sun = sun - states[:, :3]
    far, near = np.linalg.norm(to_sun, axis=1), np.linalg.norm(states[:, :3], axis=1)
    apart = np.arccos(np.sum(-states[:, :3] * to_sun, 1) / far / near)
    edge, disc = np.arcsin(R_EARTH / near), np.arcsin(R_SUN / far)
    slack = 2e-4
    assert np.all(lit[apart > edge + disc + slack] == 1)
    assert np.all(lit[apart < edge - disc - slack] == 0)
    between = np.abs(apart - edge) < disc - slack
    assert between.any() and np.all((lit[between] > 0) & (lit[between] < 1))
    assert 0.3 < (lit == 0).mean() < 0.42


def test_j2_sweeps_the_beta_angle_and_its_switch_leaves_the_orbit_alone():
    with jax.enable_x64(True):
        sweeps = []
        for drift in (True, False):
            env = DockingEnv(None, fidelity="iss-numerical", chief={"secular_drift": drift})
            params = env.default_params()
            view = jnp.zeros(13).at[6].set(1.0)
            all_dynamics = [make(env.config) for make in DYNAMICS.values()]

            @jax.jit
            def at_day(params, day, view=view, all_dynamics=tuple(all_dynamics)):
                epoch = params.chief.epoch + jnp.stack([day, jnp.zeros_like(day)])
                orbits = [station_orbit(d, params, d.init(params, epoch, view)) for d in all_dynamics]
                return jnp.stack(orbits), jnp.degrees(jnp.arcsin(heavens(epoch, orbits[0][:3], orbits[0][3:]).sun[0]))

            angles = []
            for day in range(8):
                orbits, beta = at_day(params, jnp.asarray(float(day)))
                np.testing.assert_allclose(orbits, np.stack([orbits[0]] * 3), rtol=0, atol=1e-6)
                angles.append(float(beta))
            sweeps.append(angles)
    np.testing.assert_allclose(sweeps[0][::7], [-21.7, 4.2], atol=0.1)
    np.testing.assert_allclose(sweeps[1][::7], [-21.7, -19.5], atol=0.1)


def test_a_kepler_orbit_moves_smoothly_in_float32():
    env = DockingEnv(None, fidelity="iss-hcw", precision="float32")
    params = env.default_params()
    epoch = params.chief.epoch + jnp.asarray([6.0, 80_000.0], jnp.float32)

    def position(t):
        return station_orbit(env.dynamics, params, PhysicalState(epoch, t, jnp.zeros(0), None))[:3]

    path = np.asarray(jax.jit(jax.vmap(position))(jnp.arange(0.0, 30.0, 0.25, dtype=jnp.float32)), np.float64)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    np.testing.assert_allclose(steps, 7660 * 0.25, atol=8.0)


# --- what the sky shows ---

NADIR = np.array([[0.0, 0.0, -1.0]])


@pytest.mark.parametrize(
    ("latitude", "longitude", "hour", "land"),
    [(23, 13, 11, True), (24, 45, 9, True), (-25, 133, 3, True), (0, -140, 21, False), (-20, 80, 7, False)],
    ids=["Sahara", "Arabia", "Australia", "Pacific", "Indian Ocean"],
)
def test_land_and_sea_lie_where_they_do(latitude, longitude, hour, land):
    """The reddest of many directions around nadir, so that clouds do not decide."""
    day, _ = mjd_from_calendar(EPOCHS[0])
    spread = np.random.default_rng(0).normal(0, 0.15, (400, 3)) + NADIR
    light = shown(above(latitude, longitude, (day, hour * 3600.0)), spread / np.linalg.norm(spread, axis=1)[:, None])
    redness = np.median(light[:, 0] / light[:, 2])
    assert (redness > 1.1) == land, redness


def test_the_terminator_lies_where_the_sun_sets():
    day, _ = mjd_from_calendar(EPOCHS[0])
    seen = above(0, 0, (day, 64_800.0), heading=(0.0, 1.0))
    assert abs(np.degrees(np.arcsin(seen.sun[2]))) < 3
    along = np.linspace(-0.9, 0.9, 181)
    rays = np.stack([0 * along, along, -np.ones_like(along)], 1)
    light = shown(seen, rays / np.linalg.norm(rays, axis=1)[:, None]).mean(1)
    day_side, night_side = light[along > 0.5], light[along < -0.5]  # aft is west
    assert day_side.mean() > 4 * night_side.mean()
    assert day_side.min() > np.median(night_side)


def test_the_night_side_is_dark_but_for_cities():
    day, _ = mjd_from_calendar(EPOCHS[0])
    sea, city = (above(*place, (day, hour * 3600.0)) for place, hour in (((-20, -120), 8), ((30.05, 31.25), 22)))
    spread = np.random.default_rng(1).normal(0, 0.03, (500, 3)) + NADIR
    spread /= np.linalg.norm(spread, axis=1)[:, None]
    assert shown(sea, spread).max() < 0.003
    assert shown(city, spread).max() > 0.03


def test_air_is_a_thin_blue_line_beyond_the_limb():
    day, _ = mjd_from_calendar(EPOCHS[0])
    seen = above(0, -140, (day, 21 * 3600.0))
    radius = np.linalg.norm(seen.earth)
    heights = np.array([15e3, 30e3, 60e3, 300e3])
    dip = np.arccos((R_EARTH + heights) / radius)
    light = shown(seen, np.stack([0 * dip, -np.cos(dip), -np.sin(dip)], 1))
    assert np.all(np.diff(light[:3, 2]) < 0)
    assert light[1, 2] > 2 * light[1, 0]
    assert light[3].max() < 0.01


def test_the_sun_shines_unless_the_earth_hides_it():
    day, _ = mjd_from_calendar(EPOCHS[0])
    noon, midnight = (above(0, 0, (day, hour * 3600.0)) for hour in (12, 0))
    assert shown(noon, [noon.sun]).min() > 1e3
    assert shown(midnight, [midnight.sun]).max() < 0.01


def test_orion_is_where_the_catalogue_has_it():
    """Stars by right ascension and declination of J2000 (SIMBAD), seen by a camera that looks at them."""
    names = {"Betelgeuse": (88.7929, 7.4071), "Rigel": (78.6345, -8.2016), "Bellatrix": (81.2828, 6.3497)}
    seen = at(mjd_from_calendar(EPOCHS[0]), orbit())._replace(earth=np.array([0.0, 0.0, -1e10]))
    for right, declination in np.radians(list(names.values())):
        star = np.array([np.cos(declination) * np.cos(right), np.cos(declination) * np.sin(right), np.sin(declination)])
        ahead = star @ seen.icrf_from_station
        side = np.cross(ahead, [0.3, 0.2, 0.9])
        side /= np.linalg.norm(side)
        frame = jnp.asarray(np.stack([side, np.cross(ahead, side), ahead]), jnp.float32)

        def project(toward, frame=frame):
            x, y, z = jnp.matmul(frame, toward.T, precision="highest")
            return jnp.stack([x, y], 1) / jnp.where(z > 0.1, z, 1.0)[:, None] * 2000 + 32.0, z > 0.1

        image = np.asarray(splat_stars(load_sky(), as_float32(seen), project, (65, 65))).sum(-1)
        row, column = np.unravel_index(image.argmax(), image.shape)
        assert abs(row - 32) <= 1 and abs(column - 32) <= 1
        assert image.max() > 0.3


def test_stars_set_behind_the_earth():
    seen = above(0, 0, (61_253, 0.0))

    def everywhere(toward):
        return toward[:, :2] * 30 + 32, jnp.ones(len(toward), bool)

    shown_stars = np.asarray(splat_stars(load_sky(), as_float32(seen), everywhere, (65, 65))).sum()
    clear = as_float32(seen._replace(earth=np.array([0.0, 0.0, -1e10])))
    share = shown_stars / np.asarray(splat_stars(load_sky(), clear, everywhere, (65, 65))).sum()
    assert 0.4 < share < 0.9  # the Earth fills a third of the sphere


# --- numerics ---


def random_cases(count):
    rng = np.random.default_rng(3)
    for _ in range(count):
        elements = ELEMENTS + np.array([0, 0, 0, *rng.uniform(0, 6.28, 3)])
        yield at((61_253 + rng.integers(7), rng.uniform(0, 86_400)), orbit(elements)), rng.normal(size=(512, 3))


def test_no_direction_is_nan_and_none_is_negative():
    for seen, rays in random_cases(30):
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        rays[:6] = np.concatenate([np.eye(3), -np.eye(3)])
        rays[6:9] = seen.sun, seen.moon, seen.earth / np.linalg.norm(seen.earth)
        light = shown(seen, rays)
        assert np.isfinite(light).all() and (light >= 0).all()


def test_blocks_and_batches_change_nothing(optimised):
    options = {**compiler_options(), **(optimised.keywords["compiler_options"] or {})}
    seen, rays = next(random_cases(1))
    rays = jnp.asarray(rays / np.linalg.norm(rays, axis=1)[:, None], jnp.float32)
    show = jax.jit(sky_radiance, compiler_options=options)
    alone = show(load_sky(), as_float32(seen), rays, FOOTPRINT)
    many = jnp.tile(rays, (2 * BLOCK // len(rays), 1))
    blocks = np.asarray(show(load_sky(), as_float32(seen), many, FOOTPRINT))
    np.testing.assert_allclose(blocks.reshape(-1, 512, 3)[-1], alone, rtol=2e-5, atol=1e-6)
    batch = jax.tree.map(lambda x: jnp.stack([x, x]), as_float32(seen))
    both = jax.jit(jax.vmap(sky_radiance, (None, 0, None, None)), compiler_options=options)
    light = both(load_sky(), batch, rays[:64], FOOTPRINT)
    np.testing.assert_allclose(light[1], alone[:64], rtol=2e-5, atol=1e-6)


def test_a_program_may_be_the_first_to_load_the_sky():
    sky._load.cache_clear()
    jax.jit(lambda gain: gain + load_sky().night_gain)(0.0)
    assert np.isfinite(np.asarray(load_sky().surface)).all()


@pytest.mark.slow
def test_gradients_are_finite():
    seen, rays = next(random_cases(1))
    rays = rays / np.linalg.norm(rays, axis=1)[:, None]
    rays[:2] = seen.sun, seen.moon
    rays = jnp.asarray(rays[:64], jnp.float32)

    def mean(above, rays):
        return jnp.mean(jnp.minimum(sky_radiance(load_sky(), above, rays, FOOTPRINT), 4.0))

    slopes = jax.jit(jax.grad(mean, (0, 1)), compiler_options=compiler_options())(as_float32(seen), rays)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(slopes))
    assert np.abs(slopes[1]).max() > 0


def test_one_s_own_maps(tmp_path):
    import cv2

    red = np.zeros((64, 128, 3), np.uint8)
    red[..., 2] = 200
    cv2.imwrite(str(tmp_path / "red.png"), red)
    cv2.imwrite(str(tmp_path / "clear.png"), red[..., 0])
    cv2.imwrite(str(tmp_path / "square.png"), red[:, :64])
    (tmp_path / "words.jpg").write_text("not an image")
    with pytest.raises(FileNotFoundError, match="missing"):
        load_sky(tmp_path / "missing.jpg")
    with pytest.raises(ValueError, match=r"words\.jpg.* is no image"):
        load_sky(tmp_path / "words.jpg")
    with pytest.raises(ValueError, match=r"square\.png.* twice as wide as high, got 64 by 64"):
        load_sky(clouds=tmp_path / "square.png")
    mine = load_sky(tmp_path / "red.png", clouds=tmp_path / "clear.png", night_gain=0.0)
    seen = as_float32(above(23, 13, (61_253, 11 * 3600.0)))
    light = shown(seen, NADIR, mine)[0]
    assert light[0] > 2 * light[1]


def test_the_station_sees_the_heavens_as_a_tuple_of_float32():
    with jax.enable_x64(True):
        seen = heavens(jnp.asarray([61_253.0, 0.0]), *jnp.split(jnp.asarray(orbit()), 2))
    assert isinstance(seen, Heavens)
    assert {x.dtype for x in seen} == {np.dtype(np.float32)}
