"""The training objective on one window."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key

from owm.data import history_of
from owm.model.streams import Stream
from owm.model.world_model import LearnedWorldModel, ModelState, Params


class Losses(NamedTuple):
    """The terms of the objective, unweighted.

    Attributes:
        flow: mean square error of the clean unit-variance residual at random noise levels.
        decode: mean decode loss of the rolled-out predictions over all depths, in the stream's loss units.
        round_trip: the same of the encoded measurements, no dynamics between; zero where nothing is encoded.
    """

    flow: Float[Array, ""]
    decode: Float[Array, ""]
    round_trip: Float[Array, ""]


class Draws(NamedTuple):
    """The random numbers of one window, all but the noise uniform on [0, 1).

    Attributes:
        start: which window.
        context: how much of its history the model may see.
        level: noise levels of the flow loss.
        noise: its noise, standard normal.
        coin: a step whose coin is below the teacher probability continues from the measurement.
    """

    start: Float[Array, ""]
    context: Float[Array, ""]
    level: Float[Array, "L-1"]
    noise: Float[Array, "L-1 n r"]
    coin: Float[Array, "F"]


def draw(key: Key[Array, ""], batch: int, steps: int, depth: int, stream: Stream, dtype: jnp.dtype) -> Draws:
    """Draw for a whole batch in two calls, which compiles to far less than drawing where the numbers are used."""
    k_uniform, k_noise = jax.random.split(key)
    uniform = jax.random.uniform(k_uniform, (batch, 2 + steps + depth), dtype)
    noise = jax.random.normal(k_noise, (batch, steps, stream.token_count, stream.residual_size), dtype)
    return Draws(uniform[:, 0], uniform[:, 1], uniform[:, 2 : 2 + steps], noise, uniform[:, 2 + steps :])


def pick(uniform: Float[Array, "*b"], count: int) -> Int[Array, "*b"]:
    """Turn uniform numbers into integers below `count`."""
    return jnp.minimum((uniform * count).astype(jnp.int32), count - 1)


def window_losses(
    model: LearnedWorldModel,
    params: Params,
    observation: Float[Array, "L 13"],
    action: Float[Array, "L-1 6"],
    context: Int[Array, ""] | int,
    teacher: Float[Array, ""] | float,
    draws: Draws,
) -> Losses:
    """Roll a window out on the model's own predictions and compare every depth with the measurements.

    Args:
        model: gives configuration and stream.
        params: weights and statistics.
        observation: measured views, of which the first `H` are the history, `F` more follow.
        action: between the views.
        context: how many of the `H` measurements the model may see.
        teacher: probability, at every step by itself, of continuing from the measurement instead of the prediction.
        draws: this window's random numbers.
    """
    network, statistics = params
    stream, dt, length = network.stream, model.dt, model.history_length
    history = history_of(observation, action, length, context)
    state, _, past = model.encode_sequence(params, history)
    measured = jax.vmap(lambda view: stream.start(statistics, view, history.observation[0]))(observation)
    before, after = jax.tree.map(lambda x: x[:-1], measured), jax.tree.map(lambda x: x[1:], measured)
    target = jax.vmap(lambda b, a, u: stream.target(statistics, b, a, u, dt))(before, after, action)

    def advance(state: ModelState, step: tuple) -> tuple[ModelState, tuple[Array, Array]]:
        coin, action, before, view = step
        carry = jax.tree.map(lambda m, p: jnp.where(coin < teacher, m, p), before, state.carry)
        output, memory = model.attend(params, action, ModelState(carry, state.memory))
        residual = network.head.sample(None, output, stream.residual_size)
        carry = stream.advance(statistics, carry, residual, action, dt)
        return ModelState(carry, memory), (output, stream.decode_loss(statistics, carry, view))

    # Recomputing a step in the backward pass costs less than storing the hundred arrays it would need, above all
    # while compiling.
    advance = jax.checkpoint(advance, prevent_cse=False)
    rolled = jax.tree.map(lambda x: x[length - 1 :], (action, before, observation[1:]))
    _, (ahead, decode) = jax.lax.scan(advance, state, (draws.coin, *rolled))

    # The history predicts too, so its steps count; those before the first real measurement do not.
    output = jnp.concatenate([past, ahead])
    counts = jnp.concatenate([history.valid[:-1], jnp.ones(len(draws.coin), bool)])
    tau = draws.level[:, None, None]
    noised = (1.0 - tau) * target + tau * draws.noise
    error = jnp.mean((jax.vmap(network.head)(noised, draws.level, output) - target) ** 2, axis=(1, 2))
    round_trip = jax.vmap(lambda carry, view: stream.round_trip_loss(statistics, carry, view))(measured, observation)
    flow = jnp.sum(jnp.where(counts, error, 0.0)) / jnp.sum(counts)
    return Losses(flow, jnp.mean(decode), jnp.mean(round_trip))
