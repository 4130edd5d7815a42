"""The hub's own client: how long it waits, and what goes wrong with it, in words."""

import contextlib
import errno
from collections.abc import Iterator
from typing import Any

from owm_envs.words import install, plain

PATIENCE, SILENCE = 10.0, 60.0
"""Seconds until a hub that does not answer counts as out of reach; and until one that has answered does again."""
ATTEMPTS = 3
"""At a file whose connection breaks, beside those that the client makes by itself; and at a hub that stays silent."""
_BROKEN = {"ChunkedEncodingError", "ContentDecodingError", "IncompleteRead", "ProtocolError", "ReadError"}
_UNREACHABLE = {
    *("ConnectError", "ConnectionError", "LocalEntryNotFoundError", "NetworkError", "OfflineModeIsEnabled"),
    *("SSLError", "Timeout", "TimeoutException", "TransportError"),
}
_SILENT = {"ReadTimeout", "WriteTimeout", "ReadTimeoutError", "TimeoutError", "_Silence"}
"""Names of errors, by whichever HTTP client the hub's own stands on."""


class HubError(OSError):
    """The hub refuses what was asked of it, or gives something else.

    Attributes:
        reason: what the hub does, to follow its name.
    """

    def __init__(self, name: str, reason: str):
        super().__init__(f"{name}: the hub {reason}")
        self.reason = reason


class NoRepository(HubError, FileNotFoundError):
    """There is no such repository, or not for whoever asks."""


class Unreachable(HubError):
    """The hub does not answer, or is not to be asked, and the cache does not have it."""


class Broken(Unreachable):
    """The connection ended in the middle of a file."""


def client(name: str) -> Any:
    """The hub's client.

    Raises:
        Unreachable: the user wants to stay offline.
        ImportError: it is not installed.
    """
    module = library(f"{name!r} is no folder, and ")
    if module.constants.HF_HUB_OFFLINE:
        raise Unreachable(name, "cannot be reached, because HF_HUB_OFFLINE is set")
    return module.HfApi(library_name="outofthisworldmodel")


def library(why: str = "") -> Any:
    """The module of the hub's client. Raises ImportError: it is not installed."""
    try:
        import huggingface_hub.constants
    except ImportError as error:
        raise ImportError(f"{why}the hub needs its client: {install('hub')}") from error
    return huggingface_hub


_asking = 0
"""How many threads are asking the hub for us."""
_unanswered = 0
"""How many of our requests in a row had no answer."""


class _Silence(OSError):
    """The hub has not answered so often that it is not asked again; the client does not retry after it."""


@contextlib.contextmanager
def _patient() -> Iterator[None]:
    """Have requests given up to which nothing comes: by itself the client waits for most of them for ever."""
    global _asking, _unanswered
    from huggingface_hub.utils import _http, get_session

    if hasattr(_http, "set_client_factory"):  # from 1.0 on all threads share a session
        _limited(get_session())
    elif not hasattr(made := _http._GLOBAL_BACKEND_FACTORY, "limited"):
        limited = lambda: _limited(made())
        limited.limited = True
        _http.configure_http_backend(limited)
    if not _asking:
        _unanswered = 0
    _asking += 1
    try:
        yield
    finally:
        _asking -= 1


def _limited(session: Any) -> Any:
    """A session of `requests` or `httpx` whose requests have limits, if they bring none, while we are asking."""
    if hasattr(send := session.send, "limited"):
        return session

    def limited(request: Any, **given: Any) -> Any:
        global _unanswered
        if not _asking:
            return send(request, **given)
        if _unanswered >= ATTEMPTS:
            raise _Silence(f"no answer to {_unanswered} requests in a row")
        bare = request.method == "HEAD"  # an answer without bytes, which the client may wait for a minute and more
        if hasattr(request, "extensions"):
            usual = {"connect": PATIENCE, "read": PATIENCE if bare else SILENCE, "write": SILENCE, "pool": None}
            own = {} if bare else request.extensions.get("timeout", {})
            request.extensions["timeout"] = {what: own.get(what) or limit for what, limit in usual.items()}
        elif bare or given.get("timeout") is None:
            given["timeout"] = (PATIENCE, PATIENCE if bare else SILENCE)
        try:
            answer = send(request, **given)
        except Exception as error:
            _unanswered += bool(_SILENT & {kind.__name__ for kind in type(error).__mro__})
            raise
        _unanswered = 0
        return answer

    limited.limited = True
    session.send = limited
    return session


@contextlib.contextmanager
def in_words(name: str, revision: str | None = None) -> Iterator[None]:
    """Give requests that nothing comes to up, and tell what the hub's client raises in a line of ours.

    Args:
        name: of the repository that is asked for.
        revision: of it.

    Raises:
        HubError, NoRepository, Unreachable, Broken: what went wrong.
        OSError: the disk is full.
    """
    try:
        with _patient():
            yield
    except Exception as error:  # which of its HTTP client's own exceptions come is no part of its interface
        raise _told(name, revision, error) from error


def _told(name: str, revision: str | None, error: BaseException) -> OSError:
    chain = [error]
    while (cause := chain[-1].__cause__ or chain[-1].__context__) and cause not in chain:
        chain.append(cause)
    kinds = {kind.__name__ for link in chain for kind in type(link).__mro__}
    status = next((s for link in chain if (s := getattr(getattr(link, "response", None), "status_code", None))), 0)
    if any(getattr(link, "errno", None) == errno.ENOSPC for link in chain):
        return OSError(errno.ENOSPC, f"the disk is full; make room, and the same command goes on with {name}")
    if "GatedRepoError" in kinds:
        return NoRepository(name, "keeps it for those who asked for it: do so on its page, and log in: hf auth login")
    if "RevisionNotFoundError" in kinds:
        return NoRepository(name, f"has no revision {revision!r} of it")
    if status == 401 and "RepositoryNotFoundError" in kinds:
        return NoRepository(name, "has no such repository, or a private one: log in with `hf auth login`")
    if status == 401 or "LocalTokenNotFoundError" in kinds:
        return HubError(name, "wants to know who asks: log in with `hf auth login`")
    if status == 403:
        return HubError(name, "refuses that (403): the name is another's, or your token lacks the permission")
    if "RepositoryNotFoundError" in kinds:
        return NoRepository(name, "has no such repository")
    if "EntryNotFoundError" in kinds and "LocalEntryNotFoundError" not in kinds:
        return HubError(name, "lists a file that it does not have")
    if status == 429:
        return HubError(name, "asks for patience (429): try again in a few minutes")
    if 400 <= status < 500:
        return HubError(name, f"refuses that ({status}): {plain(error)[:200]}")
    if status >= 500:
        return Unreachable(name, f"cannot be reached: it answers {status}")
    if "FileMetadataError" in kinds:
        return HubError(name, "answers like none: check proxy, firewall and HF_ENDPOINT")
    if _BROKEN & kinds or "Consistency check" in str(error):
        return Broken(name, "broke the connection in the middle of a file; the same command goes on from there")
    if _SILENT & kinds:
        return Unreachable(name, "does not answer: try again later, and what has arrived is kept")
    if _UNREACHABLE & kinds:
        return Unreachable(name, "cannot be reached")
    return HubError(name, f"could not be used: {type(error).__name__}: {plain(error)[:200]}")
