"""The plain stream and the preset `paper`: perceptrons alone, some steps decoded, and the publication's numbers."""

from itertools import combinations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from pydantic import ValidationError

from owm.catalogue.checkpoint import load_world_model
from owm.catalogue.policies import kind_of
from owm.checkpoint import save_world_model
from owm.model.config import ModelConfig
from owm.model.streams.latent import features, to_view
from owm.model.streams.plain import PlainStream
from owm.model.world_model import LearnedWorldModel, Network, Params
from owm.motion.kinematics import view_error
from owm.training.config import PRESETS, TrainConfig
from owm.training.loss import draw, draw_depths, window_losses
from owm.training.step import initial_state, make_optimizer, train_chunk
from owm_envs.view import VIEW_SLICES

MODEL = ModelConfig(stream="plain", width=16, heads=2, window=4, head_width=16, history_length=4, head="velocity")
CONFIG = TrainConfig(
    model=MODEL, batch=4, devices=1, steps=100, rollouts=((1.0, 4),), decoded=2, short_histories=False, teacher=0.0
)
DEPTH = 4


@pytest.fixture(scope="module")
def model(episodes):
    network = jax.jit(lambda: Network(MODEL, key=jax.random.key(1)))()
    return LearnedWorldModel(MODEL, Params(network, PlainStream.fit(episodes)))


@pytest.fixture(scope="module")
def losses(model):
    """Losses of one window and their gradient, the steps compared given."""

    @jax.jit
    def told(network, observation, action, draws, decoded):
        def decode(network):
            params = Params(network, model.params.statistics)
            found = window_losses(model, params, observation, action, 4, 0.5, draws, decoded)
            return found.decode, found

        return jax.grad(decode, has_aux=True)(network)

    return told


@pytest.fixture(scope="module")
def window(model, episodes):
    windows = episodes.windows(4 + DEPTH, 1, seed=5)
    draws = draw(jax.random.key(3), 1, 3 + DEPTH, DEPTH, model.params.network.stream, jnp.float32)
    return jax.tree.map(lambda x: x[0], (windows.observation, windows.action, draws))


@pytest.mark.parametrize("count", [1, 3])
def test_a_subset_s_loss_is_unbiased(count, model, losses, window):
    network = model.params.network
    gradient, whole = losses(network, *window, None)
    subsets = [losses(network, *window, jnp.asarray(each)) for each in combinations(range(DEPTH), count)]
    gradients, parts = (jax.tree.map(lambda *x: jnp.mean(jnp.stack(x), axis=0), *each) for each in zip(*subsets))
    assert float(jnp.ptp(jnp.stack([each.decode for _, each in subsets]))) > 1e-3 * float(whole.decode)
    np.testing.assert_allclose(jnp.stack(parts), jnp.stack(whole), rtol=1e-5)
    for mean, full in zip(jax.tree.leaves(gradients), jax.tree.leaves(gradient), strict=True):
        np.testing.assert_allclose(mean, full, rtol=1e-3, atol=1e-5 * float(jnp.abs(full).max()))


def test_every_set_of_steps_is_as_likely():
    keys = jax.random.split(jax.random.key(0), 6000)
    drawn = np.sort(jax.jit(jax.vmap(lambda key: draw_depths(key, 4, 2)))(keys), axis=1)
    sets, counts = np.unique(drawn, axis=0, return_counts=True)
    assert [tuple(each) for each in sets.tolist()] == list(combinations(range(4), 2)), "different steps"
    assert np.abs(counts - 1000).max() < 5 * (6000 * 1 / 6 * 5 / 6) ** 0.5


@pytest.mark.parametrize("count", [0, -1, 17, 10**6, True, 2.5])
def test_more_steps_than_a_rollout_has_are_refused(count):
    with pytest.raises(ValidationError, match="decoded"):
        TrainConfig(rollouts=((0.5, 16), (1.0, 32)), decoded=count)
    assert TrainConfig(rollouts=((0.5, 16), (1.0, 32)), decoded=16).decoded == 16


def test_a_step_of_training_sees_whole_histories_and_the_steps_drawn(model, episodes):
    """What the compiled step says of its losses is what its windows say one by one; draws follow from its number."""
    state = initial_state(CONFIG)
    rows = jax.tree.map(jnp.asarray, (episodes.observation, episodes.action))
    starts, statistics, number = jnp.asarray(episodes.starts(4 + DEPTH)), model.params.statistics, 7
    network = jax.tree.map(jnp.copy, state.network)  # the call takes its own for the result
    *_, found, _ = train_chunk(
        CONFIG, model, state.network, state.optimizer, statistics, rows, starts, jnp.int32(number), depth=DEPTH, count=1
    )
    key = jax.random.fold_in(jax.random.key(CONFIG.seed + 1), number)
    draws = draw(key, 4, 3 + DEPTH, DEPTH, network.stream, jnp.float32)
    decoded = draw_depths(jax.random.fold_in(key, 1), DEPTH, 2)
    first = starts[(draws.start * len(starts)).astype(jnp.int32)]
    index = first[:, None] + jnp.arange(4 + DEPTH)
    one = jax.jit(lambda o, a, d: window_losses(model, Params(network, statistics), o, a, 4, 0.0, d, decoded))
    each = jax.vmap(one)({"state": rows[0]["state"][index]}, rows[1][index[:, :-1]], draws)
    np.testing.assert_allclose([float(x[0]) for x in found], [float(x.mean()) for x in each], rtol=1e-4)


def test_the_rate_need_not_fall():
    def last(final):
        """How far a weight goes in the last step under a constant gradient: by the rate, since Adam divides by it."""
        config = CONFIG.model_copy(update={"steps": 50, "warmup": 5, "weight_decay": 0.0, "final_rate": final})
        optimizer, gradient = make_optimizer(config), jnp.ones(1)

        def step(carry, _):
            weight, state = carry
            updates, state = optimizer.update(gradient, state, weight)
            return (optax.apply_updates(weight, updates), state), updates

        start = jnp.zeros(1)
        return -jax.lax.scan(step, (start, optimizer.init(start)), length=51)[1][-1, 0] / config.learning_rate

    assert last(1.0) == pytest.approx(1.0, rel=1e-3)
    assert last(0.01) == pytest.approx(0.01, rel=1e-3)


def test_views_come_back_from_their_features(episodes):
    views = jnp.asarray(episodes.view[:300:7])
    anchor = views[0, [0, 1, 2, 6, 7, 8, 9]]
    back = jax.jit(jax.vmap(lambda view: to_view(features(view, anchor), anchor)))(views)
    assert float(jnp.abs(jax.vmap(view_error)(back, views)).max()) < 2e-4


def test_the_sign_of_a_quaternion_does_not_matter(model, episodes):
    network, statistics = model.params
    views, valid = jnp.asarray(episodes.view[:20]), jnp.ones(20, bool)
    follow = jax.jit(
        lambda views: network.stream.follow(statistics, views, jnp.zeros((19, 6), jnp.float32), valid, 0.25)
    )
    flipped = follow(views.at[:, VIEW_SLICES.attitude].multiply(-1.0))
    np.testing.assert_allclose(flipped.tokens, follow(views).tokens, atol=1e-5)
    assert flipped.tokens.shape == (20, 1, 16)


@pytest.mark.slow
def test_it_learns_from_a_batch(model, episodes):
    """Codec and prediction: with nothing given, and its own predictions to go on with."""
    windows = episodes.windows(4 + DEPTH, 64, seed=3)
    optimizer = optax.adam(3e-3)

    def objective(network, draws):
        params = Params(network, model.params.statistics)
        found = jax.vmap(lambda o, a, d: window_losses(model, params, o, a, 4, 0.0, d))(
            windows.observation, windows.action, draws
        )
        found = jax.tree.map(jnp.mean, found)
        return found.flow + found.decode, found

    @jax.jit
    def learn(network):
        def step(carry, key):
            network, state = carry
            draws = draw(key, 64, 3 + DEPTH, DEPTH, network.stream, jnp.float32)
            gradient, found = jax.grad(objective, has_aux=True)(network, draws)
            updates, state = optimizer.update(gradient, state, network)
            return (optax.apply_updates(network, updates), state), found

        start = (network, optimizer.init(network))
        return jax.lax.scan(step, start, jax.random.split(jax.random.key(4), 200))[1]

    found = learn(model.params.network)
    assert found.flow[-20:].mean() < 0.8 * found.flow[:2].mean()
    assert found.decode[-20:].mean() < 0.1 * found.decode[:2].mean()
    assert found.round_trip[-20:].mean() < 0.1 * found.round_trip[:2].mean(), "the codec is learned with it"


def test_the_target_leaves_the_encoder_alone(model, episodes):
    view, statistics = jnp.asarray(episodes.view[:2]), model.params.statistics

    def target(stream):
        carries = stream.follow(statistics, view, jnp.zeros((1, 6), jnp.float32), jnp.ones(2, bool), 0.25)
        before, after = (jax.tree.map(lambda x, i=i: x[i], carries) for i in (0, 1))
        return jnp.sum(stream.target(statistics, before, after, jnp.zeros(6, jnp.float32), 0.25) ** 2)

    gradient = jax.grad(target)(model.params.network.stream)
    assert all(bool(jnp.all(leaf == 0.0)) for leaf in jax.tree.leaves(eqx.filter(gradient, eqx.is_array)))


def test_it_survives_the_disk(model, tmp_path):
    loaded = load_world_model(save_world_model(model, tmp_path / "m"), expect=MODEL)
    for a, b in zip(jax.tree.leaves(loaded.params), jax.tree.leaves(model.params), strict=True):
        np.testing.assert_array_equal(a, b)
    assert kind_of(str(tmp_path / "m")) == "plain world model"


def test_the_preset_has_the_publication_s_numbers():
    """Sections on the architecture, on training and on its configuration, in the order of the text."""
    train, model = PRESETS["paper"], PRESETS["paper"].model
    assert (model.width, model.blocks, model.heads, model.window) == (128, 4, 8, 32)
    assert (model.head, model.head_blocks, model.head_heads, model.head_steps) == ("velocity", 2, 4, 1)
    assert (train.flow_weight, train.decode_weight, train.round_trip_weight) == (1.0, 1.0, 0.0)
    assert (train.learning_rate, train.weight_decay, train.warmup, train.clip) == (1e-3, 1e-4, 300, 1.0)
    assert (train.precision, train.final_rate, train.batch) == ("bfloat16", 1.0, "auto")
    assert (model.history_length, train.rollouts, train.short_histories) == (8, ((1.0, 64),), False)
    assert (train.epochs, train.teacher_epochs) == (16, 4)
    assert train.decoded is not None and model.stream == "plain"
