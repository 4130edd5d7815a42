"""The latent stream: its codec, the map it rests on, that it learns without collapsing, its files."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from owm.baselines.constant_velocity import ConstantVelocity
from owm.evaluation.prediction import prediction_error
from owm.model.bilinear import COLUMNS, bilinear_inputs, fit_bilinear_map
from owm.model.checkpoint import load_world_model, save_world_model
from owm.model.config import PRESETS, ModelConfig
from owm.model.kinematics import quaternion, rotation, view_error
from owm.model.streams.latent import LatentStream, features
from owm.model.world_model import LearnedWorldModel, Network, Params, parameter_counts
from owm.training.loss import draw, window_losses

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
    views = jnp.asarray(episodes.observation[:300:7])

    @jax.jit
    def there_and_back(views):
        valid, action = jnp.ones(len(views), bool), jnp.zeros((len(views) - 1, 6), jnp.float32)
        carries = network.stream.follow(statistics, views, action, valid, CONFIG.dt)
        decoded = jax.vmap(lambda carry: network.stream.decode(statistics, carry)["state"])(carries)
        return jax.vmap(view_error)(decoded, views), carries.tokens, decoded

    error, tokens, decoded = there_and_back(views)
    assert float(jnp.abs(error).max()) < 2e-4
    assert float((decoded[:, 6:10] @ views[0, 6:10]).min()) >= 0.0, "on the anchor's side of the sphere"
    _, flipped, _ = there_and_back(views.at[:, 6:10].multiply(-1.0))
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


def test_latents_do_not_collapse_in_training(statistics, episodes):
    """Without the map, where making targets easy would pay most."""
    config = CONFIG.model_copy(update={"skip": "none"})
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

    first, tokens, decoded, seen = (x.reshape(-1, *x.shape[2:]) for x in encoded(windows.observation, windows.action))
    assert float(jnp.abs(tokens - first).max()) > 1e-2
    assert float((jnp.var(decoded - seen, axis=0) / jnp.var(seen, axis=0)).max()) < 0.1
    flat = tokens.reshape(len(tokens), -1)
    spread = jnp.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)
    assert int((spread > 1e-3 * spread[0]).sum()) >= 12, "as many directions as a rigid body's motion has"


def test_it_survives_the_disk(untrained, tmp_path):
    loaded = load_world_model(save_world_model(untrained, tmp_path / "m"), expect=CONFIG)
    for a, b in zip(jax.tree.leaves(loaded.params), jax.tree.leaves(untrained.params), strict=True):
        np.testing.assert_array_equal(a, b)


def test_parameters_are_counted_and_narrow_tokens_refused():
    counts = parameter_counts(PRESETS["paper"])
    assert set(counts) == {"stream", "action_encoder", "kind", "backbone", "head"}
    assert 1e6 < sum(counts.values()) < 6.4e6, "the publication's 6.4 million include the image stream"
    with pytest.raises(ValueError, match="at least 10 for the latent stream, got 8"):
        ModelConfig(stream="latent", width=8, heads=2, head_width=8)
