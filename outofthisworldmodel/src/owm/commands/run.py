"""What the commands `owm train`, `owm fly` and `owm evaluate` do."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Int

from owm.baselines.ppo.config import PPOConfig
from owm.catalogue.policies import content_digest, is_planned, kind_of, load_policy
from owm.console import announce, bar, console, flying
from owm.data.recordings import corpus_facts, training_episodes
from owm.data.windows import Episodes
from owm.interface import WorldModel
from owm.planning.config import PlannerConfig
from owm.planning.health import AXES
from owm.report.page import Table
from owm.report.plots import trajectory_figure
from owm.report.prediction import prediction_blocks
from owm.report.tables import docking_table, port_table
from owm.report.terminal import print_table
from owm.scores.docking import check_identical_starts, evaluation_config, fly_episodes, trials
from owm.scores.flights import Flights, write_results
from owm.scores.prediction import PredictionError, prediction_error
from owm.study.conditions import CONDITIONS, Condition
from owm.study.conditions import condition as condition_of
from owm.study.matrix import Matrix, Study, planner_of, read_matrix, twice
from owm.study.report import rows_flown, write_matrix_report
from owm.study.run import run_matrix
from owm.training.config import TrainConfig
from owm_envs.adapters.gymnasium import DockingGymEnv
from owm_envs.claims import Claim, digest
from owm_envs.config import DockingConfig, load_config
from owm_envs.datasets.fetch import local_dataset
from owm_envs.datasets.writer import recording
from owm_envs.episode import Episode
from owm_envs.figures import save_figure
from owm_envs.files import output_folder, slug
from owm_envs.station import PORT_NAMES
from owm_envs.words import install

if TYPE_CHECKING:
    from owm_envs.camera.lens import Camera

_FILM_SIZE, _FILM_FPS = 512, 20.0


def train(data: Sequence[Path], out: Path, config: TrainConfig, wandb: str | None = None) -> None:
    """Train a world model on one or several datasets; `training_episodes` says what chooses the weights.

    Raises:
        FileNotFoundError, ValueError: the dataset is missing or damaged, or `wandb` is named but not installed.
        HubError: the dataset is one of the hub's, which does not give it.
        FolderTaken: `out` holds another run or something else.
    """
    if wandb is not None and find_spec("wandb") is None:
        raise ValueError(f"--wandb needs Weights & Biases: {install('wandb')}")
    from owm.training.loop import train as run

    Claim(out, {"config": config.model_dump(mode="json")})  # refused now, not after the data have been read
    announce(f"reading {', '.join(str(path) for path in data)} ...")
    data = [local_dataset(path) for path in data]
    episodes, val = training_episodes(data)
    announce(
        f"{len(episodes)} episodes, {episodes.steps:,} steps of {episodes.dt} s to train on; "
        "a 20 Hz recording counts once for each of its five offsets, which overlap"
    )
    about = {"corpus": [corpus_facts(path) for path in data]}
    result = run(config, episodes, val, out, console=console, about=about, wandb=wandb)
    print(f"{result.model_dir}: validation score {result.score:.4f} at step {result.step}")


def train_ppo(out: Path, config: PPOConfig) -> None:
    """Train the PPO baseline.

    Raises:
        ValueError: Stable-Baselines3 is missing.
        FolderTaken: `out` holds another run or something else.
    """
    out = output_folder(out)
    try:
        import stable_baselines3  # noqa: F401
    except ImportError as error:
        raise ValueError(f"train-ppo needs ({error}): {install('sb3')}") from error
    from owm.baselines.ppo.train import train_ppo as run

    announce("compiling the simulator ...")
    best = run(config, out, console)
    print(f"{out / 'policy'}: validation return {best['validation/return']:.1f} after {best['step']:,} decisions")


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
    out: Path | None = None,
    plot: bool = False,
    video: Path | None = None,
    camera: str = "chaser_fpv",
    planner: str = "safe",
    condition: str = "nominal",
) -> Flights:
    """Fly a policy to one port, print a table, and write CSV, JSON, a recording and, if asked, a picture.

    The same again prints the flights that are there.

    Args:
        policy: as `load_policy` takes it.
        port: name of the docking port.
        flights: how many, each from a start of its own.
        seed: decides the starts.
        shell: a key of `SHELLS`.
        noise: a preset of sensor noise.
        fidelity: of the simulation.
        out: folder for the files; by default one of these flights' own below `runs/fly`.
        plot: draw the trajectories.
        video: film the first flight into this file, .mp4.
        camera: name of the film's camera.
        planner: a key of `PLANNERS`, for policies that plan with a model.
        condition: a key of `owm.study.conditions.CONDITIONS`: what is wrong in flight, of which the policy is not told.

    Raises:
        ValueError, FileNotFoundError: an unknown policy, planner, condition, port, shell, noise preset, fidelity or
            camera.
        ImportError: a film is asked for without PyAV.
        FolderTaken: `out` holds other flights or something else.
    """
    planned = is_planned(kind_of(policy))
    variant = planner_of(planner)
    if video is not None:
        from owm_envs.film import film_camera

        lens = film_camera(video, camera, _FILM_SIZE, port)
    wrong, nominal = condition_of(condition), CONDITIONS["nominal"]
    if any(getattr(wrong, part) != getattr(nominal, part) for part in ("shell", "noise", "fidelity", "map")):
        raise ValueError(
            f"condition {condition!r} is not for one flight: choose shell, noise and env by themselves, or fly it by "
            "owm evaluate matrix"
        )
    told = evaluation_config(shell, noise=noise, fidelity=fidelity)
    config = load_config(told, **wrong.hidden)
    seeds, ports = trials([port], flights, seed)
    asked = {"command": "owm fly", "policy": content_digest(policy), "port": port, "flights": flights, "seed": seed}
    asked["environment"] = config.model_dump(mode="json")
    if planned:
        asked["planner"] = variant.model_dump(mode="json")
    with Claim(out or Path("runs/fly") / f"{slug(policy)}_{port}_{digest(asked)[:8]}", asked) as claim:
        kept = claim.folder / "flights.npz"
        if claim.holds(kept.name, "episodes"):
            announce(f"{claim.folder} holds these flights already")
            flown = Flights.load(kept)
        else:
            with recording(claim.folder / "episodes", config, slug(policy)) as writer:

                def keep(flights: list[Episode]) -> None:
                    claim.note()  # before anything lies in the folder
                    writer.write(flights)

                flown = fly_named(
                    policy, told, seeds, ports, seed=seed, planner=variant, keep=keep, wrong=wrong, after=_print_health
                )
            flown.save(kept)
            claim.seal(kept.name, "episodes")
        files = write_results({flown.policy: flown}, claim.folder)
        if plot:
            picture = claim.folder / f"{slug(policy)}_{port}.png"
            save_figure(trajectory_figure(flown), picture)
            files.append(picture)
    if video is not None:
        _film(flown, config, lens, video)
        files.append(video)
    print_table(flight_table(flown), f"{flown.policy} to {port}")
    for file in files:
        print(file)
    if (claim.folder / "episodes").is_dir():
        print(f"{claim.folder / 'episodes'}: recorded; owm-envs replay {claim.folder} shows a flight in the browser")
    return flown


def _print_health(policy: Any) -> None:
    """What a policy has found of its thrusters, if it looks for that."""
    health = getattr(policy, "health", None)
    if health is None:
        return
    rows = [
        [
            str(flight + 1),
            *(f"{low:.2f}, {high:.2f} ± {2 * off:.2f}" for (low, high), off in zip(*pair, strict=True)),
            verdict,
        ]
        for flight, (*pair, verdict) in enumerate(zip(health.share, health.deviation, policy.verdict, strict=True))
    ]
    title = "share of its thrust that each axis was found to give, backwards and forwards, with 95 % intervals"
    print_table(Table(["flight", *AXES, "in the end it"], rows), title)


def _film(flown: Flights, config: DockingConfig, lens: "Camera", video: Path) -> None:
    """Film the first flight, ten times as fast as it was."""
    from owm_envs.film import frames, save_film

    views = flown.trajectory[0]
    views = views[np.isfinite(views).all(axis=1)]
    # A flight's epoch is that of its seed and port.
    _, info = DockingGymEnv(config).reset(seed=int(flown.seed[0]), options={"dock_port": int(flown.port[0])})
    epochs = info["epoch"] + np.arange(len(views))[:, None] * np.array([0.0, flown.decision_dt])
    step = max(1, round(10.0 / (_FILM_FPS * flown.decision_dt)))
    views, epochs = views[::step], epochs[::step]
    with bar("filming", "frames") as update:
        shot = enumerate(frames(views, epochs, lens, config), 1)
        save_film(video, (update(done, len(views)) or image for done, image in shot), _FILM_FPS)


def fly_named(
    policy: str,
    config: DockingConfig,
    seeds: Int[np.ndarray, "N"],
    ports: Int[np.ndarray, "N"],
    *,
    seed: int = 0,
    slots: int | None = None,
    planner: PlannerConfig | None = None,
    name: str | None = None,
    keep: Callable[[list[Episode]], None] | None = None,
    wrong: Condition = CONDITIONS["nominal"],
    after: Callable[[Any], None] | None = None,
) -> Flights:
    """Load a policy and fly it behind a progress bar.

    Args:
        policy: as `load_policy` takes it.
        config: the environment that the policy is told of.
        seeds, ports: as `fly_episodes` takes them.
        seed: of the policy's own draws.
        slots: most flights side by side.
        planner: of planned policies.
        name: what to call it.
        keep: as `fly_episodes` takes it.
        wrong: what is otherwise in flight.
        after: given the policy when it has flown.
    """
    slots = min(slots or len(seeds), len(seeds))
    announce("compiling the simulator and the policy, once: later runs find them in the cache ...")
    flown_by = load_policy(policy, config, slots, seed, planner)
    name = name or flown_by.name
    with flying(name, len(seeds), slots) as progress:
        told = {"slots": slots, "name": name, "keep": keep}
        flown = fly_episodes(flown_by, load_config(config, **wrong.hidden), seeds, ports, progress, **told)
    if after is not None:
        after(flown_by)
    return flown


def evaluate_docking(
    policies: Sequence[str],
    *,
    flights: int = 50,
    ports: Sequence[str] = (),
    seed: int = 0,
    shell: str = "100-225",
    noise: str = "cooperative",
    slots: int = 50,
    out: Path = Path("runs/evaluate"),
    fresh: bool = False,
    processes: int = 1,
    planner: str = "geodesic",
) -> list[Flights]:
    """Score policies on identical starts; print tables, write a report, CSV, JSON and pictures.

    A killed run goes on at the port where it was.

    Args:
        policies: each as `load_policy` takes it.
        flights: to each port.
        ports: names; all when empty.
        seed, shell, noise: as for `fly`.
        slots: most flights side by side.
        out: folder for the files.
        fresh: replace what `out` holds of other settings.
        processes: that fly, as for `evaluate_matrix`.
        planner: a key of `PLANNERS`, for policies that plan with a model.

    Raises:
        ValueError, FileNotFoundError: an unknown policy, port, shell or noise preset.
        FolderTaken: as `run_matrix`.
    """
    if not policies:
        raise ValueError("name at least one policy")
    if again := twice(policies):
        raise ValueError(f"name each policy once, got {again!r} twice")
    out = output_folder(out)
    short = ["/".join(Path(policy).parts[-2:]) for policy in policies]
    labels = policies if twice(slug(name).casefold() for name in short) else short
    planner_of(planner)
    study = Study(
        title="Docking", policies=tuple(labels), planners=(planner,), figures=True, trajectories=tuple(labels)
    )
    if len(policies) > 1:
        study = study.model_copy(update={"against": (labels[-1],)})
    matrix = Matrix(
        seed=seed, flights=flights, ports=ports or PORT_NAMES, policies=dict(zip(labels, policies)), studies=(study,)
    )
    conditions = {"nominal": Condition(f"{noise} noise, starts {shell} m out", shell, noise)}
    command = f"owm evaluate docking {' '.join(policies)} --flights {flights} --seed {seed} --shell {shell}"
    command += f" --noise {noise}" + ("" if planner == "geodesic" else f" --planner {planner}")
    command += f" --ports {' '.join(ports)}" if ports else ""
    files, flown = _run_and_report(
        matrix, out, command, conditions=conditions, slots=slots, fresh=fresh, processes=processes
    )
    scored = [seeds[0] for seeds in flown.values()]
    files += write_results({each.policy: each for each in scored}, out)
    starts = check_identical_starts(scored)
    title = f"{len(scored[0])} flights each from the same starts (digest {starts}), {shell} m"
    print_table(docking_table(scored), title)
    print_table(port_table(scored))
    for file in files:
        print(file)
    return scored


def evaluate_matrix(
    table: Path,
    *,
    out: Path = Path("runs/matrix"),
    slots: int = 50,
    fresh: bool = False,
    fly: bool = True,
    processes: int = 1,
    prediction: Path | None = None,
) -> None:
    """Fly a declared table of policies, planner variants and conditions, and report on it.

    Args:
        table: TOML file, as `Matrix` describes it.
        out: folder for everything; a killed run goes on at the port where it was.
        slots: most flights side by side.
        fresh: replace what `out` holds of other settings.
        fly: or only report on the rows that are complete.
        processes: that fly, on equal shares of the cores.
        prediction: folder of `owm evaluate prediction`, for the report.

    Raises:
        ValueError, FileNotFoundError: the table is missing or wrong.
        FolderTaken: as `run_matrix`.
    """
    matrix, out = read_matrix(Path(table)), output_folder(out)
    command = f"owm evaluate matrix {Path(table).name} --slots {slots} --processes {processes}"
    extra = () if prediction is None else prediction_blocks(Path(prediction), out / "figures")
    files, flown = _run_and_report(matrix, out, command, extra, slots=slots, fresh=fresh, fly=fly, processes=processes)
    for study in matrix.studies:
        if rows := rows_flown(matrix, study, flown):
            print_table(docking_table(list(rows.values())), study.title)
    for file in files:
        print(file)


def _run_and_report(matrix, out: Path, command: str, extra=(), *, conditions=CONDITIONS, **options):
    said, update = "", None
    with ExitStack() as stack:

        def report(done: int, total: int, what: str, how_far: str) -> None:
            nonlocal said, update
            if update is None:  # no bar beside a refusal
                update = stack.enter_context(bar("flying", "flights"))
            if what != said:
                said = what
                announce(f"{done}/{total} flights; {what}")
            update(done, total, how_far)

        made_by = " ".join(command.split()[:3])
        flown = run_matrix(matrix, out, conditions=conditions, report=report, command=made_by, **options)
    if not flown:
        raise ValueError(f"{out} holds no complete row to report on")
    return write_matrix_report(matrix, flown, out, conditions=conditions, commands=command, extra=extra), flown


def predict(
    models: Sequence[WorldModel],
    episodes: Episodes,
    windows: int,
    seed: int = 0,
    progress: Callable[[int, int, str], None] | None = None,
) -> list[PredictionError]:
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
