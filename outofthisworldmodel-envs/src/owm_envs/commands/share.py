"""Commands that check datasets, publish and fetch them."""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from owm_envs.shell import resumable, terminal


def verify(dataset: Annotated[str, tyro.conf.Positional]) -> None:
    """Check a dataset: hashes, counts, rows, statistics, frames, dynamics, rewards, noise, and a picture drawn anew.

    Ends with 1 if something is wrong, and says what.

    Args:
        dataset: Folder of a dataset, or its name on the hub, user/name with an optional @revision.
    """
    from rich.table import Table
    from rich.text import Text

    from owm_envs.datasets.verify import WRONG, verify

    with terminal(stderr=True).status("") as status:
        report = verify(dataset, progress=lambda text: status.update(Text(text)))
    table = Table(title=dataset)
    for heading in ("check", "split", "result", "figure"):
        table.add_column(heading, overflow="fold")
    for check, split, result, told in report.findings:
        table.add_row(check, split, result, "" if result == WRONG else told)
    terminal().print(table)
    for finding in report.wrong:
        print(f"wrong: {finding.told}", file=sys.stderr)
    if not report.sound:
        raise SystemExit(1)


def push(
    run: Annotated[Path, tyro.conf.Positional],
    name: Annotated[str, tyro.conf.Positional],
    together: bool = False,
    private: bool = False,
    dry_run: bool = False,
) -> None:
    """Publish a recorded dataset on the Hugging Face hub: USER/NAME-train and USER/NAME-val.

    Each is a LeRobot dataset of its own, with a card and the tag that LeRobot looks for. What is there already is not
    sent again, so that the same command goes on where it was interrupted. Log in with `hf auth login`.

    Args:
        run: Folder of a dataset, as `owm-envs generate` makes it; one that differs from its manifest is refused.
        name: user/name.
        together: One repository, user/name, with the splits in folders.
        private: Make new repositories private.
        dry_run: List repositories, tags, files and sizes; send nothing.
    """
    from owm_envs import hub
    from owm_envs.datasets.publish import repositories

    planned = repositories(run, name, together=together)
    resumable()
    for repository in planned:
        print(repository.listing() if dry_run else hub.push(repository, private=private))


def download(name: Annotated[str, tyro.conf.Positional], out: Path, revision: str | None = None) -> None:
    """Copy a dataset of the Hugging Face hub to a folder, at one commit, every file checked.

    Where there is no repository user/name, user/name-train and user/name-val are taken for its splits. A killed call is
    resumed by the same command. What has been fetched once comes from the cache where the hub cannot be reached.

    Args:
        name: user/name.
        out: Folder to make.
        revision: Branch, tag or commit; the main branch by default.
    """
    from owm_envs.datasets.fetch import download as fetch

    resumable()
    for repository, commit in fetch(name, out, revision, lambda text: print(text, file=sys.stderr)).items():
        print(f"{out}: {repository} at {commit}")
