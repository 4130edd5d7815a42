"""One dataset of the shares that several runs recorded."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from owm_envs.claims import Claim
from owm_envs.config import load_config
from owm_envs.datasets.generate import PIECES, Progress, Shard, generate, settings_of
from owm_envs.datasets.pieces import Pieces
from owm_envs.datasets.recipe import SPLITS, Request
from owm_envs.datasets.runs import GENERATION
from owm_envs.files import output_folder, read_text
from owm_envs.words import plain


def merge(
    shards: Sequence[str | Path],
    out: str | Path,
    *,
    announce: Callable[[str], None] = lambda message: None,
    progress: Callable[[Progress], None] = lambda progress: None,
) -> dict:
    """Make the dataset of which `generate` recorded shares: the same to the byte as a single run.

    Episodes are linked where the disk allows, else copied. The few that no shard came to are recorded here. Killed, it
    goes on where it was by the same call.

    Args:
        shards: folders of all shares, in any order.
        out: folder to make; new or empty.
        announce, progress: as `generate` takes them.

    Returns:
        As `generate`.

    Raises:
        ValueError: a folder is no finished share, they are of different runs, or not all are there.
        FolderTaken: as `generate`.
    """
    told = [_told(Path(folder)) for folder in shards]
    if not told:
        raise ValueError("merge takes the folders of all shards, got none")
    first = {name: value for name, value in told[0].items() if name not in ("shard", "result", "versions")}
    count = Shard.parse(told[0]["shard"]).count
    have: dict[str, Path] = {}
    for folder, each in zip(map(Path, shards), told):
        if {name: each.get(name) for name in first} != first:
            raise ValueError(f"{folder} is a share of another run than {shards[0]}")
        if Shard.parse(each["shard"]).count != count or each["shard"] in have:
            raise ValueError(f"{folder} holds {each['shard']} beside {', '.join(have)}: one folder for each is needed")
        have[each["shard"]] = folder
    if missing := [str(shard) for shard in (Shard(i, count) for i in range(count)) if str(shard) not in have]:
        raise ValueError(f"shares are missing: {', '.join(missing)}")
    if first.get("sensors"):
        raise ValueError("shares with further sensors are merged by generate, in Python, not here")
    request, config = Request(**first["request"]), load_config(first["environment"])
    out = output_folder(out)
    partial = out.with_name(out.name + ".partial")
    if not Claim(out, settings_of(config, request), GENERATION).found:
        claim = Claim(partial, settings_of(config, request), GENERATION)
        if not (claim.found or {}).get("result"):
            claim.note()
            for split in SPLITS:
                for folder in have.values():
                    Pieces(partial / PIECES / split).take(Pieces(folder / PIECES / split))
    return generate(out, config, request, announce=announce, progress=progress)


def _told(folder: Path) -> dict:
    """The `generation.json` of a finished share."""
    path = folder / GENERATION
    try:
        told = json.loads(read_text(path))
        if not isinstance(told["request"], dict) or not isinstance(told["environment"], dict):
            raise TypeError("request and environment must be tables")
        Request(**told["request"]), load_config(told["environment"]), Shard.parse(told.get("shard", "1/1"))
    except FileNotFoundError:
        partial = folder.with_name(folder.name + ".partial")
        hint = f"; {partial} holds an unfinished one: run its command again" if partial.is_dir() else ""
        raise ValueError(f"{folder} is no share of a dataset: it has no {GENERATION}{hint}") from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path} is damaged: {plain(error)}") from None
    if "shard" not in told or "result" not in told:
        raise ValueError(f"{folder} is no finished share: record it with --shard")
    return told
