"""The Gymnasium ids; entry points are strings, so nothing heavy is imported."""

import importlib.abc
import importlib.util
import sys

IDS = {
    "ISS-v0": "iss",
    "ISSHCW-v0": "iss-hcw",
    "ISSNumerical-v0": "iss-numerical",
    "iss": "iss",
    "iss-hcw": "iss-hcw",
    "iss-numerical": "iss-numerical",
}
"""Environment id to fidelity; the short names are aliases."""


def register_all() -> None:
    """Register every id once; no `max_episode_steps`: the environment truncates itself."""
    import gymnasium

    for name, fidelity in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="owm_envs.adapters.gymnasium:DockingGymEnv",
                vector_entry_point="owm_envs.adapters.gymnasium:DockingVectorEnv",
                kwargs={"fidelity": fidelity},
            )


def register_with_gymnasium() -> None:
    """Register now if Gymnasium has been imported, and else as soon as it is: importing it takes long."""
    if "gymnasium" in sys.modules:
        register_all()
    elif not any(isinstance(finder, _Waiting) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Waiting())


class _Waiting(importlib.abc.MetaPathFinder):
    """Finds Gymnasium as all others do, and registers once it is there."""

    def find_spec(self, name, path=None, target=None):
        if name != "gymnasium":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            return spec
        begin = spec.loader.exec_module

        def exec_module(module):
            begin(module)
            register_all()

        spec.loader.exec_module = exec_module
        return spec
