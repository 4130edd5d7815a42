"""What is to be recorded: how much of each split, flown by whom and to which ports."""

import math
import os
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from owm_envs.config import DockingConfig, load_config
from owm_envs.episode import POLICY_NAMES
from owm_envs.files import read_text
from owm_envs.station.ports import TRAIN_PORTS, port_index
from owm_envs.words import checked_count, checked_seed, is_number, short, unknown

SPLITS = ("train", "val")
BEHAVIOUR_MIX = {"random": 0.30, "orbit": 0.35, "dock": 0.35}
"""Share of each policy among the train episodes. Source: the paper's data generation."""
_GOLDEN = 0.6180339887498949
_SHIPPED = files("owm_envs.datasets") / "recipes"


@dataclass(frozen=True)
class Request:
    """What to record: for each split whole episodes, until it has so many transitions, or so many episodes.

    `planner_style` is the share of train episodes flown by "excite"; the rest keeps `policies`.
    """

    transitions: int | None = 20_000
    val_transitions: int | None = 2_000
    seed: int = 0
    planner_style: float = 0.0
    episodes_per_batch: int = 64
    episodes: int | None = None
    """In place of `transitions`."""
    val_episodes: int | None = None
    policies: Mapping[str, float] | None = None
    """Shares of the train flights by policy; the paper's mixture if absent."""
    val_policies: Mapping[str, float] | None = None
    """The same of val; "dock" alone if absent."""
    ports: tuple[str, ...] | None = None
    """Ports of the train flights; the configured train ports if absent."""
    val_ports: tuple[str, ...] | None = None
    """Ports of the val flights; all configured ones if absent."""

    def __post_init__(self):
        for name in ("transitions", "val_transitions", "episodes", "val_episodes", "episodes_per_batch"):
            if (value := getattr(self, name)) is not None:
                most = 2**16 if name == "episodes_per_batch" else 10**12
                object.__setattr__(self, name, checked_count(name, value, most))
        for prefix in ("", "val_"):
            given = [name for name in (f"{prefix}transitions", f"{prefix}episodes") if getattr(self, name) is not None]
            if len(given) != 1:
                raise ValueError(f"exactly one of {prefix}transitions and {prefix}episodes must be given, got {given}")
        if not (is_number(self.planner_style) and 0 <= self.planner_style <= 1):
            raise ValueError(f"planner_style must be from 0 to 1, got {short(self.planner_style)}")
        for name in ("policies", "val_policies"):
            shares = getattr(self, name)
            if shares is None:
                continue
            if not isinstance(shares, Mapping):
                raise ValueError(f"{name} must be a table of shares, got {short(shares)}")
            for policy in shares:
                if policy not in POLICY_NAMES:
                    raise ValueError(unknown("policy", policy, POLICY_NAMES))
            # None is so small beside another that it would vanish.
            known = all(is_number(share) and (share == 0 or 1e-6 <= share <= 1e6) for share in shares.values())
            if not (known and any(shares.values())):
                allowed = "shares of at least 0, not all 0, the others from 1e-6 to 1e6"
                raise ValueError(f"{name} must be {allowed}, got {short(dict(shares))}")
        for name in ("ports", "val_ports"):
            ports = getattr(self, name)
            if ports is not None:
                if isinstance(ports, str) or not isinstance(ports, Sequence):
                    raise ValueError(f"{name} must be a list of names, got {short(ports)}")
                if not ports:
                    raise ValueError(f"{name} must name at least one port")
                for port in ports:
                    port_index(port)
                object.__setattr__(self, name, tuple(ports))
        checked_seed(self.seed, bits=32)

    def settings(self) -> dict[str, Any]:
        """What tells it from another request: its fields, without those that are left to themselves."""
        return {name: value for name, value in asdict(self).items() if value is not None}


class Split(NamedTuple):
    """What a split is to be, with everything that a request leaves open settled."""

    name: str
    transitions: int
    """At least so many."""
    episodes: int
    """At least so many."""
    policies: dict[str, float]
    """Shares."""
    ports: list[int]
    shuffled: bool
    """Whether ports come in shuffled rounds, else in order."""
    seed: list[int]


class Flight(NamedTuple):
    """What an episode of a split is to be: its policy and port."""

    policy: str
    port: int


def splits(request: Request, config: DockingConfig) -> dict[str, Split]:
    """Settle what each split is to be.

    Raises:
        ValueError: a port is not one of the environment's, or no train port is; the target is not the station at rest.
    """

    def chosen(name: str, own: tuple[str, ...] | None, usual: list[str]) -> list[int]:
        for port in own or ():
            if port not in config.ports:
                raise ValueError(f"{name} must be of the environment's ports ({', '.join(config.ports)}), got {port!r}")
        return [port_index(port) for port in (usual if own is None else own)]

    if config.own_target:
        raise ValueError("datasets are of the station at rest: leave target and randomization.target_rate_deg alone")
    train = chosen("ports", request.ports, [name for name in config.ports if name in TRAIN_PORTS])
    if not train:
        raise ValueError(f"ports must name at least one train port ({', '.join(TRAIN_PORTS)}), got {config.ports}")
    val = chosen("val_ports", request.val_ports, list(config.ports))
    mix = dict(BEHAVIOUR_MIX if request.policies is None else request.policies)
    scale = 1.0 if request.policies is None else sum(mix.values())
    shares = {name: share / scale * (1 - request.planner_style) for name, share in mix.items()}
    shares["excite"] = shares.get("excite", 0.0) + request.planner_style
    val_shares = dict({"dock": 1.0} if request.val_policies is None else request.val_policies)
    return {
        "train": Split(
            "train", request.transitions or 0, request.episodes or 1, shares, train, True, [request.seed, 0]
        ),
        # Whatever its length val sees each of its ports once.
        "val": Split(
            "val",
            request.val_transitions or 0,
            request.val_episodes or len(val),
            val_shares,
            val,
            False,
            [request.seed, 1],
        ),
    }


def flights(split: Split) -> Iterator[Flight]:
    """Give the endless sequence of a split's flights.

    Policies and ports are spread evenly from the first episode on, not drawn one by one, so that a small dataset has
    its share of each: policies by a golden-ratio sequence through the mix, ports in rounds.
    """
    names, edges = list(split.policies), np.cumsum(list(split.policies.values()))
    draws = np.random.default_rng(split.seed)
    place = draws.random()
    while True:
        for port in draws.permutation(split.ports) if split.shuffled else split.ports:
            choice = int(np.searchsorted(edges, place * edges[-1], side="right"))
            yield Flight(names[min(choice, len(names) - 1)], int(port))
            place = (place + _GOLDEN) % 1.0


def batch_size(request: Request, config: DockingConfig) -> int:
    """How many episodes fly at a time.

    Episodes that end early are about a seventh; batches of equal size waste the fewest flights.
    """
    likely = request.episodes or math.ceil(1.15 * request.transitions / config.horizon_decisions)
    batches = math.ceil(likely / request.episodes_per_batch)
    return min(request.episodes_per_batch, 8 * math.ceil(likely / batches / 8))


def shipped() -> list[str]:
    """Names of the recipes that come with the package."""
    return sorted(Path(str(file)).stem for file in _SHIPPED.iterdir() if str(file).endswith(".toml"))


def load_recipe(source: str | os.PathLike) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read a recipe: the fields of `Request`, and in the table `environment` those of `DockingConfig`.

    Args:
        source: name of a shipped one, or path of a TOML file.

    Returns:
        Both, as they stand there.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no recipe, naming the nearest known name.
    """
    text, known = os.fspath(source), shipped()
    path = Path(str(_SHIPPED / f"{text}.toml")) if text in known else Path(text)
    if text not in known and not path.suffix and not path.exists():
        raise ValueError(unknown("recipe", text, known) + ", or the path of a TOML file")
    try:
        values = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"recipe {text!r} is not valid TOML: {error}") from None
    environment = values.pop("environment", {})
    allowed = [field.name for field in fields(Request)]
    for name in values:
        if name not in allowed:
            raise ValueError(f"recipe {text!r}: " + unknown("key", name, [*allowed, "environment"]))
    if not isinstance(environment, dict):
        raise ValueError(f"recipe {text!r}: environment must be a table, got {short(environment)}")
    load_config(environment)
    return values, environment
