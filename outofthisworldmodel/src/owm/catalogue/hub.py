"""Checkpoints on the Hugging Face hub: three files of numbers and text, nothing that executes."""

import os
import re
from collections.abc import Iterable
from pathlib import Path

from owm.catalogue.card import model_card
from owm.catalogue.kinds import check
from owm.checkpoint import FILES, HEADER, CheckpointError, NoCheckpointError
from owm_envs import hub
from owm_envs.hub import Repository
from owm_envs.hub_client import HubError
from owm_envs.words import unknown

CARD = "README.md"
"""Comes along; whatever else a repository holds is not fetched."""
PRETRAINED = Path(__file__).parents[1] / "pretrained"
"""Where the checkpoint lies that comes with the package, if one does."""


def checkpoint_folder(source: str | os.PathLike, what: str = "world model", names: Iterable[str] = ()) -> Path:
    """Return the folder of a checkpoint: the one named, `model` or `policy` in a run's folder, or one from the hub.

    Args:
        source: as `local_folder` takes it.
        what: is looked for, for the message.
        names: known beside "pretrained" and paths, for the message.

    Raises:
        NoCheckpointError: there is nothing.
        ValueError: there is nothing, and the source looks like a misspelt name, naming the nearest.
        ImportError: `huggingface_hub` is not installed.
    """
    folder, text = local_folder(source), os.fspath(source)
    places = (folder, folder / "model", folder / "policy")
    found = next((place for place in places if (place / HEADER).is_file()), None)
    if found is None and not folder.exists() and re.fullmatch(r"[\w-]+", text):
        known = (*names, PRETRAINED.name)
        raise ValueError(unknown(what, text, known) + ", the folder of a checkpoint, or user/name on the hub")
    if found is None:
        raise NoCheckpointError(text)
    return found


def local_folder(source: str | os.PathLike) -> Path:
    """Return the folder of a checkpoint, after fetching what is missing of one on the hub.

    Args:
        source: a folder, `user/name` with an optional `@revision` (branch, tag or commit), or "pretrained".

    Raises:
        NoCheckpointError: the hub has no such repository or revision, or cannot be reached.
        ImportError: `huggingface_hub` is not installed.
    """
    if os.fspath(source) == PRETRAINED.name:
        return PRETRAINED
    named = hub.parse(source)
    if named is None:
        return Path(source)
    try:
        return hub.fetch(*named, kind="model", only=(*FILES, CARD)).folder
    except HubError as error:
        raise NoCheckpointError(source, f"neither a folder nor found on the hub, which {error.reason}") from error


def download(source: str, out: str | os.PathLike, revision: str | None = None) -> str:
    """Copy a checkpoint of the hub to a folder, whole or not at all; a killed call is resumed by the same one.

    Args:
        source: `user/name` with an optional `@revision`.
        out: new or empty, or one that holds this very checkpoint.
        revision: branch, tag or commit, if `source` names none; the main branch by default.

    Returns:
        The commit that it is of.

    Raises:
        ValueError: `source` is no repository's name.
        CheckpointError: the repository holds no checkpoint, or a damaged one.
        FolderTaken: `out` holds something else.
        NoRepository, Unreachable, HubError, ImportError, OSError: as `owm_envs.hub.fetch` and `deliver`.
    """
    name, _, at = source.partition("@")
    fetched = hub.fetch(hub.checked_name(name), at or revision, kind="model", only=(*FILES, CARD))
    check(fetched.folder)
    contents = {file.name: file for file in fetched.folder.iterdir() if file.name != hub.SOURCE}
    hub.deliver(contents, out, "model", {name: fetched.commit}, check)
    return fetched.commit


def repository(source: str | os.PathLike, name: str) -> Repository:
    """What to push of a checkpoint, once it is known to be whole: nothing is sent.

    Args:
        source: as `checkpoint_folder` takes it.
        name: `user/name`.

    Raises:
        CheckpointError: there is none, it is damaged, or its run is not finished.
        ValueError: as `checkpoint_folder`, or `name` is no repository's name.
    """
    try:
        folder = checkpoint_folder(source)
    except NoCheckpointError:
        if not (Path(source) / "run.json").is_file():
            raise
        raise CheckpointError(f"{source} has no model yet: the same `owm train` again finishes it") from None
    header = check(folder)
    files: dict[str, Path | bytes] = {each: folder / each for each in FILES if (folder / each).is_file()}
    files[CARD] = model_card(header, hub.checked_name(name), folder.parent / "metrics.jsonl").encode()
    return Repository(name, "model", files, f"Checkpoint of a {header.kind} model")
