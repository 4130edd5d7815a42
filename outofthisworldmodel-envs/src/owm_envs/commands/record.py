"""Commands that record datasets."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import tyro

from owm_envs.shell import resumable, terminal


def generate(
    out: Path,
    recipe: str | None = None,
    env: str | None = None,
    noise: str | None = None,
    transitions: int | None = None,
    val_transitions: int | None = None,
    episodes: int | None = None,
    val_episodes: int | None = None,
    seed: int | None = None,
    planner_style: float | None = None,
    policies: dict[str, float] | None = None,
    val_policies: dict[str, float] | None = None,
    ports: tuple[str, ...] | None = None,
    val_ports: tuple[str, ...] | None = None,
    steps_per_action: int | None = None,
    pixels: int | None = None,
    channels: str | None = None,
    every: int | None = None,
    view: str | None = None,
    episodes_per_batch: int | None = None,
    config: Path | None = None,
    shard: str | None = None,
) -> None:
    """Record a dataset: OUT/train and OUT/val, LeRobot v3.

    Whole episodes are recorded until each split has its transitions. A killed run is resumed by the same command.

    Args:
        out: Folder to make.
        recipe: What to record: quick, small-64, paper-500k-none, paper-500k-cooperative, paper-500k-noncooperative or a
            TOML file; the flags below win over it.
        env: iss, iss-hcw or iss-numerical (the default).
        noise: Sensor noise: none, cooperative (the default) or noncooperative.
        transitions: Least number of transitions of the train split; 20,000 by default.
        val_transitions: The same of the val split, which flies to each port at least once; a tenth of train by default.
        episodes: Number of episodes of the train split, in place of transitions.
        val_episodes: The same of the val split.
        seed: Decides everything random; 0 by default.
        planner_style: Share of train episodes flown with random wrenches held for 2 s, as a planner's candidates are.
        policies: Shares of the train flights, like "random 0.3 dock 0.7"; the paper's mixture by default.
        val_policies: The same of the val flights; dock alone by default.
        ports: Ports of the train flights; the five train ports by default.
        val_ports: Ports of the val flights; all eight by default.
        steps_per_action: Simulation steps (0.05 s) an action is held for; frames are recorded once an action.
        pixels: Record frames of so many rows and columns too.
        channels: Of the frames: rgb (a video, the default), gray, depth, part or port (columns).
        every: Decisions from one frame to the next, each held between; 1 by default.
        view: Camera of the frames; chaser_fpv by default.
        episodes_per_batch: Most episodes to fly at a time; 64 by default.
        config: TOML file of the environment's configuration; what is said of the environment here wins over it.
        shard: Record only a share of the episodes, like 2/4 for the second of four; "merge" joins them.
    """
    from owm_envs.config import FIDELITIES, load_config
    from owm_envs.datasets.generate import Shard
    from owm_envs.datasets.generate import generate as record
    from owm_envs.datasets.recipe import Request, load_recipe
    from owm_envs.words import unknown

    if env is not None and env not in FIDELITIES:
        raise ValueError(unknown("env", env, FIDELITIES))
    asked, environment = ({}, {}) if recipe is None else load_recipe(recipe)
    if recipe is not None and config is not None:
        raise ValueError("recipe and config both describe the environment: give one of them")
    given = {"fidelity": env, "noise": noise, "steps_per_action": steps_per_action}
    if config is None and recipe is None and noise is None:
        given["noise"] = "cooperative"
    shown = {"height": pixels, "width": pixels, "channels": channels, "every": every, "view": view}
    if frames := {name: value for name, value in shown.items() if value is not None}:
        given |= {"observation": "state+pixels", "camera": frames}
    if recipe is not None and env is not None:
        environment.pop("fidelity", None)
    settings = load_config(config or environment, **{name: value for name, value in given.items() if value is not None})
    flags = {
        "transitions": transitions,
        "val_transitions": val_transitions,
        "episodes": episodes,
        "val_episodes": val_episodes,
        "seed": seed,
        "planner_style": planner_style,
        "policies": policies or None,
        "val_policies": val_policies or None,
        "ports": ports or None,
        "val_ports": val_ports or None,
        "episodes_per_batch": episodes_per_batch,
    }
    asked |= {name: value for name, value in flags.items() if value is not None}
    for prefix in ("", "val_"):  # episodes come in place of transitions
        if flags[f"{prefix}episodes"] is not None and flags[f"{prefix}transitions"] is None:
            asked[f"{prefix}transitions"] = None
    if recipe is None and "val_transitions" not in asked:
        asked["val_transitions"] = None if val_episodes else max(1, (asked.get("transitions") or 20_000) // 10)
    request = Request(**asked)
    part = None if shard is None else Shard.parse(shard)
    resumable()
    with _recording() as told:
        summary = record(out, settings, request, shard=part, **told)
    _print_splits(out, summary)


def merge(shards: Annotated[tuple[Path, ...], tyro.conf.Positional], out: Path) -> None:
    """Make one dataset of the shares that "generate --shard" recorded, the same to the byte as a single run.

    Args:
        shards: Folders of all shares, in any order.
        out: Folder to make.
    """
    from owm_envs.datasets.merge import merge as joined

    resumable()
    with _recording() as told:
        summary = joined(shards, out, **told)
    _print_splits(out, summary)


@contextmanager
def _recording() -> Iterator[dict[str, Any]]:
    """What tells of a recording in the terminal: rate, bytes and the time that is left."""
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    console = terminal(stderr=True)
    bars: dict[str, int] = {}
    columns = [
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} transitions, {task.fields[told]}"),
        TimeElapsedColumn(),
        TextColumn("left:"),
        TimeRemainingColumn(),
    ]
    with Progress(*columns, console=console) as bar:

        def show(progress: Any) -> None:
            if progress.split not in bars:
                bars[progress.split] = bar.add_task(progress.split, total=max(progress.target, 1), told="")
            number = bars[progress.split]
            bar.update(number, completed=progress.done, told=f"{progress.bytes / 1e6:,.0f} MB")
            if speed := bar.tasks[number].speed:
                bar.update(number, told=f"{speed:,.0f}/s, {progress.bytes / 1e6:,.0f} MB")

        yield {"announce": lambda text: console.print(f"{text} ..."), "progress": show}


def _print_splits(out: Path, summary: dict[str, Any]) -> None:
    for split, counts in summary.items():
        told = f", {counts['transitions']:,} transitions" if "transitions" in counts else " of this share"
        print(f"{out / split}: {counts['episodes']} episodes{told}")
