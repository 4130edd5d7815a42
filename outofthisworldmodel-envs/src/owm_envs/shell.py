"""What the commands `owm` and `owm-envs` share: a mistake, an interruption or a closed pipe ends in one line."""

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, NoReturn

from owm_envs.words import plain

_GRACE = 2.0
"""Seconds that an interrupted command has to unwind before it is ended."""


def run(
    prog: str, description: str, version: str, build: Callable[[list[str]], Any], arguments: list[str] | None = None
) -> None:
    """Run a command.

    Args:
        build: makes the `tyro` application for these arguments.
        arguments: those of the process when None; only then may an interruption end the process at once.

    Raises:
        SystemExit: 2 after a user's mistake, with one line that says what it is; 130 after Ctrl-C.
    """
    tolerant_output()
    alone = arguments is None
    arguments = sys.argv[1:] if arguments is None else arguments
    if arguments[:1] == ["--version"]:
        print(f"{prog} {version}")
        return
    try:
        if alone:
            _watch_interrupts()
        build(arguments).cli(prog=prog, description=description, args=arguments)
    except BrokenPipeError:
        # Whoever read the output has gone, as `head` does; nothing more to say, at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        if alone:
            _end_interrupted()
        print(_farewell, file=sys.stderr)
        raise SystemExit(130) from None
    except (ValueError, OSError, ArithmeticError, ImportError) as error:
        if os.environ.get("OWM_TRACEBACK"):
            raise
        print(f"error: {plain(error)}", file=sys.stderr)
        raise SystemExit(2) from None
    finally:
        if alone:
            end_when_interrupted()


def end_when_interrupted() -> None:
    """Let Ctrl-C end the process at once, while nothing is going on that it would have to unwind.

    For the first lines of a command: imports that are interrupted may swallow `KeyboardInterrupt`, or print it.
    """
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, lambda *_: _end_interrupted())


def resumable() -> None:
    """Say of what the command does from now on that the same command goes on where it was interrupted."""
    global _farewell
    _farewell = "interrupted: the same command goes on where it was"


_farewell = "interrupted"


def tolerant_output() -> None:
    """Let what the encoding of redirected output lacks, such as Δ on Windows, come out as "?" instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def terminal(**options: Any) -> Any:
    """A console of the rich library's that prints text as it is: brackets and colons in a path are no markup.

    Args:
        options: of `rich.console.Console`.
    """
    from rich.console import Console

    return Console(**{"markup": False, "emoji": False, "highlight": False} | options)


def _watch_interrupts() -> None:
    """Raise `KeyboardInterrupt` again, and heed Ctrl-C inside XLA too, where Python cannot raise it."""
    if threading.current_thread() is not threading.main_thread():
        return
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if os.name == "nt":
        return
    told, tell = os.pipe()
    os.set_blocking(tell, False)
    signal.set_wakeup_fd(tell, warn_on_full_buffer=False)

    report = sys.unraisablehook
    # Raised inside a destructor or a callback of the collector it is lost: the watcher ends the process then.
    sys.unraisablehook = lambda lost: None if lost.exc_type is KeyboardInterrupt else report(lost)

    def watch():
        while True:
            if os.read(told, 1) == bytes([signal.SIGINT]):
                time.sleep(_GRACE)  # the main thread ends the process itself, if it can
                _end_interrupted()

    threading.Thread(target=watch, daemon=True).start()


def _end_interrupted() -> NoReturn:
    """End the process without tearing Python down, which crashes beside threads that compile.

    Files are whole at any moment, so that nothing is left to clean up.
    """
    with contextlib.suppress(Exception):
        sys.stdout.flush()
    with contextlib.suppress(OSError):
        # Behind the terminal's ^C and a bar that was being drawn, which hides the cursor.
        os.write(2, (b"\x1b[?25h\n" if os.isatty(2) else b"") + _farewell.encode() + b"\n")
    os._exit(130)
