"""The flow head on distributions that are known: what one evaluation from noise is worth."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from owm.model.config import ModelConfig
from owm.model.flow import FlowHead

STEPS, BATCH, DRAWS = 1200, 192, 8192
# A correlated Gaussian: standard deviations along oblique axes.
SPREAD = np.linspace(0.6, 1.3, 6)
AXES = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))[0]


def two_modes(key, count):
    """Two modes whose weights and distance depend on the context; also return the expectation."""
    k_context, k_side, k_noise = jax.random.split(key, 3)
    c = jax.random.uniform(k_context, (count, 2), jnp.float32, -1.0, 1.0)
    centre = 0.9 * jnp.stack([jnp.ones(count, jnp.float32), 0.6 * c[:, 1]], axis=1)
    side = jnp.where(jax.random.uniform(k_side, (count, 1), jnp.float32) < 0.5 + 0.3 * c[:, :1], 1.0, -1.0)
    return c, side * centre + 0.25 * jax.random.normal(k_noise, (count, 2), jnp.float32), 0.6 * c[:, :1] * centre


def oblique(key, count):
    """A correlated Gaussian whose size depends on the context."""
    k_context, k_noise = jax.random.split(key)
    c = jax.random.uniform(k_context, (count, 2), jnp.float32, -1.0, 1.0)
    x = jax.random.normal(k_noise, (count, 6), jnp.float32) * jnp.asarray(SPREAD, jnp.float32) * jnp.exp(0.5 * c[:, :1])
    return c, x @ jnp.asarray(AXES.T, jnp.float32), jnp.zeros((count, 6), jnp.float32)


@partial(jax.jit, static_argnames=("draw", "size", "kind"))
def trained(draw, size, kind):
    """Train a head of the smallest model on draws; its context is the two numbers."""
    config = ModelConfig(width=32, heads=1, head_width=32, head=kind)
    head = FlowHead(config, size, jnp.float32, key=jax.random.key(0))
    optimizer = optax.adam(optax.cosine_decay_schedule(3e-3, STEPS))

    def step(carry, key):
        head, state = carry
        k_data, k_level, k_noise = jax.random.split(key, 3)
        c, x, _ = draw(k_data, BATCH)
        level = jax.random.uniform(k_level, (BATCH, 3), jnp.float32)
        noise = jax.random.normal(k_noise, x.shape, jnp.float32)
        context = jnp.tile(c, (1, 16))

        def loss(head):
            return jnp.mean(jax.vmap(head.loss)(x, context, level, noise))

        updates, state = optimizer.update(jax.grad(loss)(head), state)
        return (optax.apply_updates(head, updates), state), None

    (head, _), _ = jax.lax.scan(step, (head, optimizer.init(head)), jax.random.split(jax.random.key(1), STEPS))
    return head


@partial(jax.jit, static_argnames=("draw", "steps"))
def sampled(head, draw, steps=1):
    """Return contexts, what was drawn there, what the head draws, and the errors of its expectation."""
    c, x, expected = draw(jax.random.key(2), DRAWS)
    context = jnp.tile(c, (1, 16))
    return c, x, head.sample(jax.random.key(3), context, steps), head.mean(context) - expected


@pytest.fixture(scope="module")
def heads():
    return {kind: trained(two_modes, 2, kind) for kind in ("flow", "mean-flow")}


def modes(c, x):
    """Return the weight of the right mode in thirds of the context, and what lies between the modes."""
    thirds = [x[(low < c[:, 0]) & (c[:, 0] < low + 2 / 3), 0] > 0 for low in (-1.0, -1 / 3, 1 / 3)]
    return np.asarray([np.mean(part) for part in thirds]), float(np.mean(np.abs(x[:, 0]) < 0.4))


def test_one_evaluation_of_the_mean_flow_hits_both_modes_with_their_weights(heads):
    c, x, drawn, error = (np.asarray(a) for a in sampled(heads["mean-flow"], two_modes))
    weights, between = modes(c, drawn)
    np.testing.assert_allclose(weights, modes(c, x)[0], atol=0.06)
    assert between < 0.2
    assert abs(drawn[:, 0].std() / x[:, 0].std() - 1.0) < 0.1
    assert np.sqrt(np.mean(error**2)) < 0.08


def test_more_evaluations_sharpen_it(heads):
    between = []
    for steps in (1, 4):
        c, _, drawn, _ = (np.asarray(a) for a in sampled(heads["mean-flow"], two_modes, steps))
        between.append(modes(c, drawn)[1])
    assert between[1] < 0.7 * between[0]


def test_one_evaluation_of_the_plain_flow_falls_between_the_modes(heads):
    """What the class says of it: the conditional mean; many evaluations do sample."""
    c, x, drawn, error = (np.asarray(a) for a in sampled(heads["flow"], two_modes))
    assert modes(c, drawn)[1] > 0.4
    assert drawn[:, 0].std() < 0.7 * x[:, 0].std()
    assert np.sqrt(np.mean(error**2)) < 0.08
    c, _, drawn, _ = (np.asarray(a) for a in sampled(heads["flow"], two_modes, 16))
    assert modes(c, drawn)[1] < 0.15


def test_one_evaluation_has_the_spread_of_a_correlated_gaussian():
    c, _, drawn, error = (np.asarray(a) for a in sampled(trained(oblique, 6, "mean-flow"), oblique))
    ratio = (drawn @ AXES) / (SPREAD * np.exp(0.5 * c[:, :1]))
    for part in (c[:, 0] < 0, c[:, 0] > 0):
        np.testing.assert_allclose(ratio[part].std(axis=0), 1.0, atol=0.2)
    correlation = np.corrcoef(ratio.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.1
    assert np.sqrt(np.mean(error**2)) < 0.08


@pytest.mark.parametrize("heads", [0, 2])
def test_tokens_are_denoised_together_only_with_attention(heads):
    head = FlowHead(ModelConfig(width=32, head_width=32, head_heads=heads), 3, jnp.float32, key=jax.random.key(0))
    head = eqx.tree_at(lambda tree: tree.out.weight, head, jnp.ones_like(head.out.weight).at[::2].set(-1.0))
    half, context = jnp.asarray(0.5, jnp.float32), jnp.ones((4, 32), jnp.float32)
    moved = jax.jacobian(lambda noised: head(noised, half, half, context))(jnp.ones((4, 3), jnp.float32))
    size = jnp.abs(moved).max(axis=(1, 3))  # by token whose residual, and whose noise
    assert (size[~np.eye(4, dtype=bool)] > 0).all() == bool(heads)
    assert (jnp.diagonal(size) > 0).all()


def test_attention_of_the_head_must_divide_its_width():
    with pytest.raises(ValueError, match="head_width must be a multiple of head_heads=3, got 32"):
        ModelConfig(head_heads=3)
