"""Several chasers bound for distinct ports at once, as a pure environment over `DockingEnv`."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key

from owm_envs.config import DockingConfig
from owm_envs.config.params import Params
from owm_envs.dynamics import PhysicalState
from owm_envs.env.docking import DockingEnv, EnvState, StepResult, is_sound
from owm_envs.task.events import Outcome, safe_norm
from owm_envs.task.navigation import outlier_factor
from owm_envs.task.noise_stream import standard_normal
from owm_envs.task.observation import VIEW_SCALE, Observation, ObservationLayout, part
from owm_envs.task.reset import Start, named_key, sample_start
from owm_envs.task.sensors import STATE, STATE_VALID
from owm_envs.task.separation import swept_separation
from owm_envs.view import View

START_CANDIDATES = 16
"""Sets of starts drawn; the first whose chasers are far enough apart is taken."""
START_SEPARATION = 25.0
"""m between the centres of any two chasers at the start."""


class FleetState(NamedTuple):
    """N chasers at one instant."""

    chasers: EnvState
    """With a leading axis N, but for `physics.epoch`, `elapsed` and `chief`: one clock and one station for all.

    Of a chaser that has ended, `view` stays valid and `physics.chaser` is left behind.
    """
    separation: Float[Array, "N"]
    """Least distance of each chaser's bounding sphere to another's so far, m."""
    others: Float[Array, "N K 6"] | None = None
    """What each chaser's observation shows of the others; None unless relative navigation goes quiet."""

    @property
    def next_key(self) -> Key[Array, ""]:
        """From which the following episode starts."""
        return self.chasers.next_key[..., 0]


@dataclass(frozen=True)
class FleetLayout:
    """The state part of one chaser's observation: that of `DockingEnv`, then each other chaser by index.

    The others' part is [position 3 m, velocity 3 m/s] of the other minus one's own, station frame, as measured; with
    `normalize`, divided by the first six of `VIEW_SCALE`. One that has ended its episode stays where it is, at rest.
    """

    own: ObservationLayout
    num_others: int
    """How many others are seen; 0 if they are not."""

    @property
    def size(self) -> int:
        """Length of the state part."""
        return self.own.size + 6 * self.num_others

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each number; `other_k` is the k-th of the others."""
        parts = [f"{part}_{a}" for part in ("position", "velocity") for a in "xyz"]
        return self.own.names + tuple(f"other_{k}_{name}" for k in range(self.num_others) for name in parts)

    def others(self, observation: Observation) -> Float[Array, "... K 6"]:
        """Measured relative positions m and velocities m/s of the others, SI units; NumPy in, NumPy out."""
        state = part(observation, STATE)
        seen = state[..., self.own.size :].reshape(*state.shape[:-1], self.num_others, 6)
        return seen * VIEW_SCALE[:6].astype(seen.dtype) if self.own.normalize else seen


class FleetEnv:
    """Several chasers docking at distinct ports of the station at once.

    `reset` and `step` are pure and written for one episode of N chasers: `vmap` them over states and keys. Every
    chaser has the task, the events, the reward and the noise of `DockingEnv`, and draws of its own; station, orbit
    and epoch are common to all. Beside the hull, chasers may run into each other: wherever two bounding spheres touch
    within a simulation step, both have collided, as if with the hull. A chaser whose episode has ended, docked or
    otherwise, stays where it is in the station frame and remains an obstacle: one that flies into it has collided, and
    it is marked `collided` too, but keeps its outcome.

    Starts are at least `START_SEPARATION` apart: `START_CANDIDATES` sets of them are drawn, and the first that is so
    is taken, or if none is, the one whose nearest pair is farthest apart. The first chaser of the first set starts as
    `DockingEnv` does from the same key and port.

    Args:
        num_chasers: N, at most the number of configured ports.
        config: as for `DockingEnv`.
        observe_others: whether a chaser measures where the others are; see `FleetLayout`.
        overrides: fields of `DockingConfig`, and what else `DockingEnv` takes.

    Raises:
        ValueError: more chasers than ports, a port configured twice, or as `DockingEnv`.
    """

    def __init__(
        self,
        num_chasers: int = 3,
        config: DockingConfig | Mapping[str, Any] | str | None = None,
        *,
        observe_others: bool = True,
        **overrides: Any,
    ):
        self.docking = DockingEnv(config, **overrides)
        self.config = self.docking.config
        ports = self.config.ports
        if len(set(ports)) < len(ports):
            raise ValueError(f"ports must be distinct for a fleet, got {', '.join(ports)}")
        whole = hasattr(num_chasers, "__index__") and not isinstance(num_chasers, bool)
        if not (whole and 1 <= num_chasers <= len(ports)):
            raise ValueError(f"num_chasers must be from 1 to {len(ports)}, the configured ports, got {num_chasers!r}")
        self.num_chasers = num_chasers
        self.layout = FleetLayout(self.docking.layout, (num_chasers - 1) * observe_others)
        self._axes = _chaser_axes(self.config)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.num_chasers}, {self.config.__repr_str__(', ')})"

    @property
    def observation_parts(self) -> dict[str, jax.ShapeDtypeStruct]:
        """Shape and dtype of each part of one chaser's observation, by its name."""
        return {**self.docking.observation_parts, STATE: jax.ShapeDtypeStruct((self.layout.size,), jnp.float32)}

    @property
    def shown_parts(self) -> dict[str, jax.ShapeDtypeStruct]:
        """Those parts that the configured `observation` has; adapters show no other."""
        return {name: self.observation_parts[name] for name in self.docking.shown_parts}

    def default_params(self) -> Params:
        """The configuration's numbers as arrays. Raises RuntimeError at float64 outside JAX's 64-bit mode."""
        return self.docking.default_params()

    def reset(
        self, params: Params, *, key: Key[Array, ""], ports: Int[Array, "N"] | None = None
    ) -> tuple[FleetState, dict[str, Array]]:
        """Start an episode: its state, and the parts of each chaser's first observation, with a leading axis N.

        Args:
            key: decides the whole episode, noise included, and the key of the next one.
            ports: (N,) index of each chaser's port, no two the same; a negative one is drawn from the configured ports
                that nobody has. All are drawn when None.
        """
        count = self.num_chasers
        ports = jnp.full(count, -1, jnp.int32) if ports is None else jnp.asarray(ports, jnp.int32)
        others = jax.vmap(jax.random.fold_in, (None, 0))(named_key(key, "chasers"), jnp.arange(1, count))
        next_keys, episode_keys = jax.vmap(jax.random.split, out_axes=1)(jnp.concatenate([key[None], others]))
        ports = assign_ports(params.port_choices, ports, key=named_key(episode_keys[0], "ports"))
        starts = _separate_starts(params, episode_keys, ports)
        drawn = jax.vmap(self.docking.draw, (None, 0))(params, episode_keys)
        if drawn is not None:
            one_orbit = jnp.broadcast_to(drawn.chief_elements[0], drawn.chief_elements.shape)
            drawn = drawn._replace(chief_elements=one_orbit)
        chasers = jax.vmap(self.docking.place, (None, Start(None, 0, 0), 0, 0, 0))(
            params, starts._replace(epoch=starts.epoch[0]), drawn, episode_keys, next_keys
        )
        chasers = _by_axis(
            lambda axis, part: jax.tree.map(lambda leaf: leaf[0], part) if axis is None else part, self._axes, chasers
        )
        apart = self._separations(params, chasers.view, chasers.view)
        separation = jnp.min(apart, axis=1)
        chasers = chasers._replace(collided=chasers.collided | (separation <= 0))
        chasers, own = jax.vmap(self.docking.observe, (None, self._axes), (self._axes, 0))(params, chasers)
        seen, others = self._observations(params, chasers, own)
        return FleetState(chasers, separation, others), seen

    def step(self, params: Params, state: FleetState, actions: Float[Array, "N 6"]) -> tuple[FleetState, StepResult]:
        """Hold an action for each chaser for one decision; chasers that have ended stay, with reward zero.

        Returns:
            The state, and a `StepResult` whose every entry has a leading axis N.
        """
        docking, before = self.docking, state.chasers
        begun, wrenches = jax.vmap(docking.begin, (None, self._axes, 0), (self._axes, 0))(params, before, actions)
        advance = jax.vmap(docking.advance, (None, self._axes, 0), (self._axes, 0))

        def substep(carry, _):
            now, touched, separation = carry
            running = now.outcome == Outcome.RUNNING
            after, touches = advance(params, now, wrenches)
            sound = jax.vmap(is_sound)(after.view)
            after = _where_running(self._axes, running & sound, after, now)
            # Two that have both ended are at rest: nothing new can happen between them.
            apart = self._separations(params, now.view, after.view)
            nearest = jnp.min(jnp.where(running[:, None] | running[None], apart, jnp.inf), axis=1)
            hit = nearest <= 0
            ends = hit & running & self.config.collision_terminates
            after = after._replace(
                collided=after.collided | hit,
                outcome=jnp.select(
                    [running & ~sound, ends], [Outcome.DIVERGED, Outcome.COLLIDED], after.outcome
                ).astype(jnp.int32),
            )
            return (after, touched | (((touches & sound) | hit) & running), jnp.minimum(separation, nearest)), None

        carry = (begun, jnp.zeros(self.num_chasers, bool), state.separation)
        if self.config.steps_per_action == 1:
            carry, _ = substep(carry, None)
        else:
            carry, _ = jax.lax.scan(substep, carry, length=self.config.steps_per_action)
        ended, touched, separation = carry
        chasers, result = jax.vmap(docking.finish, (None, self._axes, self._axes, 0, 0), (self._axes, 0))(
            params, before, ended, wrenches, touched
        )
        seen, others = self._observations(params, chasers, result.observation, state.others)
        return FleetState(chasers, separation, others), result._replace(observation=seen)

    def info(self, params: Params, state: FleetState) -> dict[str, Array]:
        """The truth behind a state, for recording and scoring: `DockingEnv.info` of each chaser, and `separation`."""
        info = jax.vmap(self.docking.info, (None, self._axes))(params, state.chasers)
        return {**info, "separation": state.separation}

    def _separations(self, params, before, after):
        """(N, N) gaps between the swept spheres of views (N, 13); infinite to oneself."""
        pairwise = jax.vmap(jax.vmap(swept_separation, (None, None, 0, 0)), (0, 0, None, None))
        start, end = View.of(before).position, View.of(after).position
        apart = pairwise(start, end, start, end) - 2 * params.chaser.radius
        return jnp.where(jnp.eye(self.num_chasers, dtype=bool), jnp.inf, apart)

    def _observations(self, params, chasers, own, held=None):
        """What each chaser observes, and what of that a quiet navigation holds, `held` until now."""
        if self.layout.num_others == 0:
            return own, None
        running = chasers.outcome == Outcome.RUNNING
        position, velocity, _, _ = View.of(chasers.view)
        seen = jnp.concatenate([position, jnp.where(running[:, None], velocity, 0)], axis=1)
        others = np.array([[j for j in range(self.num_chasers) if j != i] for i in range(self.num_chasers)])

        def look(noise_key, count, relative):
            # As `measure` does for one view, but one draw for all: drawing is what costs.
            noise, distance = params.noise, safe_norm(relative[:, :3])
            total = jnp.stack(
                [
                    noise.position + noise.position_per_range * distance,
                    jnp.broadcast_to(noise.velocity, distance.shape),
                ],
                axis=1,
            )
            stream = named_key(noise_key, "others")
            if self.docking.structure.heavy_tailed:
                total = outlier_factor(params.navigation, key=stream, count=count) * total
            errors = standard_normal(stream, count, relative.size, relative.dtype)
            per_axis = total / jnp.sqrt(jnp.asarray(3, relative.dtype))
            return relative + (per_axis[..., None] * errors.reshape(-1, 2, 3)).reshape(relative.shape)

        relative = seen[others] - seen[:, None]
        view = jax.vmap(look)(chasers.noise_key, chasers.count, relative)
        if self.config.normalize:
            view = view / jnp.asarray(VIEW_SCALE[None, None, :6], view.dtype)
        view = view.astype(jnp.float32)
        if self.docking.structure.quiet:
            held = view = view if held is None else jnp.where(own[STATE_VALID][..., None], view, held)
        shown = jnp.concatenate([own[STATE], view.reshape(self.num_chasers, -1)], axis=1)
        return {**own, STATE: shown}, held


def assign_ports(choices: Int[Array, "C"], ports: Int[Array, "N"], *, key: Key[Array, ""]) -> Int[Array, "N"]:
    """Replace each negative port by one of `choices` that nobody has, drawn uniformly without replacement."""
    shuffled = jax.random.permutation(key, choices)
    taken = jnp.any(shuffled[:, None] == ports[None], axis=1)
    free = shuffled[jnp.argsort(taken, stable=True)]
    wanting = ports < 0
    return jnp.where(wanting, free[jnp.cumsum(wanting) - 1], ports).astype(jnp.int32)


def _separate_starts(params: Params, episode_keys: Key[Array, "N"], ports: Int[Array, "N"]) -> Start:
    """Starts (N,) that are apart, out of a bounded number of draws."""
    keys = jax.vmap(partial(named_key, name="start"))(episode_keys)
    again = jax.vmap(jax.vmap(jax.random.fold_in, (0, None)), (None, 0))(keys, jnp.arange(1, START_CANDIDATES))
    sets = jax.vmap(jax.vmap(lambda key, port: sample_start(params, key=key, port=port)), (0, None))(
        jnp.concatenate([keys[None], again]), ports
    )
    position = View.of(sets.view).position
    squared = jnp.sum((position[:, :, None] - position[:, None]) ** 2, axis=-1)
    oneself = jnp.eye(ports.size, dtype=bool)
    nearest = jnp.min(jnp.where(oneself[None], jnp.inf, squared), axis=(1, 2))
    # The first of the greatest: all that are far enough apart are equally good.
    chosen = jnp.argmax(jnp.minimum(nearest, START_SEPARATION**2))
    return jax.tree.map(lambda leaf: leaf[chosen], sets)


def _chaser_axes(config: DockingConfig) -> EnvState:
    """Where the axis of the chasers stands in what `vmap` maps over; None is shared."""
    makes_up_for_rounding = config.fidelity == "iss-numerical" and config.precision == "float32"
    lost = (None, None, 0) if makes_up_for_rounding else None
    shared = PhysicalState(epoch=None, elapsed=None, chief=None, chaser=0, lost=lost)
    return EnvState(*[0] * len(EnvState._fields))._replace(physics=shared)


def _by_axis(fn, axes: EnvState, *states: EnvState) -> EnvState:
    return jax.tree.map(fn, axes, *states, is_leaf=lambda axis: axis is None)


def _where_running(axes: EnvState, running: Bool[Array, "N"], new: EnvState, old: EnvState) -> EnvState:
    """Chasers that have ended stay as they are; clock and station go on as long as one has not."""

    def choose(axis, new, old):
        on = jnp.any(running) if axis is None else running
        return jax.tree.map(lambda n, o: jnp.where(on.reshape(on.shape + (1,) * (n.ndim - on.ndim)), n, o), new, old)

    return _by_axis(choose, axes, new, old)
