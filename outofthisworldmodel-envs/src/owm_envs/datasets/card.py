"""The card that explains a dataset to whoever finds it."""

from collections.abc import Mapping
from typing import Any

from owm_envs.config import DockingConfig
from owm_envs.datasets.schema import FEATURES, features_of
from owm_envs.episode import POLICY_NAMES

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


def dataset_card(config: DockingConfig, request: Any, summary: dict, parts: Mapping[str, Any]) -> str:
    """Markdown with the header the Hugging Face hub reads."""
    lines = [
        "---",
        "license: mit",
        "task_categories: [robotics]",
        "tags: [LeRobot, spacecraft, docking]",
        "configs:",
        "- config_name: default",
        "  data_files:",
        "  - {split: train, path: train/data/*/*.parquet}",
        "  - {split: validation, path: val/data/*/*.parquet}",
        "---",
        "",
        "# Docking at the International Space Station",
        "",
        f"Simulated by `owm-envs generate` in `{config.fidelity}`, one frame every {config.decision_dt:g} s. "
        "`train/` and `val/` are LeRobot v3.0 datasets of their own. Station frame: +x port side, +y aft, +z zenith; "
        "quaternions are scalar first.",
        "",
        "| split | episodes | transitions | policies | outcomes |",
        "|---|---|---|---|---|",
    ]
    for split, counts in summary.items():
        told = [", ".join(f"{name} {n}" for name, n in counts[what].items()) for what in ("policies", "outcomes")]
        lines.append(f"| {split} | {counts['episodes']} | {counts['transitions']} | {told[0]} | {told[1]} |")
    lines += [
        "",
        "Val flies the straight docking policy to every port, the held-out ones included: tune on its train-port "
        "episodes only. Episodes are whole and kept in seed order.",
        "",
        "An episode of T decisions has T + 1 rows: the last holds the terminal observation with a zero action and "
        "starts no transition.",
        "",
        "| column | width | type | meaning |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| `{name}` | {'x'.join(map(str, feature.shape))} | {feature.dtype} | {_MEANING.get(name, _PART)} |"
        for name, feature in features_of(parts).items()
        if name in _MEANING or name not in FEATURES
    ]
    lines += [
        "",
        "`meta/stats.json` holds the statistics of the **train** split in both folders, so that val is normalised "
        "without having been looked at; each episode's own statistics stand in `meta/episodes`. Padding of the "
        "terminal rows is left out; quantiles are averages of the episodes' quantiles.",
        "",
        '`config.toml` is the environment as run (`gymnasium.make(..., config="config.toml")` takes it), '
        f"`generation.json` the request (seed {request.seed}).",
        "",
    ]
    return "\n".join(lines)
