"""The `owm` command. Heavy imports wait inside the commands, so that `--help` is quick."""

import dataclasses
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from owm import __version__
from owm_envs.shell import resumable
from owm_envs.shell import run as run_command
from owm_envs.words import checked_seed, mistakes

Shell = Literal["100-225", "100-125"]


def fly(
    policy: str = "dock",
    port: str = "zvezda_aft",
    plot: bool = False,
    flights: int = 1,
    seed: int = 0,
    shell: Shell = "100-225",
    noise: str = "cooperative",
    env: str = "iss-numerical",
    out: Path | None = None,
    video: Path | None = None,
    camera: str = "chaser_fpv",
    planner: str = "safe",
    condition: str = "nominal",
) -> None:
    """Fly a policy to a docking port and print how it went.

    Args:
        policy: pretrained, dock, dock-geodesic, dock-geodesic-integral, dock-safe, random, orbit, excite, ekf-mpc,
            ekf-mpc-gated, oracle-mppi, constant-velocity, the folder of a checkpoint, online:FOLDER, zeroed:FOLDER,
            user/name on the hub, or module:Class of your own.
        port: Docking port.
        plot: Draw the trajectory into OUT.
        flights: How many, each from a start of its own.
        seed: Decides the starts.
        shell: Distance from the station at the start, m.
        noise: Sensor noise: none, cooperative or noncooperative.
        env: iss, iss-hcw or iss-numerical.
        out: Folder for CSV, JSON and picture; by default one of these flights' own below runs/fly.
        video: Film the first flight into this file, .mp4, ten times as fast as it was.
        camera: Of the film: chaser_fpv, chaser_isometric, chaser_top, station_isometric, station_top or station_fpv.
        planner: How a model is flown: safe (drifts clear of the hull, contact as the docking standard asks) or
            geodesic (faster).
        condition: What is wrong in flight, of which the policy is not told: heavy, leak, "force x dead", "thruster
            fails", "thrust turns" and more.
    """
    checked_seed(seed)
    _compilation_cache()
    from owm.commands.run import fly as run

    asked = {"shell": shell, "noise": noise, "fidelity": env, "planner": planner, "condition": condition}
    run(policy, port, flights=flights, seed=seed, **asked, out=out, plot=plot, video=video, camera=camera)


def evaluate_docking(
    policies: Annotated[tuple[str, ...], tyro.conf.Positional],
    flights: int = 50,
    ports: tuple[str, ...] = (),
    seed: int = 0,
    shell: Shell = "100-225",
    noise: str = "cooperative",
    slots: int = 50,
    out: Path = Path("runs/evaluate"),
    fresh: bool = False,
    processes: int = 1,
    planner: str = "geodesic",
) -> None:
    """Score policies by the evaluation protocol: identical starts, fourteen definitions of success.

    Args:
        policies: Names or paths, as `owm fly --policy` takes them.
        flights: How many to each port.
        ports: Docking ports; all eight by default.
        seed: Decides the starts.
        shell: Distance from the station at the start, m.
        noise: Sensor noise: none, cooperative or noncooperative.
        slots: Most flights side by side.
        out: Folder for flights, report and pictures; a killed run goes on where it was.
        fresh: Replace what OUT holds of other settings, and flights that are not asked for.
        processes: That fly, as for `owm evaluate matrix`.
        planner: How models are flown: geodesic, safe, plain or straight.
    """
    checked_seed(seed)
    _compilation_cache()
    from owm.commands.run import evaluate_docking as run

    resumable()
    scored = {"flights": flights, "ports": ports, "seed": seed, "shell": shell, "noise": noise}
    run(policies, **scored, slots=slots, out=out, fresh=fresh, processes=processes, planner=planner)


def evaluate_matrix(
    table: Annotated[Path, tyro.conf.Positional],
    out: Path = Path("runs/matrix"),
    slots: int = 50,
    fresh: bool = False,
    fly: bool = True,
    processes: int = 1,
    prediction: Path | None = None,
) -> None:
    """Fly a declared table of policies, planner variants and conditions, and report on it.

    Args:
        table: TOML file: policies, and studies of them.
        out: Folder for flights, report and pictures; a killed run goes on where it was.
        slots: Most flights side by side.
        fresh: Replace what OUT holds of other settings, and flights that are not asked for.
        fly: Or only report on what is complete.
        processes: That fly, on equal shares of the cores: on a CPU faster than one on all of them.
        prediction: Folder that `owm evaluate prediction` wrote, to be told of in the report.
    """
    _compilation_cache()
    from owm.commands.run import evaluate_matrix as run

    resumable()
    run(table, out=out, slots=slots, fresh=fresh, fly=fly, processes=processes, prediction=prediction)


def evaluate_prediction(
    models: Annotated[tuple[str, ...], tyro.conf.Positional],
    data: tuple[Path, ...],
    split: str | None = None,
    windows: int = 256,
    spread_windows: int = 48,
    samples: int = 199,
    seed: int = 0,
    out: Path = Path("runs/prediction"),
) -> None:
    """Score open-loop predictions by horizon on recorded flights, and how well their spread is calibrated.

    Constant velocity, least squares, the Kalman filter and the exact dynamics are scored beside them.

    Args:
        models: Folders of checkpoints, pretrained, user/name on the hub, or constant-velocity, least-squares,
            least-squares-action-only, ekf, exact.
        data: Datasets to predict, folders or user/name on the hub.
        split: Their split; by default the flights that training sets aside.
        windows: Windows of behaviour and of planner-style flights in each dataset.
        spread_windows: Windows to draw samples in.
        samples: Trajectories to draw in each.
        seed: Decides the windows.
        out: Folder for JSON and pictures; the same again finds them there.
    """
    checked_seed(seed)
    _compilation_cache()
    from owm.catalogue.predictors import evaluate_prediction as run

    run(
        models,
        data,
        split=split,
        windows=windows,
        spread_windows=spread_windows,
        samples=samples,
        seed=seed,
        out=out,
    )


def presets() -> None:
    """Print what `owm train --preset` knows: models, their sizes and numbers of parameters."""
    from owm.commands.run import presets as run

    run()


def push(
    checkpoint: Annotated[str, tyro.conf.Positional],
    name: Annotated[str, tyro.conf.Positional],
    private: bool = False,
    dry_run: bool = False,
) -> None:
    """Publish a checkpoint on the Hugging Face hub, with a card; log in with `hf auth login`.

    Args:
        checkpoint: Its folder, or that of the run that made it.
        name: user/name.
        private: Make a new repository private.
        dry_run: List files and sizes; send nothing.
    """
    from owm.catalogue.hub import repository
    from owm_envs.hub import push as send

    planned = repository(checkpoint, name)
    resumable()
    print(planned.listing() if dry_run else send(planned, private=private))


def download(name: Annotated[str, tyro.conf.Positional], out: Path, revision: str | None = None) -> None:
    """Copy a checkpoint of the Hugging Face hub to a folder, at one commit, every file checked.

    What takes a checkpoint's folder takes user/name as well, and keeps it in a cache.

    Args:
        name: user/name.
        out: Folder to make.
        revision: Branch, tag or commit; the main branch by default.
    """
    from owm.catalogue.hub import download as fetch

    resumable()
    print(f"{out}: {name} at {fetch(name, out, revision)}")


def demo(
    scale: Literal["full", "ci"] = "full", out: Path = Path("runs/demo"), seed: int = 0, fresh: bool = False
) -> None:
    """Simulate, record, train, predict, plan, fly and report, end to end.

    Args:
        scale: full takes up to a quarter of an hour on two cores, ci a few minutes.
        out: Folder for everything; a killed run is resumed by the same command, a finished one is kept.
        seed: Decides everything random.
        fresh: Start over, whatever run is there.
    """
    checked_seed(seed)
    _compilation_cache()
    from owm.commands.demo import demo as run

    resumable()
    if not run(scale, out, seed, fresh=fresh):
        raise SystemExit(1)


def _train(preset: str):
    """The `train` command, its flags those of a training preset."""
    from owm.training.config import PRESETS, TrainConfig

    start_from = preset if preset in PRESETS else "nano"
    flags = _flags(PRESETS[start_from])

    def train(
        data: tuple[Path, ...],
        out: Path,
        preset: Literal[*PRESETS] = start_from,
        wandb: str | None = None,
        config: tyro.conf.OmitArgPrefixes[type(flags)] = flags,
    ) -> None:
        """Train a world model; a killed run is resumed by the same command.

        Args:
            data: Dataset, as `owm-envs generate` writes it or user/name on the hub, or several to train on together.
            out: Folder for the checkpoint.
            preset: Named configuration that the other flags change.
            wandb: Project of Weights & Biases to send the metrics to as well.
            config: The run.
        """
        del preset
        checked = _checked(TrainConfig, config)
        _compilation_cache()
        _cpu_devices(checked.devices)
        from owm.commands.run import train as run

        resumable()
        run(data, out, checked, wandb)

    return train


def _train_ppo(preset: str):
    """The `train-ppo` command, its flags those of a preset."""
    from owm.baselines.ppo.config import PRESETS, PPOConfig

    start_from = preset if preset in PRESETS else "paper"
    flags = _flags(PRESETS[start_from])

    def train_ppo(
        out: Path,
        preset: Literal[*PRESETS] = start_from,
        config: tyro.conf.OmitArgPrefixes[type(flags)] = flags,
    ) -> None:
        """Train the PPO baseline in Stable-Baselines3; a killed run is resumed by the same command.

        Args:
            out: Folder for policy, state, metrics and learning curve.
            preset: Named configuration that the other flags change.
            config: The run.
        """
        del preset
        checked = _checked(PPOConfig, config)
        _compilation_cache()
        from owm.commands.run import train_ppo as run

        resumable()
        run(out, checked)

    return train_ppo


def _flags(config: Any) -> Any:
    """A configuration as a dataclass that takes anything: the parser would tell of mistakes in pydantic's words."""
    fields = []
    for name, field in type(config).model_fields.items():
        value, kind = getattr(config, name), field.annotation
        if hasattr(type(value), "model_fields"):
            value = _flags(value)
            kind = type(value)
        described = Annotated[kind, tyro.conf.arg(help=field.description)]
        fields.append((name, described, dataclasses.field(default=value)))
    return dataclasses.make_dataclass(type(config).__name__, fields, frozen=True)()


def _checked(kind: Any, flags: Any) -> Any:
    """The configuration that flags ask for.

    Raises:
        ValueError: it is none, in our words.
    """
    from pydantic import ValidationError

    try:
        return kind.model_validate(dataclasses.asdict(flags))
    except ValidationError as error:
        raise ValueError(mistakes(error, kind)) from None


def main(arguments: list[str] | None = None) -> None:
    """Run the command; see `owm_envs.shell.run`."""
    run_command("owm", "A world model of spacecraft rendezvous.", __version__, _application, arguments)


def _application(arguments: list[str]) -> tyro.extras.SubcommandApp:
    evaluate = tyro.extras.SubcommandApp()
    evaluate.command(evaluate_docking, name="docking")
    evaluate.command(evaluate_matrix, name="matrix")
    evaluate.command(evaluate_prediction, name="prediction")
    app = tyro.extras.SubcommandApp()
    app.command(fly)
    app.command(evaluate, name="evaluate", help="Score policies (docking, matrix) or predictions (prediction).")
    app.command(_train(_option(arguments, "--preset")), name="train")
    app.command(_train_ppo(_option(arguments, "--preset")), name="train-ppo")
    app.command(presets)
    app.command(push)
    app.command(download)
    app.command(demo)
    return app


def _option(arguments: list[str], name: str) -> str:
    """The value of an option, before the parser knows which options there are."""
    for i, word in enumerate(arguments):
        if word == name and i + 1 < len(arguments):
            return arguments[i + 1]
        if word.startswith(name + "="):
            return word.partition("=")[2]
    return ""


def _cpu_devices(count: int | None) -> None:
    """Let JAX take the CPU for several devices, one a core; has no effect on accelerators."""
    import jax

    if count and count > 1 and "xla_force_host_platform_device_count" not in os.environ.get("XLA_FLAGS", ""):
        jax.config.update("jax_num_cpu_devices", count)


def _compilation_cache() -> None:
    """Keep compiled programs in the user's cache directory, so that later runs start at once.

    Commands only: importing the package changes no setting of JAX's. The environment variable
    JAX_COMPILATION_CACHE_DIR, where set, wins.
    """
    # On some processors XLA refuses what it stored, recompiles, and says so at length.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    import jax
    import platformdirs

    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        folder = platformdirs.user_cache_path("outofthisworldmodel", appauthor=False) / "compiled"
        jax.config.update("jax_compilation_cache_dir", str(folder))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


if __name__ == "__main__":
    main()
