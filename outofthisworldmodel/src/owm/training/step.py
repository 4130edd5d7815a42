"""Optimisation steps as one compiled call."""

from functools import lru_cache, partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optax
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int, PyTree, Shaped

from owm.model.world_model import LearnedWorldModel, Network, Params
from owm.training.config import TrainConfig
from owm.training.loss import Losses, draw, draw_depths, pick, window_losses


class TrainState(NamedTuple):
    """What a run carries from step to step; batches and noise follow from the seed and `step` alone."""

    step: Int[Array, ""]
    network: Network
    optimizer: PyTree
    best_network: Network
    best_score: Float[Array, ""]
    best_step: Int[Array, ""]


@lru_cache
def make_optimizer(config: TrainConfig) -> optax.GradientTransformation:
    """Return AdamW with warm-up, cosine decay if any, and a bounded gradient norm."""
    warmup = min(config.warmup, max(config.steps // 2, 1))
    rate = optax.warmup_cosine_decay_schedule(
        0.0, config.learning_rate, warmup, max(config.steps, warmup + 1), config.final_rate * config.learning_rate
    )
    # As one vector: the same arithmetic, but a dozen operations to compile instead of a thousand.
    return optax.flatten(
        optax.chain(optax.clip_by_global_norm(config.clip), optax.adamw(rate, weight_decay=config.weight_decay))
    )


@partial(jax.jit, static_argnames=("config", "dtype"))
def initial_state(config: TrainConfig, dtype: jnp.dtype = jnp.float32) -> TrainState:
    """Return the state before the first step."""
    network = Network(config.model, key=jax.random.key(config.seed), dtype=dtype)
    return TrainState(
        step=jnp.zeros((), jnp.int32),
        network=network,
        optimizer=make_optimizer(config).init(network),
        best_network=network,
        best_score=jnp.full((), jnp.inf, dtype),
        best_step=jnp.zeros((), jnp.int32),
    )


def batch_mesh(devices: int) -> Mesh | None:
    """Return a mesh over the first local devices; None for one, which needs no mesh."""
    if devices == 1:
        return None
    return jax.make_mesh((devices,), ("batch",), (AxisType.Auto,), devices=jax.local_devices()[:devices])


def put(mesh: Mesh | None, tree: PyTree, *axes: str) -> PyTree:
    """Copy a tree to every device of a mesh, or split its leaves' first axis over them with `axes` "batch"."""
    return tree if mesh is None else jax.device_put(tree, NamedSharding(mesh, PartitionSpec(*axes)))


@partial(
    jax.jit,
    static_argnames=("config", "model", "depth", "count", "mesh"),
    donate_argnames=("network", "optimizer"),
)
def train_chunk(
    config: TrainConfig,
    model: LearnedWorldModel,
    network: Network,
    optimizer: PyTree,
    statistics: PyTree,
    rows: tuple[dict[str, Shaped[Array, "N ..."]], Float[Array, "N 6"]],
    starts: Int[Array, "S"],
    step: Int[Array, ""],
    *,
    depth: int,
    count: int,
    mesh: Mesh | None = None,
) -> tuple[Network, PyTree, Losses, Float[Array, " count"]]:
    """Make `count` steps at rollout length `depth`; return the losses and gradient norm of each.

    Args:
        config: static and settled: batch and steps are numbers.
        model: static; its configuration counts, its parameters do not.
        network: weights to change.
        optimizer: its state.
        statistics: held fixed.
        rows: every observation, by parts, and action of the training episodes.
        starts: rows at which windows may start.
        step: number of the first step.
        depth: `F`.
        count: steps.
        mesh: devices that share each batch, each with weights and data of its own; its size divides the batch.
    """
    history = model.history_length
    length = history + depth

    def mean_gradient(network, statistics, rows, first, context, teacher, draws, decoded) -> tuple[Network, Losses]:
        """Gradient and losses, averaged over the windows that start at the rows `first`."""
        observation, action = rows
        index = first[:, None] + jnp.arange(length, dtype=jnp.int32)

        def objective(network: Network) -> tuple[Array, Losses]:
            if config.precision == "bfloat16":
                # All but the stream, whose carry adds up small steps.
                low = jax.tree.map(lambda weight: weight.astype(jnp.bfloat16), network)
                network = eqx.tree_at(lambda tree: tree.stream, low, network.stream)
            losses = jax.vmap(
                lambda o, a, c, d: window_losses(model, Params(network, statistics), o, a, c, teacher, d, decoded)
            )(jax.tree.map(lambda part: part[index], observation), action[index[:, :-1]], context, draws)
            losses = jax.tree.map(jnp.mean, losses)
            # What `change` trains, no other term does.
            weighted = Losses(config.flow_weight, 1.0, config.decode_weight, config.round_trip_weight)
            return sum(jax.tree.map(jnp.multiply, weighted, losses)), losses

        return jax.grad(objective, has_aux=True)(network)

    if mesh is not None:
        here, whole = PartitionSpec("batch"), PartitionSpec()
        mean_gradient = jax.shard_map(
            lambda *args, local=mean_gradient: jax.lax.pmean(local(*args), "batch"),
            mesh=mesh,
            in_specs=(whole, whole, whole, here, here, whole, here, whole),
            out_specs=whole,
            check_vma=False,
        )

    def one_step(carry: tuple[Network, PyTree], step: Array) -> tuple[tuple[Network, PyTree], tuple[Losses, Array]]:
        network, optimizer = carry
        dtype = rows[1].dtype
        key = jax.random.fold_in(jax.random.key(config.seed + 1), step)
        draws = draw(key, config.batch, length - 1, depth, network.stream, dtype)
        first = starts[pick(draws.start, starts.shape[0])]
        # Half of all windows at least have the whole history, as nearly every prediction in flight does.
        full = (jnp.arange(config.batch, dtype=jnp.int32) % 2 == 0) | (not config.short_histories)
        context = jnp.where(full, history, 1 + pick(draws.context, history))
        teacher = jnp.clip(1.0 - step / max(config.teacher * config.steps, 1.0), 0.0, 1.0).astype(dtype)
        decoded = None
        if config.decoded is not None:
            decoded = draw_depths(jax.random.fold_in(key, 1), depth, config.decoded)
        gradient, losses = mean_gradient(network, statistics, rows, first, context, teacher, draws, decoded)
        updates, optimizer = make_optimizer(config).update(gradient, optimizer, network)
        return (optax.apply_updates(network, updates), optimizer), (losses, optax.tree.norm(gradient))

    steps = step + jnp.arange(count, dtype=jnp.int32)
    (network, optimizer), (losses, norms) = jax.lax.scan(one_step, (network, optimizer), steps)
    return network, optimizer, losses, norms
