"""The learned world model: tokens, backbone, flow head and a stream, behind the interface of `owm.interface`."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, PyTree

from owm.checkpoint import CheckpointError, Contents, dtype_of, fill
from owm.interface import History
from owm.model.backbones import BACKBONES, SequenceModel
from owm.model.config import ModelConfig
from owm.model.flow import FlowHead
from owm.model.streams import STREAMS, Stream
from owm.model.transformer import MLP
from owm_envs.flags import own_promotion
from owm_envs.task.sensors import STATE

RENAMED = {"skip": "base_dynamics", "rise": "up", "fall": "down", "kind": "token_type"}
"""What older checkpoints call fields of their configuration and parts of the paths of their weights."""

_STACKS = {"backbone.blocks.": "blocks", "backbone.layers.": "blocks", "head.layers.": "head_blocks"}
"""Layers by the beginning of their weights' paths, and the field that says how many there are."""


class Network(eqx.Module):
    """The trained weights: the stream's own, an encoder of the action, the backbone and the flow head."""

    stream: Stream
    action_encoder: MLP
    token_type: Float[Array, "n+1 d"]
    backbone: SequenceModel
    head: FlowHead

    def __init__(self, config: ModelConfig, *, key: Key[Array, ""], dtype: jnp.dtype = jnp.float32):
        k_stream, k_action, k_type, k_backbone, k_head = jax.random.split(key, 5)
        self.stream = STREAMS[config.stream](config, dtype, key=k_stream)
        self.action_encoder = MLP(6, 2 * config.width, config.width, dtype, key=k_action)
        self.token_type = 0.1 * jax.random.normal(k_type, (self.stream.token_count + 1, config.width), dtype)
        self.backbone = BACKBONES[config.backbone](config, self.stream.token_count + 1, dtype, key=k_backbone)
        self.head = FlowHead(config, self.stream.residual_size, dtype, key=k_head)

    def tokens(self, statistics: PyTree, carry: Any, action: Float[Array, "6"]) -> Float[Array, "n+1 d"]:
        """Return the token vector of a step: the stream's tokens, then the action's."""
        action = self.action_encoder(action / statistics.action_scale)
        return jnp.concatenate([self.stream.tokens(statistics, carry), action[None]]) + self.token_type


def parameter_counts(config: ModelConfig) -> dict[str, int]:
    """Return how many numbers training changes, by part of the network."""
    network = eqx.filter_eval_shape(lambda: Network(config, key=jax.random.key(0)))
    return {name: sum(leaf.size for leaf in jax.tree.leaves(part)) for name, part in vars(network).items()}


class Params(NamedTuple):
    """Everything traced: what training changes and what it measured."""

    network: Network
    statistics: PyTree


class ModelState(NamedTuple):
    """Where a prediction stands: the carry at the current step, and what the backbone keeps of earlier ones."""

    carry: Any
    cache: PyTree


@dataclass(frozen=True)
class LearnedWorldModel:
    """A trained world model; two of one configuration compare equal, so one compiled planner serves both."""

    config: ModelConfig
    params: Params = field(compare=False, repr=False)
    name: str = field(default="learned", compare=False)

    @property
    def history_length(self) -> int:
        """`H`."""
        return self.config.history_length

    @property
    def dt(self) -> float:
        """Seconds a step."""
        return self.config.dt

    def contents(self) -> Contents:
        """What a checkpoint holds of it."""
        return Contents("learned", self.name, self.config.model_dump(), self.params.network, self.params.statistics)

    @classmethod
    def from_contents(cls, contents: Contents, expect: ModelConfig | None = None) -> "LearnedWorldModel":
        """The model that a checkpoint holds.

        Args:
            expect: the configuration that it must have, if only one will do.

        Raises:
            CheckpointError: it is another model, of another configuration, or its weights don't fit.
        """
        if contents.kind != "learned":
            raise CheckpointError(f"expected a learned model, found {contents.kind!r}")
        named = {RENAMED.get(k, k): v for k, v in contents.config.items()}
        if len(named) < len(contents.config):
            raise CheckpointError(f"config names fields twice, as now and as before: {', '.join(contents.config)}")
        config = ModelConfig.model_validate(named, strict=True)
        if expect is not None and config != expect:
            wrong = [k for k in ModelConfig.model_fields if getattr(config, k) != getattr(expect, k)]
            details = ", ".join(f"{k}={getattr(config, k)!r} where {getattr(expect, k)!r} is expected" for k in wrong)
            raise CheckpointError(f"another configuration: {details}")
        dtype = dtype_of(contents.weights)
        weights = {".".join(RENAMED.get(k, k) for k in path.split(".")): v for path, v in contents.weights.items()}
        _check_depth(config, weights)
        skeleton = eqx.filter_eval_shape(lambda: Network(config, key=jax.random.key(0), dtype=dtype))
        numbers = {k: np.asarray(v, dtype) for k, v in contents.statistics.items()}
        statistics = fill(STREAMS[config.stream].skeleton(dtype), numbers)
        return cls(config, Params(fill(skeleton, weights), statistics), contents.name)

    @own_promotion()
    def encode(self, params: Params, history: History) -> ModelState:
        """Turn a history into the state from which `step` predicts; computed in the dtype of the weights."""
        history = _cast(params, history)
        return self.encode_sequence(params, history)[0]

    @own_promotion()
    def encode_sequence(self, params: Params, history: History) -> tuple[ModelState, Any, Float[Array, "H-1 n d"]]:
        """Encode, and also return the carries of all measurements and the backbone's output at all but the last."""
        network, statistics = params
        carries = network.stream.follow(statistics, history.observation[STATE], history.action, history.valid, self.dt)
        past = jax.tree.map(lambda x: x[:-1], carries)
        tokens = jax.vmap(lambda carry, action: network.tokens(statistics, carry, action))(past, history.action)
        outputs, cache = network.backbone.sequence(tokens, history.valid[:-1])
        last = jax.tree.map(lambda x: x[-1], carries)
        return ModelState(last, cache), carries, outputs[:, : network.stream.token_count]

    @own_promotion()
    def attend(self, params: Params, action: Float[Array, "6"], state: ModelState) -> tuple[Array, PyTree]:
        """Run the backbone on the current step under an action; return its output for the stream's tokens."""
        network, statistics = params
        output, cache = network.backbone.step(network.tokens(statistics, state.carry, action), state.cache)
        return output[: network.stream.token_count], cache

    @own_promotion()
    def step(
        self, params: Params, key: Key[Array, ""] | None, action: Float[Array, "6"], state: ModelState
    ) -> ModelState:
        """Predict one step of `dt`: what is expected, or with a key a sample of the next measurement."""
        network, statistics = params
        action = _cast(params, action)
        output, cache = self.attend(params, action, state)
        sampled = key is not None
        residual = network.head.sample(key, output, self.config.head_steps) if sampled else network.head.mean(output)
        carry = network.stream.advance(statistics, state.carry, residual, action, self.dt, sampled=sampled)
        return ModelState(carry, cache)

    @own_promotion()
    def observe(
        self, params: Params, state: ModelState, action: Float[Array, "6"], observation: dict[str, Array]
    ) -> ModelState:
        """Advance by one executed action and the observation that followed it."""
        network, statistics = params
        view, action = _cast(params, (observation[STATE], action))
        _, cache = self.attend(params, action, state)
        return ModelState(network.stream.observe(statistics, state.carry, action, view, self.dt), cache)

    @own_promotion()
    def decode(self, params: Params, state: ModelState) -> dict[str, Array]:
        """Read a state out as `{"state": view}` in the station frame."""
        return params.network.stream.decode(params.statistics, state.carry)


def _check_depth(config: ModelConfig, names: Iterable[str]) -> None:
    """Refuse weights of another number of layers, before a network of so many is laid out."""
    found = {key: len({name.split(".")[2] for name in names if name.startswith(key)}) for key in _STACKS}
    for key, name in _STACKS.items():
        if found[key] not in (0, getattr(config, name)):
            raise CheckpointError(f"config has {name}={getattr(config, name)}, the weights {found[key]}")


def _cast(params: Params, tree: Any) -> Any:
    """Bring measurements to the dtype of the statistics, that of the weights but where training lowers those."""
    dtype = params.statistics.action_scale.dtype
    return jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, tree)
