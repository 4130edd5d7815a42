"""The pure environment behind whatever a user holds."""

from typing import Any

from owm_envs.config import DockingConfig
from owm_envs.env.docking import DockingEnv


def docking_env(subject: Any) -> DockingEnv:
    """The pure environment of one, of its configuration, or of a Gymnasium environment over one, wrapped or not.

    Raises:
        TypeError: the subject is none of these.
    """
    if isinstance(subject, DockingEnv):
        return subject
    if isinstance(subject, DockingConfig):
        return DockingEnv(subject)
    found = getattr(getattr(subject, "unwrapped", subject), "docking_env", None)
    if not isinstance(found, DockingEnv):
        raise TypeError(
            "env must be a DockingEnv, a DockingConfig, or a Gymnasium environment of this package, "
            f"got {type(subject).__name__}"
        )
    return found
