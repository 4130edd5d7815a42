"""What a run tells while it goes: JSON lines, TensorBoard events, Weights & Biases, and a view in the terminal."""

import contextlib
import json
import re
import secrets
import time
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from owm_envs.files import write_atomically

_SHOWN = 6
"""Validations that the view keeps in sight."""


class Metrics:
    """Writes one JSON object a line, and the same numbers as TensorBoard scalars and to Weights & Biases if asked.

    Args:
        out: folder of the run: `metrics.jsonl`, `tensorboard/` and `wandb/` go there.
        step: what was written after this step by a run that was killed is dropped; -1 drops everything.
        project: of Weights & Biases; None leaves it out. A resumed run goes on there under its old id.
        config: what to show there as the run's configuration.

    Raises:
        ImportError: a project is given and `wandb` is not installed.
    """

    def __init__(self, out: Path, step: int, project: str | None = None, config: dict[str, Any] | None = None):
        from tensorboardX import SummaryWriter  # here, as only training needs it

        self.file = out / "metrics.jsonl"
        _truncate(self.file, step)
        self._events = SummaryWriter(str(out / "tensorboard"), purge_step=step + 1)
        self._online = None
        if project is not None:
            import wandb

            known = out / "wandb" / "id"
            name = _known_id(known) or secrets.token_hex(4)
            write_atomically(known, lambda stream: stream.write(name), text=True)
            self._online = wandb.init(
                project=project, dir=out, id=name, name=out.name, resume="allow", config=config,
                settings=wandb.Settings(console="off", silent=True),
            )  # fmt: skip

    def __enter__(self) -> "Metrics":
        return self

    def __exit__(self, *error: object) -> None:
        self._events.close()
        if self._online is not None:
            self._online.finish(exit_code=int(error[0] is not None))

    def write(self, line: dict[str, Any]) -> None:
        """Add the numbers of one step."""
        with self.file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(line) + "\n")
        for name, value in line.items():
            if name != "step":
                self._events.add_scalar(name, value, line["step"])
        if self._online is not None:
            self._online.log(line, step=line["step"])


def _known_id(file: Path) -> str | None:
    """The id under which a run is known there already; it becomes part of a path, so that it has to be one of ours."""
    found = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
    return found if re.fullmatch(r"[0-9a-f]{8}", found) else None


def _truncate(file: Path, step: int) -> None:
    """Keep the lines of a metrics file up to a step: those that are whole."""
    if not file.exists():
        return
    kept = []
    for text in file.read_text(encoding="utf-8", errors="replace").splitlines():
        with contextlib.suppress(ValueError, KeyError, TypeError, RecursionError):  # cut short by a kill, or damaged
            if json.loads(text)["step"] <= step:
                kept.append(text)
    write_atomically(file, lambda stream: stream.writelines(text + "\n" for text in kept), text=True)


class View:
    """A live view: progress, speed and time left, losses, and the latest validations.

    Args:
        console: where to; a quiet one silences it.
        steps: of the whole run.
        step: done before.
    """

    def __init__(self, console: Console, steps: int, step: int):
        self._progress = Progress(
            TextColumn("train"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[speed]}"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
        )
        self._bar = self._progress.add_task("", total=steps, completed=step, speed="", note="compiling")
        self._rows: list[dict[str, float]] = []
        self._live = Live(self._picture(), console=console, refresh_per_second=4)
        self._last = (step, time.perf_counter())

    def __enter__(self) -> "View":
        self._live.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self._live.__exit__(*error)
        if not self._live.console.is_interactive:
            self._live.console.print()  # ends the line, as `Progress` does

    def update(self, line: dict[str, Any]) -> None:
        """Show the numbers of a step."""
        (step, then), now = self._last, time.perf_counter()
        self._last = (line["step"], now)
        speed = f"{(line['step'] - step) / (now - then):.1f} steps/s" if line["step"] > step else ""
        losses = [f"{name.removesuffix('_loss')} {line[name]:.3f}" for name in line if name.endswith("_loss")]
        note = "  ".join([*([f"F={line['rollout']}"] if "rollout" in line else []), *losses])
        self._progress.update(self._bar, completed=line["step"], speed=speed, note=note)
        if "score" in line:
            self._rows.append(line)
        self._live.update(self._picture())

    def _picture(self) -> Group:
        if not self._rows:
            return Group(self._progress)
        best = min(self._rows, key=lambda row: row["score"])
        shown = self._rows[-_SHOWN:]
        kinds = [name.split("/")[0] for name in best if name.endswith("/score")]
        table = Table("step", "score", *(f"{kind} {unit}" for kind in kinds for unit in ("m", "deg")), box=None)
        for row in [best] * (best not in shown) + shown:
            cells = [f"{row[f'{kind}/{part}']:.3f}" for kind in kinds for part in ("position_m", "attitude_deg")]
            style = "bold" if row is best else ""
            table.add_row(str(row["step"]), f"{row['score']:.3f}" + " best" * (row is best), *cells, style=style)
        return Group(self._progress, table)
