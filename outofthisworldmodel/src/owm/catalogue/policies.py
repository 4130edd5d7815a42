"""Every policy by the name that commands and reports use, and what each of them is given."""

import importlib
import inspect
import os
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

from owm.catalogue import hub
from owm.catalogue.kinds import check
from owm.checkpoint import FILES, About, read_header
from owm_envs.config import DockingConfig
from owm_envs.words import checked_seed, unknown


class Given(NamedTuple):
    """What a policy knows beside observation, port, hold pose and the thrusters' limits."""

    hull: str
    motion: str
    mass: str
    noise: str
    images: str
    feedback: str
    data: str


GIVEN_COLUMNS = (
    "hull map",
    "equations of motion",
    "mass and inertia",
    "noise model",
    "images",
    "feedback of past errors",
    "learned from",
)
_MAP = "yes: geodesic field and clearance"
_PROFILE = "only through the profile's braking limits"
_CORRECTOR = "yes: bias corrector"
_KINEMATICS = "kinematics of a rigid body; accelerations"
_EXACT = "the simulator's own, started from the measurement"
OWN = "user's own"
GIVEN: dict[str, Given] = {
    "world model": Given(_MAP, f"{_KINEMATICS} learned", _PROFILE, "no", "no", _CORRECTOR, "corpus"),
    "latent world model": Given(_MAP, "none: all learned", _PROFILE, "no", "no", _CORRECTOR, "corpus"),
    "plain world model": Given(_MAP, "none: all learned", _PROFILE, "no", "no", _CORRECTOR, "corpus"),
    "latent world model, fitted map": Given(
        _MAP, "none; products of features fitted, the rest learned", _PROFILE, "no", "no", _CORRECTOR, "corpus"
    ),
    "least-squares": Given(_MAP, f"{_KINEMATICS} fitted", _PROFILE, "no", "no", _CORRECTOR, "corpus"),
    "least-squares-online": Given(
        _MAP, f"{_KINEMATICS} fitted, then again in flight", _PROFILE, "no", "no", f"{_CORRECTOR}; action map", "corpus"
    ),
    "world model, online": Given(
        _MAP,
        f"{_KINEMATICS} learned, linear part fitted again in flight",
        _PROFILE,
        "no",
        "no",
        f"{_CORRECTOR}; action map",
        "corpus",
    ),
    "world model, online, guarded": Given(
        f"{_MAP}; the filter a sphere and a corridor",
        f"{_KINEMATICS} learned, linear part fitted again in flight; Clohessy and Wiltshire's where it hands over",
        "yes, where it hands over",
        "yes, where it hands over",
        "no",
        f"{_CORRECTOR}; action map; state estimate where it hands over",
        "corpus",
    ),
    "world model, network zeroed": Given(
        _MAP, f"{_KINEMATICS} fitted; the network's weights are zero", _PROFILE, "no", "no", _CORRECTOR, "corpus"
    ),
    "world model, network zeroed, online": Given(
        _MAP,
        f"{_KINEMATICS} fitted, then again in flight; the network's weights are zero",
        _PROFILE,
        "no",
        "no",
        f"{_CORRECTOR}; action map",
        "corpus",
    ),
    **dict.fromkeys(
        ("ekf-mpc", "ekf-mpc-gated"),
        Given(
            "no: a sphere about the station and a corridor to the port",
            "Clohessy and Wiltshire's and a rigid body's, with the orbit's rate",
            "yes",
            "yes",
            "no",
            "yes: state estimate",
            "nothing",
        ),
    ),
    "constant-velocity": Given(_MAP, "kinematics of a rigid body", _PROFILE, "no", "no", _CORRECTOR, "nothing"),
    "oracle-mppi": Given(_MAP, _EXACT, "yes", "no", "no", _CORRECTOR, "nothing"),
    "ppo": Given("no", "no", "no", "no", "no", "no", "flying, by reward"),
    "ppo-field": Given("yes: geodesic field", "no", "no", "no", "no", "no", "flying, by reward"),
    "dock": Given("no", "no: fixed PD gains", "inertia ratios", "no", "no", "no", "nothing"),
    "dock-geodesic": Given(_MAP, "no: fixed time constants", "yes", "no", "no", "no", "nothing"),
    "dock-geodesic-integral": Given(_MAP, "no: fixed time constants", "yes", "no", "no", "yes: integral", "nothing"),
    "dock-safe": Given(
        _MAP,
        "Clohessy and Wiltshire's; fixed time constants",
        "yes",
        "no",
        "no",
        "no",
        "nothing",
    ),
    "orbit": Given("no", "no: fixed PD gains", "yes", "no", "no", "no", "nothing"),
    "excite": Given("no", "no", "yes", "no", "no", "no", "nothing"),
    "random": Given("no", "no", "no", "no", "no", "no", "nothing"),
    OWN: Given(*["not told"] * 7),
}
"""Keyed by `kind_of` a policy."""
SCRIPTED = ("dock", "dock-geodesic", "dock-geodesic-integral", "dock-safe", "random", "orbit", "excite")
NAMES = (*SCRIPTED, "ekf-mpc", "ekf-mpc-gated", "oracle-mppi", "constant-velocity")
"""What `load_policy` knows beside paths."""
ONLINE_PREFIX = "online:"
"""Before the folder of a model whose linear part is to be fitted again in flight."""
GUARDED_PREFIX = "guarded:"
"""Before that of a world model fitted again in flight, which hands over to a classical policy where it should."""
ZEROED_PREFIX = "zeroed:"
"""Before the folder of a world model whose network is to be silenced, to see what it is worth."""
_ZEROED = {"world model": "world model, network zeroed"}
_ONLINE = {
    "least-squares": "least-squares-online",
    "world model": "world model, online",
    "world model, network zeroed": "world model, network zeroed, online",
}
_GUARDED = {"world model": "world model, online, guarded"}
_OWN = re.compile(r"(?P<module>[A-Za-z_][\w.]*):(?P<name>[A-Za-z_]\w*)")
"""A user's class, `module:Class`."""
_KINDS = {
    "learned": "world model",
    "latent": "latent world model",
    "plain": "plain world model",
    "latent, fitted map": "latent world model, fitted map",
    "least_squares": "least-squares",
    "constant_velocity": "constant-velocity",
}


def own_class(policy: str) -> Callable[..., Any]:
    """The class, or function that makes a policy, behind `module:Class`, looked for in the current folder too.

    Raises:
        ImportError: there is no such module, or it cannot be imported.
        ValueError: it has no such class, naming the nearest.
    """
    parts = _OWN.fullmatch(policy)
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        module = importlib.import_module(parts["module"])
    except ImportError as error:
        raise ImportError(f"policy {policy!r} cannot be imported: {error}") from error
    if not callable(made := getattr(module, parts["name"], None)):
        classes = [name for name, value in vars(module).items() if inspect.isclass(value)]
        raise ValueError(unknown(f"class of {parts['module']}", parts["name"], classes))
    return made


def _own_policy(policy: str, **told: Any) -> Any:
    """A user's policy, made with those of `config`, `num_slots` and `seed` that its class takes.

    Raises:
        ValueError: the class needs something else, or what it makes is no policy.
    """
    made = own_class(policy)
    taken = inspect.signature(made).parameters
    everything = any(each.kind is each.VAR_KEYWORD for each in taken.values())
    try:
        flown = made(**{name: value for name, value in told.items() if everything or name in taken})
    except TypeError as error:
        raise ValueError(f"policy {policy!r} is made with {', '.join(told)} or some of them: {error}") from error
    if lacking := [name for name in ("reset", "predict") if not callable(getattr(flown, name, None))]:
        raise ValueError(f"policy {policy!r} lacks {' and '.join(lacking)}; try owm_envs.testing.check_policy on it")
    return flown


def is_planned(kind: str) -> bool:
    """Whether a kind of policy is a world model in the planner."""
    return kind in ("oracle-mppi", *_ONLINE.values(), *_GUARDED.values(), *_ZEROED.values(), *_KINDS.values())


def kind_of(policy: str) -> str:
    """The key of `GIVEN` that a name or path belongs to.

    Raises:
        ValueError: neither a known name (naming the nearest) nor the checkpoint of a model to plan with, or a damaged
            one.
        FileNotFoundError: a path at which there is nothing.
    """
    if policy in NAMES:
        return policy
    if policy == "least-squares":
        raise ValueError("least-squares needs a fit: give its folder, such as runs/demo/least-squares")
    for prefix, kinds, needed in (
        (ONLINE_PREFIX, _ONLINE, "a model with a linear part"),
        (ZEROED_PREFIX, _ZEROED, "a model with a network over a fitted part"),
        (GUARDED_PREFIX, _GUARDED, "a model with a network over a fitted part"),
    ):
        if policy.startswith(prefix):
            start = kind_of(policy.removeprefix(prefix))
            if start not in kinds:
                raise ValueError(f"{prefix} needs {needed} ({', '.join(kinds)}), got a {start}")
            return kinds[start]
    if _OWN.fullmatch(policy):
        own_class(policy)
        return OWN
    header = read_header(checkpoint_folder(policy))
    kind = header.kind
    if kind == "ppo":
        return "ppo-field" if header.config.get("observe_field") is True else "ppo"
    stream = header.config.get("stream")
    if kind == "learned" and stream == "plain":
        kind = "plain"
    if kind == "learned" and stream == "latent":
        base = header.config.get("base_dynamics", header.config.get("skip", "bilinear"))  # its name in older files
        kind = "latent, fitted map" if base == "bilinear" else "latent"
    if kind not in _KINDS:
        raise ValueError(f"{policy!r} holds a {kind} model, which is no policy; need {', '.join(_KINDS)}")
    return _KINDS[kind]


def _folder(policy: str) -> str:
    """The path in a policy's name, without "guarded:", "online:", "zeroed:" or "online:zeroed:"."""
    return policy.removeprefix(GUARDED_PREFIX).removeprefix(ONLINE_PREFIX).removeprefix(ZEROED_PREFIX)


def checkpoint_folder(path: str) -> Path:
    """The folder of a policy's checkpoint, as `owm.catalogue.hub.checkpoint_folder` finds it."""
    return hub.checkpoint_folder(path, "policy", NAMES)


def content_digest(source: str) -> str:
    """Fingerprint of a policy: its name, what its checkpoint holds, or the file of a class of one's own."""
    if source in NAMES:
        return source
    if kind_of(source) == OWN:
        return sha256(source.encode() + Path(inspect.getfile(own_class(source))).read_bytes()).hexdigest()[:16]
    path = _folder(source)
    folder = checkpoint_folder(path)
    sha = sha256(source.removesuffix(path).encode())
    check(folder)
    for name in sorted(FILES):
        if (folder / name).is_file():
            sha.update(name.encode() + (folder / name).read_bytes())
    return sha.hexdigest()[:16]


def load_policy(
    policy: str, config: DockingConfig, num_slots: int = 1, seed: int = 0, planner: Any = None, field: Any = None
) -> Any:
    """Build a policy for a batch of slots.

    Args:
        policy: one of `NAMES`, or the folder of a trained world model or a least-squares fit, for the planner
            to fly; `online:FOLDER` fits the linear part of either again in flight; `zeroed:FOLDER` flies a world model
            whose network says nothing, `online:zeroed:FOLDER` both; `guarded:FOLDER` is `online:FOLDER` that hands over
            to `ekf-mpc` where measurements are too bad for it, and to `dock-safe` where no linear map explains the
            vehicle; `module:Class` is a class of your own, made with
            those of `config`, `num_slots` and `seed` that it takes.
        config: the environment to fly.
        num_slots: flights side by side.
        seed: decides the policy's own draws.
        planner: a `PlannerConfig` for planned policies; the standard one when None.
        field: the `GeodesicField` for policies that use one; the station's own when None.

    Returns:
        A policy as `owm.scores.docking.Policy` describes it, with a `name`.

    Raises:
        ValueError: the name is unknown, the seed negative, the checkpoint damaged, or the decision rate not the
            model's.
        FileNotFoundError: there is nothing at the path.
    """
    kind = kind_of(policy)
    checked_seed(seed, bits=32)
    from owm_envs.env import DockingEnv
    from owm_envs.policies import VectorPolicy, make_policy
    from owm_envs.policies.reckoning import reckoning

    env = DockingEnv(config)
    if kind in SCRIPTED:
        return VectorPolicy(reckoning(make_policy(kind, env, geodesic_field=field)), seed=seed)
    if kind == OWN:
        flown = _own_policy(policy, config=config, num_slots=num_slots, seed=seed)
        if not isinstance(getattr(flown, "name", None), str):
            flown.name = policy
        return flown
    if kind in ("ekf-mpc", "ekf-mpc-gated"):
        from owm.baselines.classical import GATE, classical_policy

        gated = {"gate": GATE} if kind == "ekf-mpc-gated" else {}
        return VectorPolicy(classical_policy(env, **gated), seed=seed)
    from owm_envs.policies.geodesic import field_of

    name = kind if kind == policy else "/".join(Path(policy).parts[-2:])
    if field is None and kind != "ppo":
        field = field_of(env.config)
    if kind in ("ppo", "ppo-field"):
        from owm.baselines.ppo.policy import PPOPolicy

        flown = PPOPolicy(checkpoint_folder(policy), config, num_slots, field if kind == "ppo-field" else None)
        flown.name = name
        return flown
    from owm.planning.policy import PlannerPolicy

    model, learner = load_model(policy, config), None
    if kind in (*_ONLINE.values(), *_GUARDED.values()):
        from owm.baselines.online import OnlineBase, OnlineLeastSquares

        learner = OnlineLeastSquares(env.layout.wrench_limit, model.dt)
        if kind != _ONLINE["least-squares"]:
            learner = OnlineBase(learner)
    made = PlannerPolicy(model, field, env, planner, num_slots, seed, learner)
    if kind in _GUARDED.values():
        from owm.baselines.guarded import GuardedPolicy

        fallbacks = (load_policy(each, config, num_slots, seed, field=field) for each in ("ekf-mpc", "dock-safe"))
        made = GuardedPolicy(made, *fallbacks)
    made.name = name
    return made


def differences(about: About, config: DockingConfig) -> list[str]:
    """How what a checkpoint was trained on differs from the environment, where it tells."""
    told = []
    for part in ("fidelity", "noise"):
        facts = (corpus.model_dump(exclude_unset=True).get(part) for corpus in about.corpus)
        seen = [each for each in facts if each is not None]
        now = config.model_dump(mode="json")[part]
        if seen and now not in seen:
            told.append(f"was trained on other {part} than it flies in: {_short(seen)}; now {_short([now])}")
    return told


def _short(values: list[Any]) -> str:
    """Values in a few words: of a noise model, what is not zero."""
    texts = [
        value if isinstance(value, str) else str({k: v for k, v in value.items() if v and k != "bias"})
        for value in values
    ]
    return ", ".join(dict.fromkeys(texts))


def read_model(folder: Path, name: str, config: DockingConfig) -> Any:
    """The world model in a checkpoint's folder; says how what it was trained on differs from what it is used in."""
    from owm.catalogue.checkpoint import load_world_model
    from owm.console import announce

    model = load_world_model(folder)
    for text in differences(read_header(folder).about, config):
        announce(f"note: {name} {text}")
    return model


def zeroed(model: Any) -> Any:
    """A learned world model with all weights of its network set to zero; what was measured and fitted stays."""
    import jax

    network = jax.tree.map(lambda x: 0 * x, model.params.network)
    return replace(model, params=model.params._replace(network=network), name=f"{model.name}, network zeroed")


def load_model(policy: str, config: DockingConfig) -> Any:
    """The world model behind "oracle-mppi" or a checkpoint.

    Raises:
        ValueError: the name is unknown or has no world model, or the checkpoint is damaged.
        FileNotFoundError: there is nothing at the path.
    """
    kind = kind_of(policy)
    if kind == "oracle-mppi":
        from owm.baselines.exact import ExactDynamics

        return ExactDynamics(config.fidelity, config)
    if policy == "constant-velocity":
        from owm.baselines.constant_velocity import ConstantVelocity

        return ConstantVelocity()
    if is_planned(kind):
        model = read_model(checkpoint_folder(_folder(policy)), policy, config)
        return zeroed(model) if policy.removeprefix(ONLINE_PREFIX).startswith(ZEROED_PREFIX) else model
    raise ValueError(f"policy {policy!r} has no world model")
