"""Fly a policy from identical starts and record what it did; the truth is recorded, never shown to it."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from typing import Any, Protocol

import numpy as np
from jaxtyping import Bool, Float, Int

from owm.scores.flights import Flights, join
from owm.scores.tape import Tape
from owm_envs.adapters.gymnasium import DockingVectorEnv
from owm_envs.config import DockingConfig, load_config
from owm_envs.config.params import goals_of
from owm_envs.episode import Episode
from owm_envs.station import PORT_NAMES, port_index
from owm_envs.station.ports import outward_normals
from owm_envs.task.events import OUTCOME_NAMES
from owm_envs.task.observation import Observation, seen_now
from owm_envs.view import VIEW_SIZE, View
from owm_envs.words import checked_seed, unknown

SHELLS: dict[str, tuple[float, float]] = {"100-125": (100.0, 125.0), "100-225": (100.0, 225.0)}
"""Start shells of the two tables, m: the paper's for reinforcement learning, and all starts."""
_FIRST_SEED = 2**40
"""Far from the seeds that corpora count from, so that no flight starts as a recorded episode did."""
_CLOSEST = ("distance", "speed", "attitude", "rate", "time")


class Policy(Protocol):
    """Whatever flies a batch of slots; one with an attribute `active` is told which flights still go on.

    Where relative navigation goes quiet, the observation is a mapping, "state" and "state_valid".
    """

    def reset(self, mask: Bool[np.ndarray, "B"] | None, ports: Int[np.ndarray, "B"] | None) -> None:
        """Announce new episodes and their ports."""

    def predict(
        self, observation: Observation, state: Any, episode_start: Any, deterministic: bool
    ) -> tuple[Float[np.ndarray, "B 6"], Any]:
        """Actions in the environment's layout, and the policy's own state."""


def evaluation_config(shell: str = "100-225", **overrides: Any) -> DockingConfig:
    """The protocol's environment: numerical fidelity, cooperative noise, 4 Hz decisions over 20 Hz dynamics.

    Args:
        shell: a key of `SHELLS`.
        overrides: fields of `DockingConfig`.

    Raises:
        ValueError: the shell or a field is unknown.
    """
    if shell not in SHELLS:
        raise ValueError(unknown("shell", shell, SHELLS))
    low, high = SHELLS[shell]
    standard = {
        "noise": "cooperative",
        "steps_per_action": 5,
        "collision_terminates": False,
        "reset": {"radius_min": low, "radius_max": high},
    }
    return load_config(standard, **{"fidelity": "iss-numerical"} | overrides)


def trials(
    ports: Sequence[str] = PORT_NAMES, per_port: int = 50, seed: int = 0
) -> tuple[Int[np.ndarray, "N"], Int[np.ndarray, "N"]]:
    """Seeds and port indices of `per_port` flights to each port: a seed depends on port and trial only.

    Raises:
        ValueError: a port is unknown, or there are no flights, or more than 100 000 a port.
    """
    if not ports or not 1 <= per_port <= 100_000:
        raise ValueError(f"need 1 to 100000 flights to each of one or more ports, got {per_port}, {list(ports)}")
    seed = checked_seed(seed)
    index = np.repeat([port_index(name) for name in ports], per_port).astype(np.int32)
    trial = np.tile(np.arange(per_port), len(ports))
    return _FIRST_SEED + (np.int64(seed) * len(PORT_NAMES) + index) * 100_000 + trial, index


def fly_episodes(
    policy: Policy,
    config: DockingConfig | Mapping[str, Any],
    seeds: Int[np.ndarray, "N"],
    ports: Int[np.ndarray, "N"],
    progress: Callable[[int, int, int, int], None] | None = None,
    *,
    record: bool = True,
    slots: int | None = None,
    name: str | None = None,
    keep: Callable[[list[Episode]], None] | None = None,
) -> Flights:
    """Fly one episode per seed with a policy that sees observations and ports only.

    A collision is recorded and does not end the flight, whatever `config` says.

    Args:
        policy: see `Policy`.
        config: the environment; its decision rate must be the policy's.
        seeds: one a flight.
        ports: indices into `owm_envs.station.PORTS`, one a flight.
        progress: called with (flights of earlier batches, decisions taken, most decisions, flights running).
        record: keep the trajectories.
        slots: most flights at a time, all when None; the last batch is filled up, so that shapes stay.
        name: what to call the policy; its own `name` when None.
        keep: given the flights of each batch, in order, as whole recordings of what was seen and done.

    Raises:
        ValueError: shapes disagree, nothing to fly, an unknown port, or actions of the wrong shape.
    """
    config = load_config(config, collision_terminates=False)
    seeds, ports = np.asarray(seeds, np.int64), np.asarray(ports, np.int32)
    if seeds.ndim != 1 or len(seeds) == 0 or seeds.shape != ports.shape:
        raise ValueError(f"seeds and ports must be one each a flight, got {seeds.shape} and {ports.shape}")
    slots = min(slots or len(seeds), len(seeds))
    env = DockingVectorEnv(slots, config, autoreset_mode="disabled")
    name = name or getattr(policy, "name", type(policy).__name__)
    parts = []
    for first in range(0, len(seeds), slots):
        index = np.arange(first, first + slots) % len(seeds)
        told = None if progress is None else lambda *now, first=first: progress(first, *now)
        tape = None if keep is None else Tape(name, goals_of(config))
        batch = _fly_batch(policy, env, seeds[index], ports[index], told, record, name, tape)
        real = slice(0, len(seeds) - first)
        parts.append(batch.select(real))
        if tape is not None:
            keep(tape.episodes(batch.port[real]))
    env.close()
    return join(parts)


def _fly_batch(policy, env, seeds, ports, progress, record, name, tape) -> Flights:
    config, layout = env.config, env.layout
    decisions = config.horizon_decisions
    observation, info = env.reset(seed=seeds.tolist(), options={"dock_port": [int(port) for port in ports]})
    path, clock, began = [info["true_state"]], [np.zeros(len(seeds))], info["epoch"]
    if tape is not None:
        tape.frame(layout.measured_view(observation), info, seen_now(observation))
    digest = np.array([start_digest(*start) for start in zip(info["true_state"], info["epoch"], ports)])
    running = np.ones(len(seeds), bool)
    flown = np.zeros(len(seeds))
    force, torque = np.zeros(len(seeds)), np.zeros(len(seeds))
    limit = np.asarray(layout.wrench_limit)
    thinking, thoughts = 0.0, 0

    policy.reset(np.ones(len(seeds), bool), ports)
    state, start = None, np.ones(len(seeds), bool)
    for decision in range(decisions):
        before = time.perf_counter()
        action, state = policy.predict(observation, state, start, True)
        action = np.asarray(action)
        if decision:  # the first call compiles
            thinking, thoughts = thinking + time.perf_counter() - before, thoughts + int(running.sum())
        if action.shape != (len(seeds), 6):
            raise ValueError(f"policy {name!r} must return actions ({len(seeds)}, 6), got {action.shape}")
        start = np.zeros(len(seeds), bool)
        action = np.where(running[:, None], action, 0)
        wrench = np.clip(action * limit if config.normalize else action, -limit, limit)
        held = np.where(running & np.isfinite(action).all(1), config.decision_dt, 0)
        force += np.linalg.norm(np.nan_to_num(wrench[:, :3]), axis=1) * held
        torque += np.linalg.norm(np.nan_to_num(wrench[:, 3:]), axis=1) * held
        observation, reward, terminated, truncated, info = env.step(action)
        if tape is not None:
            tape.decision(wrench, reward, running)
            tape.frame(layout.measured_view(observation), info, seen_now(observation))
        flown += np.where(running, config.decision_dt, 0)
        path.append(np.where(running[:, None], info["true_state"], np.nan))
        clock.append(np.where(running, (info["epoch"] - began) @ np.array([86_400.0, 1.0]), np.nan))
        running = running & ~(terminated | truncated)
        if hasattr(policy, "active"):
            policy.active = running
        if progress is not None:
            progress(decision + 1, decisions, int(running.sum()))
        if not running.any():
            break

    trajectory = np.full((len(seeds), decisions + 1, VIEW_SIZE), np.nan, np.float32)
    trajectory[:, : len(path)] = np.stack(path, axis=1)
    closest = {f"closest_{part}": info[f"closest_{part}"].copy() for part in _CLOSEST}
    approach = state_at(np.stack(path, axis=1), np.stack(clock, axis=1), closest["closest_time"])
    bounds = config.docking
    return Flights(
        policy=name,
        port=ports.copy(),
        seed=seeds.copy(),
        digest=digest,
        outcome=np.array(OUTCOME_NAMES).take(info["outcome"]),
        collided=info["collided"].copy(),
        **closest,
        **_split(approach, goals_of(config)[ports]),
        clearance=info["clearance"].copy(),
        time=flown,
        delta_v=force / config.chaser.mass,
        angular_impulse=torque,
        decision_seconds=thinking / max(thoughts, 1),
        decision_dt=config.decision_dt,
        bounds=(bounds.speed, math.radians(bounds.attitude_deg), math.radians(bounds.rate_deg)),
        trajectory=trajectory if record else None,
    )


def state_at(
    path: Float[np.ndarray, "N T 13"], clock: Float[np.ndarray, "N T"], time: Float[np.ndarray, "N"]
) -> Float[np.ndarray, "N 6"]:
    """Position and velocity between the samples of each flight by cubic Hermite interpolation, m and m/s.

    Wrenches are held from sample to sample, so that the acceleration hardly changes in between.

    Args:
        path: views, NaN after the end of a flight.
        clock: their times, s, NaN after the end.
        time: one a flight, s.
    """
    rows = np.arange(len(path))
    last = np.isfinite(clock).sum(axis=1) - 1
    # The sample before; half a step of a float32 clock must not make it the one before that.
    before = np.clip((clock <= time[:, None] + 1e-9).sum(axis=1) - 1, 0, np.maximum(last - 1, 0))
    after = np.minimum(before + 1, last)
    (p0, v0, *_), (p1, v1, *_) = (View.of(path[rows, i]) for i in (before, after))
    step = (clock[rows, after] - clock[rows, before])[:, None]
    whole = np.where(step > 0, step, 1.0)
    s = np.clip((time - clock[rows, before])[:, None] / whole, 0, 1)
    position = (
        (1 + 2 * s) * (1 - s) ** 2 * p0 + s * (1 - s) ** 2 * step * v0 + s**2 * (3 - 2 * s) * p1
        - s**2 * (1 - s) * step * v1
    )  # fmt: skip
    velocity = 6 * s * (1 - s) * (p1 - p0) / whole + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
    return np.concatenate([position, velocity], axis=1)


def _split(states: Float[np.ndarray, "N 6"], goals: Float[np.ndarray, "N 7"]) -> dict[str, Float[np.ndarray, "N"]]:
    """Offset from the hold pose and velocity, along and across the normal of each flight's port."""
    normal = outward_normals(goals)
    offset, velocity = states[:, :3] - goals[:, :3], states[:, 3:]
    axial, outwards = (np.sum(vector * normal, axis=1) for vector in (offset, velocity))
    return {
        "closest_axial": axial,
        "closest_lateral": np.linalg.norm(offset - axial[:, None] * normal, axis=1),
        "closest_closing": -outwards,
        "closest_lateral_speed": np.linalg.norm(velocity - outwards[:, None] * normal, axis=1),
    }


def start_digest(view: Float[np.ndarray, "13"], epoch: Float[np.ndarray, "2"], port: int) -> str:
    """Fingerprint of a true initial state, its epoch (day, seconds) and the port to fly to."""
    return sha256(np.concatenate([view, epoch, [port]]).astype(np.float64).tobytes()).hexdigest()[:16]


def check_identical_starts(flights: Sequence[Flights]) -> str:
    """The digest of the starts that all policies share.

    Raises:
        ValueError: two policies flew different ones.
    """
    digests = [each.starts_digest for each in flights]
    if len(set(digests)) != 1:
        named = ", ".join(f"{each.policy} {digest}" for each, digest in zip(flights, digests))
        raise ValueError(f"the policies did not fly the same starts: {named}")
    return digests[0]
