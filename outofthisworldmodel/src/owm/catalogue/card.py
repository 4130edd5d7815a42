"""The card that explains a checkpoint to whoever finds it on the hub, written from the checkpoint's own files."""

import json
from collections.abc import Iterator
from pathlib import Path

from owm import __version__
from owm.checkpoint import About, Header, Noise
from owm_envs.words import inert


def model_card(header: Header, name: str, metrics: Path | None = None) -> str:
    """Markdown with the header that the Hugging Face hub reads.

    Args:
        header: of the checkpoint.
        name: of the repository, `user/name`.
        metrics: `metrics.jsonl` of the run that it came from, if that is there.
    """
    about, kind = header.about, header.kind
    use = {"ppo": "A policy", "learned": "A world model"}.get(kind, "A predictor")
    return "\n".join(
        [
            *("---", "license: mit", "library_name: outofthisworldmodel", "pipeline_tag: robotics"),
            *("tags: [spacecraft, docking, jax]", "---", ""),
            *(f"# {use} of spacecraft docking", ""),
            inert(f"Kind `{kind}`") + ", three files of numbers and text: nothing in them is executed.",
            "",
            *_loading(kind, name),
            "",
            *map(inert, (*_corpora(about), *_training(about), *_scores(about, metrics))),
            f"Versions: outofthisworldmodel {__version__}, checkpoint format {header.format}.",
            "",
            "Licence: MIT.",
            "",
        ]
    )


def _loading(kind: str, name: str) -> Iterator[str]:
    yield from ("With outofthisworldmodel installed from its source repository, and `huggingface-hub`:", "")
    yield from ("```sh", f"owm fly --policy {name} --port zvezda_aft --plot", "```")
    if kind != "ppo":
        yield from ("", "```python", "import owm", "", f'model = owm.load_world_model("{name}")', "```")


def _corpora(about: About) -> Iterator[str]:
    """What it was trained on."""
    if about.corpus:
        yield from ("| trained on | equations of motion | noise of position | of velocity |", "|---|---|---|---|")
        for corpus in about.corpus:
            noise = corpus.noise or Noise()
            part, position = noise.position_per_range, noise.position
            place = f"{part:g} of the distance" if part else f"{position:g} m" if position is not None else ""
            speed = f"{noise.velocity:g} m/s" if noise.velocity is not None else ""
            yield f"| {corpus.name} | {corpus.fidelity or ''} | {place} | {speed} |"
        yield ""


def _training(about: About) -> Iterator[str]:
    """How it was trained: every setting, in the order of the configuration."""
    config = about.run.get("config")
    run = config if isinstance(config, dict) else about.run
    settings = about.settled or {name: value for name, value in run.items() if name != "model"}
    if settings:
        told = {name: value for name, value in settings.items() if value is not None}
        yield f"Trained with seed {told.pop('seed', 'unknown')}:"
        yield ", ".join(f"`{name} = {json.dumps(value)}`" for name, value in told.items()) + "."
        yield ""
    if about.parameters is not None:
        yield from (f"{about.parameters:,} trained parameters.", "")


def _scores(about: About, metrics: Path | None) -> Iterator[str]:
    """How good it is: what chose the weights, and what the run noted at that step."""
    if about.score is None:
        return
    yield f"Validation score {about.score:.4f} at step {about.step}, the lower the better."
    yield ""
    lines = metrics.read_text(encoding="utf-8").splitlines() if metrics and metrics.is_file() else []
    noted: dict[str, float] = {}
    for line in map(json.loads, lines):
        if isinstance(line, dict) and line.get("step") == about.step:
            scores = {name: value for name, value in line.items() if name.endswith(("score", "energy"))}
            noted |= {name: value for name, value in scores.items() if isinstance(value, float)}
    if noted:
        yield from ("| validation | |", "|---|---|")
        yield from (f"| {name} | {value:.4f} |" for name, value in noted.items())
        yield ""
