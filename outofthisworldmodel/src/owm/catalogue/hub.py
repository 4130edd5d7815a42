"""Checkpoints on the Hugging Face hub: three files of numbers and text, nothing that executes.

To publish one, `hf upload USER/NAME FOLDER`, the hub's own command.
"""

import os
import re
from pathlib import Path

CONTENTS = ("config.json", "statistics.json", "weights.safetensors")
"""The files of a checkpoint; whatever else a repository holds is not fetched."""
PRETRAINED = Path(__file__).parents[1] / "pretrained"
"""Where the checkpoint lies that comes with the package, if one does."""
_REPOSITORY = re.compile(r"(?P<name>\w[\w.-]*/\w[\w.-]*)(@(?P<revision>\w[\w./-]*))?")


def is_repository(source: str | os.PathLike) -> bool:
    """Whether a source is to be looked for on the hub: `user/name` or `user/name@revision`, and no local path."""
    text = os.fspath(source)
    return _REPOSITORY.fullmatch(text) is not None and not os.path.exists(text) and not Path(text).parent.is_dir()


def local_folder(source: str | os.PathLike) -> Path:
    """Return the folder of a checkpoint, after fetching what is missing of one on the hub.

    Args:
        source: a folder, `user/name` with an optional `@revision` (branch, tag or commit), or "pretrained".

    Raises:
        FileNotFoundError: the hub has no such repository or revision, or cannot be reached.
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
        first = str(error).strip().splitlines()
        reason = first[0] if first else type(error).__name__
        raise FileNotFoundError(
            f"there is no checkpoint at {os.fspath(source)!r}: neither a folder nor found on the hub ({reason})"
        ) from error
