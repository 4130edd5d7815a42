"""Scripted policies by name."""

from typing import Any

import jax.numpy as jnp

from owm_envs.env import docking_env
from owm_envs.episode import POLICY_NAMES
from owm_envs.policies.base import ScriptedPolicy, Vehicle, known_goals
from owm_envs.policies.geodesic import DockGeodesicIntegralPolicy, DockGeodesicPolicy, prepared
from owm_envs.policies.guidance import drift_beside
from owm_envs.policies.safe import DockSafePolicy
from owm_envs.policies.scripted import DockPolicy, ExcitePolicy, OrbitPolicy, RandomPolicy
from owm_envs.words import unknown


def make_policy(name: str, env: Any, *, geodesic_field: Any = None) -> ScriptedPolicy:
    """Build a scripted policy for an environment's chaser, layout and decision rate.

    Args:
        name: one of `POLICY_NAMES`.
        env: to be flown: a `DockingEnv`, its configuration, or a Gymnasium environment over it, scalar or vector.
        geodesic_field: a `GeodesicField` for those that follow one; when None the station's own, or that about a target
            with a hold pose of its own.

    Raises:
        ValueError: the name is unknown (naming the nearest).
        TypeError: `env` is no such environment.
    """
    if name not in POLICY_NAMES:
        raise ValueError(unknown("policy", name, POLICY_NAMES))
    env = docking_env(env)
    chaser, decision_dt = env.config.chaser, env.config.decision_dt
    vehicle = Vehicle(chaser.mass, chaser.inertia, chaser.force_limit, chaser.torque_limit, decision_dt)
    layout = env.layout
    if name == "random":
        return RandomPolicy(vehicle, layout=layout)
    if name == "orbit":
        return OrbitPolicy(vehicle, layout=layout)
    if name == "dock":
        return DockPolicy(vehicle, known_goals(env.config), layout=layout)
    if name == "excite":
        return ExcitePolicy(vehicle, layout=layout, hold=max(1, round(2.0 / decision_dt)))
    if name == "dock-safe":
        known = prepared(env.config, geodesic_field)
        drift = jnp.asarray(drift_beside(env.config.chief.semi_major_axis))
        return DockSafePolicy(vehicle, *known, drift, layout=layout, turning=env.structure.turning)
    kinds = {kind.name: kind for kind in (DockGeodesicPolicy, DockGeodesicIntegralPolicy)}
    return kinds[name](vehicle, *prepared(env.config, geodesic_field), layout=layout)
