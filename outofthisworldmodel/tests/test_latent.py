"""The latent stream: its codec, the layers it rests on, that it learns without collapsing, its files."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from owm import cli
from owm.baselines.constant_velocity import ConstantVelocity
from owm.catalogue.checkpoint import load_world_model
from owm.catalogue.policies import kind_of
from owm.checkpoint import save_world_model
from owm.model.config import PRESETS, ModelConfig
from owm.model.flow import FlowHead
from owm.model.streams.latent import SPREAD_RATE, LatentStream, features
from owm.model.world_model import LearnedWorldModel, Network, Params, parameter_counts
from owm.motion.bilinear import COLUMNS, bilinear_inputs, fit_bilinear_map
from owm.motion.kinematics import quaternion, rotation, view_error
from owm.scores.prediction import prediction_error
from owm.training.loss import draw, window_losses
from owm_envs.view import VIEW_SLICES, View

CONFIG = ModelConfig(stream="latent", width=16, heads=2, window=4, head_width=16, history_length=4)
DEPTH = 5


@pytest.fixture(scope="module")
def statistics(episodes):
    return LatentStream.fit(episodes)


@pytest.fixture(scope="module")
def untrained(statistics):
    network = jax.jit(lambda: Network(CONFIG, key=jax.random.key(1)))()
    return LearnedWorldModel(CONFIG, Params(network, statistics))


def test_the_quaternion_is_that_of_the_nearest_rotation():
    q = np.random.default_rng(0).normal(size=(200, 4))
    q[:8] = [*np.eye(4), *np.eye(4)[:, ::-1] + np.eye(4)]  # half turns, where one formula is not enough
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    matrix = np.asarray(jax.vmap(rotation)(jnp.asarray(q, jnp.float32)))
    bent = 0.8 * matrix + 0.02 * np.random.default_rng(1).normal(size=matrix.shape)
    left, _, right = np.linalg.svd(bent)
    for given, wanted, tolerance in ((matrix, matrix, 1e-5), (bent, left @ right, 1e-3)):
        found = jax.vmap(lambda m: rotation(quaternion(m)))(jnp.asarray(given, jnp.float32))
        np.testing.assert_allclose(found, wanted, atol=tolerance)


def test_a_view_survives_its_encoding(untrained, episodes):
    network, statistics = untrained.params
    views = jnp.asarray(episodes.view[:300:7])

    @jax.jit
    def there_and_back(views):
        valid, action = jnp.ones(len(views), bool), jnp.zeros((len(views) - 1, 6), jnp.float32)
        carries = network.stream.follow(statistics, views, action, valid, CONFIG.dt)
        decoded = jax.vmap(lambda carry: network.stream.decode(statistics, carry)["state"])(carries)
        return jax.vmap(view_error)(decoded, views), carries.tokens, decoded

    error, tokens, decoded = there_and_back(views)
    assert float(jnp.abs(error).max()) < 2e-4
    attitudes, first = View.of(decoded).attitude, View.of(views[0]).attitude
    assert float((attitudes @ first).min()) >= 0.0, "on the anchor's side of the sphere"
    _, flipped, _ = there_and_back(views.at[:, VIEW_SLICES.attitude].multiply(-1.0))
    np.testing.assert_allclose(flipped, tokens, atol=1e-5)


def test_the_fit_finds_the_products_that_matter_and_drops_the_rest():
    rng = np.random.default_rng(0)
    seen, action = rng.normal(size=(4000, 18)), rng.normal(size=(4000, 6))
    inputs = np.asarray(bilinear_inputs(jnp.asarray(seen, jnp.float32), jnp.asarray(action, jnp.float32)))
    truth = np.zeros((18, COLUMNS))
    truth[0, [4, 30]], truth[7, 100] = (0.25, -0.1), 0.3
    change = inputs @ truth.T + 0.05 * rng.normal(size=(4000, 18))
    found, left = fit_bilinear_map(jnp.asarray(seen, jnp.float32), jnp.asarray(action, jnp.float32), change)
    np.testing.assert_array_equal(found != 0, truth != 0)
    np.testing.assert_allclose(found, truth, atol=0.005)
    assert left.std() == pytest.approx(0.05, rel=0.02)


def test_untrained_it_predicts_by_its_map(untrained, episodes):
    windows = episodes.windows(4 + 32, 48, seed=1)
    coasting = prediction_error(ConstantVelocity(history_length=4), windows, (8, 32), batch=48)
    fitted = prediction_error(untrained, windows, (8, 32), batch=48)
    for quantity in ("velocity_mps", "attitude_deg", "rate_degps"):
        assert (fitted.mean(quantity) < 0.1 * coasting.mean(quantity)).all()
    assert (fitted.mean("position_m") < 0.2).all()


@pytest.fixture(scope="module")
def learned(statistics, episodes):
    """A model whose trained layer alone has been trained."""
    config = CONFIG.model_copy(update={"base_dynamics": "learned"})
    network = jax.jit(lambda: Network(config, key=jax.random.key(1)))()
    windows, steps = episodes.windows(4, 1500, seed=2), 1500
    valid = jnp.ones(4, bool)
    optimizer = optax.adam(optax.cosine_decay_schedule(1e-2, steps))

    def loss(stream, observation, action):
        carries = stream.follow(statistics, observation, action, valid, config.dt)
        before, after = (jax.tree.map(lambda x, i=i: x[i], carries) for i in (2, 3))
        return stream.change_loss(statistics, before, after, action[2], config.dt)

    @jax.jit
    def learn(stream):
        def step(carry, key):
            stream, state = carry
            chosen = jax.random.randint(key, (256,), 0, len(windows.action))
            gradient = jax.grad(
                lambda s: jnp.mean(
                    jax.vmap(loss, (None, 0, 0))(s, windows.observation["state"][chosen], windows.action[chosen])
                )
            )(stream)
            updates, state = optimizer.update(gradient, state, stream)
            return (optax.apply_updates(stream, updates), state), None

        keys = jax.random.split(jax.random.key(3), steps)
        return jax.lax.scan(step, (stream, optimizer.init(stream)), keys)[0][0]

    network = eqx.tree_at(lambda net: net.stream, network, learn(network.stream))
    return LearnedWorldModel(config, Params(network, statistics))


@pytest.mark.slow
def test_the_trained_layer_finds_the_motion_by_itself(learned, statistics, episodes):
    windows = episodes.windows(4 + 32, 48, seed=1)
    coasting = prediction_error(ConstantVelocity(history_length=4), windows, (8, 32), batch=48)
    found = prediction_error(learned, windows, (8, 32), batch=48)
    for quantity in ("velocity_mps", "attitude_deg", "rate_degps"):
        assert (found.mean(quantity) < 0.3 * coasting.mean(quantity)).all()
    # It leaves of positions and velocities what the least-squares map does, noise; of the others little.
    left = np.exp(SPREAD_RATE * np.asarray(learned.params.network.stream.spread)) * statistics.change_scale
    np.testing.assert_allclose(left[:2], statistics.residual_scale[:2], rtol=0.2)
    assert (left[2:] < 0.15 * statistics.change_scale[2:]).all()


def test_the_trained_layer_learns_from_measured_steps_alone(learned, statistics, episodes):
    window = episodes.windows(2, 1, seed=3)
    view, action, residual = window.observation["state"][0], window.action[0, 0], jnp.ones((4, 16), jnp.float32)

    @jax.jit
    @jax.grad
    def measured(stream):
        before, after = (stream.observe(statistics, carry, action, v, 0.25) for carry, v in zip(carries, view))
        return stream.change_loss(statistics, before, after, action, 0.25)

    @jax.jit
    @jax.grad
    def predicted(stream):
        carry = stream.observe(statistics, carries[0], action, view[0], 0.25)
        carry = stream.advance(statistics, carry, residual, action, 0.25, sampled=False)
        return stream.decode_loss(statistics, carry, view[1])

    stream = learned.params.network.stream
    carries = [stream.follow(statistics, view[:1], action[:0, None], jnp.ones(1, bool), 0.25)] * 2
    carries = jax.tree.map(lambda x: x[0], carries)
    for gradient, layer, rest in ((measured(stream), True, False), (predicted(stream), False, True)):
        for part in (gradient.quadratic, gradient.spread):
            assert bool(jnp.any(part != 0.0)) == layer
        assert bool(jnp.any(gradient.encoder.down.bias != 0.0)) == rest


@pytest.mark.slow
def test_latents_do_not_collapse_in_training(statistics, episodes):
    """Without the map, where making targets easy would pay most."""
    config = CONFIG.model_copy(update={"base_dynamics": "none", "head": "flow"})
    network = jax.jit(lambda: Network(config, key=jax.random.key(2)))()
    model = LearnedWorldModel(config, Params(network, statistics))
    windows = episodes.windows(4 + DEPTH, 64, seed=3)
    optimizer = optax.adam(3e-3)

    def objective(network, draws):
        losses = jax.vmap(
            lambda o, a, d: window_losses(model, Params(network, statistics), o, a, 4, 0.0, d)
        )(windows.observation, windows.action, draws)  # fmt: skip
        losses = jax.tree.map(jnp.mean, losses)
        return sum(losses), losses

    @jax.jit
    def learn(network):
        def step(carry, key):
            network, state = carry
            draws = draw(key, 64, 3 + DEPTH, DEPTH, network.stream, jnp.float32)
            gradient, losses = jax.grad(objective, has_aux=True)(network, draws)
            updates, state = optimizer.update(gradient, state, network)
            return (optax.apply_updates(network, updates), state), losses

        start = (network, optimizer.init(network))
        return jax.lax.scan(step, start, jax.random.split(jax.random.key(4), 80))

    (trained, _), losses = learn(network)
    assert losses.flow[:2].mean() > 0.5 and losses.flow[-10:].mean() < 0.6 * losses.flow[:2].mean()
    assert losses.decode[-10:].mean() < 0.5 * losses.decode[:2].mean()

    # What the tokens are has changed, and still every feature can be told from them.
    @jax.jit
    @jax.vmap
    def encoded(observation, action):
        valid = jnp.ones(len(observation), bool)
        follow = lambda net: net.stream.follow(statistics, observation, action, valid, config.dt)
        before, after = follow(network), follow(trained)
        decoded = jax.vmap(lambda carry: trained.stream.decoded(statistics, carry))(after)
        return before.tokens, after.tokens, decoded, jax.vmap(lambda view: features(view, after.anchor[0]))(observation)

    first, tokens, decoded, seen = (
        x.reshape(-1, *x.shape[2:]) for x in encoded(windows.observation["state"], windows.action)
    )
    assert float(jnp.abs(tokens - first).max()) > 1e-2
    assert float((jnp.var(decoded - seen, axis=0) / jnp.var(seen, axis=0)).max()) < 0.1
    flat = tokens.reshape(len(tokens), -1)
    spread = jnp.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)
    assert int((spread > 1e-3 * spread[0]).sum()) >= 12, "as many directions as a rigid body's motion has"


@pytest.mark.parametrize("kind", ["untrained", "learned"])
def test_it_survives_the_disk(kind, request, tmp_path):
    model = request.getfixturevalue(kind)
    folder = save_world_model(model, tmp_path / "m")
    loaded = load_world_model(folder, expect=model.config)
    for a, b in zip(jax.tree.leaves(loaded.params), jax.tree.leaves(model.params), strict=True):
        np.testing.assert_array_equal(a, b)
    fitted = ", fitted map" if model.config.base_dynamics == "bilinear" else ""
    assert kind_of(str(folder)) == f"latent world model{fitted}", "reports say what it was given: no kinematics"


def test_the_published_loss_is_that_of_the_velocity():
    head = FlowHead(PRESETS["paper"], 3, jnp.float32, key=jax.random.key(0))
    residual, noise = jax.random.normal(jax.random.key(1), (2, 4, 3), jnp.float32)
    context = jnp.ones((4, 128), jnp.float32)
    # Untrained it gives the velocity zero, so that the error is the path's own velocity whatever the level.
    for level in (0.01, 0.5, 0.99):
        loss = head.loss(residual, context, jnp.full(3, level, jnp.float32), noise)
        np.testing.assert_allclose(loss, jnp.mean((noise - residual) ** 2), rtol=1e-3)


def test_parameters_are_counted_and_narrow_tokens_refused(capsys):
    cli.main(["presets"])
    assert "latent" in capsys.readouterr().out
    counts = parameter_counts(PRESETS["paper"])
    assert set(counts) == {"stream", "action_encoder", "token_type", "backbone", "head"}
    assert 1e6 < sum(counts.values()) < 6.4e6, "the publication's 6.4 million include the image stream"
    with pytest.raises(ValueError, match="at least 10 for the latent stream, got 8"):
        ModelConfig(stream="latent", width=8, heads=2, head_width=8)
