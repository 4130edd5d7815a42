"""The velocity of the safe approach on its last metres, for a sound vehicle and for one that answers slowly."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_rotate
from owm_envs.field import field_rows, load_field
from owm_envs.policies.guidance import Goal, drift_beside, safe_velocity
from owm_envs.station import goal_poses, port_index

PORT = "zvezda_aft"


@pytest.fixture(scope="module")
def wanted():
    """The velocity (m/s) along the port's outward axis and across it, at an offset from the hold pose in such axes."""
    field, index = load_field([PORT]), port_index(PORT)
    pose = goal_poses()[index].astype(np.float32)
    axes = -np.asarray(jax.vmap(quat_rotate, (None, 0))(jnp.asarray(pose[3:]), jnp.eye(3)[::-1]))
    goal = Goal(field, np.int32(field_rows(field)[index]), pose, drift_beside(6_795_000.0))
    compiled = jax.jit(safe_velocity)

    def at(along, across=0.0, away=False, **changed):
        position = pose[:3] + along * axes[0] + across * axes[1]
        numbers = {
            name: np.float32(value) for name, value in ({"pace": 1, "gate": -10, "steady": 1.014} | changed).items()
        }
        velocity = compiled(
            goal._replace(**numbers, away=np.bool_(away)), position.astype(np.float32), np.zeros(3, np.float32)
        )
        return axes[:2] @ np.asarray(velocity)

    return at


@pytest.mark.parametrize(("along", "speed"), [(4.5, 4.5 / 13), (2.0, 2.0 / 13), (0.5, 0.078), (0.05, 0.078)])
def test_a_sound_vehicle_closes_in_by_distance_and_touches_at_the_standard_s_rate(wanted, along, speed):
    np.testing.assert_allclose(wanted(along), [-speed, 0], atol=1e-3)


def test_off_the_axis_it_holds_back_and_comes_back_to_it(wanted):
    on, off = wanted(2.0), wanted(2.0, 0.5)
    assert on[0] < off[0] < 0.05 and off[1] == pytest.approx(-0.5 / 4, abs=1e-3)


SLOW = {"pace": 0.16, "steady": 6.0}


@pytest.mark.parametrize(("along", "across"), [(4.0, 0.0), (3.0, 0.6), (1.0, -0.2), (-0.5, 0.1)])
def test_a_slow_vehicle_aims_for_the_goal_at_the_rate_of_contact(wanted, along, across):
    towards = -np.array([along, across]) / np.hypot(along, across)
    np.testing.assert_allclose(wanted(along, across, **SLOW), 0.078 * towards, atol=1e-3)


def test_it_waits_at_a_gate_and_backs_off_to_it(wanted):
    speeds = [wanted(along, gate=1.2, **SLOW)[0] for along in (3.0, 1.5, 1.2, 0.4)]
    np.testing.assert_allclose(speeds, [-0.078, -0.3 / 13, 0.0, 0.05], atol=2e-3)


def test_far_out_it_goes_down_the_field_at_its_pace(wanted):
    sound, slow = wanted(60.0, pace=0.99, steady=6.0), wanted(60.0, **SLOW)
    np.testing.assert_allclose(slow, sound * 0.16 / 0.99, rtol=1e-4)
    assert slow[0] < -0.05


@pytest.mark.parametrize("along", [0.0, 2.0, 20.0, 60.0, 200.0])
def test_who_leaves_goes_straight_out_the_faster_the_farther_off(wanted, along):
    out, across = wanted(along, away=True)
    assert out == pytest.approx(np.clip(0.2 + 0.03 * (along + 3.75), 0.2, 1.0), abs=0.12)
    assert abs(across) < 0.2 * out
