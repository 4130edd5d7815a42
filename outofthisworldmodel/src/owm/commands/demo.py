"""The whole road in one command: simulate, record, train, predict, plan, fly, report."""

import json
import shutil
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import jax
import numpy as np
from rich.text import Text

from owm import __version__
from owm.commands.demo_report import Results, write_demo_report
from owm.commands.run import fly_named, predict
from owm.console import announce, bar, console
from owm.data.recordings import at_model_rate, corpus_facts, recorded, training_episodes
from owm.data.windows import Episodes
from owm.planning.config import PlannerConfig
from owm.report.tables import docking_table
from owm.report.terminal import print_table
from owm.scores.coasting import add_coasts
from owm.scores.docking import check_identical_starts, evaluation_config, trials
from owm.scores.flights import Flights, succeeded, write_results
from owm.scores.prediction import QUANTITIES, PredictionError
from owm.stages import Stages, peak_memory, source_digest
from owm.training.config import PRESETS, TrainConfig
from owm_envs.config import DockingConfig, load_config
from owm_envs.datasets.writer import recording
from owm_envs.files import slug, write_atomically
from owm_envs.station import PORT_NAMES, TRAIN_PORTS


@dataclass(frozen=True)
class Scale:
    """How much of everything."""

    transitions: int
    """Of 20 Hz, to train on."""
    planner_style: float
    """Share of train episodes flown with random wrenches held for 2 s, as a planner's candidates are."""
    episodes: int
    """Flown side by side when recording, and recorded anew to test predictions on."""
    phases: int
    """Offsets of the 4 Hz grid in the 20 Hz recording."""
    train: TrainConfig
    windows: int
    """To score predictions on, of either kind."""
    trials: int
    """Flights of each policy to each port."""
    slots: int
    """Flights side by side."""
    planner: PlannerConfig
    must_dock: bool
    """Whether a demo whose model docks less than half of the time has failed."""


_SOON = PRESETS["nano"].model_copy(update={"steps": 2000})
"""The score hardly falls after that."""
SCALES: dict[str, Scale] = {
    "full": Scale(500_000, 0.2, 64, 5, _SOON, 512, 5, 40, PlannerConfig(), True),
    "ci": Scale(60_000, 0.2, 16, 5, PRESETS["ci"], 128, 1, 8, PlannerConfig(), False),
}
POLICIES: dict[str, str] = {
    "world model": "train/model",
    "pretrained": "",
    "least-squares": "least-squares",
    "oracle-mppi": "",
    "dock": "",
    "dock-geodesic": "",
}
"""The rows of the docking table, and where in the demo's folder their model lies."""
ON_POLICY = "held-out episodes: random, orbit, dock"
MADE = (
    *("corpus", "corpus.partial", "least-squares", "train", "prediction.npz", "flights", "figures"),
    *("report.md", "report.html", "replay.html"),
)
"""What a demo leaves in its folder."""
RECORDED = "flights/world_model"
"""Dataset of the world model's flights."""
PLANNER_STYLE = "held-out episodes: random wrenches held for 2 s"


def demo(scale: str | Scale = "full", out: Path = Path("runs/demo"), seed: int = 0, *, fresh: bool = False) -> bool:
    """Run the demo, print its table and write its report.

    Args:
        scale: a key of `SCALES`, or one of your own.
        out: folder for everything.
        seed: decides everything random.
        fresh: start over, whatever run is there.

    Returns:
        Whether the demo kept its promises; they are in the report.

    Raises:
        FolderTaken: `out` holds another demo or something else.
    """
    size = SCALES[scale] if isinstance(scale, str) else scale
    name = scale if isinstance(scale, str) else "custom"
    settings = {**asdict(size), "train": size.train.model_dump(), "planner": size.planner.model_dump()}
    code = f"{__version__}, jax {jax.__version__}, {source_digest()}"
    with Stages(out, {"scale": name, "seed": seed, **settings}, code, made=MADE, fresh=fresh) as stages:
        return _run(stages, name, size, seed)


def _run(stages: Stages, name: str, size: Scale, seed: int) -> bool:
    """Do all stages, and report."""
    out, config = stages.folder, corpus_config()
    announce("1/5 recording the corpus", "bold")
    corpus = stages.run("corpus", ["corpus"], lambda: _record(out / "corpus", config, size, seed))
    announce("2/5 fitting and training", "bold")
    episodes = cache(lambda: _read(out, size))
    stages.run("least squares", ["least-squares"], lambda: _fit(out, episodes()[0]))
    trained = stages.run("training", ["train"], lambda: _train(out, *episodes(), size, seed))
    episodes.cache_clear()
    announce("3/5 predicting", "bold")
    stages.run("prediction", ["prediction.npz"], lambda: _predict(out, config, size, seed))
    announce("4/5 flying", "bold")
    flights = _fly(stages, out, size, seed)
    if len(stages.resumed) == len(stages.seconds):
        announce(f"an earlier run has done all of it in {out}; --fresh starts over")
    announce("5/5 reporting", "bold")

    predictions = _load_predictions(out / "prediction.npz")
    checks = check(predictions, flights["world model"])
    results = Results(
        scale=name,
        folder=out,
        seed=seed,
        size=size,
        corpus=corpus,
        training=trained,
        metrics=[json.loads(line) for line in (out / "train" / "metrics.jsonl").read_text().splitlines()],
        predictions=predictions,
        flights=list(flights.values()),
        starts=check_identical_starts(list(flights.values())),
        checks=checks,
        replay=_replay(out, flights["world model"]),
        seconds=dict(stages.seconds),
        resumed=list(stages.resumed),
        peak_memory=max(stages.peak, peak_memory() or 0.0),
    )
    write_results(flights, out / "flights")
    reports = write_demo_report(results)

    print_table(docking_table(results.flights, ["world model"]), f"Docking, {len(results.flights[0])} flights each")
    for text, kept in checks.items():
        console.print(Text.assemble(("kept", "green") if kept else ("broken", "red"), f"  {text}"))
    for path in [*reports, results.replay]:
        print(path)
    promises = list(checks.values()) if size.must_dock else list(checks.values())[:1]
    if not all(promises):
        announce("the demo did not keep its promises: see the report", "red bold")
    return all(promises)


def _replay(out: Path, flights: Flights) -> Path:
    """One flight of the world model as a page: the first that came within 1 m, if any did."""
    from owm_envs.replay import load, save_page

    number = int(np.argmax(succeeded(flights, 1.0)))
    title = f"The world model to {PORT_NAMES[flights.port[number]]}".replace("_", " ")
    return save_page(out / "replay.html", load(out / RECORDED, number=number, title=title))


def corpus_config() -> DockingConfig:
    """The environment that the corpus is recorded in: 20 Hz, collisions end an episode, train ports only."""
    return load_config(fidelity="iss-numerical", noise="cooperative", ports=TRAIN_PORTS)


def check(predictions: dict[str, list[PredictionError]], flights: Flights) -> dict[str, bool]:
    """What the demo promises, and whether it kept it."""
    beaten = True
    for errors in predictions.values():
        by_name = {each.name: each for each in errors}
        model, floor = by_name["world model"], by_name["constant velocity"]
        later = np.asarray(model.horizons) * model.dt >= 1.0
        for quantity in QUANTITIES:
            beaten &= bool(np.all(model.mean(quantity)[later] < floor.mean(quantity)[later]))
    docked = int(succeeded(flights, 1.0).sum())
    return {
        "the world model predicts position, velocity, attitude and rate better than constant velocity at every "
        "horizon from 1 s on, for held-out episodes of either kind": beaten,
        f"the world model comes within 1 m with no collision in at least half of its flights ({docked} of "
        f"{len(flights)})": 2 * docked >= len(flights),
    }


def _record(folder: Path, config: DockingConfig, size: Scale, seed: int) -> dict:
    from owm_envs.datasets.generate import Request, generate

    request = Request(size.transitions, max(1, size.transitions // 10), seed, size.planner_style, size.episodes)
    shutil.rmtree(folder, ignore_errors=True)
    with bar("recording", "transitions") as update:

        def progress(now):
            update(now.done, now.target, now.split)

        try:
            return generate(folder, config, request, announce=announce, progress=progress)
        except FileExistsError:
            # An unfinished recording of another run: of no use to this one.
            shutil.rmtree(folder.with_name(folder.name + ".partial"))
            return generate(folder, config, request, announce=announce, progress=progress)


def _read(out: Path, size: Scale) -> tuple[Episodes, Episodes]:
    announce("reading the corpus ...")
    return training_episodes(out / "corpus", size.phases)


def _fit(out: Path, episodes: Episodes) -> None:
    from owm.baselines.least_squares import fit_least_squares
    from owm.checkpoint import save_world_model

    announce("fitting least squares ...")
    save_world_model(fit_least_squares(episodes), out / "least-squares")


def _train(out: Path, episodes: Episodes, val: Episodes, size: Scale, seed: int) -> dict:
    from owm.training.loop import train

    config = size.train.model_copy(update={"seed": seed})
    about = {"corpus": [corpus_facts(out / "corpus")]}
    result = train(config, episodes, val, out / "train", console=console, name="world model", about=about)
    parameters = sum(leaf.size for leaf in jax.tree.leaves(result.model.params.network))
    facts = {"score": float(result.score), "best_step": int(result.step), "parameters": int(parameters)}
    return facts | {"steps": episodes.steps, "episodes": len(episodes), "val_episodes": len(val)}


def _predict(out: Path, config: DockingConfig, size: Scale, seed: int) -> None:
    from owm.baselines.constant_velocity import ConstantVelocity
    from owm.baselines.exact import ExactDynamics
    from owm.catalogue.checkpoint import load_world_model
    from owm_envs.env import DockingEnv
    from owm_envs.policies import make_policy
    from owm_envs.rollout import episodes, rollout
    from owm_envs.station import port_index

    announce("flying new episodes to predict ...")
    env = DockingEnv(config)
    names = ["random", "orbit", "dock", "excite"]
    # As the recorder's keys, but of a third kind beside train and val: no episode is one of theirs.
    base = jax.random.fold_in(jax.random.key(np.uint32(seed)), 2)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(base, np.arange(size.episodes, dtype=np.uint32))
    ports = np.array([port_index(TRAIN_PORTS[i // len(names) % len(TRAIN_PORTS)]) for i in range(size.episodes)])
    which = np.arange(size.episodes) % len(names)
    with bar("flying", "steps") as update:
        update(0, 0, "compiling")
        chunks = rollout(
            env,
            [make_policy(name, env) for name in names],
            keys,
            ports,
            which=which,
            progress=lambda done, running: update(done, config.horizon_decisions, f"{running} flying"),
        )
        flown = list(episodes(chunks))
    groups = {
        ON_POLICY: at_model_rate([recorded(e) for e in flown if e.policy_name != "excite"]),
        PLANNER_STYLE: at_model_rate([recorded(e) for e in flown if e.policy_name == "excite"]),
    }
    models = [
        load_world_model(out / "train" / "model"),
        load_world_model(out / "least-squares"),
        ExactDynamics(config.fidelity, config),
        ConstantVelocity(),
    ]
    stored = {}
    for number, (group, grouped) in enumerate(groups.items()):
        with bar(f"predicting {group}", "models") as update:
            errors = predict(models, grouped, size.windows, seed, update)
        for each in errors:
            stored[f"{number}|{group}|{each.name}"] = each.error
        stored["horizons"], stored["dt"] = np.asarray(errors[0].horizons), np.asarray(errors[0].dt)
    write_atomically(out / "prediction.npz", lambda file: np.savez_compressed(file, **stored))


def _load_predictions(path: Path) -> dict[str, list[PredictionError]]:
    groups: dict[str, list[PredictionError]] = {}
    with np.load(path) as file:
        horizons, dt = tuple(file["horizons"].tolist()), float(file["dt"])
        for key in file.files:
            if "|" in key:
                _, group, name = key.split("|")
                groups.setdefault(group, []).append(PredictionError(name, horizons, dt, file[key]))
    return groups


def _fly(stages: Stages, out: Path, size: Scale, seed: int) -> dict[str, Flights]:
    from owm_envs.field import load_field

    config = evaluation_config()
    seeds, ports = trials(PORT_NAMES, size.trials, seed)

    def solve():
        load_field()

    stages.run("geodesic field", [], solve)
    flights = {}
    for name, model in POLICIES.items():
        file = f"flights/{slug(name)}.npz"
        spec = str(out / model) if model else name

        def fly(name=name, spec=spec, file=file, keep=None):
            options = {"seed": seed, "slots": size.slots, "planner": size.planner, "name": name, "keep": keep}
            flown = fly_named(spec, config, seeds, ports, **options)
            add_coasts(flown, load_field()).save(out / file)

        def record(fly=fly, name=name):
            with recording(out / RECORDED, config, name) as writer:
                fly(keep=writer.write)

        if name == "world model":
            stages.run(f"flying {name}", [file, RECORDED], record)
        else:
            stages.run(f"flying {name}", [file], fly)
        flights[name] = Flights.load(out / file)
    return flights
