"""Repositories of the Hugging Face hub: fetched at one commit and checked, or published.

What is fetched lies twice in the cache, on the same bytes: as the hub's client keeps it, which lets a broken download
go on, and beside it as a folder of plain files for each commit, which appears once every hash has been checked.
"""

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Collection, Mapping
from pathlib import Path, PurePath
from typing import Any, Literal, NamedTuple
from urllib.parse import quote

from owm_envs import hub_client
from owm_envs.claims import Claim
from owm_envs.files import (
    check_free,
    inner_path,
    output_folder,
    publish,
    published,
    read_text,
    remove,
    settle,
    staged,
    write_atomically,
)
from owm_envs.hub_client import (
    ATTEMPTS,
    Broken,
    HubError,
    Unreachable,
    client,
    in_words,
    library,
)

Kind = Literal["dataset", "model"]
SOURCE = "source.json"
"""Names the repositories and commits that a folder was fetched from."""
OUTPUT = "runs"
"""The folder that commands write to unless told otherwise: what is missing there is on no hub."""
_MAIN = "main"
_REPOSITORY = re.compile(r"(?P<name>\w[\w.-]*/\w[\w.-]*)(@(?P<revision>\w[\w./-]*))?")
_COMMIT = re.compile(r"[0-9a-f]{40}")


class Hashes(NamedTuple):
    """What the hub tells of a file."""

    bytes: int
    sha256: str | None
    """Of large files."""
    blob: str
    """Git's SHA-1 of the others."""


class Fetched(NamedTuple):
    """A repository as it was at one commit."""

    folder: Path
    """In the cache: plain files, checked."""
    name: str
    commit: str


class Repository(NamedTuple):
    """A repository as it is to be."""

    name: str
    kind: Kind
    files: Mapping[str, Path | bytes]
    """By their paths in it."""
    message: str
    """Of the commit."""
    folders: tuple[str, ...] = ()
    """Those that are to hold nothing else."""
    tag: str | None = None
    """To point at the commit, wherever it pointed before."""

    def listing(self) -> str:
        """What there is to push, a line each."""
        sizes = {path: _size(content) for path, content in sorted(self.files.items())}
        tag = f", tag {self.tag}" if self.tag else ""
        head = f"{self.name} ({self.kind}{tag}): {len(sizes)} files, {sum(sizes.values()):,} bytes"
        return "\n".join([head, *(f"  {size:>15,}  {path}" for path, size in sizes.items())])


class Pushed(NamedTuple):
    """What has come of a push."""

    name: str
    url: str
    """Of that commit."""
    commit: str
    sent: tuple[str, ...]
    """The files that were not there already."""
    removed: tuple[str, ...]

    def __str__(self) -> str:
        told = f"{len(self.sent)} files sent" if self.sent else "nothing new to send"
        return f"{self.url}: {told}" + (f", {len(self.removed)} removed" if self.removed else "")


def parse(source: str | os.PathLike) -> tuple[str, str | None] | None:
    """Split `user/name` or `user/name@revision`; None for what is to be taken for a path.

    That is whatever lies on this machine, or in a folder that does, or in the commands' usual one.
    """
    text = source.as_posix() if isinstance(source, PurePath) else os.fspath(source)
    path = Path(text)
    parts = _REPOSITORY.fullmatch(text)
    if not parts or path.exists() or path.parent.is_dir() or path.parts[:1] == (OUTPUT,):
        return None
    return parts["name"], parts["revision"]


def checked_name(name: str) -> str:
    """A repository's name, once it looks like one.

    Raises:
        ValueError: it does not.
    """
    parts = _REPOSITORY.fullmatch(name)
    if not parts or parts["revision"]:
        raise ValueError(f"a repository is called user/name, of letters, digits, -, _ and dots; got {name!r}")
    return name


def fetch(
    name: str,
    revision: str | None = None,
    *,
    kind: Kind,
    only: Collection[str] | None = None,
    check: Callable[[Path], None] = lambda folder: None,
    again: bool = False,
) -> Fetched:
    """Fetch a repository into the cache as it is at one commit; from there if the hub cannot be reached.

    A call that was killed, or whose connection broke, goes on with the files that it had not finished.

    Args:
        revision: branch, tag or commit; the main branch if not given.
        only: names of the files to fetch; all if not given.
        check: looks at the folder once, after the hub's own hashes have been checked, and raises `ValueError`.
        again: let it look at what the cache has already, too, and fetch that anew if it was damaged.

    Raises:
        NoRepository, Unreachable, HubError: as they say.
        ImportError: the hub's client is not installed.
    """
    commit = _resolved(name, revision, kind)
    folder = _cache(name, kind) / commit
    if again and folder.is_dir():
        try:
            check(folder)
        except ValueError:
            remove(folder)
    if not folder.is_dir():
        files = _checked(name, commit, kind, only)
        keep(files | {SOURCE: source_note(kind, {name: commit})}, folder, check)
    return Fetched(folder, name, commit)


def _checked(name: str, commit: str, kind: Kind, only: Collection[str] | None) -> dict[str, Path | bytes]:
    """The files of a commit in the client's own cache, each as the hub lists it."""
    listed = _tree(name, commit, kind)
    wanted = [path for path in listed if path != ".gitattributes" and (only is None or path in only)]
    wrong: list[str] = []
    for _ in range(2):  # the cache may have been damaged
        snapshot = _downloaded(name, commit, kind, only)
        wrong = [path for path in wanted if not _matches(snapshot / path, listed[path])]
        if not wrong:
            return {path: snapshot / path for path in wanted}
        for path in wrong:
            _forget(snapshot / path)
    raise HubError(name, f"does not give {wrong[0]} with the hash that it lists: damaged on the way, or changed there")


def source_note(kind: Kind, commits: Mapping[str, str]) -> bytes:
    """What `SOURCE` says of these repositories and their commits."""
    return (json.dumps(_source(kind, commits), indent=1) + "\n").encode()


def _source(kind: Kind, commits: Mapping[str, str]) -> dict[str, Any]:
    return {"kind": kind, "repositories": dict(commits)}


def keep(contents: Mapping[str, Path | bytes], folder: Path, check: Callable[[Path], None]) -> None:
    """Make a folder of the cache, whole or not at all: files by their paths in it, linked where that can be.

    Args:
        check: looks at the folder before it gets its name.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with staged(folder, folder=True) as stage:
        for path, content in contents.items():
            _place(content, stage / path, link=True)
        settle(stage)
        check(stage)
        try:
            os.replace(stage, folder)
        except OSError:
            if not folder.is_dir():  # else another process was quicker
                raise


def deliver(
    contents: Mapping[str, Path | bytes],
    out: str | os.PathLike,
    kind: Kind,
    commits: Mapping[str, str],
    check: Callable[[Path], None] = lambda folder: None,
) -> tuple[Path, bool]:
    """Copy what was fetched to a folder of the user's, whole or not at all; a killed call is resumed by the same one.

    Args:
        contents: files by their paths in the folder.
        commits: of the repositories that they come from, for `SOURCE`.
        check: looks at the folder before it gets its name, and again whenever it is there already.

    Returns:
        Where it is, and whether it was there already.

    Raises:
        FolderTaken: the folder holds something else.
        OSError: the disk is full.
    """
    out = output_folder(out)
    partial = out.with_name(out.name + ".partial")
    asked, moved = _source(kind, commits), published(partial)
    if Claim(out, asked, SOURCE, besides=moved).found and not moved:
        check(out)
        return out, True
    claim = Claim(partial, asked, SOURCE)
    sizes = {path: _size(content) for path, content in contents.items()}
    missing = [path for path, size in sizes.items() if not _is_file(partial / path, size)]
    if not moved:
        check_free(out)
        needed, free = sum(sizes[path] for path in missing), shutil.disk_usage(_existing(partial)).free
        if needed > free:
            raise OSError(errno.ENOSPC, f"{needed / 1e6:,.0f} MB are to be written, {free / 1e6:,.0f} MB are free")
        claim.note()
        for path in missing:
            _place(contents[path], partial / path)
        try:
            check(partial)
        except ValueError:
            remove(partial)
            raise
    publish(partial, out)
    return out, False


def push(repository: Repository, *, private: bool = False) -> Pushed:
    """Make a repository what it is to be, in one commit; what it has already is not sent again.

    A push that was killed leaves the repository as it was. The same call does not send again what had arrived whole.

    Args:
        private: make it a private one, if it is to be made.

    Raises:
        HubError: the hub refuses.
        ImportError: its client is not installed.
    """
    name, kind, files, message, folders, tag = repository
    api = client(name)
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete

    about: dict[str, Any] = {"repo_id": checked_name(name), "repo_type": kind}
    with in_words(name):
        api.create_repo(**about, private=private or None, exist_ok=True)
        info = api.repo_info(**about, timeout=hub_client.PATIENCE)
    if private and not info.private:
        raise HubError(name, "shows it to everybody already: make it private there, or leave out --private")
    there = _tree(name, info.sha, kind) if info.sha else {}
    sent = [path for path, content in files.items() if not (path in there and _matches(content, there[path]))]
    gone = [path for path in there if path.split("/")[0] in folders and path not in files]
    commit = info.sha
    if sent or gone:
        added = [CommitOperationAdd(path, c if isinstance(c := files[path], bytes) else str(c)) for path in sent]
        with in_words(name):
            done = api.create_commit(
                **about,
                operations=[*added, *(CommitOperationDelete(path, is_folder=False) for path in gone)],
                commit_message=message,
            )
        commit = done.oid
        there = _tree(name, commit, kind)
        if wrong := [path for path in files if not (path in there and _matches(files[path], there[path]))]:
            raise HubError(name, f"holds something else than was sent as {wrong[0]}: push again")
    if tag is not None:
        with in_words(name):
            tags = {ref.name: ref.target_commit for ref in api.list_repo_refs(**about).tags}
            if tags.get(tag, commit) != commit:
                api.delete_tag(**about, tag=tag)
            if tags.get(tag) != commit:
                api.create_tag(**about, tag=tag, revision=commit)
    return Pushed(name, f"{address(name, kind)}/tree/{commit}", commit, tuple(sent), tuple(gone))


def address(name: str, kind: Kind) -> str:
    """Where a browser finds a repository."""
    return f"{library().constants.ENDPOINT}/{'datasets/' if kind == 'dataset' else ''}{name}"


def cache() -> Path:
    """The folder for what is fetched, beside the hub's own cache and on its disk."""
    return Path(library().constants.HF_HUB_CACHE).expanduser().absolute().parent / "owm"


def _cache(name: str, kind: Kind) -> Path:
    return cache() / f"{kind}s--{name.replace('/', '--')}"


def _resolved(name: str, revision: str | None, kind: Kind) -> str:
    """The commit that a revision stands for; the last that was known, while the hub cannot be reached."""
    if revision and _COMMIT.fullmatch(revision):
        return revision
    try:
        api = client(name)
        with in_words(name, revision):
            commit = api.repo_info(name, repo_type=kind, revision=revision, timeout=hub_client.PATIENCE).sha
    except Unreachable as error:
        known = _cache(name, kind) / "revisions" / quote(revision or _MAIN, safe="")
        if not known.is_file():
            at = f" at {revision}" if revision else ""
            raise Unreachable(name, f"{error.reason}, and the cache does not hold it{at}") from error
        return read_text(known)
    if not _COMMIT.fullmatch(commit or ""):
        raise HubError(name, f"tells of the commit {commit!r}, which is none")
    known = _cache(name, kind) / "revisions" / quote(revision or _MAIN, safe="")
    write_atomically(known, lambda file: file.write(commit), text=True)
    return commit


def _tree(name: str, commit: str, kind: Kind) -> dict[str, Hashes]:
    """The files of a commit."""
    api = client(name)
    from huggingface_hub.hf_api import RepoFile

    with in_words(name, commit):
        entries = list(api.list_repo_tree(name, recursive=True, revision=commit, repo_type=kind))
    files = [entry for entry in entries if isinstance(entry, RepoFile)]
    for file in files:
        try:
            inner_path(file.path)
        except ValueError as error:
            raise HubError(name, f"lists a file that is not to be written: {error}") from None
    return {file.path: Hashes(file.size, file.lfs.sha256 if file.lfs else None, file.blob_id) for file in files}


def _downloaded(name: str, commit: str, kind: Kind, only: Collection[str] | None) -> Path:
    """The client's own snapshot of a commit."""
    from huggingface_hub import snapshot_download

    patterns = {"allow_patterns": None if only is None else list(only), "ignore_patterns": [".gitattributes"]}

    def once() -> Path:
        with in_words(name, commit):
            return Path(snapshot_download(name, repo_type=kind, revision=commit, **patterns))

    for _ in range(ATTEMPTS - 1):
        with contextlib.suppress(Broken):  # what had arrived is kept
            return once()
    return once()


def _matches(content: Path | bytes, listed: Hashes) -> bool:
    """Whether a file is what the hub lists; the size is compared first, which costs nothing."""
    if isinstance(content, Path) and not content.is_file():
        return False
    if (size := _size(content)) != listed.bytes:
        return False
    sha = hashlib.sha256() if listed.sha256 else hashlib.sha1(f"blob {size}\0".encode())
    if isinstance(content, bytes):
        sha.update(content)
    else:
        with open(content, "rb") as file:
            while block := file.read(2**20):
                sha.update(block)
    return sha.hexdigest() == (listed.sha256 or listed.blob)


def _forget(path: Path) -> None:
    """Remove a file of the client's cache, and the bytes behind it."""
    Path(os.path.realpath(path)).unlink(missing_ok=True)
    path.unlink(missing_ok=True)


def _size(content: Path | bytes) -> int:
    return len(content) if isinstance(content, bytes) else content.stat().st_size


def _is_file(path: Path, size: int) -> bool:
    return path.is_file() and path.stat().st_size == size


def _existing(path: Path) -> Path:
    return next(place for place in (path, *path.parents) if place.exists())


def _place(content: Path | bytes, path: Path, *, link: bool = False) -> None:
    """Write, link or copy a file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(content, bytes):
        return write_atomically(path, lambda file: file.write(content))
    if link:
        with contextlib.suppress(OSError):  # other disks, and some file systems, have no such links
            return os.link(os.path.realpath(content), path)
    with open(content, "rb") as source:
        write_atomically(path, lambda file: shutil.copyfileobj(source, file, 2**20))
