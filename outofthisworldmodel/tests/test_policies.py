"""Policies beside the planner on a learned model: online least squares and the classical stack."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import synthetic

from owm.baselines.classical import CRUISE_RADIUS, classical_policy, corridor_of, inside, wanted_velocity
from owm.baselines.least_squares import LeastSquares
from owm.baselines.online import OnlineBase, OnlineLeastSquares
from owm.catalogue.policies import GIVEN, content_digest, is_planned, kind_of, load_model
from owm.checkpoint import save_world_model
from owm.model.config import ModelConfig
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Network, Params
from owm.motion.linear import LinearMap
from owm.planning.health import usable
from owm.planning.mpc import beyond, clohessy_wiltshire, solve, tracking
from owm.scores.docking import evaluation_config
from owm_envs.env import DockingEnv
from owm_envs.policies import VectorPolicy
from owm_envs.station import goal_poses, hull_boxes
from owm_envs.view import VIEW_SLICES, View

LIMIT = (1600.0,) * 3 + (2000.0,) * 3
NOMINAL = np.diag(0.25 / np.array([12_000.0] * 3 + [80_000.0, 80_000.0, 50_000.0]))
RATE = 1.127e-3


@pytest.fixture(scope="module")
def fit() -> LinearMap:
    """The nominal chaser's map, without orbital terms."""
    values = (NOMINAL, np.zeros(6), np.zeros((3, 6)), np.zeros((3, 15)))
    return LinearMap(*(jnp.asarray(x, jnp.float32) for x in values))


@pytest.fixture(scope="module")
def world_model(episodes) -> LearnedWorldModel:
    """An untrained kinematic model."""
    config = ModelConfig(width=8, heads=2, head_width=8)
    network = jax.jit(lambda: Network(config, key=jax.random.key(0)))()
    return LearnedWorldModel(config, Params(network, STREAMS["kinematic"].fit(episodes)))


def test_online_least_squares_finds_another_chaser_and_keeps_what_it_is_not_shown(fit):
    """A weak, skewed thruster and a bias under cooperative noise; the torque about y is never commanded."""
    learner = OnlineLeastSquares(LIMIT)
    truth = NOMINAL.copy()
    truth[0, :2] = 0.7 * NOMINAL[0, 0], 0.09 * NOMINAL[1, 1]
    bias = np.array([0, 0, 2e-3, 0, 0, 0])
    held = np.repeat(np.random.default_rng(0).uniform(-0.3, 0.3, (60, 6)), 8, axis=0) * LIMIT
    held[:, 4] = 0.0

    @jax.jit
    def fly(held, changes):
        def step(carry, given):
            view, before, known = carry
            key, wrench, change = given
            # Torques are measured but do not turn it, so that the body axes stay those of the changes.
            position, velocity, attitude, _ = View.of(view)
            view = View(position, velocity + change[:3], attitude, change[3:]).numbers()
            after = synthetic.measure(key, view)
            return (view, after.at[VIEW_SLICES.rate].set(0.0), learner.learn(known, before, wrench, after)), None

        view = jnp.asarray([0, -30, 5, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], jnp.float32)
        keys = jax.random.split(jax.random.key(1), len(held))
        (_, _, known), _ = jax.lax.scan(step, (view, view, learner.init(fit)), (keys, held, changes))
        return learner.params(learner.init(fit)), learner.params(known)

    fresh, found = fly(held.astype(np.float32), (held @ truth.T + bias).astype(np.float32))
    np.testing.assert_allclose(fresh.action, fit.action, rtol=1e-4, atol=1e-10)
    assert np.abs(np.asarray(found.action)[:3, :3] - truth[:3, :3]).max() < 0.03 * NOMINAL[0, 0]
    assert abs(float(found.bias[2]) - 2e-3) < 2e-4
    np.testing.assert_allclose(found.action[4, 4], NOMINAL[4, 4], rtol=1e-3)


def test_a_change_in_flight_is_found_in_seconds_and_nothing_where_there_is_none(fit):
    """Cooperative noise; the force along y dies after 40 s, or its one way, or not. The learner says how sure it is."""
    learner = OnlineLeastSquares(LIMIT)
    rng = np.random.default_rng(0)
    held = (np.repeat(rng.uniform(-0.3, 0.3, (60, 6)), 8, axis=0) * LIMIT).astype(np.float32)
    noise = rng.normal(size=(480, 13)) * ([0.03] * 3 + [1.2e-3] * 3 + [0] * 4 + [6e-6] * 3)

    @jax.jit
    def fly(lives, noise):
        def step(carry, given):
            velocity, before, known = carry
            wrench, alive, error = given
            alive = jnp.where(wrench[1] < 0, *alive)
            change = jnp.asarray(NOMINAL, jnp.float32) @ wrench * jnp.ones(6, jnp.float32).at[1].set(alive)
            velocity = velocity + change[:3]
            view = View(jnp.zeros(3), velocity, jnp.asarray([1.0, 0, 0, 0]), change[3:]).numbers() + error
            known = learner.learn(known, before.at[VIEW_SLICES.rate].set(0.0), wrench, view)
            return (velocity, view, known), learner.health(known)

        start = (jnp.zeros(3), jnp.zeros(13).at[6].set(1.0), learner.init(fit))
        return jax.lax.scan(step, start, (held, lives, noise))[1]

    lives = np.where(np.arange(480) < 160, 1.0, 0.0).astype(np.float32)
    always = np.ones_like(lives)
    failed, one_sided, sound = (
        jax.device_get(fly(np.stack(x, axis=1), noise.astype(np.float32)))
        for x in ((lives, lives), (lives, always), (always, always))
    )
    assert not (sound.alarms > 0).any() and np.abs(sound.share[100:] - 1).max() < 0.2
    assert not (failed.alarms > 0)[:160].any() and (failed.alarms > 0)[160:].any(axis=0).tolist() == [0, 1, 0, 0, 0, 0]
    found = np.argmax((failed.alarms > 0)[:, 1])
    assert 160 < found < 200, "within ten seconds, of commands up to three tenths"
    share, spread = failed.share[found + 20 :, 1], failed.deviation[found + 20 :, 1]
    assert np.abs(share).max() < 0.5 and np.abs(share[60:]).max() < 0.2
    assert np.mean(np.abs(share) < 3 * spread[:, None]) > 0.9
    assert np.abs(np.delete(failed.share[240:], 1, axis=1) - 1).max() < 0.2
    np.testing.assert_allclose(one_sided.share[-1, 1], [0.0, 1.0], atol=0.25)
    # One measurement in twenty is far off: no change is seen in that, and a true one is.
    outliers = noise * np.where(rng.uniform(size=(480, 1)) < 0.05, 20.0, 1.0)
    sound_too, failed_too = (
        jax.device_get(fly(np.stack(x, axis=1), outliers.astype(np.float32)))
        for x in ((always, always), (lives, lives))
    )
    assert not (sound_too.alarms > 0).any() and np.abs(sound_too.share[100:] - 1).max() < 0.2
    assert (failed_too.alarms > 0)[-1].tolist() == [0, 1, 0, 0, 0, 0] and 160 < np.argmax(
        (failed_too.alarms > 0)[:, 1]
    ) < 220
    assert failed.alarms.max() == failed_too.alarms.max() == 1, "once is enough"
    works = jax.vmap(usable)
    assert np.asarray(works(sound)).all()
    for each in (failed, one_sided):
        np.testing.assert_array_equal(np.asarray(works(each))[-20:], np.tile([1, 0, 1, 1, 1, 1], (20, 1)))


def test_clohessy_wiltshire_steps_compose_and_drift_as_they_should():
    ahead, push = clohessy_wiltshire(RATE, 1.0)
    twice, pushed = clohessy_wiltshire(RATE, 2.0)
    np.testing.assert_allclose(ahead @ ahead, twice, atol=1e-12)
    np.testing.assert_allclose(ahead @ push + push, pushed, atol=1e-12)
    radial = clohessy_wiltshire(RATE, 2 * np.pi / RATE)[0] @ [0, 0, 10.0, 0, 20.0 * RATE, 0]
    np.testing.assert_allclose(radial, [0, 0, 10.0, 0, 20.0 * RATE, 0], atol=1e-6)  # a closed ellipse


@pytest.mark.parametrize(("limit", "confined"), [(10.0, 0.0), (0.1, 0.0), (10.0, 1.0)])
def test_the_controller_solves_its_convex_programme(limit, confined):
    """Against the linear system where nothing binds; no projected gradient is left where something does."""
    problem = tracking(RATE)
    corridor = corridor_of(*np.split(jnp.asarray(goal_poses()[0], jnp.float32), [3]))
    start = np.concatenate([np.asarray(corridor.goal) + [9.0, -15.0, 4.0], [0.3, 0.5, -0.2]]).astype(np.float32)
    target = np.tile(np.asarray(corridor.goal), (20, 1))
    arguments = (
        problem,
        start,
        target,
        np.zeros_like(target),
        corridor,
        confined,
        limit,
        np.zeros((20, 3), np.float32),
    )
    run = jax.jit(lambda *given: solve(*given, iterations=300))
    found = np.asarray(run(*arguments))
    assert np.linalg.norm(found, axis=1).max() <= limit * (1 + 1e-5)

    by_position, by_velocity = (x.reshape(60, 60) for x in (problem.forced_position, problem.forced_velocity))
    hessian = by_position.T @ by_position + 8.0 * by_velocity.T @ by_velocity + 256.0 * np.eye(60)
    free = (problem.free_position @ start - target).ravel(), (problem.free_velocity @ start).ravel()
    pull = by_position.T @ free[0] + 8.0 * by_velocity.T @ free[1]

    def outside(found):
        return beyond(corridor, jnp.asarray(problem.forced_position @ found.ravel() + problem.free_position @ start))

    slope = hessian @ found.ravel() + pull + 3.0 * confined * by_position.T @ np.asarray(outside(found)[1]).ravel()
    stepped = found - slope.reshape(20, 3) / problem.curvature
    length = np.linalg.norm(stepped, axis=1, keepdims=True)
    np.testing.assert_allclose(stepped * np.minimum(1, limit / length), found, atol=1e-5)
    if limit > 1 and not confined:
        np.testing.assert_allclose(found.ravel(), -np.linalg.solve(hessian, pull), atol=5e-3)
    if confined:
        alone = np.asarray(run(*arguments[:5], 0.0, *arguments[6:]))
        assert outside(found)[0] < 0.9 * outside(alone)[0]


def test_the_route_stays_outside_the_hull_and_ends_at_every_port():
    corners = np.where(np.abs(hull_boxes()[:, 0]) > np.abs(hull_boxes()[:, 1]), *np.moveaxis(hull_boxes(), 1, 0))
    assert np.linalg.norm(corners, axis=1).max() + 2.25 < CRUISE_RADIUS - 5.0
    goals = jnp.asarray(goal_poses(), jnp.float32)
    directions = np.random.default_rng(0).normal(size=(24, 3)).astype(np.float32)
    starts = 100.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)

    @jax.jit
    def follow(goal, start):
        corridor = corridor_of(goal[:3], goal[3:])

        def step(position, _):
            after = position + wanted_velocity(corridor, position)
            return after, (after, inside(corridor, after))

        return jax.lax.scan(step, start, length=300)[1]

    follow = jax.vmap(jax.vmap(follow, (None, 0)), (0, None))
    path, confined = (np.asarray(x) for x in follow(goals, starts))
    assert np.linalg.norm(path[~confined], axis=1).min() > CRUISE_RADIUS - 3.0
    assert np.linalg.norm(path[:, :, -1] - np.asarray(goals)[:, None, :3], axis=-1).max() < 0.1


@pytest.mark.slow
def test_the_classical_stack_commands_within_limits_and_forgets_between_episodes():
    env = DockingEnv(fidelity="iss-hcw", noise="cooperative", steps_per_action=5, normalize=True)
    policy = VectorPolicy(classical_policy(env))
    policy.reset(ports=[0, 3])
    with jax.enable_x64(True):
        view = np.array([60.0, -90.0, 40.0, 0.1, 0, 0, 0.6, 0.8, 0, 0, 0.01, 0, 0])
        observation = np.tile(np.asarray(env.layout.observe(np.zeros(2), view, np.zeros(12))), (2, 1))
    first, _ = policy.predict(observation)
    for _ in range(3):
        policy.predict(observation)
    with pytest.warns(UserWarning, match="flies to that of the last one, harmony_forward"):
        again, _ = policy.predict(observation, episode_start=np.array([True, False]))
    assert np.linalg.norm(first[:, :3], axis=1).max() < 1.0 and np.abs(first).max() <= 1.0
    np.testing.assert_array_equal(again[0], first[0])
    assert np.abs(again[1] - first[1]).max() > 1e-4 and np.abs(first[0] - first[1]).max() > 0.05


def test_online_models_are_named_by_what_they_start_from(fit, world_model, tmp_path):
    save_world_model(LeastSquares(fit), tmp_path / "fit")
    save_world_model(world_model, tmp_path / "learned")
    assert kind_of(f"online:{tmp_path / 'fit'}") == "least-squares-online" in GIVEN
    assert kind_of(f"online:{tmp_path / 'learned'}") == "world model, online" in GIVEN
    assert kind_of(f"guarded:{tmp_path / 'learned'}") == "world model, online, guarded" in GIVEN
    both = f"online:zeroed:{tmp_path / 'learned'}"
    assert kind_of(both) == "world model, network zeroed, online" in GIVEN and is_planned(kind_of(both))
    assert content_digest(both) not in (
        content_digest(both.replace("online:", "")),
        content_digest(str(tmp_path / "fit")),
    )
    with pytest.raises(ValueError, match="zeroed: needs a model with a network"):
        kind_of(f"zeroed:online:{tmp_path / 'learned'}")
    with pytest.raises(ValueError, match="linear part"):
        kind_of("online:oracle-mppi")
    with pytest.raises(FileNotFoundError):
        kind_of(f"online:{tmp_path / 'nothing.here'}")


def test_a_network_is_silenced_by_name(world_model, fit, tmp_path):
    save_world_model(LeastSquares(fit), tmp_path / "fit")
    save_world_model(world_model, tmp_path / "learned")
    name = f"zeroed:{tmp_path / 'learned'}"
    assert kind_of(name) == "world model, network zeroed" in GIVEN and is_planned(kind_of(name))
    assert content_digest(name) != content_digest(str(tmp_path / "learned"))
    config = evaluation_config(fidelity="iss-hcw")
    silent, speaking = load_model(name, config), load_model(str(tmp_path / "learned"), config)
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(silent.params.network))
    assert silent == speaking, "one compiled planner serves both"
    np.testing.assert_array_equal(
        *(jax.tree.leaves(model.params.statistics)[0] for model in (silent, speaking)), strict=True
    )
    with pytest.raises(ValueError, match="network over a fitted part"):
        kind_of(f"zeroed:{tmp_path / 'fit'}")


def test_the_linear_part_under_a_network_follows_as_the_fit_alone_does(fit, world_model):
    learner = OnlineLeastSquares(LIMIT)
    params = world_model.params._replace(statistics=world_model.params.statistics._replace(linear=fit))
    over, alone = OnlineBase(learner), learner.init(fit)
    known = over.init(params)
    view = jnp.asarray([60.0, -90.0, 40.0, 0.1, 0, 0, 0.6, 0.8, 0, 0, 0.01, 0, 0], jnp.float32)
    action = jnp.asarray([800.0, 0, 0, 0, 0, 500.0], jnp.float32)
    after = view.at[3].add(0.02)
    known, alone = over.learn(known, view, action, after), learner.learn(alone, view, action, after)
    found, expected = over.params(known).statistics.linear, learner.params(alone)
    np.testing.assert_array_equal(found.action, expected.action)
    assert np.abs(np.asarray(found.action) - np.asarray(fit.action)).max() > 0
    assert over.params(known).network is params.network
