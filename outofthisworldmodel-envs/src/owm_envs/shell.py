"""What the commands `owm` and `owm-envs` share: a mistake, an interruption or a closed pipe ends in one line."""

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
    if alone:
        _watch_interrupts()
    try:
        build(arguments).cli(prog=prog, description=description, args=arguments)
    except BrokenPipeError:
        # Whoever read the output has gone, as `head` does; nothing more to say, at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        if alone:
            _end_interrupted()
        print("interrupted", file=sys.stderr)
        raise SystemExit(130) from None
    except (ValueError, OSError, ArithmeticError, ImportError) as error:
        if os.environ.get("OWM_TRACEBACK"):
            raise
        print(f"error: {plain(error)}", file=sys.stderr)
        raise SystemExit(2) from None


def tolerant_output() -> None:
    """Let what the encoding of redirected output lacks, such as Δ on Windows, come out as "?" instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


def _watch_interrupts() -> None:
    """Heed Ctrl-C while the main thread is inside XLA, where Python cannot raise `KeyboardInterrupt`."""
    if threading.current_thread() is not threading.main_thread() or os.name == "nt":
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
    sys.stdout.flush()
    os.write(2, b"\ninterrupted: the same command goes on where it was\n")
    os._exit(130)
