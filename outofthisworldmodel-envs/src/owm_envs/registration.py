"""The Gymnasium ids, registered on `import owm_envs`; entry points are strings, so nothing heavy is imported."""

import gymnasium

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
    for name, fidelity in IDS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="owm_envs.adapters.gymnasium:DockingGymEnv",
                vector_entry_point="owm_envs.adapters.gymnasium:DockingVectorEnv",
                kwargs={"fidelity": fidelity},
            )
