"""The planner as a policy that flies the vector environment."""

import time
from collections.abc import Callable
from functools import cache, partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PyTree, Shaped

from astrojax.attitude import quat_sign
from astrojax.compilation import compiler_options
from owm.interface import History, WorldModel, check_complete
from owm.planning.config import PlannerConfig
from owm.planning.health import Health, may_dock, usable
from owm.planning.mppi import PlannerState, Problem, init_planner, plan
from owm.planning.turning import BeforeTurning, transition_at_rest
from owm_envs.config.params import goals_of
from owm_envs.cores import workers
from owm_envs.env import DockingEnv, docking_env
from owm_envs.field import GeodesicField, field_rows
from owm_envs.flags import own_flags
from owm_envs.policies import SlotPolicy, Slots
from owm_envs.policies.guidance import Goal, drift_beside
from owm_envs.station import PORT_NAMES
from owm_envs.task.sensors import STATE, TARGET_RATE
from owm_envs.view import VIEW_SIZE, View
from owm_envs.words import checked_seed

_TRIES = 8
"""Replans after which a model that has not predicted a finite view is given up."""


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

    # `health(known) -> Health`, where it has one, tells what it believes of the vehicle's axes: those that are out are
    # left alone, and if too few are left, it leaves.


class SlotStates(NamedTuple):
    """What every slot carries from decision to decision; NumPy arrays, never changed in place."""

    observation: dict[str, Shaped[np.ndarray, "B H ..."]]
    """The parts that the model looks at; of the state part the measured view (B, H, 13)."""
    action: Float[np.ndarray, "B H-1 6"]
    valid: Bool[np.ndarray, "B H"]
    measured: Bool[np.ndarray, "B"]
    """Whether the last view was measured, and not predicted."""
    chunk: Float[np.ndarray, "B L+C 6"]
    """Wrenches [N, N m]: those that stood when the last replan began (L), and what it planned."""
    index: Int[np.ndarray, "B"]
    """The next of them to execute; when C are, the slot replans."""
    replans: Int[np.ndarray, "B"]
    """Replans in this episode."""
    planner: PlannerState
    known: Any
    """What the learner knows of each slot; () without a learner."""


class PlannerPolicy(SlotPolicy):
    """Fly a batch of slots by replanning with a world model.

    Each slot keeps its own history, plan, correction and place in its chunk, all cleared when its episode begins. It
    has keys of its own, the same ones in every episode. Only slots that are due replan, each by itself through one
    compiled program, as many side by side as there are cores.

    Args:
        model: a world model; its `precision`, "float32" unless it says otherwise, decides in which mode it
            runs. It is one of a target at rest, whatever the environment's does.
        field: geodesic field that covers the ports to be flown, from `owm_envs.field.load_field`.
        env: the environment to be flown, pure or Gymnasium's, or its configuration: layout, wrench limits, decision
            rate.
        config: the planner's.
        num_slots: episodes flown side by side; as many as the environment has when None.
        learner: replaces the model's parameters by those it finds in flight.
        seed: decides every draw.

    Attributes:
        seconds: wall time of each replan so far, the first one's compilation included; of those side by side each
            by itself.

    Raises:
        ValueError: the environment's decision rate is not the model's, or it does not observe what the model looks at.
        TypeError: the model lacks a part of `WorldModel`, or `env` is no environment.
    """

    def __init__(
        self,
        model: WorldModel,
        field: GeodesicField,
        env: Any,
        config: PlannerConfig | None = None,
        num_slots: int | None = None,
        seed: int = 0,
        learner: Learner | None = None,
    ):
        check_complete(model)
        num_slots = getattr(env, "num_envs", 1) if num_slots is None else num_slots
        env = docking_env(env)
        if not np.isclose(env.config.decision_dt, model.dt):
            raise ValueError(
                f"the environment must take one action every {model.dt} s, the step of the model "
                f"{model.name!r}; got decision_dt = {env.config.decision_dt} s: "
                f"set steps_per_action={round(model.dt / env.config.dt)}"
            )
        super().__init__(f"mppi, {model.name}", env.layout, num_slots)
        self.model = BeforeTurning(model) if env.structure.turning else model
        self.config = PlannerConfig() if config is None else config
        self.seconds: list[float] = []
        self._predicts = False
        self._learner = learner
        self._seed = np.uint32(checked_seed(seed, bits=32))
        self._wide = getattr(model, "precision", "float32") == "float64"
        self._tuning = self.config.tuning(env.layout.wrench_limit)
        goals = goals_of(env.config)
        self._goals = goals.astype(np.float32)
        self._rows = field_rows(field, goals)
        self._parts = _model_parts(self.model, env)
        self._field = jax.device_put(field)
        self._drift = None
        if self.config.objective == "safe":
            self._drift = drift_beside(env.config.chief.semi_major_axis)

    def __repr__(self) -> str:
        return f"PlannerPolicy({self.name!r}, num_slots={self.num_slots}, {self.config!r})"

    @property
    def health(self) -> Health | None:
        """What has been found of each slot's axes; None without a learner that says so, or before the first flight."""
        return None if self._state is None else self.health_of(self._state)

    @property
    def verdict(self) -> list[str]:
        """What each slot does with what is left of its axes: "docks", or "leaves" if the safe planner flies it."""
        return self.verdict_of(self._state)

    def health_of(self, state: SlotStates) -> Health | None:
        """What a state says of each slot's axes; None without a learner that says so."""
        if not hasattr(self._learner, "health"):
            return None
        with own_flags(self._wide):
            return jax.device_get(_healths(self._learner, state.known))

    def verdict_of(self, state: SlotStates) -> list[str]:
        """As `verdict`, of a state."""
        health = self.health_of(state)
        if health is None:
            return ["docks"] * len(state.index)
        return ["docks" if docks else "leaves" for docks in jax.vmap(may_dock)(health).tolist()]

    def begin(self, count: int) -> SlotStates:
        """Every slot before its first measurement; its chunk is used up."""
        history, shape = self.model.history_length, self.config.shape
        known = () if self._learner is None else self._learner.init(self.model.params)

        def each(tree: Any) -> Any:
            return jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], count, axis=0), jax.device_get(tree))

        return SlotStates(
            observation={name: np.zeros((count, history, *x.shape), x.dtype) for name, x in self._parts.items()},
            action=np.zeros((count, history - 1, 6), np.float32),
            valid=np.zeros((count, history), bool),
            measured=np.ones(count, bool),
            chunk=np.zeros((count, shape.latency + shape.chunk, 6), np.float32),
            index=np.full(count, shape.chunk, np.int32),
            replans=np.zeros(count, np.uint32),
            planner=each(init_planner(shape)),
            known=each(known),
        )

    def check_ports(self, ports: Int[np.ndarray, "N"]) -> None:
        """Raise ValueError if the field does not cover one of the ports."""
        missing = {PORT_NAMES[port] for port in ports if self._rows[port] < 0}
        if missing:
            raise ValueError(f"the geodesic field does not cover {', '.join(sorted(missing))}: load it for them")

    def act(
        self, state: SlotStates, observation: dict[str, np.ndarray], slots: Slots
    ) -> tuple[Float[np.ndarray, "B 6"], SlotStates]:
        """The next wrench of each slot's chunk, planned anew where that is used up.

        Raises:
            ValueError: an active slot's view is not finite, or no view that the model has predicted so far.
        """
        view = self.layout.measured_view(observation).astype(np.float32)
        broken = slots.active & ~np.isfinite(view).all(axis=1)
        if broken.any():
            raise ValueError(f"observation is not finite in slots {np.flatnonzero(broken).tolist()}")
        lost = slots.active & ~slots.measured & ~slots.fresh
        if lost.any():
            view = np.where(lost[:, None], self._reckoned(state), view)
        state = self._remember(state, {name: observation[name] for name in self._parts} | {STATE: view}, slots)
        due = np.flatnonzero((state.index >= self.config.chunk) & slots.active)
        if due.size:
            state = self._replan(state, due, slots.port)
        wrench = state.chunk[np.arange(len(view)), np.minimum(state.index, state.chunk.shape[1] - 1)]
        return self.layout.action(wrench), state._replace(index=state.index + slots.active)

    def _remember(self, state: SlotStates, seen: dict[str, np.ndarray], slots: Slots) -> SlotStates:
        """Append what is seen and the wrench that led to it; begin anew in the slots that are due to."""
        view, before = View.of(seen[STATE]), state.observation[STATE][:, -1]
        sign = quat_sign(view.attitude, View.of(before).attitude)[:, None]
        continuous = view._replace(attitude=view.attitude * sign).numbers()
        executed = state.chunk[np.arange(len(continuous)), state.index - 1]
        known = state.known
        if self._learner is not None:
            # The noise of the measurement that a plan was made from is in its first action: what follows would be
            # taken for the action's work.
            telling = slots.active & ~slots.fresh & ((state.index > 1) | (self.config.latency > 0))
            telling &= slots.measured & state.measured
            seen_then, seen_now = before, continuous
            if TARGET_RATE in self._parts:
                seen_then, seen_now = transition_at_rest(before, continuous, seen[TARGET_RATE], self.model.dt)
            known = jax.device_get(_learn(self._learner, known, telling, seen_then, executed, seen_now))
        latest = seen | {STATE: continuous}
        longer = state._replace(
            observation={
                name: np.concatenate([held, latest[name][:, None]], axis=1)[:, 1:]
                for name, held in state.observation.items()
            },
            action=np.concatenate([state.action, executed[:, None]], axis=1)[:, 1:],
            valid=np.concatenate([state.valid, np.ones((len(continuous), 1), bool)], axis=1)[:, 1:],
            measured=slots.measured,
            known=known,
        )
        if not slots.fresh.any():
            return longer

        def choose(new: np.ndarray, old: np.ndarray) -> np.ndarray:
            return np.where(slots.fresh.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        begun = self.begin(len(continuous))._replace(
            observation={
                name: np.broadcast_to(seen[name][:, None], held.shape) for name, held in state.observation.items()
            },
            valid=np.arange(state.valid.shape[1]) == np.full((len(continuous), 1), state.valid.shape[1] - 1),
        )
        return jax.tree.map(choose, begun, longer)

    def _reckoned(self, state: SlotStates) -> Float[np.ndarray, "B 13"]:
        """The view that the model predicts for now in every slot, from what it saw before and the wrench since."""
        executed = state.chunk[np.arange(len(state.chunk)), state.index - 1]
        params = self.model.params
        if self._learner is not None:
            params = jax.vmap(self._learner.params)(state.known)
        history = History(state.observation, state.action, state.valid)
        with own_flags(self._wide):
            ahead = _ahead(self.model, self._learner is not None, params, history, executed)
        return np.asarray(ahead, np.float32)

    def _replan(self, state: SlotStates, due: Int[np.ndarray, "D"], port: Int[np.ndarray, "B"]) -> SlotStates:
        """Replan the slots that are due."""
        chunk, replan = self.config.chunk, replan_slot()
        committed = state.chunk[:, chunk:]

        def one(slot: int) -> tuple:
            began = time.perf_counter()
            with own_flags(self._wide):  # of this thread
                params, tuning = self.model.params, self._tuning
                goal = Goal(self._field, np.int32(self._rows[port[slot]]), self._goals[port[slot]], self._drift)
                if self._learner is not None:
                    params, works, docks = _learned(self._learner, jax.tree.map(lambda x: x[slot], state.known))
                    tuning = tuning._replace(limit=tuning.limit * works)
                    goal = goal._replace(away=~docks)
                output = replan(
                    self.model,
                    self.config.shape,
                    Problem(params, tuning, goal),
                    History(
                        {name: held[slot] for name, held in state.observation.items()},
                        state.action[slot],
                        state.valid[slot],
                    ),
                    jax.tree.map(lambda x: x[slot], state.planner),
                    committed=committed[slot],
                    seed=self._seed,
                    slot=np.uint32(slot),
                    count=state.replans[slot],
                )
                output = jax.device_get(output)
            self.seconds.append(time.perf_counter() - began)
            return output

        # The first call compiles, once.
        first = [one(slot) for slot in due[: not self.seconds]]
        outputs = [*first, *workers().map(one, due[len(first) :])]
        wrenches, planners = jax.tree.map(lambda *rows: np.stack(rows), *outputs)
        self._predicts |= bool(planners.started.any())
        if not self._predicts and len(self.seconds) >= _TRIES:
            raise ValueError(f"the model {self.model.name!r} predicts no finite view: its numbers mean nothing")

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


def _model_parts(model: WorldModel, env: DockingEnv) -> dict[str, jax.ShapeDtypeStruct]:
    """Shape and dtype of what the model looks at, as a history keeps it."""
    shown = env.observation_parts | {STATE: jax.ShapeDtypeStruct((VIEW_SIZE,), np.float32)}
    names = getattr(model, "parts", (STATE,))
    if missing := [name for name in names if name not in shown]:
        raise ValueError(
            f"the model {model.name!r} looks at {', '.join(missing)}, which the environment does not observe; "
            f"it observes {', '.join(shown)}: give it such a sensor"
        )
    return {name: shown[name] for name in {STATE: None} | dict.fromkeys(names)}


@cache
def replan_slot() -> Callable[..., tuple[Float[Array, "C 6"], PlannerState]]:
    """One slot's replan, compiled once per model and shape; its key follows from seed, slot and count."""

    def replan(model, shape, problem, history, state, *, committed, seed, slot, count):
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(seed), slot), count)
        return plan(model, shape, problem, history, state, committed=committed, key=key)

    return jax.jit(replan, static_argnums=(0, 1), compiler_options=compiler_options(libraries=False))


@partial(jax.jit, static_argnums=(0, 1))
def _ahead(model, learned, params, history, wrench):
    """What a model predicts one step ahead of each slot's history; parameters of each slot's own where learned."""

    def one(params, history, wrench):
        return model.decode(params, model.step(params, None, wrench, model.encode(params, history)))[STATE]

    return jax.vmap(one, (0 if learned else None, 0, 0))(params, history, wrench)


@partial(jax.jit, static_argnums=0)
def _healths(learner, known):
    """What is believed of every slot's axes."""
    return jax.vmap(learner.health)(known)


@partial(jax.jit, static_argnums=0)
def _learned(learner, known):
    """One slot's parameters, which axes it may use, and whether it is to dock with them."""
    if not hasattr(learner, "health"):
        return learner.params(known), np.ones(6, np.float32), True
    health = learner.health(known)
    return learner.params(known), usable(health), may_dock(health)


@partial(jax.jit, static_argnums=0)
def _learn(learner, known, telling, before, action, after):
    """Every slot's transition taken in, where it tells anything."""

    def one(known, telling, before, action, after):
        learned = learner.learn(known, before, action, after)
        return jax.tree.map(lambda new, old: jnp.where(telling, new, old), learned, known)

    return jax.vmap(one)(known, telling, before, action, after)
