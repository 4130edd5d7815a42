"""Checkpoints on the Hugging Face hub: three files of numbers and text, nothing that executes.

To publish one, `hf upload USER/NAME FOLDER`, the hub's own command.
"""

import os
import re
from collections.abc import Iterable
from pathlib import Path

from owm.checkpoint import NoCheckpointError
from owm_envs.words import unknown

CONTENTS = ("config.json", "statistics.json", "weights.safetensors")
"""The files of a checkpoint; whatever else a repository holds is not fetched."""
PRETRAINED = Path(__file__).parents[1] / "pretrained"
"""Where the checkpoint lies that comes with the package, if one does."""
_OUTPUT = "runs"
"""The folder that commands write to unless told otherwise: what is missing there is on no hub."""
_MISSING = {
    "RepositoryNotFoundError": "which has no such repository",
    "GatedRepoError": "which keeps that repository for those who asked for it",
    "RevisionNotFoundError": "which has no such revision of that repository",
    "LocalEntryNotFoundError": "which cannot be reached",
}
_REPOSITORY = re.compile(r"(?P<name>\w[\w.-]*/\w[\w.-]*)(@(?P<revision>\w[\w./-]*))?")


def is_repository(source: str | os.PathLike) -> bool:
    """Whether a source is to be looked for on the hub: `user/name` or `user/name@revision`, and no local path."""
    text = os.fspath(source)
    local = os.path.exists(text) or Path(text).parent.is_dir() or Path(text).parts[:1] == (_OUTPUT,)
    return _REPOSITORY.fullmatch(text) is not None and not local


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
    found = next((place for place in places if (place / "config.json").is_file()), None)
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
    if not is_repository(source):
        return Path(source)
    try:
        from huggingface_hub import snapshot_download
    except ImportError as error:
        raise ImportError(
            f"there is no folder {os.fspath(source)!r}, and to look for it on the hub "
            "needs: pip install 'outofthisworldmodel[hub]'"
        ) from error
    parts = _REPOSITORY.fullmatch(os.fspath(source))
    try:
        return Path(snapshot_download(parts["name"], revision=parts["revision"], allow_patterns=list(CONTENTS)))
    except Exception as error:  # which of its HTTP client's own exceptions come is no part of the hub's interface
        reason = _MISSING.get(type(error).__name__, "which cannot be reached")
        raise NoCheckpointError(source, f"neither a folder nor found on the hub, {reason}") from error
