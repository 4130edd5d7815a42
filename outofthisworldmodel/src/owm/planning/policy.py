"""The planner as a policy that flies the vector environment: the one stateful shell around `plan`."""

import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree

from astrojax.compilation import compiler_options
from owm.interface import History, WorldModel
from owm.planning.config import PlannerConfig
from owm.planning.mppi import PlannerState, init_planner, plan
from owm_envs.config import DockingConfig
from owm_envs.cores import workers
from owm_envs.env import DockingEnv
from owm_envs.field import GeodesicField, field_rows
from owm_envs.flags import own_flags
from owm_envs.station import PORT_NAMES, goal_poses, port_index


class Learner(Protocol):
    """Parameters of a model that follow what a flight shows of them: pure functions of one slot, hashable."""

    def init(self, params: PyTree) -> Any:
        """What is known before the flight."""

    def learn(
        self, known: Any, before: Float[Array, "13"], action: Float[Array, "6"], after: Float[Array, "13"]
    ) -> Any:
        """Take in one transition: measured views, `dt` apart, and the wrench [N, N m] held between them."""

    def params(self, known: Any) -> PyTree:
        """The parameters to plan with."""


class SlotStates(NamedTuple):
    """What every slot carries from decision to decision; NumPy arrays, never changed in place."""

    observation: Float[np.ndarray, "B H 13"]
    action: Float[np.ndarray, "B H-1 6"]
    valid: Bool[np.ndarray, "B H"]
    chunk: Float[np.ndarray, "B L+C 6"]
    """Wrenches [N, N m]: those that stood when the last replan began (L), and what it planned."""
    index: Int[np.ndarray, "B"]
    """The next of them to execute; when C are, the slot replans."""
    replans: Int[np.ndarray, "B"]
    """Replans in this episode."""
    planner: PlannerState
    known: Any
    """What the learner knows of each slot; () without a learner."""


class PlannerPolicy:
    """Fly a batch of slots by replanning with a world model.

    It sees observations and ports, never `info`. Each slot keeps its own history, plan, correction and place
    in its chunk, all cleared when its episode begins. Only slots that are due replan, each by itself through one
    compiled program, as many side by side as there are cores.

    Args:
        model: a world model; its `precision`, "float32" unless it says otherwise, decides in which mode it
            runs.
        field: geodesic field that covers the ports to be flown, from `owm_envs.field.load_field`.
        env: the environment to be flown, or its configuration: layout, wrench limits, decision rate.
        config: the planner's.
        num_slots: episodes flown side by side.
        learner: replaces the model's parameters by those it finds in flight.
        seed: decides every draw; each slot has keys of its own, the same ones in every episode.

    Attributes:
        active: (num_slots,) set to False where an episode has ended: such a slot is skipped and gets zero
            actions until its next reset.
        seconds: wall time of each replan so far, the first one's compilation included; of those side by side each
            by itself.

    Raises:
        ValueError: the environment's decision rate is not the model's.
    """

    def __init__(
        self,
        model: WorldModel,
        field: GeodesicField,
        env: DockingEnv | DockingConfig,
        config: PlannerConfig | None = None,
        num_slots: int = 1,
        seed: int = 0,
        learner: Learner | None = None,
    ):
        env = env if isinstance(env, DockingEnv) else DockingEnv(env)
        if not np.isclose(env.config.decision_dt, model.dt):
            raise ValueError(
                f"the environment must take one action every {model.dt} s, the step of the model "
                f"{model.name!r}; got decision_dt = {env.config.decision_dt} s: "
                f"set steps_per_action={round(model.dt / env.config.dt)}"
            )
        if num_slots < 1:
            raise ValueError(f"num_slots must be at least 1, got {num_slots}")
        self.model = model
        self.config = PlannerConfig() if config is None else config
        self.layout = env.layout
        self.num_slots = num_slots
        self.name = f"mppi, {model.name}"
        self.active = np.ones(num_slots, bool)
        self.seconds: list[float] = []
        self._learner = learner
        self._seed = np.uint32(seed)
        self._wide = getattr(model, "precision", "float32") == "float64"
        self._tuning = self.config.tuning(env.layout.wrench_limit)
        self._goals = goal_poses().astype(np.float32)
        self._rows = field_rows(field)
        self._field = jax.device_put(field)
        self._ports: np.ndarray | None = None
        self._pending = np.ones(num_slots, bool)
        self._fresh = self._initial()
        self._state = self._fresh

    def __repr__(self) -> str:
        return f"PlannerPolicy({self.name!r}, num_slots={self.num_slots}, {self.config!r})"

    def _initial(self) -> SlotStates:
        """Every slot before its first measurement; its chunk is used up."""
        slots, history, shape = self.num_slots, self.model.history_length, self.config.shape
        planner = jax.device_get(init_planner(shape))
        known = ()
        if self._learner is not None:
            known = self._each(jax.device_get(self._learner.init(self.model.params)))
        return SlotStates(
            observation=np.zeros((slots, history, 13), np.float32),
            action=np.zeros((slots, history - 1, 6), np.float32),
            valid=np.zeros((slots, history), bool),
            chunk=np.zeros((slots, shape.latency + shape.chunk, 6), np.float32),
            index=np.full(slots, shape.chunk, np.int32),
            replans=np.zeros(slots, np.uint32),
            planner=self._each(planner),
            known=known,
        )

    def _each(self, tree: Any) -> Any:
        """The same for every slot."""
        return jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], self.num_slots, axis=0), tree)

    def reset(
        self,
        mask: Bool[np.ndarray, "B"] | None = None,
        ports: Int[np.ndarray, "B"] | Sequence[int | str] | None = None,
    ) -> None:
        """Announce new episodes: their slots forget everything and start afresh at the next `predict`.

        Args:
            mask: slots whose episode begins; all when None.
            ports: assigned port of every slot, by name or index (read where `mask` is True); the ones known so
                far when None.

        Raises:
            ValueError: a shape is not (num_slots,), a port is out of range or not in the field, or no ports
                were ever given.
        """
        expected = (self.num_slots,)
        mask = np.ones(expected, bool) if mask is None else np.atleast_1d(np.asarray(mask, bool))
        if mask.shape != expected:
            raise ValueError(f"mask must have shape {expected}, got {mask.shape}")
        if ports is not None:
            ports = np.atleast_1d([port_index(p) if isinstance(p, str) else p for p in ports])
            if ports.shape != expected:
                raise ValueError(f"ports must have shape {expected}, got {ports.shape}")
            wanted = ports[mask]
            if not np.isin(wanted, np.arange(len(PORT_NAMES))).all():
                raise ValueError(f"ports must be indices from 0 to {len(PORT_NAMES) - 1}, got {wanted.tolist()}")
            missing = {PORT_NAMES[port] for port in wanted if self._rows[port] < 0}
            if missing:
                raise ValueError(f"the geodesic field does not cover {', '.join(sorted(missing))}: load it for them")
            known = np.zeros(expected, np.int32) if self._ports is None else self._ports
            if self._ports is None and not mask.all():
                raise ValueError("the first reset must start every slot")
            self._ports = np.where(mask, ports, known).astype(np.int32)
        elif self._ports is None:
            raise ValueError("ports must be given on the first reset: one port index for each slot")
        self._pending = self._pending | mask
        self.active = self.active | mask

    def predict(
        self,
        observation: Float[np.ndarray, "B O"],
        state: SlotStates | None = None,
        episode_start: Bool[np.ndarray, "B"] | None = None,
        deterministic: bool = True,
    ) -> tuple[Float[np.ndarray, "B 6"], SlotStates]:
        """Actions for a batch of observations, as Stable-Baselines3 policies give them.

        Args:
            observation: (B, O), or (O,) for a single slot.
            state: what the last call returned; the state kept inside when None.
            episode_start: slots whose episode begins with this observation, at the port last announced.
            deterministic: has no effect: the planner's draws follow from its seed, and it plans with the
                model's deterministic prediction.

        Returns:
            float32 actions (B, 6), or (6,) for a single slot, in the environment's layout, and the state.

        Raises:
            ValueError: `reset` never told the ports, the shape is wrong, or an active slot's view is not
            finite.
        """
        del deterministic
        if self._ports is None:
            raise ValueError("call reset(ports=...) before predict: the policy must know each slot's port")
        observation = np.asarray(observation, np.float32)
        single = observation.ndim == 1
        batch = observation[None] if single else observation
        expected = (self.num_slots, self.layout.size)
        if batch.shape != expected:
            raise ValueError(f"observation must have shape {expected}, got {observation.shape}")
        if episode_start is not None:
            self.reset(np.broadcast_to(np.asarray(episode_start, bool), (self.num_slots,)))
        view = self.layout.measured_view(batch).astype(np.float32)
        broken = self.active & ~np.isfinite(view).all(axis=1)
        if broken.any():
            raise ValueError(f"observation is not finite in slots {np.flatnonzero(broken).tolist()}")

        state = self._remember(self._state if state is None else state, view)
        due = np.flatnonzero((state.index >= self.config.chunk) & self.active)
        if due.size:
            state = self._replan(state, due)
        slots = np.arange(self.num_slots)
        wrench = state.chunk[slots, np.minimum(state.index, state.chunk.shape[1] - 1)]
        action = self.layout.action(np.where(self.active[:, None], wrench, np.float32(0))).astype(np.float32)
        self._state = state._replace(index=state.index + self.active)
        return (action[0] if single else action), self._state

    def _remember(self, state: SlotStates, view: Float[np.ndarray, "B 13"]) -> SlotStates:
        """Append a measurement and the wrench that led to it; begin anew in the slots that are due to."""
        fresh, self._pending = self._pending, np.zeros_like(self._pending)

        def choose(new, old):
            return np.where(fresh.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        flip = np.sum(view[:, 6:10] * state.observation[:, -1, 6:10], axis=1) < 0
        continuous = view.copy()
        continuous[:, 6:10] *= np.where(flip, np.float32(-1), np.float32(1))[:, None]
        executed = state.chunk[np.arange(self.num_slots), state.index - 1]
        known = state.known
        if self._learner is not None:
            # The noise of the measurement that a plan was made from is in its first action: what follows would be
            # taken for the action's work.
            telling = self.active & ~fresh & ((state.index > 1) | (self.config.latency > 0))
            known = jax.device_get(
                _learn(self._learner, known, telling, state.observation[:, -1], executed, continuous)
            )
        longer = state._replace(
            observation=np.concatenate([state.observation, continuous[:, None]], axis=1)[:, 1:],
            action=np.concatenate([state.action, executed[:, None]], axis=1)[:, 1:],
            valid=np.concatenate([state.valid, np.ones((self.num_slots, 1), bool)], axis=1)[:, 1:],
            known=known,
        )
        begun = self._fresh._replace(
            observation=np.broadcast_to(view[:, None], state.observation.shape),
            valid=np.arange(state.valid.shape[1]) == np.full((self.num_slots, 1), state.valid.shape[1] - 1),
        )
        return jax.tree.map(choose, begun, longer)

    def _replan(self, state: SlotStates, due: Int[np.ndarray, "D"]) -> SlotStates:
        """Replan the slots that are due."""
        chunk, replan = self.config.chunk, replan_slot()
        committed = state.chunk[:, chunk:]

        def one(slot: int) -> tuple:
            began = time.perf_counter()
            params = self.model.params
            if self._learner is not None:
                params = _learned(self._learner, jax.tree.map(lambda x: x[slot], state.known))
            with own_flags(self._wide):  # of this thread
                output = replan(
                    self.model,
                    self.config.shape,
                    params,
                    self._tuning,
                    self._field,
                    np.int32(self._rows[self._ports[slot]]),
                    self._goals[self._ports[slot]],
                    History(state.observation[slot], state.action[slot], state.valid[slot]),
                    committed[slot],
                    jax.tree.map(lambda x: x[slot], state.planner),
                    self._seed,
                    np.uint32(slot),
                    state.replans[slot],
                )
                output = jax.device_get(output)
            self.seconds.append(time.perf_counter() - began)
            return output

        # The first call compiles, once.
        first = [one(slot) for slot in due[: not self.seconds]]
        outputs = [*first, *workers().map(one, due[len(first) :])]
        wrenches, planners = jax.tree.map(lambda *rows: np.stack(rows), *outputs)

        def put(old, new):
            old = old.copy()
            old[due] = new
            return old

        return state._replace(
            chunk=put(state.chunk, np.concatenate([committed[due], wrenches], axis=1)),
            index=put(state.index, 0),
            replans=put(state.replans, state.replans[due] + 1),
            planner=jax.tree.map(put, state.planner, planners),
        )


@cache
def replan_slot() -> Callable[..., tuple[Float[Array, "C 6"], PlannerState]]:
    """One slot's replan, compiled once per model and shape; its key follows from seed, slot and count."""

    def replan(model, shape, params, tuning, field, port, goal, history, committed, planner, seed, slot, count):
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), slot), count)
        return plan(model, shape, params, tuning, field, port, goal, history, committed, planner, key)

    return jax.jit(replan, static_argnums=(0, 1), compiler_options=compiler_options(libraries=False))


@partial(jax.jit, static_argnums=0)
def _learned(learner, known):
    """One slot's parameters."""
    return learner.params(known)


@partial(jax.jit, static_argnums=0)
def _learn(learner, known, telling, before, action, after):
    """Every slot's transition taken in, where it tells anything."""

    def one(known, telling, before, action, after):
        learned = learner.learn(known, before, action, after)
        return jax.tree.map(lambda new, old: jnp.where(telling, new, old), learned, known)

    return jax.vmap(one)(known, telling, before, action, after)
