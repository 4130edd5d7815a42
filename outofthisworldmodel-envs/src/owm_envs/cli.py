"""The `owm-envs` command. Heavy imports wait inside the commands, so that `--help` is quick."""

import sys
from pathlib import Path
from typing import Annotated

import tyro


def generate(
    out: Path,
    env: str | None = None,
    noise: str | None = None,
    transitions: int = 20_000,
    val_transitions: int | None = None,
    seed: int = 0,
    planner_style: float = 0.0,
    steps_per_action: int | None = None,
    episodes_per_batch: int = 64,
    config: Path | None = None,
) -> None:
    """Record a dataset: OUT/train and OUT/val, LeRobot v3.

    Whole episodes are recorded until each split has its transitions. A killed run is resumed by the same command.

    Args:
        out: Folder to make.
        env: iss, iss-hcw or iss-numerical (the default).
        noise: Sensor noise: none, cooperative (the default) or noncooperative.
        transitions: Least number of transitions of the train split.
        val_transitions: The same of the val split, which flies to each port at least once; a tenth of train by default.
        seed: Decides everything random.
        planner_style: Share of train episodes flown with random wrenches held for 2 s, as a planner's candidates are.
        steps_per_action: Simulation steps (0.05 s) an action is held for; frames are recorded once an action.
        episodes_per_batch: Most episodes to fly, and write to one file, at a time.
        config: TOML file of the environment's configuration; env, noise and steps_per_action win over it if given.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from owm_envs.config import FIDELITIES, load_config, unknown
    from owm_envs.datasets.generate import Request
    from owm_envs.datasets.generate import generate as record

    if env is not None and env not in FIDELITIES:
        raise ValueError(unknown("env", env, FIDELITIES))
    given = {"fidelity": env, "noise": noise, "steps_per_action": steps_per_action}
    if config is None and noise is None:
        given["noise"] = "cooperative"
    settings = load_config(config, **{name: value for name, value in given.items() if value is not None})
    val_transitions = max(1, transitions // 10) if val_transitions is None else val_transitions
    request = Request(transitions, val_transitions, seed, planner_style, episodes_per_batch)
    console = Console(stderr=True)
    bars: dict[str, int] = {}
    columns = [
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} transitions"),
        TimeElapsedColumn(),
    ]
    with Progress(*columns, console=console) as bar:

        def show(progress):
            if progress.split not in bars:
                bars[progress.split] = bar.add_task(progress.split, total=progress.target)
            bar.update(bars[progress.split], completed=progress.done)

        summary = record(out, settings, request, announce=lambda text: console.print(f"{text} ..."), progress=show)
    for split, counts in summary.items():
        print(f"{out / split}: {counts['episodes']} episodes, {counts['transitions']:,} transitions")


def show(config: Annotated[Path | None, tyro.conf.Positional] = None, preset: str = "data") -> None:
    """Print a complete configuration as TOML, each number with its unit and bounds.

    Args:
        config: TOML file to complete; the preset alone if absent.
        preset: data or rl.
    """
    from owm_envs.config import load_config

    print(load_config(config, preset=preset).to_toml(notes=True), end="")


def schema() -> None:
    """Print the JSON schema of configuration files, for editors."""
    import json

    from owm_envs.config_text import json_schema

    print(json.dumps(json_schema(), indent=1))


def validate(config: Annotated[Path, tyro.conf.Positional]) -> None:
    """Check a configuration file and print what it changes; a mistake is named, with bounds or the nearest known key.

    Args:
        config: TOML file.
    """
    from owm_envs.config import DockingConfig, load_config
    from owm_envs.config_text import changes

    try:
        settings = load_config(config)
    except ValueError as error:
        raise ValueError(f"{config}: {error}") from None
    print(f"{config}: valid, a configuration of {settings.fidelity}")
    for line in changes(settings, DockingConfig(fidelity=settings.fidelity)):
        print(f"  {line}")


def ports() -> None:
    """Print the docking ports and the poses to hold at them."""
    from rich.console import Console
    from rich.table import Table

    from owm_envs.station.ports import PORTS, goal_poses

    table = Table(title="Docking ports (station frame: x port side, y aft, z zenith; m; attitude scalar first)")
    for heading in ("", "port", "mechanism", "split", "hold position", "hold attitude"):
        table.add_column(heading, no_wrap=True)
    for index, (port, pose) in enumerate(zip(PORTS, goal_poses())):
        position = " ".join(f"{x:8.3f}" for x in pose[:3])
        attitude = " ".join(f"{x:7.4f}" for x in pose[3:])
        table.add_row(str(index), port.name, port.mechanism, port.split.replace("_", " "), position, attitude)
    Console(width=110).print(table)


def main(arguments: list[str] | None = None) -> None:
    """Run the command; a user's mistake ends with exit code 2 and one line that says what it is."""
    config = tyro.extras.SubcommandApp()
    config.command(show)
    config.command(validate)
    config.command(schema)
    app = tyro.extras.SubcommandApp()
    app.command(generate)
    app.command(config, name="config", help="Print or check a configuration.")
    app.command(ports)
    try:
        app.cli(prog="owm-envs", description="Spacecraft docking environments.", args=arguments)
    except KeyboardInterrupt:
        print("interrupted; a dataset is resumed by the same command", file=sys.stderr)
        raise SystemExit(130) from None
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
