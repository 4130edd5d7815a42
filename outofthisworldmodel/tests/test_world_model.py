"""The learned world model: its attention, its interface, its invariances, its files."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import synthetic

from astrojax.attitude import quat_from_rotation_vector, quat_multiply, quat_rotate
from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.least_squares import fit_least_squares
from owm.catalogue.checkpoint import load_world_model
from owm.checkpoint import CheckpointError, save_world_model
from owm.data import windows as cut
from owm.data.windows import from_episodes
from owm.interface import History, roll_out
from owm.model.backbones import BACKBONES
from owm.model.config import ModelConfig, preset
from owm.model.streams import STREAMS
from owm.model.world_model import RENAMED, LearnedWorldModel, Network, Params
from owm.motion.kinematics import advance, increments, motion_error, multiply, rotation, to_motion, to_view, view_error
from owm.scores.prediction import prediction_error
from owm_envs.files import FolderTaken
from owm_envs.view import VIEW_SLICES, View

CONFIG = ModelConfig(width=16, heads=2, window=5, head_width=16)
DEPTH = 10


@pytest.fixture(scope="module")
def statistics(episodes):
    return STREAMS["kinematic"].fit(episodes)


@pytest.fixture(scope="module")
def untrained(statistics):
    network = jax.jit(lambda: Network(CONFIG, key=jax.random.key(1)))()
    return LearnedWorldModel(CONFIG, Params(network, statistics))


@pytest.fixture(scope="module")
def model(untrained):
    """A model whose every part matters: the zero-initialised output is replaced by noise."""
    network, statistics = untrained.params
    weight = jax.random.normal(jax.random.key(2), network.head.out.weight.shape, jnp.float32)
    network = eqx.tree_at(lambda n: n.head.out.weight, network, weight)
    return LearnedWorldModel(CONFIG, Params(network, statistics))


@pytest.fixture(scope="module")
def baseline(episodes):
    return fit_least_squares(episodes)


@pytest.fixture(scope="module")
def encode(model):
    return jax.jit(model.encode)


@pytest.fixture(scope="module")
def step(model):
    return jax.jit(model.step)


@pytest.fixture(scope="module")
def errors():
    """The compiled error norms of a batch of predicted views."""
    return jax.jit(jax.vmap(view_error))


def history_of(views, action, length, context):
    """The history of a window of views."""
    return cut.history_of({"state": views}, action, length, context)


@pytest.fixture(scope="module")
def window(episodes):
    windows = episodes.windows(8 + DEPTH, 1, seed=5)
    return windows.observation["state"][0], windows.action[0]


@pytest.fixture(scope="module")
def rolled(model):
    """The compiled rollout of a history under actions."""
    return jax.jit(lambda params, history, actions: roll_out(model, params, model.encode(params, history), actions))


@pytest.mark.parametrize("kind", BACKBONES)
def test_backbones_are_of_one_size(kind):
    def size(kind):
        config = preset("nano").model_copy(update={"backbone": kind})
        network = eqx.filter_eval_shape(lambda: Network(config, key=jax.random.key(0)))
        return sum(leaf.size for leaf in jax.tree.leaves(network))

    assert abs(size(kind) / size("transformer") - 1) < 0.1


@pytest.mark.parametrize("kind", BACKBONES)
def test_cached_steps_equal_the_whole_sequence(kind):
    with jax.enable_x64(True):
        config = CONFIG.model_copy(update={"blocks": 2})
        backbone = jax.jit(lambda: BACKBONES[kind](config, 2, jnp.float64, key=jax.random.key(0)))()
        x = jax.random.normal(jax.random.key(1), (17, 2, config.width), jnp.float64)
        valid = jnp.arange(17) >= 3
        sequence = jax.jit(lambda net, x, valid: net.sequence(x, valid))
        step = jax.jit(lambda net, x, cache: net.step(x, cache))
        whole, _ = sequence(backbone, x, valid)
        _, cache = sequence(backbone, x[:7], valid[:7])
        for i in range(7, 17):
            out, cache = step(backbone, x[i], cache)
            np.testing.assert_allclose(out, whole[i], rtol=0, atol=1e-12)
        spoiled, _ = sequence(backbone, x.at[:3].add(1.0), valid)
        np.testing.assert_array_equal(spoiled[3:], whole[3:])


@pytest.mark.slow
def test_cached_rollout_equals_recomputing_everything(model, window, rolled, errors):
    """Autoregression from the cache against a fresh pass over the whole track at every step."""
    observation, action = window
    cached = rolled(model.params, history_of(observation, action, 8, 8), action[7:])
    network, statistics = model.params
    every = jnp.ones(len(observation), bool)
    track = jax.jit(lambda o, a: network.stream.follow(statistics, o, a, every, CONFIG.dt))(observation, action)

    @jax.jit
    def extend(track, action, last):
        """Fill in step `last + 1`; what follows is padding, which by causality cannot matter."""
        past = jax.tree.map(lambda x: x[:-1], track)
        tokens = jax.vmap(lambda motion, action: network.tokens(statistics, motion, action))(past, action)
        outputs, _ = network.backbone.sequence(tokens, jnp.ones(len(tokens), bool))
        residual = network.head.mean(outputs[last, :1])
        current = jax.tree.map(lambda x: x[last], track)
        after = network.stream.advance(statistics, current, residual, action[last], CONFIG.dt, sampled=False)
        return jax.tree.map(lambda x, y: x.at[last + 1].set(y), track, after), to_view(after.view)

    views = []
    for last in range(7, 7 + DEPTH):
        track, view = extend(track, action, last)
        views.append(view)
    assert float(jnp.abs(errors(cached, jnp.stack(views))).max()) < 2e-5


def test_the_future_cannot_change_an_earlier_prediction(model, window, rolled):
    observation, action = window
    history = history_of(observation, action, 8, 8)
    ahead = action[7:]
    changed = ahead.at[6:].add(500.0)
    first, second = (rolled(model.params, history, a) for a in (ahead, changed))
    np.testing.assert_array_equal(first[:6], second[:6])
    assert float(jnp.abs(first[6] - second[6]).max()) > 1e-3


def test_what_is_not_valid_cannot_matter(model, window, rolled):
    observation, action = window
    history = history_of(observation, action, 8, 3)
    spoiled = History(
        observation={"state": history.observation["state"].at[1:5].add(1.0)},
        action=history.action.at[:5].add(100.0),
        valid=history.valid,
    )
    kept, other = (rolled(model.params, h, action[7:]) for h in (history, spoiled))
    np.testing.assert_array_equal(kept, other)
    full = rolled(model.params, history_of(observation, action, 8, 8), action[7:])
    assert float(jnp.abs(full - kept).max()) > 1e-5, "the real measurements must matter"


def test_observing_equals_encoding_the_longer_history(model, window, encode, step, errors):
    """A history and two further measurements, against all ten at once."""
    observation, action = window
    state = encode(model.params, history_of(observation, action, 8, 8))
    observe = jax.jit(model.observe)
    for i in (8, 9):
        state = observe(model.params, state, action[i - 1], {"state": observation[i]})
    whole = jax.jit(model.encode)(model.params, history_of(observation, action, 10, 10))
    for k in range(9, 13):
        state, whole = (step(model.params, None, action[k], s) for s in (state, whole))
        a, b = (model.decode(model.params, s)["state"][None] for s in (state, whole))
        assert float(jnp.abs(errors(a, b)).max()) < 2e-5


def test_sign_of_the_quaternion_does_not_matter(model, window, rolled, errors):
    observation, action = window
    flipped = observation.at[:, VIEW_SLICES.attitude].multiply(-1.0)
    a, b = (rolled(model.params, history_of(o, action, 8, 8), action[7:]) for o in (observation, flipped))
    assert float(jnp.abs(errors(a, b)).max()) < 1e-5
    q, other = View.of(a).attitude, View.of(b).attitude
    np.testing.assert_allclose(q, -other, atol=1e-6)
    # Continuous: no prediction jumps to the other side of the sphere.
    q = jnp.concatenate([View.of(observation[7:8]).attitude, q])
    assert float(jnp.sum(q[1:] * q[:-1], axis=1).min()) > 0.9


def test_a_key_makes_a_sample_and_none_is_deterministic(model, window, encode, step):
    observation, action = window
    state = encode(model.params, history_of(observation, action, 8, 8))
    same = [step(model.params, None, action[7], state).carry.view.velocity for _ in range(2)]
    drawn = [step(model.params, jax.random.key(k), action[7], state).carry.view.velocity for k in range(2)]
    np.testing.assert_array_equal(*same)
    assert float(jnp.abs(drawn[0] - drawn[1]).max()) > 0


def test_untrained_model_is_its_least_squares_map_from_the_filtered_start(
    untrained, baseline, window, encode, rolled, errors
):
    observation, action = window
    history = history_of(observation, action, 8, 8)
    a = rolled(untrained.params, history, action[7:])
    start = to_view(encode(untrained.params, history).carry.motion)
    history = history._replace(observation={"state": history.observation["state"].at[-1].set(start)})
    b = jax.jit(lambda: roll_out(baseline, baseline.params, baseline.encode(baseline.params, history), action[7:]))()
    assert float(jnp.abs(errors(a, b)).max()) < 1e-4


def test_gradient_through_a_rollout_is_finite(model, window):
    """At rest and without thrust, where norms and quaternion series have their corners."""
    observation, action = window
    history = history_of(observation.at[:, VIEW_SLICES.rate].set(0.0), action, 8, 8)

    def cost(actions):
        views = roll_out(model, model.params, model.encode(model.params, history), actions)
        return jnp.sum(View.of(views[-1]).position)

    gradient = jax.jit(jax.grad(cost))(jnp.zeros((4, 6), jnp.float32))
    assert bool(jnp.isfinite(gradient).all()) and float(jnp.abs(gradient).max()) > 0


def test_measurements_of_another_dtype_are_taken(model, window):
    observation, action = window
    history = history_of(observation, action, 8, 8)
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda x: x.astype(jnp.float64) if x.dtype == jnp.float32 else x, history)
        state = jax.eval_shape(model.encode, model.params, wide)
        after = jax.eval_shape(lambda s: model.step(model.params, None, action[7].astype(jnp.float64), s), state)
    for tree in (state, after):
        assert {str(leaf.dtype) for leaf in jax.tree.leaves(tree)} == {"float32", "bool", "int32"}
    assert jax.tree.structure(state) == jax.tree.structure(after), "a rollout must scan"


def test_kinematics_invert_and_match_fine_integration():
    view = synthetic.start(jax.random.key(4)).at[VIEW_SLICES.rate].set(jnp.asarray([0.05, -0.04, 0.06]))
    action = jnp.asarray([900.0, -500.0, 300.0, 800.0, -600.0, 400.0])
    after = synthetic.replay(view, action[None], 1)[1]

    @jax.jit
    def there_and_back(view, after):
        before, reached = to_motion(view, view), to_motion(after, view)
        again = advance(before, increments(before, reached, 0.25), 0.25)
        return jnp.sqrt(motion_error(again, reached)), view_error(to_view(reached), after)

    error, around = there_and_back(view, after)
    # Velocity and rate are exact by construction; position and attitude to third order in the step.
    assert (error < jnp.asarray([2e-4, 2e-6, 2e-5, 1e-6])).all()
    assert float(jnp.abs(around).max()) < 5e-5


def test_quaternion_tables_match_the_component_form():
    p, q = (jax.random.normal(jax.random.key(k), (4,), jnp.float32) for k in (0, 1))
    p, q = p / jnp.linalg.norm(p), q / jnp.linalg.norm(q)
    v = jnp.asarray([0.3, -1.0, 2.0])
    np.testing.assert_allclose(multiply(p, q), quat_multiply(p, q), atol=1e-6)
    np.testing.assert_allclose(rotation(q) @ v, quat_rotate(q, v), atol=1e-6)


# Baselines


def test_least_squares_recovers_mass_inertia_and_orbital_rate():
    recorded = synthetic.episodes(7, 8, 60.0, policies=("excite", "orbit"), noise=0.1)
    linear = fit_least_squares(from_episodes(recorded)).params
    gain = np.diag(linear.action) / 0.25
    np.testing.assert_allclose(gain[:3] * synthetic.MASS, 1.0, rtol=0.01)
    np.testing.assert_allclose(gain[3:] * np.asarray(synthetic.INERTIA), 1.0, rtol=0.01)
    n = synthetic.MEAN_MOTION
    coupling = np.asarray(linear.station) / 0.25
    np.testing.assert_allclose(coupling[1, 5], 2 * n, rtol=0.05)
    np.testing.assert_allclose(coupling[2, 4], -2 * n, rtol=0.05)
    np.testing.assert_allclose(coupling[2, 2], 3 * n * n, rtol=0.3)
    # Euler's equations: the rate about x changes by (I_y - I_z) / I_x times the product of the others.
    a, b, c = synthetic.INERTIA
    yz, zx, xy = np.asarray(linear.gyroscopic)[:, 3:6].T / 0.25
    np.testing.assert_allclose([yz[0], zx[1], xy[2]], [(b - c) / a, (c - a) / b, (a - b) / c], atol=0.02)


def test_action_only_least_squares_moves_with_the_world_frame(episodes, window, errors):
    """Without terms of motion the prediction turns and shifts with the frame it is expressed in."""
    baseline = fit_least_squares(episodes, motion=False)
    observation, action = window
    turn = quat_from_rotation_vector(jnp.asarray([0.7, -1.1, 0.4]))
    shift = jnp.asarray([30.0, -50.0, 20.0])

    def move(view):
        position, velocity, attitude, rate = View.of(view)
        position, velocity = quat_rotate(turn, position) + shift, quat_rotate(turn, velocity)
        return View(position, velocity, quat_multiply(turn, attitude), rate).numbers()

    @jax.jit
    def run(observation):
        start = baseline.encode(baseline.params, history_of(observation, action, 8, 8))
        return roll_out(baseline, baseline.params, start, action[7:])

    move = jax.jit(jax.vmap(move))
    error = errors(move(run(observation)), run(move(observation)))
    assert float(jnp.abs(error).max()) < 1e-3
    assert float(jnp.abs(error[:, 6:]).max()) < 1e-5


def test_error_grows_with_horizon_and_least_squares_beats_constant_velocity(episodes, baseline):
    windows = episodes.windows(40, 60, seed=1)
    coasting = prediction_error(ConstantVelocity(), windows, (4, 16, 32), batch=32)
    fitted = prediction_error(baseline, windows, (4, 16, 32), batch=32)
    assert (np.diff(coasting.mean("attitude_deg")) > 0).all()
    for quantity in ("velocity_mps", "attitude_deg", "rate_degps"):
        assert (fitted.mean(quantity) < 0.5 * coasting.mean(quantity)).all()
    assert len(fitted.rows()) == 3 and json.dumps(fitted.rows())
    with pytest.raises(ValueError, match="need at least one window of 72 views"):
        prediction_error(ConstantVelocity(), windows)


def test_no_batch_boundary_shows_in_the_scores(episodes):
    windows = episodes.windows(20, 10, seed=1)
    a, b = (prediction_error(ConstantVelocity(), windows, (1, 12), batch=n).error for n in (4, 10))
    np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4)


# Files


def test_a_checkpoint_of_older_names_is_read(model):
    """The words that `RENAMED` translates stood in configurations and weights until they became the field's."""
    older = {new: old for old, new in RENAMED.items()}

    def paths(tree):
        leaves, _ = jax.tree_util.tree_flatten_with_path(tree)
        return {jax.tree_util.keystr(path, simple=True, separator="."): np.asarray(leaf) for path, leaf in leaves}

    contents = model.contents()
    weights = {".".join(older.get(k, k) for k in path.split(".")): v for path, v in paths(contents.weights).items()}
    assert {"kind", "action_encoder.rise.weight", "action_encoder.fall.bias"} <= set(weights)
    config = {older.get(name, name): value for name, value in contents.config.items()}
    assert "skip" in config
    numbers = {name: value.tolist() for name, value in paths(contents.statistics).items()}
    read = LearnedWorldModel.from_contents(contents._replace(config=config, weights=weights, statistics=numbers))
    assert read.config == model.config
    for a, b in zip(jax.tree.leaves(read.params), jax.tree.leaves(model.params), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("kind", ["learned", "least_squares", "constant_velocity"])
def test_every_model_survives_the_disk(kind, model, baseline, tmp_path):
    chosen = {"learned": model, "least_squares": baseline, "constant_velocity": ConstantVelocity()}[kind]
    save_world_model(ConstantVelocity(dt=0.5), tmp_path / "m")
    save_world_model(chosen, tmp_path / "m", about={"why": "test"})
    loaded = load_world_model(tmp_path / "m")
    assert loaded == chosen and loaded.name == chosen.name
    for a, b in zip(jax.tree.leaves(loaded.params), jax.tree.leaves(chosen.params), strict=True):
        np.testing.assert_array_equal(a, b)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m"]
    assert jax.tree.structure(loaded.params) == jax.tree.structure(chosen.params)


@pytest.mark.parametrize("mine", ["config.json", "weights.safetensors", "thesis.tex"])
def test_a_folder_of_the_user_s_own_is_no_place_for_a_checkpoint(mine, tmp_path, monkeypatch):
    (tmp_path / mine).write_text('{"mine": true}')
    monkeypatch.chdir(tmp_path)
    for path in (tmp_path, "."):
        with pytest.raises(FolderTaken, match=f"holds {mine} but no checkpoint: choose another folder"):
            save_world_model(ConstantVelocity(), path)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [(mine, '{"mine": true}')]


def test_another_configuration_is_refused(model, tmp_path):
    saved = save_world_model(model, tmp_path / "model")
    with pytest.raises(CheckpointError, match="width=16 where 32 is expected"):
        load_world_model(saved, expect=ModelConfig())
    assert load_world_model(saved, expect=CONFIG).config == CONFIG


def test_configurations_are_checked():
    with pytest.raises(ValueError, match="unknown model preset 'nan'"):
        preset("nan")
    with pytest.raises(ValueError, match="even multiple of heads"):
        ModelConfig(width=30)
    with pytest.raises(ValueError, match="must not exceed width"):
        ModelConfig(head_width=64)
    for name in ("nano", "adaptive", "small", "latent", "paper"):
        shapes = jax.eval_shape(lambda name=name: jax.tree.leaves(Network(preset(name), key=jax.random.key(0))))
        assert 1e4 < sum(leaf.size for leaf in shapes) < 1e7
