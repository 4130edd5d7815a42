"""The adaptive stream: vehicles that differ, told apart by their histories."""

from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import synthetic

from owm.catalogue.checkpoint import load_world_model
from owm.checkpoint import save_world_model
from owm.data.windows import from_episodes
from owm.model.config import ModelConfig
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Network, Params
from owm.motion import track
from owm.motion.response import VEHICLE
from owm.motion.track import follow_windows
from owm.scores.prediction import prediction_error
from owm_envs.view import VIEW_SLICES

STEPS, HISTORY = 150, 64
KINDS = ("kinematic", "adaptive")


@jax.jit
@partial(jax.vmap, in_axes=(0, None, None))
def fly(key, spread, late):
    """One flight: what is measured, the truth, the actions."""
    k_start, k_action, k_scale, k_late, k_noise = jax.random.split(key, 5)
    scale = 1.0 + spread * jax.random.uniform(k_scale, (6,), jnp.float32, -1.0, 1.0)
    delay = jax.random.randint(k_late, (), 0, late + 1)
    limit = jnp.asarray([synthetic.FORCE] * 3 + [0.1 * synthetic.TORQUE] * 3, jnp.float32)
    knots = limit * jax.random.uniform(k_action, (STEPS // 5, 6), jnp.float32, -1.0, 1.0)
    actions = jnp.repeat(knots, 5, axis=0)  # each is held for 1.25 s

    def step(view, pair):
        before, now = pair
        for frame in range(5):
            delivered = scale * jnp.where(frame < delay, before, now)
            view = synthetic.substep(view, delivered)
        return view, view

    start = synthetic.start(k_start)
    previous = jnp.concatenate([jnp.zeros_like(actions[:1]), actions[:-1]])
    _, rest = jax.lax.scan(step, start, (previous, actions))
    truth = jnp.concatenate([start[None], rest])
    return jax.vmap(synthetic.measure)(jax.random.split(k_noise, STEPS + 1), truth), truth, actions


def flights(seed: int, spread: float, late: int):
    """Flights under held random wrenches, of which each vehicle makes its own, up to `late` of 5 frames late."""
    views, truths, actions = map(np.asarray, fly(jax.random.split(jax.random.key(seed), 32), spread, late))
    return from_episodes(
        SimpleNamespace(observation={"state": v}, true_state=t, action=a, policy="excite", stride=1)
        for v, t, a in zip(views, truths, actions, strict=True)
    )


def untrained(kind, episodes):
    """A model whose network predicts nothing yet: what stands under it."""
    config = ModelConfig(stream=kind, width=16, heads=2, window=4, head_width=16, history_length=HISTORY)
    network = jax.jit(lambda: Network(config, key=jax.random.key(0)))()
    return LearnedWorldModel(config, Params(network, STREAMS[kind].fit(episodes)), name=kind)


@pytest.fixture(scope="module")
def filters(optimised):
    """Filters are chosen by optimised code, whatever the tests' flags: they try each choice on every window."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(track, "_mean_logs", optimised(track._mean_logs.__wrapped__, static_argnames="squares"))
        yield


@pytest.fixture(scope="module")
def models(filters):
    """Fitted to vehicles whose wrenches differ by up to 30 % by axis and that answer up to 4 frames late."""
    various = flights(0, 0.3, 4)
    return {kind: untrained(kind, various) for kind in KINDS}


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "late", "gain"), [(0.3, 4, 4.0), (0.3, 0, 4.0), (0.0, 0, 2.0)])
def test_a_vehicle_never_seen_is_found_from_its_history(models, spread, late, gain):
    windows = flights(9, spread, late).windows(HISTORY + 32, 64, seed=1)
    errors = {kind: prediction_error(models[kind], windows, (32,)) for kind in KINDS}
    for quantity in ("position_m", "velocity_mps", "attitude_deg", "rate_degps"):
        fixed, found = (errors[kind].mean(quantity)[0] for kind in KINDS)
        assert found * gain < fixed, f"{quantity} after 8 s: {found:.3g}, without adaptation {fixed:.3g}"


@pytest.mark.slow
def test_the_prior_is_the_spread_of_the_vehicles(models):
    statistics = models["adaptive"].params.statistics
    share = np.diag(np.asarray(statistics.filter.response)[:, :6]) / np.abs(np.diag(statistics.linear.action))
    assert np.all((share > 0.1) & (share < 0.6)), f"now, as a share of the whole: {share}"
    alike = STREAMS["adaptive"].fit(flights(1, 0.0, 0))
    share = np.diag(np.asarray(alike.filter.response)[:, :6]) / np.abs(np.diag(alike.linear.action))
    assert np.all(share < 0.05), f"where all vehicles are one there is nothing to find: {share}"


def followed(model, windows):
    """The tracks of whole windows of a history, by window and measurement."""
    statistics = model.params.statistics
    return follow_windows(
        VEHICLE, statistics.filter, statistics.linear, windows.observation["state"], windows.action, 0.25
    )


@pytest.mark.slow
def test_innovations_have_unit_variance_whatever_the_vehicle(models):
    windows = flights(9, 0.3, 4).windows(HISTORY, 64, seed=2)
    late = np.asarray(followed(models["adaptive"], windows).innovation)[:, HISTORY // 2 :]
    deviation = np.sqrt(np.mean(late.reshape(-1, 4, 3) ** 2, axis=(0, 2)))
    assert np.all((deviation > 0.7) & (deviation < 1.4)), deviation


@pytest.mark.slow
def test_noise_beyond_the_training_s_is_not_taken_for_the_vehicle(models):
    statistics = models["adaptive"].params.statistics
    windows = flights(9, 0.3, 0).windows(HISTORY, 64, seed=4)
    loud = np.random.default_rng(0).normal(size=(64, HISTORY, 3)) * 25.0 * np.sqrt(statistics.filter.noise[1])
    louder = windows.observation["state"].at[:, :, VIEW_SLICES.velocity].add(np.float32(loud))
    windows = windows._replace(observation={"state": louder})
    mean = np.asarray(followed(models["adaptive"], windows).response.mean)[:, 15]  # after 4 s
    found = mean[:, :3, :3] / statistics.filter.response[:3, :3]
    size = np.sqrt(np.mean(np.diagonal(found, axis1=1, axis2=2) ** 2))
    assert size < 1.5, f"in deviations of the training's vehicles, where next to nothing can be known: {size:.2f}"


@pytest.mark.slow
def test_a_sample_is_taken_in_as_a_measurement_is_and_files_keep_it(models, tmp_path):
    model = models["adaptive"]
    windows = flights(9, 0.3, 4).windows(HISTORY, 64, seed=3)
    tracks = followed(model, windows)
    before, after = jax.tree.map(lambda x: x[0, 6], tracks), jax.tree.map(lambda x: x[0, 7], tracks)

    @jax.jit
    def advanced(params, before, after, action):
        stream = params.network.stream
        residual = stream.target(params.statistics, before, after, action, 0.25)
        return stream.advance(params.statistics, before, residual, action, 0.25, sampled=True)

    now = advanced(model.params, before, after, windows.action[0, 6])
    np.testing.assert_allclose(now.response.mean, after.response.mean, atol=1e-7)
    np.testing.assert_allclose(now.view.position, after.view.position, atol=1e-4)

    save_world_model(model, tmp_path / "model")
    loaded = load_world_model(tmp_path / "model")
    jax.tree.map(np.testing.assert_array_equal, loaded.params, model.params)
