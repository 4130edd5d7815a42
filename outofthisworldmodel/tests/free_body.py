"""A rigid body beside a box, near one port: what the tests of the planner fly."""

from dataclasses import dataclass
from functools import cache

import jax
import numpy as np

from astrojax.attitude import quat_from_rotation_vector, quat_multiply, quat_normalize, quat_rotate
from owm.interface import History
from owm.planning.config import PlannerConfig
from owm.planning.policy import PlannerPolicy
from owm_envs.config import load_config
from owm_envs.field import FieldConfig, GeodesicField, solve_field
from owm_envs.station import PORTS, goal_poses
from owm_envs.view import View

PORT = 0
GOAL = goal_poses()[PORT].astype(np.float32)
LIMIT = (1600.0,) * 3 + (2000.0,) * 3
NO_BIAS = np.zeros(6, np.float32)
BIAS = np.float32([0.012, -0.008, 0.01, 5e-4, 0, -5e-4])
BOX_CORNER = GOAL[:3] + np.float32([24.0, -12.0, -12.0])


@dataclass(frozen=True)
class FreeBody:
    """Accelerated by its wrench over 12 t and 80 t m2 and by a bias, its only parameter (m/s2, rad/s2)."""

    history_length: int = 3
    dt: float = 0.25
    name: str = "free body"

    @property
    def params(self):
        return NO_BIAS

    def encode(self, params, history):
        return history.observation["state"][-1]

    def step(self, params, key, action, state):
        dt = self.dt
        position, velocity, attitude, rate = View.of(state)
        velocity = velocity + dt * (quat_rotate(attitude, action[:3] / 12_000.0) + params[:3])
        rate = rate + dt * (action[3:] / 80_000.0 + params[3:])
        attitude = quat_multiply(attitude, quat_from_rotation_vector(dt * rate))
        return View(position + dt * velocity, velocity, quat_normalize(attitude), rate).numbers()

    def observe(self, params, state, action, observation):
        return observation["state"]

    def decode(self, params, state):
        return {"state": state}


@cache
def small_field() -> GeodesicField:
    """A coarse field of one port with one box 24 m to its side."""
    box = np.stack([BOX_CORNER, BOX_CORNER + np.float32([8.0, 24.0, 24.0])])[None]
    config = FieldConfig(fine_spacing=4.0, coarse_spacing=8.0, extent=48.0, exact_radius=12.0)
    return jax.device_put(solve_field(box, GOAL[None, :3], np.asarray([PORTS[PORT].normal]), config=config))


def view_at(offset, attitude=None) -> np.ndarray:
    """A view at rest, `offset` metres from the goal."""
    attitude = GOAL[3:] if attitude is None else attitude
    return np.concatenate([GOAL[:3] + np.float32(offset), np.zeros(3), attitude, np.zeros(3)]).astype(np.float32)


def history_at(view, length: int = 3) -> History:
    """A history that saw nothing but one view."""
    views = np.tile(view, (length, 1))
    return History({"state": views}, np.zeros((length - 1, 6), np.float32), np.arange(length) == length - 1)


@jax.jit
def move(bias, views, actions):
    """Advance a batch of true views by one decision of a body with a bias."""
    return jax.vmap(lambda view, action: FreeBody().step(bias, None, action, view))(views, actions)


ENV = load_config(fidelity="iss", precision="float32", steps_per_action=5)
STARTS = np.stack([view_at((3, -20, 4)), view_at((-8, -14, -6), np.float32([0.5, -0.866, 0, 0]))])


def observe(layout, views) -> np.ndarray:
    """Observations (B, O) that hold views (B, 13) and nothing else."""
    observation = np.zeros((len(views), layout.size), np.float32)
    observation[:, layout.view] = views
    return observation


def make(slots=2, **values) -> PlannerPolicy:
    policy = PlannerPolicy(FreeBody(), small_field(), ENV, PlannerConfig(**values), slots)
    policy.reset(ports=np.full(slots, PORT))
    return policy
