"""Plumes that the hull throws back."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.config import load_config
from owm_envs.config.params import params_from_config
from owm_envs.task.plume import near_hull, thrown_back
from owm_envs.view import View

CUBE = np.array([[[-1.0] * 3, [1.0] * 3]])
LEVEL = np.array([1.0, 0, 0, 0])


@pytest.fixture(scope="module")
def push():
    """Of a wrench on a chaser of radius 2 m at a position and attitude by a cube of 2 m; strength 0.4, reach 5 m."""
    chaser = {"radius": 2.0, "plume": {"strength": 0.4, "reach": 5.0}}

    @jax.jit
    def pushed(chaser, view, wrench):
        return thrown_back(near_hull(chaser, view, jnp.asarray(CUBE)), wrench)

    def of(wrench, position, attitude=LEVEL):
        with jax.enable_x64(True):
            view = np.concatenate([position, np.zeros(3), attitude, np.zeros(3)])
            return np.asarray(pushed(params_from_config(load_config(chaser=chaser)).chaser, view, jnp.asarray(wrench)))

    return of


def test_a_jet_straight_at_the_hull_pushes_back_and_less_from_afar(push):
    """At contact by the strength, a reach away by a quarter of it, to either side alike."""
    brake = np.array([100.0, 0, 0, 0, 0, 50.0])
    for clearance, share in ((0.0, 0.4), (5.0, 0.1), (45.0, 0.004)):
        for side in (1.0, -1.0):
            back = push(side * brake, [side * (3.0 + clearance), 0.3, -0.2])
            np.testing.assert_allclose(back, [side * 100.0 * share, 0, 0, 0, 0, 0], atol=1e-9)


def test_only_what_is_blown_at_the_hull_comes_back(push):
    away_from_hull, across, torque = [-100.0, 0, 0, 0, 0, 0], [0, 100.0, -50.0, 0, 0, 0], [0, 0, 0, 9.0, 9.0, 9.0]
    for wrench in (away_from_hull, across, torque):
        np.testing.assert_array_equal(push(np.array(wrench, float), [4.0, 0, 0]), 0)


def test_a_plume_is_narrow_and_turns_with_the_body(push):
    half = np.radians(30) / 2
    turned = np.array([np.cos(half), 0, 0, np.sin(half)])
    straight, slanted = (push(np.array([100.0, 0, 0, 0, 0, 0]), [3.0, 0, 0], at) for at in (LEVEL, turned))
    assert np.linalg.norm(slanted) == pytest.approx(np.linalg.norm(straight) * np.cos(np.radians(30)) ** 7)
    # Away from the hull, whichever way the body is turned.
    np.testing.assert_allclose(slanted[:2] / np.linalg.norm(slanted), [np.cos(2 * half), -np.sin(2 * half)], atol=1e-9)


def test_without_strength_programs_are_the_default_ones():
    assert load_config(chaser={"plume": {"reach": 9.0}, "sag_time": 2.0}).structure == load_config().structure
    assert load_config(chaser={"plume": {"strength": 0.1}}).structure.plume


def test_an_environment_brakes_harder_by_the_hull_and_its_gradient_is_finite(x64, docking):
    box, gained = [[-1.0] * 3, [1.0] * 3], {}
    for strength in (0.0, 0.4):
        env, params, reset, step = docking(
            fidelity="iss", hull=[box], chaser={"plume": {"strength": strength}, "delay_growth": 2}
        )
        start, _ = reset(params, key=jax.random.key(0))
        there = View.of(start.view)._replace(position=jnp.asarray([8.25, 0, 0]), attitude=jnp.asarray(LEVEL))
        state = env.relocate(params, start, there.numbers())
        brake = jnp.asarray([1000.0, 0, 0, 0, 0, 0])
        after, _ = step(params, state, brake)
        gained[strength] = float(View.of(after.view - state.view).velocity[0])
    pushed = (gained[0.4] - gained[0.0]) * 12_000 / 0.05
    assert pushed == pytest.approx(1000 * 0.1, rel=0.2)  # it turns and drifts a little in one step
    slope = jax.jit(jax.grad(lambda a: jnp.sum(View.of(env.step(params, state, a)[0].view).velocity ** 2)))(brake)
    assert np.isfinite(slope).all() and slope[0] != 0
