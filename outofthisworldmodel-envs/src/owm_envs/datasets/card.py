"""The card that explains a dataset to whoever finds it."""

import dataclasses
import shlex
from collections.abc import Iterator, Mapping
from typing import Any

from owm_envs.config import NOISE_PRESETS, DockingConfig
from owm_envs.config.text import fields
from owm_envs.datasets.schema import CODEBASE_VERSION, FEATURES, OBSERVATION
from owm_envs.episode import POLICY_NAMES
from owm_envs.station.ports import PORTS
from owm_envs.words import inert

_MEANING = {
    "observation.state": "relative view as measured: position m, velocity m/s, attitude (body to station), rate rad/s",
    "observation.environment_state": "the true relative view",
    "action": "commanded body force N and torque N m, after clipping",
    "next.reward": "reward of the action",
    "next.done": "the action ended the episode (also set on the terminal row)",
    "next.success": "the action docked",
    "port": "index of the assigned port",
    "goal_pose": "pose to hold at the port: position m, attitude",
    "policy": "who flew: " + ", ".join(f"{i} {name}" for i, name in enumerate(POLICY_NAMES)),
    "epoch": "UTC: whole modified Julian day, seconds of day",
    "outcome": "what the episode came to: 1 docked, 2 collided, 3 escaped, 4 timeout, 5 invalid action, 6 diverged",
}
_PART = "a further sensor's part of the observation; with `_valid`, whether it was measured at this very instant"


_SPLITS = {"train": "train", "val": "validation"}
"""What the hub calls the splits."""
_SIZES = ("n<1K", "1K<n<10K", "10K<n<100K", "100K<n<1M", "1M<n<10M", "10M<n<100M", "100M<n<1B", "n>1B")
"""The hub's names for numbers of rows, each for ten times as many as the one before."""


def dataset_card(
    config: DockingConfig,
    request: Any,
    summary: Mapping[str, Any],
    parts: Mapping[str, Any],
    *,
    name: str | None = None,
    split: str | None = None,
    picture: str | None = None,
    sensors: Any = None,
    versions: Mapping[str, str] | None = None,
) -> str:
    """Markdown with the header the Hugging Face hub reads.

    Args:
        config: the environment as run.
        request: what was asked for, a dataclass or its fields by their names.
        summary: counts of each split, as in `generation.json`.
        parts: what is observed beside the state, each of a `shape` and `dtype`.
        name: of the repository that the card is for, if it is for one.
        split: the one that this repository holds; both, in folders, if None.
        picture: path of a picture of the flights.
        sensors: that were carried, if any, as `generation.json` tells.
        versions: of what recorded the dataset.
    """
    asked = dataclasses.asdict(request) if dataclasses.is_dataclass(request) else dict(request)
    folders = {each: f"{each}/" for each in summary} if split is None else {split: ""}
    lines = [
        *_header(summary, folders),
        "",
        "# Docking at the International Space Station",
        "",
        f"Simulated by `owm-envs generate` in `{config.fidelity}`, one frame every {config.decision_dt:g} s. "
        + _layout(name, split)
        + " Station frame: +x port side, +y aft, +z zenith; quaternions are scalar first.",
        "",
    ]
    if picture:
        lines += [f"![The station's boxes and the paths of some flights, each in its port's colour]({picture})", ""]
    lines += [
        "| split | episodes | transitions | policies | outcomes |",
        "|---|---|---|---|---|",
    ]
    for each, counts in summary.items():
        told = [", ".join(f"{name} {n}" for name, n in counts[what].items()) for what in ("policies", "outcomes")]
        lines.append(inert(f"| {each} | {counts['episodes']} | {counts['transitions']} | {told[0]} | {told[1]} |"))
    lines += [
        "",
        "Val flies the straight docking policy to every port, the held-out ones included: tune on its train-port "
        "episodes only. Episodes are whole and kept in seed order.",
        "",
        *_ports(config, summary),
        "",
        *_noise(config),
        "",
        "An episode of T decisions has T + 1 rows: the last holds the terminal observation with a zero action and "
        "starts no transition.",
        "",
        "| column | width | type | meaning |",
        "|---|---|---|---|",
    ]
    columns = {name: feature for name, feature in FEATURES.items() if name in _MEANING}
    columns |= {OBSERVATION + part: feature for part, feature in parts.items() if OBSERVATION + part not in FEATURES}
    for column, feature in columns.items():
        size, kind = "x".join(map(str, feature.shape)), getattr(feature.dtype, "name", feature.dtype)
        lines.append(f"| `{column}` | {size} | {kind} | {_MEANING.get(column, _PART)} |")
    lines += [
        "",
        "`meta/stats.json` holds the statistics of the **train** split in both splits, so that val is normalised "
        "without having been looked at; each episode's own statistics stand in `meta/episodes`. Padding of the "
        "terminal rows is left out. Quantiles are exact, but for columns of more than 64 numbers.",
        "",
        '`config.toml` is the environment as run (`gymnasium.make(..., config="config.toml")` takes it), '
        f"`generation.json` the request (seed {asked['seed']}).",
        "",
        "The same episodes again, on a machine of the same kind:",
        "",
        "```",
        reproduce(asked),
        "```",
        "",
    ]
    if sensors:
        lines += [f"With the further sensors `{inert(', '.join(sensors))}`, which only `generate` in Python takes.", ""]
    known = {"LeRobot format": CODEBASE_VERSION, **(versions or {})}
    lines += [inert("Versions: " + ", ".join(f"{what} {version}" for what, version in known.items()) + "."), ""]
    lines += ["Licence: MIT, the data and the program that made them.", ""]
    return "\n".join(lines)


def reproduce(asked: Mapping[str, Any]) -> str:
    """The command that records the same dataset, its configuration in `config.toml`."""
    words = ["owm-envs", "generate", "--config", "config.toml"]
    for name, value in asked.items():
        flag = "--" + name.replace("_", "-")
        if isinstance(value, bool):
            words += [flag] if value else []
        elif value is not None:
            several = [word for pair in value.items() for word in pair] if isinstance(value, Mapping) else value
            words += [flag, *map(str, several if isinstance(several, list | tuple) else [several])]
    return shlex.join([*words, "--out", "dataset"])


def _header(summary: Mapping[str, Any], folders: Mapping[str, str]) -> Iterator[str]:
    """The YAML that the hub reads."""
    rows = sum(summary[split]["transitions"] + summary[split]["episodes"] for split in folders)
    yield from ("---", "license: mit", "pretty_name: Docking at the International Space Station")
    yield from ("task_categories: [robotics]", "tags: [LeRobot, spacecraft, docking]")
    yield f"size_categories: ['{_SIZES[min(max(len(str(rows)) - 3, 0), len(_SIZES) - 1)]}']"
    yield from ("configs:", "- config_name: default", "  data_files:")
    for split, folder in folders.items():
        yield f"  - {{split: {_SPLITS.get(split, split)}, path: {folder}data/*/*.parquet}}"
    yield "---"


def _layout(name: str | None, split: str | None) -> str:
    if split is None:
        told = "`train/` and `val/` are LeRobot v3.0 datasets of their own."
        return told + (f" `owm train --data {name}` takes both." if name else "")
    other = {"train": "val", "val": "train"}.get(split, "train")
    base = (name or "").removesuffix(f"-{split}")
    return (
        f"This is the {split} split, a LeRobot v3.0 dataset: `LeRobotDataset({name!r})`. "
        f"The {other} split is `{base}-{other}`; `owm train --data {base}` takes both."
    )


def _ports(config: DockingConfig, summary: Mapping[str, Any]) -> Iterator[str]:
    """How many flights of each split went to which port, and whether training may see it."""
    yield "| port |" + "".join(f" flights of {split} |" for split in summary) + " is for |"
    yield "|---|" + "---|" * (len(summary) + 1)
    for port in PORTS:
        if port.name in config.ports:
            flown = "".join(f" {counts.get('ports', {}).get(port.name, 0)} |" for counts in summary.values())
            yield f"| {port.name} |{flown} {'training' if port.split == 'train' else port.split.replace('_', ' ')} |"


def _noise(config: DockingConfig) -> Iterator[str]:
    """What is added to measurements: the preset's name, and its numbers."""
    preset = next((name for name, noise in NOISE_PRESETS.items() if noise == config.noise), "of its own")
    yield f"Sensor noise: {preset}. Root mean squares of the whole vector's error:"
    yield ""
    yield from ("| measurement | error |", "|---|---|")
    numbers = {("noise", name): value for name, value in config.noise if name != "bias"}
    bias = {("noise", "bias", name): value for name, value in config.noise.bias}
    drifts = any(value for path, value in bias.items() if path[-1] != "correlation_time")
    for path, value in (numbers | (bias if drifts else {})).items():
        unit = fields(DockingConfig)[path]["unit"]
        label = " ".join(path[1:]).replace("_per_range", ", share of the distance").replace("_", " ")
        yield f"| {label} | {value:g}{'' if unit == '1' else ' ' + unit} |"
    spoiled = config.navigation
    if spoiled.heavy_tailed:
        yield from (
            "",
            f"Of measurements {100 * spoiled.outlier_share:g} % err {spoiled.outlier_scale:g} times as much.",
        )
    if spoiled.quiet:
        yield ""
        yield (
            f"For {100 * spoiled.outage_share:g} % of the time there are none, for {spoiled.outage_duration:g} s each: "
            "`observation.state` then holds the last, and `observation.state_valid` is false."
        )
