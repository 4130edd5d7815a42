"""What a run of `owm train` shows so far: its curve as CSV, its circumstances as JSON, and a picture.

python benchmarks/learning_curve.py runs/paper --data corpus/paper --out docs/results/paper

Constant velocity and least squares are scored on the windows that the run is validated on, by the same function. The
clock is that of the run's TensorBoard events; it begins with the first validation, before the first step.
"""

import argparse
import csv
import json
from pathlib import Path

from tensorboardX.proto.event_pb2 import Event

from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.least_squares import fit_least_squares
from owm.data.recordings import training_episodes
from owm.report.learning import ERRORS, LOSSES, learning_figure
from owm.training.config import TrainConfig
from owm.training.validation import validate, validation_sets
from owm_envs.figures import save_figure

COLUMNS = ("step", "windows", "epochs", "seconds", *LOSSES, "gradient_norm", *ERRORS)


def clock(folder: Path) -> dict[int, float]:
    """Seconds at which each step was written, from the first."""
    written: dict[int, float] = {}
    for file in sorted(folder.iterdir()):
        data = file.read_bytes()
        while data:  # a record: length, its checksum, an event, its checksum
            length = int.from_bytes(data[:8], "little")
            event = Event.FromString(data[12 : 12 + length])
            if event.summary.value:
                written.setdefault(event.step, event.wall_time)
            data = data[16 + length :]
    start = min(written.values())
    return {step: at - start for step, at in written.items()}


def told(line: dict[str, float]) -> dict[str, float]:
    """A line of metrics, or what `validate` says, with the errors of behaviour flights under their own names."""
    return {key.removeprefix("behaviour/"): value for key, value in line.items() if key != "behaviour/score"}


def main() -> None:
    """Read a run, score what needs no training, write three files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--data", type=Path, nargs="+", required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    claim = json.loads((options.run / "run.json").read_text(encoding="utf-8"))
    config = TrainConfig.model_validate(claim["config"])
    train, val = training_episodes(options.data)
    windows = len(train.starts(config.model.history_length + max(depth for _, depth in config.rollouts)))
    at = clock(options.run / "tensorboard")
    lines = []
    for text in (options.run / "metrics.jsonl").read_text(encoding="utf-8").splitlines():
        line = told(json.loads(text))
        if line["step"] not in at:  # a run that was stopped has not told TensorBoard of its last steps
            continue
        seen = line["step"] * claim["settled"]["batch"]
        lines.append(line | {"windows": seen, "epochs": seen / windows, "seconds": at[line["step"]]})
    sets = {"behaviour": validation_sets(config, val)["behaviour"]}
    models = ConstantVelocity(config.model.history_length), fit_least_squares(train)
    bars = {}
    for model in models:
        found = told(validate(model, model.params, sets))
        bars[model.name] = {name: found[name] for name in ERRORS}
    options.out.mkdir(parents=True, exist_ok=True)
    with (options.out / "curve.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.DictWriter(file, COLUMNS, extrasaction="ignore", restval="", lineterminator="\n")
        rows.writeheader()
        rows.writerows(lines)
    said = {"config": claim["config"], "settled": claim["settled"], "windows_an_epoch": windows, "not_trained": bars}
    (options.out / "curve.json").write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")
    save_figure(learning_figure(lines, bars), options.out / "curve.png")
    print(json.dumps({"last": lines[-1], "not trained": bars}, indent=1))


if __name__ == "__main__":
    main()
