"""The learned world model: its attention, its interface, its invariances, its files."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import synthetic
from astrojax.attitude import quat_from_rotation_vector, quat_multiply, quat_rotate
from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.least_squares import fit_least_squares
from owm.data import history_of
from owm.evaluation.prediction import prediction_error, roll_out
from owm.model.checkpoint import CheckpointError, load_world_model, save_world_model
from owm.model.config import ModelConfig, preset
from owm.model.interface import History
from owm.model.kinematics import advance, increments, motion_error, multiply, rotation, to_motion, to_view, view_error
from owm.model.stream import KinematicStream
from owm.model.transformer import Backbone
from owm.model.world_model import LearnedWorldModel, Network, Params

CONFIG = ModelConfig(width=16, blocks=2, heads=2, window=5, head_width=16)


@pytest.fixture(scope="module")
def model(episodes):
    """A model whose every part matters: the zero-initialised output is replaced by noise."""
    network = Network(CONFIG, key=jax.random.key(1))
    weight = jax.random.normal(jax.random.key(2), network.head.out.weight.shape, jnp.float32)
    network = jax.tree.map(lambda x: x, network)
    network = _replace_out(network, weight)
    return LearnedWorldModel(CONFIG, Params(network, KinematicStream.fit(episodes)))


def _replace_out(network, weight):
    import equinox as eqx

    return eqx.tree_at(lambda n: n.head.out.weight, network, weight)


@pytest.fixture(scope="module")
def window(episodes):
    windows = episodes.windows(24, 1, seed=5)
    return windows.observation[0], windows.action[0]


@pytest.fixture(scope="module")
def rolled(model):
    """The compiled rollout of a history under actions."""
    return jax.jit(lambda params, history, actions: roll_out(model, params, history, actions))


def test_cached_steps_equal_the_whole_sequence():
    with jax.enable_x64(True):
        backbone = Backbone(CONFIG, jnp.float64, key=jax.random.key(0))
        x = jax.random.normal(jax.random.key(1), (17, 2, CONFIG.width), jnp.float64)
        valid = jnp.arange(17) >= 3
        whole, _ = jax.jit(backbone.sequence)(x, valid)
        _, memory = jax.jit(backbone.sequence)(x[:7], valid[:7])
        step = jax.jit(backbone.step)
        for i in range(7, 17):
            out, memory = step(x[i], memory)
            np.testing.assert_allclose(out, whole[i], rtol=0, atol=1e-12)


def test_cached_rollout_equals_recomputing_everything(model, window, rolled):
    """Autoregression from the cache against a fresh pass over the whole track at every step."""
    observation, action = window
    length, depth = CONFIG.history_length, 10
    cached = rolled(model.params, history_of(observation, action, length, length), action[length - 1 :][:depth])
    network, statistics = model.params
    track = [to_motion(view, observation[0]) for view in observation[:length]]

    @jax.jit
    def whole(inputs, actions):
        scaled = actions / statistics.action_scale
        outputs, _ = network.backbone.sequence(network.tokens(inputs, scaled), jnp.ones(len(inputs), bool))
        return network.head.sample(None, outputs[:, :1], 6)

    for k in range(depth):
        # Padded to one length: by causality what follows cannot matter.
        inputs = [KinematicStream.inputs(statistics, motion) for motion in track]
        inputs += [inputs[-1]] * (length + depth - len(inputs))
        residual = whole(jnp.stack(inputs), action[: length + depth])[len(track) - 1]
        track.append(KinematicStream.advance(statistics, track[-1], residual, action[len(track) - 1], CONFIG.dt))
        error = view_error(cached[k], to_view(track[-1]))
        assert float(jnp.abs(error).max()) < 2e-5


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
        observation=history.observation.at[1:5].add(1.0),
        action=history.action.at[:5].add(100.0),
        valid=history.valid,
    )
    kept, other = (rolled(model.params, h, action[7:]) for h in (history, spoiled))
    np.testing.assert_allclose(kept, other, atol=1e-5)
    full = rolled(model.params, history_of(observation, action, 8, 8), action[7:])
    assert float(jnp.abs(full - kept).max()) > 1e-4, "the real measurements must matter"


def test_observing_equals_encoding_the_longer_history(model, window):
    """Four measurements, then four observed one by one, against all eight at once."""
    observation, action = window
    state = jax.jit(model.encode)(model.params, history_of(observation[:5], action[:4], 5, 5))
    observe = jax.jit(model.observe)
    for i in range(5, 9):
        state = observe(model.params, state, action[i - 1], observation[i])
    whole = jax.jit(model.encode)(model.params, history_of(observation[:9], action[:8], 9, 9))
    step = jax.jit(model.step)
    for k in range(9, 13):
        state, whole = (step(model.params, None, action[k - 1], s) for s in (state, whole))
        error = view_error(model.decode(model.params, state)["state"], model.decode(model.params, whole)["state"])
        assert float(jnp.abs(error).max()) < 2e-5


def test_sign_of_the_quaternion_does_not_matter(model, window, rolled):
    observation, action = window
    flipped = observation.at[:, 6:10].multiply(-1.0)
    a, b = (rolled(model.params, history_of(o, action, 8, 8), action[7:]) for o in (observation, flipped))
    assert float(jnp.abs(jax.vmap(view_error)(a, b)).max()) < 1e-5
    np.testing.assert_allclose(a[:, 6:10], -b[:, 6:10], atol=1e-6)
    # Continuous: no prediction jumps to the other side of the sphere.
    q = jnp.concatenate([observation[7:8, 6:10], a[:, 6:10]])
    assert float(jnp.sum(q[1:] * q[:-1], axis=1).min()) > 0.9


def test_a_key_makes_a_sample_and_none_is_deterministic(model, window):
    observation, action = window
    state = model.encode(model.params, history_of(observation, action, 8, 8))
    step = jax.jit(model.step)
    same = [step(model.params, None, action[7], state).carry.velocity for _ in range(2)]
    drawn = [step(model.params, jax.random.key(k), action[7], state).carry.velocity for k in range(2)]
    np.testing.assert_array_equal(*same)
    assert float(jnp.abs(drawn[0] - drawn[1]).max()) > 0


def test_untrained_model_is_its_least_squares_skip(episodes, window):
    model = LearnedWorldModel(CONFIG, Params(Network(CONFIG, key=jax.random.key(0)), KinematicStream.fit(episodes)))
    baseline = fit_least_squares(episodes)
    observation, action = window
    history = history_of(observation, action, 8, 8)
    a = roll_out(model, model.params, history, action[7:])
    b = roll_out(baseline, baseline.params, history, action[7:])
    assert float(jnp.abs(jax.vmap(view_error)(a, b)).max()) < 1e-4


def test_gradient_through_a_rollout_is_finite(model, window):
    observation, action = window
    history = history_of(observation.at[:, 10:].set(0.0), action, 8, 8)

    def cost(actions):
        return jnp.sum(roll_out(model, model.params, history, actions)[-1, :3])

    gradient = jax.jit(jax.grad(cost))(action[7:] * 0.0)
    assert bool(jnp.isfinite(gradient).all()) and float(jnp.abs(gradient).max()) > 0


def test_measurements_of_another_dtype_are_taken(model, window):
    observation, action = window
    history = history_of(observation, action, 8, 8)
    with jax.enable_x64(True):
        wide = jax.tree.map(lambda x: x.astype(jnp.float64) if x.dtype == jnp.float32 else x, history)
        state = model.step(model.params, None, action[7].astype(jnp.float64), model.encode(model.params, wide))
    assert {leaf.dtype for leaf in jax.tree.leaves(state)} == {jnp.dtype("float32"), jnp.dtype("bool")}


def test_kinematics_invert_and_match_fine_integration():
    view = synthetic.start(jax.random.key(4)).at[10:].set(jnp.asarray([0.05, -0.04, 0.06]))
    action = jnp.asarray([900.0, -500.0, 300.0, 800.0, -600.0, 400.0])
    after = synthetic.replay(view, action[None], 1)[1]
    before, reached = to_motion(view, view), to_motion(after, view)
    again = advance(before, increments(before, reached, 0.25), 0.25)
    error = jnp.sqrt(motion_error(again, reached))
    # Velocity and rate are exact by construction; position and attitude to third order in the step.
    assert (error < jnp.asarray([2e-4, 2e-6, 2e-5, 1e-6])).all()
    assert float(jnp.abs(view_error(to_view(reached), after)).max()) < 5e-5


def test_quaternion_tables_match_the_component_form():
    p, q = (jax.random.normal(jax.random.key(k), (4,), jnp.float32) for k in (0, 1))
    p, q = p / jnp.linalg.norm(p), q / jnp.linalg.norm(q)
    v = jnp.asarray([0.3, -1.0, 2.0])
    np.testing.assert_allclose(multiply(p, q), quat_multiply(p, q), atol=1e-6)
    np.testing.assert_allclose(rotation(q) @ v, quat_rotate(q, v), atol=1e-6)


# Baselines


def test_least_squares_recovers_mass_inertia_and_orbital_rate():
    from owm.data import from_episodes

    recorded = synthetic.episodes(7, 12, 60.0, policies=("dock", "orbit"), noise=0.1)
    linear = fit_least_squares(from_episodes(recorded)).params
    gain = np.diag(linear.action) / 0.25
    np.testing.assert_allclose(gain[:3] * synthetic.MASS, 1.0, rtol=0.01)
    np.testing.assert_allclose(gain[3:] * np.asarray(synthetic.INERTIA), 1.0, rtol=0.01)
    n = synthetic.MEAN_MOTION
    coupling = np.asarray(linear.station) / 0.25
    np.testing.assert_allclose(coupling[1, 5], 2 * n, rtol=0.05)
    np.testing.assert_allclose(coupling[2, 4], -2 * n, rtol=0.05)
    np.testing.assert_allclose(coupling[2, 2], 3 * n * n, rtol=0.3)


def test_action_only_least_squares_moves_with_the_world_frame(episodes, window):
    """Without station terms the prediction turns and shifts with the frame it is expressed in."""
    baseline = fit_least_squares(episodes, station=False)
    observation, action = window
    turn = quat_from_rotation_vector(jnp.asarray([0.7, -1.1, 0.4]))
    shift = jnp.asarray([30.0, -50.0, 20.0])

    def move(view):
        return jnp.concatenate(
            [
                quat_rotate(turn, view[:3]) + shift,
                quat_rotate(turn, view[3:6]),
                quat_multiply(turn, view[6:10]),
                view[10:],
            ]
        )

    run = jax.jit(lambda o: roll_out(baseline, baseline.params, history_of(o, action, 8, 8), action[7:]))
    error = jax.vmap(view_error)(jax.vmap(move)(run(observation)), run(jax.vmap(move)(observation)))
    assert float(jnp.abs(error).max()) < 1e-3
    assert float(jnp.abs(error[:, 6:]).max()) < 1e-5


def test_error_grows_with_horizon_and_least_squares_beats_constant_velocity(episodes):
    windows = episodes.windows(40, 60, seed=1)
    coasting = prediction_error(ConstantVelocity(), windows, (4, 16, 32), batch=32)
    fitted = prediction_error(fit_least_squares(episodes), windows, (4, 16, 32), batch=32)
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


@pytest.mark.parametrize("kind", ["learned", "least_squares", "constant_velocity"])
def test_every_model_survives_the_disk(kind, model, episodes, window, tmp_path):
    chosen = {"learned": model, "constant_velocity": ConstantVelocity()}.get(kind) or fit_least_squares(episodes)
    save_world_model(ConstantVelocity(dt=0.5), tmp_path / "m")
    save_world_model(chosen, tmp_path / "m", about={"why": "test"})
    loaded = load_world_model(tmp_path / "m")
    assert loaded == chosen and loaded.name == chosen.name
    for a, b in zip(jax.tree.leaves(loaded.params), jax.tree.leaves(chosen.params), strict=True):
        np.testing.assert_array_equal(a, b)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m"]
    assert jax.tree.structure(loaded.params) == jax.tree.structure(chosen.params)


@pytest.fixture
def saved(model, tmp_path):
    return save_world_model(model, tmp_path / "model")


def test_missing_and_damaged_files_are_named(saved, tmp_path):
    with pytest.raises(CheckpointError, match="config.json is missing"):
        load_world_model(tmp_path / "elsewhere")
    weights = (saved / "weights.safetensors").read_bytes()
    (saved / "weights.safetensors").write_bytes(weights[:-8])
    with pytest.raises(CheckpointError, match="weights.safetensors does not match"):
        load_world_model(saved)
    (saved / "weights.safetensors").unlink()
    with pytest.raises(CheckpointError, match="weights.safetensors is missing"):
        load_world_model(saved)
    (saved / "config.json").write_text("{")
    with pytest.raises(CheckpointError, match="config.json is damaged"):
        load_world_model(saved)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": 99}, "has format 99"),
        ({"kind": "dreamer"}, "unknown kind 'dreamer'"),
        ({"config": {**CONFIG.model_dump(), "width": 32}}, "expected float32"),
        ({"config": {**CONFIG.model_dump(), "blocks": 1}}, "not part of this configuration"),
        ({"config": {**CONFIG.model_dump(), "blocks": 3}}, "missing"),
        ({"config": {**CONFIG.model_dump(), "widht": 3}}, "widht"),
    ],
)
def test_mismatches_are_refused(saved, change, message):
    header = json.loads((saved / "config.json").read_text())
    (saved / "config.json").write_text(json.dumps(header | change))
    with pytest.raises(CheckpointError, match=message):
        load_world_model(saved)


def test_another_configuration_is_refused(saved):
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
    for name in ("nano", "small", "paper"):
        shapes = jax.eval_shape(lambda name=name: jax.tree.leaves(Network(preset(name), key=jax.random.key(0))))
        assert 1e4 < sum(leaf.size for leaf in shapes) < 1e7
