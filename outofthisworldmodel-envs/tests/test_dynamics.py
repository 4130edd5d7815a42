import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_angle, quat_from_rotation_vector, quat_multiply
from astrojax.constants import GM_EARTH
from astrojax.orbits import stm_hcw
from owm_envs.config import FIDELITIES
from owm_envs.dynamics import RTN_TO_STATION
from owm_envs.view import View

VIEW = np.array([30.0, -40.0, 20.0, 0.3, -0.2, 0.1, 0.5, 0.5, -0.5, 0.5, 0.004, -0.003, 0.002])
STILL = {"zonal_degree": 0, "sun": False, "moon": False, "drag": False}
CIRCULAR = {"eccentricity": 0.0}
ORBITAL = [f for f in FIDELITIES if f != "iss"]


@pytest.fixture
def flight(x64, docking):
    """Drifts a view for so many steps under a wrench and returns every relative view, the first included."""

    def fly(view, wrench=(0.0,) * 6, steps=20, dt=0.05, **overrides):
        env, params, *_ = docking(**overrides)
        dynamics = env.dynamics
        epoch = params.chief.epoch + jnp.asarray([2.0, 1234.5])

        @jax.jit
        def run(view):
            state = dynamics.init(params, epoch, view)

            def step(state, _):
                after = dynamics.step(params, state, jnp.asarray(wrench, float), jnp.asarray(dt))
                return after, dynamics.relative_state(params, after)

            _, views = jax.lax.scan(step, state, length=steps)
            return jnp.concatenate([dynamics.relative_state(params, state)[None], views])

        return np.array(run(jnp.asarray(view, float)))

    return fly


def apart(q, p):
    return float(quat_angle(jnp.asarray(q), jnp.asarray(p)))


def test_init_is_the_inverse_of_the_relative_view(flight, fidelity):
    seen, given = View.of(flight(VIEW, steps=1, fidelity=fidelity)[0]), View.of(VIEW)
    np.testing.assert_allclose(seen.position, given.position, atol=1e-7)
    np.testing.assert_allclose(seen.velocity, given.velocity, atol=1e-9)
    assert apart(seen.attitude, given.attitude) < 1e-9
    np.testing.assert_allclose(seen.rate, given.rate, atol=1e-12)


def test_velocity_and_rate_are_the_derivatives_of_position_and_attitude(flight, fidelity):
    dt = 0.05
    views = flight(VIEW, wrench=[800, -600, 400, 500, 300, -200], dt=dt, fidelity=fidelity)
    position, velocity, attitude, rate = View.of(views)
    np.testing.assert_allclose((position[2:] - position[:-2]) / (2 * dt), velocity[1:-1], atol=1e-5)
    turns = jnp.asarray((rate[1:] + rate[:-1]) / 2 * dt)
    for before, after, turn in zip(attitude, attitude[1:], turns):
        assert apart(after, quat_multiply(jnp.asarray(before), quat_from_rotation_vector(turn))) < 1e-8


def test_thrust_accelerates_along_the_body_axes(flight, fidelity):
    at_rest = np.concatenate([np.zeros(6), [0.0, 0.0, 0.0, 1.0], np.zeros(3)])  # half a turn about zenith
    end = View.of(flight(at_rest, wrench=[1200, 0, 600, 0, 0, 1000], fidelity=fidelity)[-1])
    np.testing.assert_allclose(end.velocity, [-0.1, 0.0, 0.05], atol=5e-4)
    np.testing.assert_allclose(end.rate, [0, 0, 1000 / 50_000], atol=2e-5)


def test_free_flyer_drifts_straight(flight):
    start, end = View.of(VIEW), View.of(flight(VIEW, steps=200, fidelity="iss")[-1])
    np.testing.assert_allclose(end.position, start.position + 10 * start.velocity, atol=1e-9)
    np.testing.assert_allclose(end.velocity, start.velocity, atol=1e-12)


@pytest.mark.parametrize(
    ("overrides", "scale", "tolerance"),
    [
        ({"fidelity": "iss-hcw"}, 1.0, 1e-8),
        # Two point-mass orbits differ from their linearisation by terms of order separation squared over radius.
        ({"fidelity": "iss-numerical", "forces": STILL, "chief": CIRCULAR}, 1.0, 5e-4),
        ({"fidelity": "iss-numerical", "forces": STILL, "chief": CIRCULAR}, 0.01, 5e-7),
    ],
)
def test_drift_follows_the_closed_form_of_hill(flight, overrides, scale, tolerance):
    view = np.concatenate([VIEW[:6] * scale, VIEW[6:]])
    end = View.of(flight(view, steps=400, **overrides)[-1])
    n = np.sqrt(GM_EARTH / 6_795_000.0**3)
    relabel = np.kron(np.eye(2), RTN_TO_STATION)
    expected = relabel @ np.asarray(stm_hcw(n, 20.0)) @ relabel.T @ view[:6]
    np.testing.assert_allclose(end.position, expected[:3], atol=tolerance)


@pytest.mark.parametrize("fidelity", ORBITAL)
def test_an_inertially_fixed_attitude_turns_backwards_in_the_station_frame(flight, fidelity):
    n = np.sqrt(GM_EARTH / 6_795_000.0**3)
    spherical = {"inertia": (50_000.0,) * 3}
    fixed = np.concatenate([np.zeros(6), [1.0, 0.0, 0.0, 0.0], [-n, 0.0, 0.0]])
    overrides = {"fidelity": fidelity, "chaser": spherical, "chief": CIRCULAR}
    if fidelity == "iss-numerical":
        overrides["forces"] = STILL
    end = flight(fixed, steps=400, **overrides)[-1]
    expected = quat_from_rotation_vector(jnp.asarray([-20 * n, 0.0, 0.0]))
    assert apart(View.of(end).attitude, expected) < 1e-8


def test_gravity_gradient_acts_in_orbit_only(flight, fidelity):
    tilted = np.concatenate([np.zeros(6), np.asarray(quat_from_rotation_vector(jnp.asarray([0.7, 0, 0]))), np.zeros(3)])
    end = flight(tilted, steps=400, fidelity=fidelity)[-1]
    slender = {"inertia": (80_000.0, 80_000.0, 80_000.0)}
    without = flight(tilted, steps=400, fidelity=fidelity, chaser=slender)[-1]
    n = np.sqrt(GM_EARTH / 6_795_000.0**3)
    torque = 3 * n**2 * (50_000 - 80_000) / 80_000 * np.sin(0.7) * np.cos(0.7)
    expected = 0.0 if fidelity == "iss" else abs(torque) * 20
    assert abs(end[10] - without[10]) == pytest.approx(expected, rel=0.02, abs=1e-9)
