"""The equations of motion against each other, against independent propagations and against what nature conserves."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference_orbit as reference

from astrojax.ephemeris import illumination_conical, sun_position
from owm_envs.env import DockingEnv
from owm_envs.task.reset import sample_start
from owm_envs.view import View

SEGMENTS = 12
HORIZON = 360.0
SMA = 6_795_000.0
MEAN_MOTION = np.sqrt(reference.GM / SMA**3)
PERIOD = 2 * np.pi / MEAN_MOTION
POINT_MASS = {"zonal_degree": 0, "sun": False, "moon": False, "drag": False}
ZONAL = {"sun": False, "moon": False, "drag": False}
ATTITUDE = np.array([0.5, 0.5, -0.5, 0.5])
RATE = np.array([0.004, -0.003, 0.002])


@partial(jax.jit, static_argnums=0)
def _fly(dynamics, params, epoch, view, wrenches, steps, dt):
    state = dynamics.init(params, epoch, view)

    def segment(state, wrench):
        state = jax.lax.fori_loop(0, steps, lambda _, s: dynamics.step(params, s, wrench, dt), state)
        return state, (state.chief, dynamics.relative_state(params, state))

    chiefs, views = jax.lax.scan(segment, state, wrenches)[1]
    first = state.chief, dynamics.relative_state(params, state)
    return [jnp.concatenate([a[None], b]) for a, b in zip(first, (chiefs, views))]


@pytest.fixture
def fly(x64):
    """Chief orbits (13, 6) and views (13, 13) at the start and at the end of each of twelve segments.

    One program a fidelity and choice of forces: everything else is data. `elements` replaces the chief's.
    """

    def flown(view, wrenches=None, seconds=HORIZON, dt=0.5, day=2.0, second=1234.5, elements=None, **overrides):
        env = DockingEnv(None, **overrides)
        params = env.default_params()
        if elements is not None:  # of a Kepler orbit, as the references have it
            chief = params.chief._replace(elements=jnp.asarray(elements), drift=jnp.zeros(()))
            params = params._replace(chief=chief)
        steps = round(seconds / SEGMENTS / dt)
        wrenches = np.zeros((SEGMENTS, 6)) if wrenches is None else wrenches
        epoch = params.chief.epoch + jnp.asarray([day, second])
        data = (jnp.asarray(x, jnp.float64) for x in (view, wrenches))
        step = jnp.asarray(seconds / SEGMENTS / steps)
        return [np.array(x) for x in _fly(env.dynamics, params, epoch, *data, jnp.asarray(steps), step)]

    return flown


def view_of(position, velocity=(0.0, 0.0, 0.0), attitude=ATTITUDE, rate=RATE):
    return np.concatenate([position, velocity, attitude, rate])


def turned(a, b):
    """Angle [rad] between the attitudes of two views."""
    return (reference.rotation(View.of(a).attitude).inv() * reference.rotation(View.of(b).attitude)).magnitude()


def distance(a, b):
    return np.linalg.norm(a[..., :3] - b[..., :3], axis=-1)


OBLIQUE = np.array([0.5, -0.6, 0.62449979983984])  # of length one


# --- one fidelity as the limit of another ---


def test_hill_is_the_limit_of_two_close_orbits(fly):
    """Circular chief, point-mass Earth: what linearising leaves out falls with the square of the separation."""
    errors = []
    for separation in (900.0, 450.0, 225.0, 112.5):
        view = view_of(separation * OBLIQUE, separation * np.array([1e-3, 2e-3, -1e-3]))
        _, linear = fly(view, fidelity="iss-hcw")
        _, orbits = fly(view, fidelity="iss-numerical", forces=POINT_MASS, chief={"eccentricity": 0.0})
        errors.append(distance(linear[-1], orbits[-1]))
        assert turned(linear[-1], orbits[-1]) < 1e-8
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.02)
    assert errors[2] < 2e-3  # metres, at 225 m


def test_hill_misses_the_chief_s_eccentricity_in_proportion(fly):
    errors, angles = [], []
    view = view_of(10.0 * OBLIQUE)
    _, linear = fly(view, fidelity="iss-hcw")
    for eccentricity in (4e-3, 2e-3, 1e-3):
        _, orbits = fly(view, fidelity="iss-numerical", forces=POINT_MASS, chief={"eccentricity": eccentricity})
        errors.append(distance(linear[-1], orbits[-1]))
        angles.append(turned(linear[-1], orbits[-1]))
    for errors_of in (errors, angles):
        np.testing.assert_allclose(np.log2(np.divide(errors_of[:-1], errors_of[1:])), 1.0, atol=0.05)


def test_perturbations_and_eccentricity_part_hill_from_the_orbits_by_decimetres(fly):
    """What Hill leaves out is a tide, in proportion to the separation, 11 cm after 360 s from 225 m, and the drag that
    the chaser feels more than the station, millimetres wherever it is."""

    def error(separation, **chaser):
        view = view_of(separation * OBLIQUE)
        flights = [fly(view, fidelity=fidelity, chaser=chaser)[1] for fidelity in ("iss-hcw", "iss-numerical")]
        return distance(flights[0][-1], flights[1][-1])

    same_fall = {"drag_area": 12_000.0 * 1500.0 / 419_700.0}
    assert error(0.0, **same_fall) < 1e-6
    assert 1e-3 < error(0.0) < 0.015
    far, near = error(225.0, **same_fall), error(22.5, **same_fall)
    assert 0.05 < far < 0.2
    assert far / near == pytest.approx(10.0, rel=0.01)


def test_the_free_flyer_is_the_limit_of_hill_without_orbital_terms(fly):
    """As the orbit grows its mean motion goes to zero: Coriolis with it, tides and gravity gradient with its square."""
    moving, still = view_of(200 * OBLIQUE, [0.3, -0.2, 0.4]), view_of(200 * OBLIQUE, rate=(0.0, 0.0, 0.0))
    for view, order in ((moving, 1.0), (still, 2.0)):
        _, free = fly(view, fidelity="iss")
        errors = []
        for n in (MEAN_MOTION / 64, MEAN_MOTION / 128, MEAN_MOTION / 256):
            elements = [np.cbrt(reference.GM / n**2), 0.0, 0.9, 0.0, 0.0, 0.0]
            _, hill = fly(view, fidelity="iss-hcw", elements=elements)
            errors.append(distance(free[-1], hill[-1]))
        np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), order, atol=0.06)


def test_orbital_terms_grow_with_the_square_of_time(fly):
    view = view_of(200 * OBLIQUE, [0.3, -0.2, 0.4])
    errors = []
    for seconds in (24.0, 12.0, 6.0):
        _, free = fly(view, seconds=seconds, dt=0.05, fidelity="iss")
        _, hill = fly(view, seconds=seconds, dt=0.05, fidelity="iss-hcw")
        errors.append(distance(free[-1], hill[-1]))
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.02)


# --- independent propagations ---

SCENES = {  # days and seconds into the window, chief's elements, position [m], velocity [m/s]
    "zenith": (0.0, 0.0, [SMA, 0.0005, np.radians(51.64), 0.0, 0.0, 0.0], [0, 0, 225], [0.05, -0.05, 0.07]),
    "orbit normal": (3.0, 40_000.0, [SMA, 0.0005, np.radians(51.64), 0.0, 0.0, 0.0], [225, 0, 0], [0.1, 0, 0]),
    "aft": (5.0, 80_000.5, [SMA, 0.0005, np.radians(51.64), 0.0, 0.0, 0.0], [0, 225, 0], [0, -0.1, 0]),
    "oblique": (6.0, 86_000.0, [6.798e6, 0.002, np.radians(97.0), 2.1, 0.8, 4.0], 225 * OBLIQUE, [-0.06, 0.05, 0.06]),
}


@pytest.mark.parametrize("scene", SCENES)
def test_two_independent_propagations_agree_within_a_tenth_of_a_millimetre(fly, scene):
    """Drift, then thrust and torque held for 30 s at a time, over 360 s at the environment's own step."""
    day, second, elements, position, velocity = SCENES[scene]
    rng = np.random.default_rng(7)
    thrust = rng.uniform(-1, 1, (SEGMENTS, 6)) * np.repeat([400.0, 60.0], 3)
    view = view_of(position, velocity)
    epoch = 61_253.0 + day, second
    chief = reference.chief_state(elements, day * 86_400.0 + second)
    # A drift is one segment to the references.
    for wrenches, duration in ((np.zeros((1, 6)), HORIZON), (thrust, HORIZON / SEGMENTS)):
        held = np.repeat(wrenches, SEGMENTS // len(wrenches), axis=0)
        chiefs, views = fly(view, held, dt=0.05, day=day, second=second, elements=elements, fidelity="iss-numerical")
        for propagate in (reference.fly_scipy, reference.fly_brahe):
            ends = propagate(epoch, chief, view, wrenches, duration)
            for k, end in enumerate(ends, 1):
                ours = View.of(views[k * SEGMENTS // len(ends)])
                orbit, attitude, rate = reference.station_relative(end, epoch, k * duration)
                figures = (
                    np.linalg.norm(orbit[:3] - ours.position),
                    np.linalg.norm(orbit[3:] - ours.velocity),
                    (attitude.inv() * reference.rotation(ours.attitude)).magnitude(),
                    np.linalg.norm(rate - ours.rate),
                )
                assert np.all(np.less(figures, (1e-4, 1e-6, 1e-7, 1e-9))), (propagate.__name__, k, figures)
            assert distance(chiefs[-1], ends[-1][0]) < 1e-3
        assert np.linalg.norm(View.of(views[-1]).position) < 750


# --- conservation ---


def inertial(chiefs, views, degrees):
    """Inertial orbits (13, 6) of the chaser, its attitudes and body rates."""
    return zip(*(reference.to_inertial(c, reference.gravity(c[:3], degrees), v) for c, v in zip(chiefs, views)))


@pytest.mark.parametrize("forces, degrees", [(POINT_MASS, ()), (ZONAL, (2, 3, 4))], ids=["point mass", "zonal"])
def test_orbits_keep_energy_and_angular_momentum(fly, forces, degrees):
    """Over one orbit both vehicles keep their energy to 1e-5 J/kg (2 um of semi-major axis).

    The point mass keeps the whole angular momentum, the zonal field that about its axis, to 0.01 m2/s (of 5e10).
    """
    view = view_of(225 * OBLIQUE, [0.1, -0.1, 0.1])
    chiefs, views = fly(view, seconds=PERIOD, fidelity="iss-numerical", forces=forces)
    chasers = np.array(next(inertial(chiefs, views, degrees)))
    kept = slice(2, 3) if degrees else slice(0, 3)
    for orbits in (chiefs, chasers):
        r, v = orbits[:, :3], orbits[:, 3:]
        energy = (v * v).sum(1) / 2 + reference.potential(r, degrees)
        momentum = np.cross(r, v)
        np.testing.assert_allclose(energy, energy[0], rtol=0, atol=1e-5)
        np.testing.assert_allclose(momentum[:, kept], momentum[:1, kept].repeat(13, 0), rtol=0, atol=0.01)
        if degrees:
            assert np.ptp(momentum[:, 0]) > 1e6  # the bulge does turn the plane


def test_a_free_body_keeps_its_energy_and_angular_momentum(fly):
    """No gravity gradient in `iss`: three unequal moments tumble about a fixed momentum."""
    moments = np.array([80_000.0, 60_000.0, 50_000.0])
    view = view_of(np.zeros(3), rate=[0.02, 0.05, -0.03])
    _, views = fly(view, seconds=PERIOD, fidelity="iss", chaser={"inertia": tuple(moments)})
    _, _, attitudes, rates = View.of(views)
    momentum = np.array([reference.rotation(q).apply(moments * rate) for q, rate in zip(attitudes, rates)])
    energy = (moments * rates**2).sum(1) / 2
    assert np.ptp(rates, axis=0).min() > 0.01
    np.testing.assert_allclose(energy, energy[0], rtol=0, atol=1e-6)  # J, of 145
    np.testing.assert_allclose(momentum, momentum[:1].repeat(13, 0), rtol=0, atol=1e-4)  # N m s, of 3700


@pytest.mark.parametrize("fidelity", ["iss-hcw", "iss-numerical"])
def test_a_librating_body_keeps_its_jacobi_integral(fly, fidelity):
    """At the station on a circular orbit: kinetic energy in the station frame plus gravity gradient and centrifugal."""
    moments = np.array([80_000.0, 60_000.0, 50_000.0])
    orbit = {"forces": POINT_MASS, "chief": {"eccentricity": 0.0}} if fidelity == "iss-numerical" else {}
    view = view_of(np.zeros(3), attitude=[0.6, 0.48, -0.64, 0.0], rate=[3e-4, -2e-4, 1e-4])
    _, views = fly(view, seconds=PERIOD, fidelity=fidelity, chaser={"inertia": tuple(moments)}, **orbit)

    def integral(view):
        _, _, attitude, rate = View.of(view)
        normal, _, zenith = reference.rotation(attitude).as_matrix()
        along = 3 * (moments * zenith**2).sum() - (moments * normal**2).sum()
        return ((moments * rate**2).sum() + MEAN_MOTION**2 * along) / 2

    values = np.array([integral(v) for v in views])
    assert np.ptp((moments * View.of(views).rate ** 2).sum(1)) / 2 > 0.02  # J: the parts do change
    np.testing.assert_allclose(values, values[0], rtol=0, atol=1e-12)


def test_hill_keeps_its_invariants_and_closes_the_drift_free_ellipse(fly):
    """Station axes: x cross-track, y aft, z zenith; the ellipse 2 x 1 with no drift has vy = 2 n z."""
    n = MEAN_MOTION
    ellipse = view_of([80.0, 120.0, 60.0], [0.05, 2 * n * 60.0, -0.03])
    drifting = view_of([80.0, 120.0, 60.0], [0.05, 0.1, -0.03])
    _, views = fly(ellipse, seconds=PERIOD, fidelity="iss-hcw")
    np.testing.assert_allclose(views[-1, :6], views[0, :6], rtol=0, atol=1e-8)
    assert distance(views[6], views[0]) > 100
    for view in (ellipse, drifting):
        _, views = fly(view, seconds=PERIOD, fidelity="iss-hcw")
        (x, _, z), (vx, vy, vz) = (part.T for part in View.of(views)[:2])
        energy = (vx**2 + vy**2 + vz**2 + n**2 * (x**2 - 3 * z**2)) / 2
        np.testing.assert_allclose(energy, energy[0], rtol=0, atol=1e-11)  # J/kg
        np.testing.assert_allclose(vy - 2 * n * z, vy[0] - 2 * n * z[0], rtol=0, atol=1e-11)  # m/s


# --- the station frame ---


def test_the_station_frame_turns_with_its_orbit_plane_too(fly):
    """Its axes rebuilt from the chief's orbit and differenced: the rate has an out-of-plane part, and views use it.

    A spherical body that stands still in inertial space by that rate does so for 360 s; a frame that turned about
    the orbit normal only would give it 1e-6 rad/s, 4e-4 rad in all.
    """
    at = {"day": 1.0, "second": 700.0, "fidelity": "iss-numerical", "chaser": {"inertia": (5e4,) * 3}}
    central, forward = ((-2, 1), (-1, -8), (1, 8), (2, -1)), ((0, -25), (1, 48), (2, -36), (3, 16), (4, -3))

    def derivative(f, i, spacing, stencil=central):
        return sum(weight * f[i + k] for k, weight in stencil) / (12 * spacing)

    def axes(chief):
        normal = np.cross(chief[:3], chief[3:])
        normal, zenith = normal / np.linalg.norm(normal), chief[:3] / np.linalg.norm(chief[:3])
        return np.array([normal, np.cross(zenith, normal), zenith])

    def frame_rate(chiefs, i, *difference):
        frames = np.array([axes(c) for c in chiefs])
        spin = frames[i] @ derivative(frames, i, *difference).T  # columns: the axes' derivatives, in the axes
        return np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]) / 2

    chiefs, views = fly(view_of(225 * OBLIQUE, [0.1, -0.2, 0.1]), seconds=6.0, **at)
    position, velocity, *_ = View.of(views)
    np.testing.assert_allclose(velocity[6], derivative(position, 6, 0.5), rtol=0, atol=1e-6)  # m/s
    rate = frame_rate(chiefs, 0, 0.5, forward)
    assert abs(rate[2]) > 1e-6  # rad/s: else this would show nothing

    still = -reference.rotation(ATTITUDE).inv().apply(rate)
    chiefs, views = fly(view_of(225 * OBLIQUE, rate=still), **at)
    _, _, attitude, rates = View.of(views)
    attitudes = [reference.Rotation.from_matrix(axes(c).T) * reference.rotation(q) for c, q in zip(chiefs, attitude)]
    assert (attitudes[0].inv() * attitudes[-1]).magnitude() < 1e-7  # rad
    seen = -reference.rotation(attitude[6]).apply(rates[6])
    np.testing.assert_allclose(seen, frame_rate(chiefs, 6, 30.0), rtol=0, atol=1e-9)  # rad/s


# --- lighting ---


def test_starts_over_the_seven_days_see_day_night_and_terminator(x64):
    """Of 20 000 starts 62 % are in full sunlight, 38 % in the umbra, 0.3 % between; 12 % are lit by a Sun below the
    local horizontal. A circular orbit through a cylinder of shadow, at each start's Sun angle, gives the same night.
    """
    env = DockingEnv(None, fidelity="iss-numerical")
    params = env.default_params()

    @jax.jit
    @jax.vmap
    def lighting(key):
        start = sample_start(params, key=key, port=jnp.asarray(-1))
        chief = env.dynamics.init(params, start.epoch, start.view).chief
        sun = sun_position(*start.epoch)
        zenith = jnp.dot(chief[:3], sun) / jnp.linalg.norm(chief[:3]) / jnp.linalg.norm(sun)
        normal = jnp.cross(chief[:3], chief[3:])
        beta = jnp.arcsin(jnp.dot(normal, sun) / jnp.linalg.norm(normal) / jnp.linalg.norm(sun))
        return illumination_conical(chief[:3], sun), jnp.degrees(jnp.arcsin(zenith)), beta

    visible, elevation, beta = map(np.asarray, lighting(jax.random.split(jax.random.key(0), 20_000)))
    day, night = np.mean(visible == 1), np.mean(visible == 0)
    penumbra = 1 - day - night
    # Below the local horizontal and still lit: the dip of the horizon at 417 km is 20 deg.
    terminator = np.mean((visible > 0) & (elevation < 0))
    shadow = np.arccos(np.sqrt(1 - (reference.RADIUS / SMA) ** 2) / np.cos(beta)) / np.pi
    assert night + penumbra / 2 == pytest.approx(shadow.mean(), abs=0.01)
    assert 0.60 < day < 0.64
    assert 0.36 < night < 0.40
    assert 1e-3 < penumbra < 6e-3
    assert 0.10 < terminator < 0.14
    assert elevation.min() < -60 and elevation.max() > 60


# --- starts ---

OTHERWISE = {  # what must not move a start, changed in groups
    "rates": {"dt": 0.5, "steps_per_action": 20, "horizon": 90.0},
    "task": {
        "noise": "noncooperative",
        "reward": "rl",
        "collision_terminates": False,
        "escape_radius": 500.0,
        "obstacles": [((100.0, 100.0, 100.0), (101.0, 101.0, 101.0))],
        "goal_error": False,
        "normalize": True,
    },
    "physics": {
        "chaser": {"actuation_delay": 3, "mass": 9e3, "misalignment": (0.1, 0.0, 0.0)},
        "forces": POINT_MASS,
        "chief": {"eccentricity": 0.01, "inclination_deg": 97.0},
    },
    "ports": {"ports": ["zvezda_aft"]},
}


@pytest.fixture(scope="module")
def starts_of(quick):
    """Epochs, views, next episodes' keys and ports that two seeds draw under a configuration, once a module."""
    drawn = {}

    def starts(x64=True, **config):
        name = repr((x64, sorted(config.items())))
        if name not in drawn:
            with jax.enable_x64(x64):
                env = DockingEnv(None, **config)

                def start(params, key):
                    state, _ = env.reset(params, key=key)
                    return state.physics.epoch, state.view, jax.random.key_data(state.next_key), state.port

                # Only what is returned gets compiled: neither collision nor sensors.
                program = quick(jax.vmap(start, in_axes=(None, 0)))
                drawn[name] = jax.device_get(program(env.default_params(), jax.random.split(jax.random.key(11))))
        return drawn[name]

    return starts


@pytest.mark.parametrize("change", OTHERWISE)
def test_the_same_seed_starts_the_same_whatever_else_changes(starts_of, change):
    ours, theirs = starts_of(fidelity="iss-numerical"), starts_of(fidelity="iss-numerical", **OTHERWISE[change])
    for a, b in zip(ours[:3] if change == "ports" else ours, theirs):
        np.testing.assert_array_equal(a, b)


def test_the_same_seed_starts_the_same_at_every_fidelity_and_rate(starts_of, fidelity):
    ours, theirs = starts_of(fidelity="iss-numerical"), starts_of(fidelity=fidelity, **OTHERWISE["rates"])
    for a, b in zip(ours, theirs):
        np.testing.assert_array_equal(a, b)


def test_float32_starts_are_the_same_in_and_out_of_64_bit_mode(starts_of):
    """They are not float64's: the generator spends other bits on a draw of another width."""
    inside, outside = (starts_of(x64, fidelity="iss", precision="float32") for x64 in (True, False))
    for a, b in zip(inside, outside):
        np.testing.assert_array_equal(a, b)
    double = starts_of(fidelity="iss-numerical")
    np.testing.assert_array_equal(double[2], inside[2])
    assert np.abs(double[1] - inside[1]).max() > 1.0
