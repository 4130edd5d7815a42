"""Spacecraft docking at the International Space Station at three fidelities.

`import owm_envs` registers the Gymnasium ids `ISS-v0`, `ISSHCW-v0`, `ISSNumerical-v0` and the short names `iss`,
`iss-hcw`, `iss-numerical`. It imports neither JAX nor any drawing library: members are imported when first asked for.
"""

import importlib
from importlib import metadata as _metadata
from typing import TYPE_CHECKING, Any


def _refuse_foreign_distribution() -> None:
    """Stop when a distribution of another project shares this import name."""
    try:
        foreign = _metadata.distribution("owm-envs")
    except _metadata.PackageNotFoundError:
        return
    raise ImportError(
        f"the distribution 'owm-envs' {foreign.version} is installed beside 'outofthisworldmodel-envs'; "
        "both provide the import package 'owm_envs', so their files overwrite each other. "
        "Fix: pip uninstall owm-envs, then install ours again from its source, as the README says"
    )


_refuse_foreign_distribution()

from owm_envs.registration import DockingKeywords, make, make_vec, register_all  # noqa: E402  (after the check above)

if TYPE_CHECKING:
    from owm_envs.config import DockingConfig, load_config
    from owm_envs.env import DockingEnv, FleetEnv
    from owm_envs.field import load_field
    from owm_envs.policies import VectorPolicy, make_policy
    from owm_envs.station import PORT_NAMES, PORTS, goal_poses, hull_boxes
    from owm_envs.task.events import OUTCOME_NAMES, Outcome
    from owm_envs.task.sensors import Measurement, Sensor
    from owm_envs.testing import check_env, check_policy
    from owm_envs.view import View

__version__ = "0.1.0"
__all__ = [
    "OUTCOME_NAMES",
    "PORTS",
    "PORT_NAMES",
    "DockingConfig",
    "DockingEnv",
    "DockingKeywords",
    "FleetEnv",
    "Measurement",
    "Outcome",
    "Sensor",
    "VectorPolicy",
    "View",
    "__version__",
    "check_env",
    "check_policy",
    "goal_poses",
    "hull_boxes",
    "load_config",
    "load_field",
    "make",
    "make_policy",
    "make_vec",
]
_LATER = {
    "DockingConfig": "owm_envs.config",
    "load_config": "owm_envs.config",
    "DockingEnv": "owm_envs.env",
    "FleetEnv": "owm_envs.env",
    "load_field": "owm_envs.field",
    "VectorPolicy": "owm_envs.policies",
    "make_policy": "owm_envs.policies",
    "PORTS": "owm_envs.station",
    "PORT_NAMES": "owm_envs.station",
    "goal_poses": "owm_envs.station",
    "hull_boxes": "owm_envs.station",
    "OUTCOME_NAMES": "owm_envs.task.events",
    "Outcome": "owm_envs.task.events",
    "Measurement": "owm_envs.task.sensors",
    "Sensor": "owm_envs.task.sensors",
    "check_env": "owm_envs.testing",
    "check_policy": "owm_envs.testing",
    "View": "owm_envs.view",
}
"""Where a member is imported from when it is first asked for."""

register_all()


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_LATER[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
