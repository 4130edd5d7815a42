"""What the commands `owm train`, `owm fly` and `owm evaluate` do."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax

from owm.console import announce, console, flying, print_table
from owm.evaluation.docking import check_identical_starts, evaluation_config, fly_episodes, trials
from owm.evaluation.flights import Flights, write_results
from owm.evaluation.plots import prediction_figure, save_figure, tolerance_figure, trajectory_figure
from owm.evaluation.prediction import PredictionError, prediction_error
from owm.evaluation.report import Table
from owm.evaluation.tables import docking_table, port_table, prediction_table
from owm.files import write_atomically
from owm.planning.config import PlannerConfig
from owm.policies import kind_of, load_model, load_policy
from owm.ppo.config import PPOConfig
from owm.recordings import at_model_rate, corpus_facts, read_recordings, training_episodes
from owm.training.config import TrainConfig
from owm_envs.config import DockingConfig
from owm_envs.station import PORT_NAMES


def train(data: Sequence[Path], out: Path, config: TrainConfig) -> None:
    """Train a world model on one or several datasets; `training_episodes` says what chooses the weights.

    Raises:
        FileNotFoundError, ValueError: the dataset is missing or damaged, or `out` holds another run.
    """
    from owm.training.loop import train as run

    announce(f"reading {', '.join(str(path) for path in data)} ...")
    episodes, val = training_episodes(data)
    announce(f"{len(episodes)} episodes, {episodes.steps:,} steps of {episodes.dt} s to train on")
    about = {"corpus": [corpus_facts(path) for path in data]}
    result = run(config, episodes, val, out, console=console, about=about)
    print(f"{result.model_dir}: validation score {result.score:.4f} at step {result.step}")


def train_ppo(out: Path, config: PPOConfig) -> None:
    """Train the PPO baseline.

    Raises:
        ValueError: Stable-Baselines3 is missing, or `out` holds another run.
    """
    try:
        import stable_baselines3  # noqa: F401
    except ImportError as error:
        raise ValueError(f"train-ppo needs ({error}): pip install 'outofthisworldmodel[ppo]'") from error
    from owm.ppo.train import train_ppo as run

    announce("compiling the simulator ...")
    last = run(config, out, console)
    print(f"{out / 'policy'}: validation return {last['validation/return']:.1f} after {last['step']:,} decisions")


def presets() -> None:
    """Print the training presets: their model, its trained parameters by part, and how they train."""
    from owm.model.world_model import parameter_counts
    from owm.training.config import PRESETS

    rows = []
    for name, config in PRESETS.items():
        model, counts = config.model, parameter_counts(config.model)
        size = f"{model.width} x {model.blocks}, {model.heads} heads, window {model.window}"
        parts = ", ".join(f"{part.replace('_', ' ')} {count:,}" for part, count in counts.items())
        rows.append([name, model.stream, size, f"{sum(counts.values()):,}", parts])
    print_table(Table(["preset", "stream", "width x blocks", "parameters", "of which"], rows), "training presets")


def fly(
    policy: str,
    port: str,
    *,
    flights: int = 1,
    seed: int = 0,
    shell: str = "100-225",
    noise: str = "cooperative",
    fidelity: str = "iss-numerical",
    out: Path = Path("runs/fly"),
    plot: bool = False,
) -> Flights:
    """Fly a policy to one port, print a table, and write CSV, JSON and, if asked, a picture.

    Args:
        policy: as `load_policy` takes it.
        port: name of the docking port.
        flights: how many, each from a start of its own.
        seed: decides the starts.
        shell: a key of `SHELLS`.
        noise: a preset of sensor noise.
        fidelity: of the simulation.
        out: folder for the files.
        plot: draw the trajectories.

    Raises:
        ValueError, FileNotFoundError: an unknown policy, port, shell, noise preset or fidelity.
    """
    kind_of(policy)
    config = evaluation_config(shell, noise=noise, fidelity=fidelity)
    seeds, ports = trials([port], flights, seed)
    flown = fly_named(policy, config, seeds, ports, seed=seed)
    files = write_results({flown.policy: flown}, out)
    if plot:
        picture = Path(out) / f"{slug(policy)}_{port}.png"
        save_figure(trajectory_figure(flown), picture)
        files.append(picture)
    print_table(flight_table(flown), f"{flown.policy} to {port}")
    for file in files:
        print(file)
    return flown


def fly_named(
    policy: str,
    config: DockingConfig,
    seeds,
    ports,
    *,
    seed: int = 0,
    slots: int | None = None,
    planner: PlannerConfig | None = None,
    name: str | None = None,
) -> Flights:
    """Load a policy and fly it behind a progress bar.

    Args:
        policy: as `load_policy` takes it.
        config: the environment.
        seeds, ports: as `fly_episodes` takes them.
        seed: of the policy's own draws.
        slots: most flights side by side.
        planner: of planned policies.
        name: what to call it.
    """
    slots = min(slots or len(seeds), len(seeds))
    announce("compiling the simulator and the policy, once: later runs find them in the cache ...")
    flown_by = load_policy(policy, config, slots, seed, planner)
    name = name or flown_by.name
    with flying(name, len(seeds), slots) as progress:
        return fly_episodes(flown_by, config, seeds, ports, progress, slots=slots, name=name)


def evaluate_docking(
    policies: Sequence[str],
    *,
    flights: int = 50,
    ports: Sequence[str] = (),
    seed: int = 0,
    shell: str = "100-225",
    noise: str = "cooperative",
    slots: int = 40,
    out: Path = Path("runs/evaluate"),
) -> list[Flights]:
    """Score policies on identical starts; print tables, write CSV, JSON and pictures.

    Args:
        policies: each as `load_policy` takes it.
        flights: to each port.
        ports: names; all when empty.
        seed, shell, noise: as for `fly`.
        slots: most flights side by side.
        out: folder for the files.

    Raises:
        ValueError, FileNotFoundError: an unknown policy, port, shell or noise preset.
    """
    if not policies:
        raise ValueError("name at least one policy")
    for policy in policies:
        kind_of(policy)
    config = evaluation_config(shell, noise=noise)
    seeds, index = trials(ports or PORT_NAMES, flights, seed)
    if slots < 1:
        raise ValueError(f"slots must be at least 1, got {slots}")
    flown = [fly_named(policy, config, seeds, index, seed=seed, slots=slots) for policy in policies]
    if len({each.policy for each in flown}) < len(flown):
        flown = [replace(each, policy=policy) for policy, each in zip(policies, flown)]
    starts = check_identical_starts(flown)
    files = write_results({each.policy: each for each in flown}, out)
    for policy, each in zip(policies, flown):
        files.append(Path(out) / f"trajectories_{slug(policy)}.png")
        save_figure(trajectory_figure(each), files[-1])
    files.append(Path(out) / "tolerance.png")
    save_figure(tolerance_figure(flown), files[-1])
    print_table(docking_table(flown), f"{len(seeds)} flights each from the same starts (digest {starts}), {shell} m")
    print_table(port_table(flown))
    for file in files:
        print(file)
    return flown


def evaluate_prediction(
    models: Sequence[str],
    data: Path,
    *,
    split: str = "val",
    windows: int = 512,
    seed: int = 0,
    out: Path = Path("runs/evaluate"),
) -> list[PredictionError]:
    """Score open-loop predictions on a recorded dataset, constant velocity beside them.

    Args:
        models: checkpoints, or "oracle-mppi" for the exact dynamics.
        data: the dataset.
        split: its split.
        windows: how many to draw.
        seed: decides which.
        out: folder for table and picture.

    Raises:
        ValueError, FileNotFoundError: no such model, dataset or split, or episodes too short.
    """
    from owm.baselines.constant_velocity import ConstantVelocity

    loaded = [load_model(model, evaluation_config()) for model in models]
    if windows < 1:
        raise ValueError(f"windows must be at least 1, got {windows}")
    episodes = at_model_rate(read_recordings(data, split))
    errors = predict([*loaded, ConstantVelocity()], episodes, windows, seed)
    out = Path(out)
    rows = [row for each in errors for row in each.rows()]
    write_atomically(out / "prediction.json", lambda file: json.dump(rows, file, indent=1), text=True)
    save_figure(prediction_figure({f"{data} {split}": errors}), out / "prediction.png")
    print_table(prediction_table(errors), "mean prediction error")
    print(out / "prediction.json", out / "prediction.png", sep="\n")
    return errors


def predict(models, episodes, windows: int, seed: int = 0, progress=None) -> list[PredictionError]:
    """Score models on the same windows, each at the precision it computes in.

    Args:
        models: world models of one step and history length.
        episodes: at the model's rate.
        windows: how many to draw with `seed`.
        progress: called with (models done, models, name).
    """
    horizons = tuple(range(1, 65))
    drawn = episodes.windows(models[0].history_length + max(horizons), windows, seed=seed)
    errors = []
    for done, model in enumerate(models):
        if progress is not None:
            progress(done, len(models), model.name)
        with jax.enable_x64(getattr(model, "precision", "float32") == "float64"):
            errors.append(prediction_error(model, drawn, horizons))
    if progress is not None:
        progress(len(models), len(models), "")
    return errors


def flight_table(flights: Flights) -> Table:
    """One row per flight."""
    rows = [
        [
            str(row["seed"]),
            row["outcome"] + (", after a collision" if row["collided"] else ""),
            f"{row['closest_distance']:.2f}",
            f"{row['closest_speed']:.3f}",
            f"{row['closest_attitude_deg']:.2f}",
            f"{row['closest_rate_deg']:.3f}",
            f"{row['clearance']:.2f}",
            f"{row['time']:.0f}",
            f"{row['delta_v']:.1f}",
        ]
        for row in flights.rows()
    ]
    columns = ["seed", "outcome", "closest m", "m/s", "deg", "deg/s", "least clearance m", "time s", "Δv m/s"]
    return Table(columns, rows)


def slug(name: str) -> str:
    """A name as part of a file's name."""
    return re.sub(r"[^A-Za-z0-9-]+", "_", name).strip("_") or "policy"
