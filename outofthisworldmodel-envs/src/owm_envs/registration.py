"""The Gymnasium ids; entry points are strings, so nothing heavy is imported."""

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypedDict, TypeVar, Unpack

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

Id = Literal["ISS-v0", "ISSHCW-v0", "ISSNumerical-v0", "iss", "iss-hcw", "iss-numerical"]
Boxes = Sequence[tuple[Sequence[float], Sequence[float]]]
Part = Mapping[str, Any]
"""Fields of a part of `DockingConfig`; the rest keep their values."""
_Made = TypeVar("_Made", bound=Callable[..., Any])


class DockingKeywords(TypedDict, total=False):
    """Keywords of `make` and `make_vec`: the fields of `DockingConfig`, and what they are laid over.

    `owm_envs.DockingConfig` documents each with its default; `owm-envs config show` prints units and bounds.
    """

    config: Any
    """A `DockingConfig`, a mapping of its fields, or the path of a TOML file."""
    preset: Literal["data", "rl", "tumbling"]
    noise: Literal["none", "cooperative", "noncooperative"] | Part
    navigation: Part
    reward: Literal["data", "rl"] | Part
    ports: Sequence[str]
    observation: Literal["state", "pixels", "state+pixels"]
    goal_error: bool
    normalize: bool
    precision: Literal["float32", "float64"]
    dt: float
    steps_per_action: int
    horizon: float
    escape_radius: float
    collision_terminates: bool
    hull: str | os.PathLike | Boxes
    obstacles: Boxes
    reset: Part
    docking: Part
    chief: Part
    target: Part
    chaser: Part
    camera: Part
    forces: Part
    randomization: Part
    render_mode: Literal["rgb_array"] | None
    width: int
    height: int
    camera_name: str | None
    """Whose picture `render()` gives; the flight from outside if None."""
    dynamics: Any
    """Equations of motion of your own, a `Dynamics`."""
    sensors: Sequence[Any]
    """What the chaser carries beside relative navigation: each is a `Sensor`."""
    max_episode_steps: int | None
    disable_env_checker: bool | None


def _with_keywords(function: _Made) -> _Made:
    """Show the keywords one by one to whoever asks for the signature, as notebooks do."""
    given = inspect.signature(function)
    own = [p for p in given.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
    keywords = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=..., annotation=annotation)
        for name, annotation in DockingKeywords.__annotations__.items()
    ]
    function.__signature__ = given.replace(parameters=[*own, *keywords])
    return function


@_with_keywords
def make(id: Id = "ISSNumerical-v0", **keywords: Unpack[DockingKeywords]) -> gymnasium.Env:
    """`gymnasium.make`, with the keywords of these environments for an editor to complete.

    Args:
        id: a key of `IDS`.
        keywords: see `DockingKeywords`.
    """
    return gymnasium.make(id, **keywords)


@_with_keywords
def make_vec(
    id: Id = "ISSNumerical-v0",
    num_envs: int = 1,
    autoreset_mode: Literal["next_step", "same_step", "disabled"] = "next_step",
    vectorization_mode: Literal["vector_entry_point", "sync", "async"] | None = None,
    vector_kwargs: Mapping[str, Any] | None = None,
    **keywords: Unpack[DockingKeywords],
) -> gymnasium.vector.VectorEnv:
    """`gymnasium.make_vec`, with the keywords of these environments for an editor to complete.

    Args:
        id: a key of `IDS`.
        num_envs: slots, advanced by one compiled program.
        autoreset_mode: when a slot that has ended starts again.
        vectorization_mode: "sync" and "async" make an environment for each slot in place of that program, Gymnasium's
            way. A process that has used JAX needs `vector_kwargs={"context": "spawn"}` for "async".
        vector_kwargs: of Gymnasium's own vector environment.
        keywords: see `DockingKeywords`.
    """
    if vectorization_mode in (None, "vector_entry_point"):
        return gymnasium.make_vec(id, num_envs=num_envs, autoreset_mode=autoreset_mode, **keywords)
    known = {mode.name.lower(): mode for mode in gymnasium.vector.AutoresetMode}
    if autoreset_mode not in known:
        raise ValueError(f"autoreset_mode must be one of {', '.join(known)}, got {autoreset_mode!r}")
    given = {"autoreset_mode": known[autoreset_mode], **(vector_kwargs or {})}
    return gymnasium.make_vec(id, num_envs, vectorization_mode, given, **keywords)


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
