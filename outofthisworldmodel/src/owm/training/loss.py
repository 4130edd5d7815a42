"""The training objective on one window."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Key, Shaped

from owm.data.windows import history_of
from owm.model.streams import Stream
from owm.model.world_model import LearnedWorldModel, ModelState, Params
from owm_envs.flags import own_promotion
from owm_envs.task.sensors import STATE


class Losses(NamedTuple):
    """The terms of the objective, unweighted.

    Attributes:
        flow: the head's loss on the next measurement after every measured history of the window.
        change: the stream's own loss on every measured step; zero where nothing under the network is trained.
        decode: mean decode loss of the rolled-out predictions over the decoded depths, in the stream's loss units.
        round_trip: the same of the encoded measurements, no dynamics between; zero where nothing is encoded.
    """

    flow: Float[Array, ""]
    change: Float[Array, ""]
    decode: Float[Array, ""]
    round_trip: Float[Array, ""]


class Draws(NamedTuple):
    """The random numbers of one window, all but the noise uniform on [0, 1).

    Attributes:
        start: which window.
        context: how much of its history the model may see.
        level: decide the noise levels of the flow loss.
        noise: its noise, standard normal.
        coin: a step whose coin is below the teacher probability continues from the measurement.
    """

    start: Float[Array, ""]
    context: Float[Array, ""]
    level: Float[Array, "L-1 3"]
    noise: Float[Array, "L-1 n r"]
    coin: Float[Array, "F"]


def draw(key: Key[Array, ""], batch: int, steps: int, depth: int, stream: Stream, dtype: jnp.dtype) -> Draws:
    """Draw for a whole batch in two calls, which compiles to far less than drawing where the numbers are used."""
    k_uniform, k_noise = jax.random.split(key)
    uniform = jax.random.uniform(k_uniform, (batch, 2 + 3 * steps + depth), dtype)
    noise = jax.random.normal(k_noise, (batch, steps, stream.token_count, stream.residual_size), dtype)
    start, context, level, coin = jnp.split(uniform, (1, 2, 2 + 3 * steps), axis=1)
    return Draws(start[:, 0], context[:, 0], level.reshape(batch, steps, 3), noise, coin)


def pick(uniform: Float[Array, "*b"], count: int) -> Int[Array, "*b"]:
    """Turn uniform numbers into integers below `count`."""
    return jnp.minimum((uniform * count).astype(jnp.int32), count - 1)


def draw_depths(key: Key[Array, ""], depth: int, count: int) -> Int[Array, "S"]:
    """Choose which steps of a rollout are decoded: `count` different ones, each set of them as likely."""
    return jax.random.choice(key, jnp.arange(depth, dtype=jnp.int32), (count,), replace=False)


@own_promotion()
def window_losses(
    model: LearnedWorldModel,
    params: Params,
    observation: dict[str, Shaped[Array, "L ..."]],
    action: Float[Array, "L-1 6"],
    context: Int[Array, ""] | int,
    teacher: Float[Array, ""] | float,
    draws: Draws,
    decoded: Int[Array, "S"] | None = None,
) -> Losses:
    """Predict a window from its measurements, step by step, and from its own predictions after the history.

    Args:
        model: gives configuration and stream.
        params: weights and statistics.
        observation: parts by name, of which the first `H` rows are the history, `F` more follow.
        action: between the views.
        context: how many of the `H` measurements the model may see.
        teacher: probability, at every step by itself, of continuing from the measurement instead of the prediction.
        draws: this window's random numbers.
        decoded: steps of the rollout, from 0, whose predictions are compared, as `draw_depths` chooses them; None is
            all. The mean over them is an unbiased estimate of that over all.
    """
    network, statistics = params
    stream, dt, length = network.stream, model.dt, model.history_length
    steps = len(action) + 1 - length
    # The distribution of a measurement given the measurements before it ...
    whole = history_of(observation, action, length + steps, context + steps)
    _, measured, outputs = model.encode_sequence(params, whole)
    before, after = jax.tree.map(lambda x: x[:-1], measured), jax.tree.map(lambda x: x[1:], measured)
    target = jax.vmap(lambda b, a, u: stream.target(statistics, b, a, u, dt))(before, after, action)
    error = jax.vmap(network.head.loss)(target, outputs, draws.level, draws.noise)
    counts = whole.valid[:-1]
    left = jax.vmap(lambda b, a, u: stream.change_loss(statistics, b, a, u, dt))(before, after, action)
    flow, change = (jnp.sum(jnp.where(counts, x, 0.0)) / jnp.sum(counts) for x in (error, left))

    # ... and what is expected of a rollout.
    def compare(carry: Any, view: Array) -> Array:
        return stream.decode_loss(statistics, carry, view)

    def advance(state: ModelState, step: tuple) -> tuple[ModelState, Any]:
        coin, action, before, view = step
        carry = jax.tree.map(lambda m, p: jnp.where(coin < teacher, m, p), before, state.carry)
        output, cache = model.attend(params, action, ModelState(carry, state.cache))
        carry = stream.advance(statistics, carry, network.head.mean(output), action, dt, sampled=False)
        return ModelState(carry, cache), compare(carry, view) if decoded is None else carry

    # Recomputing a step in the backward pass costs less than storing the hundred arrays it would need, above all
    # while compiling.
    advance = jax.checkpoint(advance, prevent_cse=False)
    rolled = jax.tree.map(lambda x: x[length - 1 :], (action, before, observation[STATE][1:]))
    state = model.encode(params, history_of(observation, action, length, context))
    _, decode = jax.lax.scan(advance, state, (draws.coin, *rolled))
    if decoded is not None:
        chosen = jax.tree.map(lambda x: x[decoded], (decode, observation[STATE][length:]))
        decode = jax.vmap(compare)(*chosen)
    lost = jax.vmap(lambda carry, view: stream.round_trip_loss(statistics, carry, view))(
        measured, whole.observation[STATE]
    )
    return Losses(flow, change, jnp.mean(decode), jnp.mean(lost))
