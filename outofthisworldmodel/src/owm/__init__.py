"""A world model of spacecraft rendezvous: train it, plan with it, dock with it.

Members are imported when first asked for.
"""

import importlib
from importlib import metadata as _metadata
from typing import TYPE_CHECKING, Any


def _refuse_foreign_distribution() -> None:
    """Stop when a distribution of another project shares this import name."""
    try:
        foreign = _metadata.distribution("owm")
    except _metadata.PackageNotFoundError:
        return
    raise ImportError(
        f"the distribution 'owm' {foreign.version} is installed beside 'outofthisworldmodel'; "
        "both provide the import package 'owm', so their files overwrite each other. "
        "Fix: pip uninstall owm, then install ours again from its source, as the README says"
    )


_refuse_foreign_distribution()

if TYPE_CHECKING:
    from owm.baselines.least_squares import fit_least_squares
    from owm.catalogue.checkpoint import load_world_model
    from owm.catalogue.policies import load_policy
    from owm.checkpoint import save_world_model
    from owm.data.recordings import training_episodes
    from owm.interface import History, WorldModel
    from owm.planning.config import PlannerConfig
    from owm.planning.policy import PlannerPolicy
    from owm.scores.docking import evaluation_config, fly_episodes
    from owm.training.config import TrainConfig

__version__ = "0.1.0"
__all__ = [
    "History",
    "PlannerConfig",
    "PlannerPolicy",
    "TrainConfig",
    "WorldModel",
    "__version__",
    "evaluation_config",
    "fit_least_squares",
    "fly_episodes",
    "load_policy",
    "load_world_model",
    "save_world_model",
    "training_episodes",
]
_LATER = {
    "fit_least_squares": "owm.baselines.least_squares",
    "load_world_model": "owm.catalogue.checkpoint",
    "load_policy": "owm.catalogue.policies",
    "save_world_model": "owm.checkpoint",
    "training_episodes": "owm.data.recordings",
    "History": "owm.interface",
    "WorldModel": "owm.interface",
    "PlannerConfig": "owm.planning.config",
    "PlannerPolicy": "owm.planning.policy",
    "evaluation_config": "owm.scores.docking",
    "fly_episodes": "owm.scores.docking",
    "TrainConfig": "owm.training.config",
}
"""Where a member is imported from when it is first asked for."""


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_LATER[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
