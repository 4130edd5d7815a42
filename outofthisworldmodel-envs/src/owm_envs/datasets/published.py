"""Read the columns of the datasets that the paper's authors published (LeRobot v3, vectors only)."""

import numpy as np

from owm_envs.episode import Episode
from owm_envs.station.ports import goal_poses

PUBLISHED_COLUMNS = (
    "observation_vector",
    "state_vector",
    "action",
    "reward",
    "terminated",
    "policy_id",
    "dock_target",
)


def episode_from_published(columns: dict[str, np.ndarray]) -> Episode:
    """The episode whose rows these are.

    The observation is [epoch 2] + relative view 13 + [goal error 12]. A true state of 13 numbers is the relative view;
    one of 21 is the inertial state [MJD day, elapsed s, chief r v, chaser r v, q, rate] and is turned into it. The
    outcome is told by the last reward, whose terminal terms are -1e6 (collision), +1e4 (docked), -1e4 (escaped). The
    epoch is the observation's where it has one, else zero; policy ids are the authors' own.

    Raises:
        ValueError: a vector has an unknown length.
    """
    from owm_envs.task.events import Outcome

    vector, truth = columns["observation_vector"], columns["state_vector"]
    if vector.shape[1:] not in ((13,), (15,), (25,), (27,)):
        raise ValueError(f"observation_vector must have 13, 15, 25 or 27 numbers, got {vector.shape[1:]}")
    has_epoch = vector.shape[1] in (15, 27)
    view = vector[:, 2:15] if has_epoch else vector[:, :13]
    if truth.shape[1:] not in ((13,), (21,)):
        raise ValueError(f"state_vector must have 13 or 21 numbers, got {truth.shape[1:]}")
    rows = len(vector)
    reward = columns["reward"].reshape(rows).astype(np.float32)
    outcome = Outcome.TIMEOUT
    if columns["terminated"].astype(bool).any():
        # Whether the padded row repeats the terminal reward or holds zero is not specified: look at both.
        last = max(reward[-2:].tolist(), key=abs)
        outcome = Outcome.COLLIDED if last < -5e5 else Outcome.ESCAPED if last < -5e3 else Outcome.DOCKED
    done = np.arange(rows - 1) == rows - 2
    target = columns["dock_target"].reshape(rows, 7)[0].astype(np.float64)
    port = int(np.argmin(np.linalg.norm(goal_poses()[:, :3] - target[:3], axis=1)))
    return Episode(
        observation={"state": view.astype(np.float32)},
        true_state=truth.astype(np.float64) if truth.shape[1] == 13 else _relative_states(truth.astype(np.float64)),
        epoch=vector[:, :2].astype(np.float64) if has_epoch else np.zeros((rows, 2)),
        action=columns["action"].reshape(rows, 6)[:-1].astype(np.float32),
        reward=reward[:-1],
        done=done,
        success=done & (outcome == Outcome.DOCKED),
        port=port,
        goal_pose=target,
        policy=int(columns["policy_id"].reshape(rows)[0]),
        outcome=int(outcome),
    )


def _relative_states(inertial: np.ndarray) -> np.ndarray:
    import jax
    import jax.numpy as jnp

    from owm_envs.dynamics import PhysicalState, VehicleState
    from owm_envs.dynamics.numerical import NumericalOrbits

    def one(row):
        chaser = VehicleState(row[8:14] - row[2:8], row[14:18], row[18:21])
        return NumericalOrbits().relative_state(None, PhysicalState(row[:2], row[1], row[2:8], chaser))

    with jax.enable_x64(True):
        return np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(inertial)))
