"""How the planner flies a vehicle that has lost an axis of force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax.attitude import quat_conjugate, quat_from_rotation_vector, quat_multiply, quat_rotate
from owm.planning import facing as facings
from owm.planning.approach import Approach, led_along
from owm.planning.effect import Effect, authority, effect_of, wrench_for
from owm.planning.facing import is_crippled
from owm.planning.health import Health, may_dock

PORT = np.array([0.5, 0.5, -0.5, 0.5], np.float32)
facing, missing_forces = jax.jit(facings.facing), jax.jit(facings.missing_forces)
facing_out = jax.jit(facings.facing_out)
ACCELERATION = 1600.0 / 12_000.0


def effect_with(shares, attitude) -> Effect:
    """Of candidates that a vehicle with these shares of its forces flies at an attitude, for a second."""
    actions = 0.2 * np.random.default_rng(0).standard_normal((128, 2, 6)).astype(np.float32)
    body = ACCELERATION * np.asarray(shares, np.float32) * actions.mean(axis=1)[:, :3]
    after = np.zeros((128, 13), np.float32)
    after[:, 3:6] = np.asarray(jax.vmap(quat_rotate, (None, 0))(jnp.asarray(attitude), body))
    after[:, 10:] = 0.02 * actions.mean(axis=1)[:, 3:]
    return effect_of(jnp.asarray(actions), jnp.zeros_like(after), after, 1.0)


@pytest.mark.parametrize("attitude", [np.float32([1, 0, 0, 0]), PORT])
def test_an_axis_that_is_out_is_asked_for_nothing_and_does_not_count(attitude):
    effect = effect_with((1.0, 0.0, 1.0), attitude)
    wanted = jnp.zeros(6).at[:3].set(quat_rotate(jnp.asarray(attitude), jnp.asarray([0.05, 0.05, -0.02])))
    wrench = np.asarray(wrench_for(effect, wanted))
    np.testing.assert_allclose(wrench[[0, 2]], np.array([0.05, -0.02]) / ACCELERATION, atol=2e-3)
    assert wrench[1] == pytest.approx(float(effect.action[1]), abs=2e-4), "as the candidates had it"
    assert float(authority(effect)) == pytest.approx(ACCELERATION, rel=1e-3)
    missing = np.asarray(missing_forces(effect, attitude))
    np.testing.assert_allclose(np.diag(missing), [0.01, 1.0, 0.01], atol=5e-3)
    assert is_crippled(missing)


@pytest.mark.parametrize("shares", [(1.0, 1.0, 1.0), (1.0, 0.3, 1.0), (0.2, 0.2, 0.2)])
def test_a_vehicle_that_is_merely_weak_holds_the_port_s_attitude(shares):
    effect = effect_with(shares, PORT)
    assert float(authority(effect)) == pytest.approx(min(shares) * ACCELERATION, rel=0.01)
    missing = missing_forces(effect, PORT)
    assert not is_crippled(missing)
    np.testing.assert_array_equal(facing(missing, *seen((0, -9, 0)), leading([0.3, 0.2, 0.1])), PORT)


def seen(offset, velocity=(0, 0, 0), attitude=PORT):
    """A view, and the pose of a goal at the origin."""
    view = np.concatenate([offset, velocity, attitude, np.zeros(3)]).astype(np.float32)
    return view, np.concatenate([np.zeros(3), PORT]).astype(np.float32)


def leading(change):
    """A path from rest that takes up a velocity within its first 4 s."""
    velocity = np.minimum(np.arange(65) / 16, 1)[:, None] * np.asarray(change)
    return np.concatenate([[0, -60, 0] + 0.25 * np.cumsum(velocity, axis=0), velocity], axis=1).astype(np.float32)


@pytest.mark.parametrize("axis", range(3))
def test_the_axis_that_is_out_is_turned_away_from_what_is_wanted(axis):
    shares = np.where(np.arange(3) == axis, 0.0, 1.0)
    missing = missing_forces(effect_with(shares, PORT), PORT)
    out = np.asarray(quat_rotate(jnp.asarray(PORT), jnp.eye(3)[axis]))
    view, pose = seen((0, -60, 0))
    turned = facing(missing, view, pose, leading(0.2 * out))
    lost = np.dot(np.asarray(quat_rotate(turned, jnp.eye(3)[axis])), out)
    assert abs(lost) < 1e-5
    angle = 2 * np.degrees(np.arccos(abs(np.dot(turned, PORT))))
    assert angle == pytest.approx(90.0, abs=0.01)
    across = np.asarray(quat_rotate(jnp.asarray(PORT), jnp.eye(3)[(axis + 1) % 3]))
    np.testing.assert_array_equal(facing(missing, view, pose, leading(0.2 * across)), PORT)


def test_who_is_on_course_and_near_turns_to_the_port_for_good():
    """Out along the port's axis: at the closing speed it needs no more of it; too slow, it stays turned to push."""
    nose = np.asarray(quat_rotate(jnp.asarray(PORT), jnp.asarray([0.0, 0, 1])))
    quarter = quat_from_rotation_vector(jnp.asarray([np.pi / 2, 0, 0], jnp.float32))
    aside = np.asarray(quat_multiply(jnp.asarray(PORT), quarter))
    missing = missing_forces(effect_with((1.0, 1.0, 0.0), aside), aside)
    steps = np.arange(65)[:, None]

    def held(speed):
        view, pose = seen(-3.0 * nose, speed * nose, aside)
        towards = speed + (0.078 - speed) * np.minimum(steps / 16, 1)
        path = np.concatenate([-3.0 * nose + 0.25 * np.cumsum(towards, axis=0) * nose, towards * nose], axis=1)
        return np.asarray(facing(missing, view, pose, path.astype(np.float32)))

    np.testing.assert_allclose(held(0.075), PORT, atol=1e-6)
    assert abs(np.dot(held(0.01), aside)) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("led", [True, False])
def test_torques_are_led_along_rates_or_left_to_the_plan(led):
    """Rates grow by 0.01 rad/s2 about x and against z: by half of what the torques can do."""
    effect = effect_with((1.0, 1.0, 1.0), PORT)
    plan = jnp.full((8, 6), 0.3, jnp.float32)
    rates = 0.25 * jnp.arange(9.0)[:, None] * jnp.asarray([0.01, 0.0, -0.01])
    approach = Approach(None, None, jnp.zeros((9, 6)), jnp.ones(6), rates, jnp.asarray(led))
    actions = np.asarray(jax.jit(led_along, static_argnums=3)(approach, effect, plan, 0.25))
    np.testing.assert_allclose(actions[:, 3:], [[0.5, 0.0, -0.5] if led else [0.3] * 3] * 8, atol=0.02)


def test_attitudes_are_unit_quaternions_whatever_is_known():
    nothing = Effect(*(jnp.zeros(n) for n in ((6,), (6,), (6, 6), (6, 6))), jnp.ones(()))
    missing = missing_forces(nothing, PORT)
    assert not np.any(missing) and float(authority(nothing)) == np.inf
    away = np.asarray(quat_conjugate(jnp.asarray(PORT)))
    np.testing.assert_array_equal(facing(missing, *seen((1, 2, 3), (1, 0, 0), away), leading([1, 2, 3])), PORT)


@pytest.mark.parametrize("left", range(3))
def test_who_leaves_with_one_axis_turns_it_along_the_way_out(left):
    shares = np.where(np.arange(3) == left, 1.0, 0.0)
    missing = missing_forces(effect_with(shares, PORT), PORT)
    wanted = np.array([0.1, -0.3, 0.2], np.float32)
    turned = facing_out(missing, PORT, wanted)
    along = np.asarray(quat_rotate(turned, jnp.eye(3)[left]))
    assert abs(np.dot(along, wanted)) == pytest.approx(np.linalg.norm(wanted), rel=1e-4)
    angle = 2 * np.degrees(np.arccos(min(1, abs(np.dot(turned, PORT)))))
    assert angle < 90.01, "whichever way along the axis is nearer"


def test_who_leaves_with_more_stays_as_it_is_turned():
    missing = missing_forces(effect_with((1.0, 0.0, 1.0), PORT), PORT)
    np.testing.assert_array_equal(facing_out(missing, PORT, np.float32([0.1, 0, 0])), PORT)


@pytest.mark.parametrize(
    ("shares", "docks"),
    [
        ({}, True),
        ({1: 0.0}, True),
        ({0: 0.0, 1: 0.2}, False),
        ({3: 0.0}, False),
        ({5: 0.3}, False),
        ({4: 0.7}, True),  # turned by 45 deg, say
    ],
)
def test_two_axes_of_force_or_one_of_torque_are_too_few(shares, docks):
    share = np.ones((6, 2), np.float32)
    for axis, left in shares.items():
        share[axis, 0] = left  # pushes one way
    found = Health(jnp.asarray(share), jnp.full(6, 0.1), jnp.zeros(6), jnp.zeros(6))
    assert may_dock(found) == docks
    unsure = found._replace(deviation=jnp.full(6, 0.5))
    assert may_dock(unsure), "not on a suspicion"
