"""Verify a dataset as a whole: hashes, counts, every row, statistics, every frame, and the physics behind them."""

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from owm_envs.config import load_config
from owm_envs.datasets.fetch import local_dataset
from owm_envs.datasets.frames import decode
from owm_envs.datasets.manifest import MANIFEST, differences, load_manifest
from owm_envs.datasets.metadata import check_tallies, tallies
from owm_envs.datasets.parse import read_rows, schema_of
from owm_envs.datasets.reader import Dataset
from owm_envs.datasets.statistics import (
    WIDEST,
    Statistics,
    counted_rows,
    episode_statistics,
    exact_quantiles,
    pixel_statistics,
    united,
)
from owm_envs.episode import Episode

OK, WRONG, SKIPPED = "ok", "wrong", "not checked"
COLOURS = 0.02
"""How far mean and deviation of decoded colours, 0 to 1, may lie from those before they were encoded."""
_MOST_TOLD = 20


class Finding(NamedTuple):
    """What one check of one split came to."""

    check: str
    split: str
    result: str
    """`OK`, `WRONG` or `SKIPPED`."""
    told: str
    """A figure, what is wrong, or why it was not checked."""


class Report(NamedTuple):
    """What `verify` found."""

    findings: tuple[Finding, ...]

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong."""
        return not self.wrong

    @property
    def wrong(self) -> list[Finding]:
        """The findings of what is wrong."""
        return [finding for finding in self.findings if finding.result == WRONG]


def verify(source: str | os.PathLike, progress: Callable[[str], None] = lambda text: None) -> Report:
    """Check all that can be known of a dataset.

    Datasets of others are checked as far as their metadata go; physics is of ours alone.

    Args:
        source: the folder of a run or of one LeRobot dataset, or a name on the hub, as `local_dataset` takes it.
        progress: told in words what is looked at.

    Raises:
        FileNotFoundError: there is no such folder.
        ValueError: it holds no LeRobot dataset.
    """
    root = local_dataset(source)
    if not root.is_dir():
        raise FileNotFoundError(f"no dataset at {root}")
    told = (root / "meta" / "info.json", *root.glob("*/meta/info.json"))
    folders = sorted(path.parent.parent for path in told if path.is_file())
    if not folders:
        raise ValueError(f"{root} is not a LeRobot dataset: it has no meta/info.json")
    return Report(tuple(_findings(root, folders, progress)))


def _findings(root: Path, folders: list[Path], progress: Callable[[str], None]) -> Iterator[Finding]:
    progress("hashes")
    yield from _hashes(root)
    if (root / "config.toml").is_file():
        yield from _configuration(root, folders[0])
    for folder in folders:
        split = folder.name
        progress(f"{split}: rows")
        try:
            dataset = Dataset(folder)
        except (ValueError, FileNotFoundError) as error:
            yield Finding("rows", split, WRONG, str(error))
            continue
        found = list(_rows(dataset, split))
        yield from found
        progress(f"{split}: statistics")
        yield from _statistics(dataset, folders, split)
        progress(f"{split}: frames")
        yield from _frames(dataset, split)
        if not dataset.ours or dataset.run.config is None:
            yield Finding("physics", split, SKIPPED, "no generation.json of ours tells how it was simulated")
        elif all(finding.result == OK for finding in found):
            progress(f"{split}: physics")
            yield from _physics(dataset, split)


def _outcome(check: str, split: str, wrong: list[str], told: str) -> Iterator[Finding]:
    """One finding that all is well, or one for each thing that is wrong."""
    for text in wrong[:_MOST_TOLD]:
        yield Finding(check, split, WRONG, text)
    if len(wrong) > _MOST_TOLD:
        yield Finding(check, split, WRONG, f"and {len(wrong) - _MOST_TOLD} more")
    if not wrong:
        yield Finding(check, split, OK, told)


def _hashes(root: Path) -> Iterator[Finding]:
    if not (root / MANIFEST).is_file():
        yield Finding("hashes", "", SKIPPED, f"no {MANIFEST}")
        return
    try:
        wrong = list(differences(root))
        entries = load_manifest(root).values()
    except ValueError as error:
        wrong, entries = [str(error)], ()
    size = sum(entry.bytes for entry in entries)
    yield from _outcome("hashes", "", wrong, f"{len(entries)} files, {size / 1e6:,.1f} MB")


def _configuration(root: Path, folder: Path) -> Iterator[Finding]:
    path, wrong = root / "config.toml", []
    try:
        told, recorded = load_config(path), Dataset(folder).run.config
        if recorded is not None and told != recorded:
            wrong.append(f"{path} is another configuration than generation.json has")
    except (ValueError, OSError) as error:
        wrong.append(" ".join(str(error).split()))
    yield from _outcome("configuration", "", wrong, "config.toml is that of generation.json")


def _rows(dataset: Dataset, split: str) -> Iterator[Finding]:
    wrong: list[str] = []

    def flown() -> Iterator[Episode]:
        for number in range(len(dataset)):
            try:
                if dataset.ours or dataset.published:
                    yield dataset[number]
                else:
                    _in_time(dataset, number)
            except (ValueError, FileNotFoundError) as error:
                wrong.append(str(error))

    found = tallies(flown())
    if dataset.ours and not wrong:
        try:
            check_tallies(dataset.folder, dataset.run, found)
        except ValueError as error:
            wrong.append(str(error))
    rows = int(dataset.lengths.sum())
    yield from _outcome("rows", split, wrong, f"{len(dataset)} episodes, {rows:,} rows: order, time, types, ranges")


def _in_time(dataset: Dataset, number: int) -> None:
    """Time advances, in a dataset of which nothing else is known."""
    time = dataset.columns(number).get("timestamp")
    if time is not None and not (time.dtype.kind in "iuf" and (np.diff(time.astype(float).reshape(-1)) > 0).all()):
        raise ValueError(f"{dataset.layout.span(number).path}: timestamp of episode {number} must advance")


def _statistics(dataset: Dataset, folders: list[Path], split: str) -> Iterator[Finding]:
    if not dataset.ours:
        yield Finding("statistics", split, SKIPPED, "of a dataset that others wrote")
        return
    wrong: list[str] = []
    try:
        told = dataset.statistics
        train = next((folder for folder in folders if folder.name == "train"), dataset.folder)
        source = dataset if train == dataset.folder else Dataset(train)
        parts = [_of_episode(source, number) for number in range(len(source))]
        wrong += _compare(dataset.folder / "meta" / "stats.json", _together(source, parts), told)
        wrong += _compare_episodes(dataset, parts if source is dataset else None)
    except (ValueError, FileNotFoundError) as error:
        wrong.append(str(error))
    yield from _outcome("statistics", split, wrong, f"{len(dataset.features)} columns, recomputed")


def _of_episode(dataset: Dataset, number: int) -> Statistics:
    """Statistics of an episode's columns; its videos are looked at elsewhere."""
    columns = dataset.columns(number)
    return episode_statistics({name: values for name, values in columns.items() if isinstance(values, np.ndarray)})


def _together(dataset: Dataset, parts: list[Statistics]) -> Statistics:
    """Statistics of all rows, quantiles found among them anew, a column at a time."""

    def rows(name: str) -> Iterator[np.ndarray]:
        for number in range(len(dataset)):
            span = dataset.layout.span(number)
            found = read_rows(span.path, [name], span.first, span.first + span.rows)[name]
            yield counted_rows(name, found)

    whole: Statistics = {}
    for part in parts:
        whole = united(whole, part)
    narrow = [name for name, part in whole.items() if part["mean"].size <= WIDEST]
    return whole | {name: whole[name] | exact_quantiles(partial(rows, name)) for name in narrow}


def _compare(path: Path, found: Statistics, told: Statistics) -> list[str]:
    wrong = []
    for name, part in found.items():
        for key, numbers in part.items():
            if key not in told.get(name, {}):
                continue
            stored = told[name][key].astype(np.float64).reshape(-1)
            numbers = numbers.astype(np.float64).reshape(-1)
            slack = 1e-6 * np.maximum(np.abs(numbers), part["std"].astype(np.float64).reshape(-1)) + 1e-9
            if stored.shape != numbers.shape or (np.abs(stored - numbers) > slack).any():
                wrong.append(f"{path}: {key} of {name} is {_told(stored)}; its rows give {_told(numbers)}")
    return wrong


def _told(numbers: np.ndarray) -> str:
    return np.array2string(numbers, precision=6, max_line_width=10_000, threshold=6)


def _compare_episodes(dataset: Dataset, parts: list[Statistics] | None) -> list[str]:
    """The statistics of each episode in meta/episodes, against its rows."""
    wrong, number = [], 0
    for path in sorted((dataset.folder / "meta" / "episodes").rglob("*.parquet")):
        names = [name for name in schema_of(path).names if name.startswith("stats/")]
        if not names:
            return []
        table = read_rows(path, names)
        for row in range(len(table[names[0]])):
            told: dict[str, dict[str, np.ndarray]] = {}
            for name in names:
                _, column, key = name.split("/")
                told.setdefault(column, {})[key] = np.asarray(table[name][row])
            if parts is None:
                found = _of_episode(dataset, number)
            else:
                found = parts[number]
            wrong += _compare(path, found, told)
            number += 1
    return wrong


def _frames(dataset: Dataset, split: str) -> Iterator[Finding]:
    """Each video decodes, and has a frame for each row, at the row's time; colours are as the statistics say."""
    layout, wrong, count = dataset.layout, [], 0
    for key, (paths, which, start) in layout.videos.items():
        if not dataset.ours and 3 not in dataset.features[key]["shape"]:
            continue
        histogram, frames = np.zeros((3, 256), np.int64), 0
        for number, path in enumerate(paths):
            inside = np.flatnonzero(which == number)
            first = [round(float(start[episode]) * dataset.fps) for episode in inside]
            wanted = {row for begin, episode in zip(first, inside) for row in begin + np.arange(layout.rows[episode])}
            try:
                shape, seen = dataset.columns(int(inside[0]))[key].shape[1:], set()
                for place, image in decode(path, dataset.fps, 0, 1 << 62):
                    if image.shape != tuple(shape):
                        raise ValueError(f"{path}: frame {place} is {image.shape}, info.json tells of {tuple(shape)}")
                    seen.add(place)
                    histogram += [np.bincount(image[..., channel].ravel(), minlength=256) for channel in range(3)]
                if wanted != seen:
                    odd = min(wanted ^ seen)
                    told = "is missing" if odd in wanted else "belongs to no row"
                    wrong.append(f"{path}: {len(seen)} frames for {len(wanted)} rows; frame {odd} {told}")
                frames += len(seen)
            except (ValueError, FileNotFoundError) as error:
                wrong.append(str(error))
        if dataset.ours and split != "val" and not wrong:  # val has the statistics of train
            wrong += _compare_colours(dataset, key, pixel_statistics(histogram, frames))
        count += frames
    if layout.videos:
        yield from _outcome("frames", split, wrong, f"{count:,} decoded, one a row")


def _compare_colours(dataset: Dataset, key: str, found: dict[str, np.ndarray]) -> Iterator[str]:
    """The statistics of a video, which are of the frames before they were encoded: nearly those of what is decoded."""
    path = dataset.folder / "meta" / "stats.json"
    for name in ("mean", "std"):
        told = dataset.statistics.get(key, {}).get(name)
        if told is None or told.size != 3 or np.abs(told.reshape(3) - found[name].reshape(3)).max() > COLOURS:
            came = "missing" if told is None else _told(told.reshape(-1))
            yield f"{path}: {name} of {key} is {came}; its frames give {_told(found[name].reshape(-1))}"


def _physics(dataset: Dataset, split: str) -> Iterator[Finding]:
    from owm_envs.datasets import physics

    config = dataset.run.config
    errors = physics.step_errors(map(dataset.columns, range(len(dataset))), config)
    if errors is None:
        yield Finding("dynamics", split, SKIPPED, "vehicles were drawn: only that truth moves as limits allow")
    else:
        allowed = np.array(physics.STEP_TOLERANCE[config.precision])
        wrong = [
            f"{dataset.layout.span(number).path}: episode {number} is {error[part]:.2g} {physics.UNITS[part]} of "
            f"{physics.PARTS[part]} off a step of the dynamics, {allowed[part]:g} are allowed"
            for number, error in enumerate(errors)
            for part in np.flatnonzero(~(error <= allowed))[:1]
        ]
        most = ", ".join(f"{x:.1e} {unit}" for x, unit in zip(errors.max(axis=0), physics.UNITS))
        yield from _outcome("dynamics", split, wrong, f"off by at most {most}")
    off = physics.reward_errors(map(dataset.columns, range(len(dataset))), config)
    wrong = [
        f"{dataset.layout.span(number).path}: next.reward of episode {number} is not that of its rows, off by "
        f"{error:.3g} times what is allowed"
        for number, error in enumerate(off)
        if not error <= 1
    ]
    yield from _outcome("reward", split, wrong, f"that of its rows, off by at most {off.max():.2g} of what is allowed")
    ratio, score = physics.noise_scores(physics.residuals(dataset.columns(i), config) for i in range(len(dataset)))
    least = physics.largest_score(4)
    wrong = [
        f"{dataset.folder}: the measured {name} errs {ratio[part]:.3f} times as much as configured, score "
        f"{score[part]:+.1f} of at most {least:.1f}"
        for part, name in enumerate(physics.PARTS)
        if abs(score[part]) > least
    ]
    sizes = ", ".join(f"{name} {r:.3f}" for name, r in zip(physics.PARTS, ratio) if np.isfinite(r))
    yield from _outcome("noise", split, wrong, f"of the configured size: {sizes or 'none, and there is none'}")
    if config.has_pixels:
        yield from _picture(dataset, split)


def _picture(dataset: Dataset, split: str) -> Iterator[Finding]:
    """A frame of the middle of an episode, drawn anew."""
    from owm_envs.datasets import physics

    number, config = len(dataset) // 2, dataset.run.config
    columns: dict[str, Any] = dataset.columns(number)
    row = int(dataset.lengths[number]) // 2 // config.camera.every * config.camera.every
    anew = physics.redrawn(columns, row, config)
    if anew is None:
        yield Finding("picture", split, SKIPPED, "the camera's errors, or light and look, were drawn")
        return
    name = next(name for name in ("observation.images.fpv", "observation.pixels") if name in columns)
    stored, where = np.asarray(columns[name][row]), f"frame {row} of episode {number}"
    if config.camera.channels == "rgb":
        likeness = physics.psnr(anew, stored)
        good, told = likeness >= physics.PSNR, f"{where} drawn anew: {likeness:.1f} dB, at least {physics.PSNR:g}"
    else:
        share = float(np.mean(np.abs(anew.astype(np.float64) - stored) <= 1e-3 * np.abs(anew) + 1))
        good, told = share >= 0.99, f"{where} drawn anew: {100 * share:.1f} % of pixels equal, at least 99"
    yield from _outcome("picture", split, [] if good else [f"{dataset.folder}: {told}"], told)
