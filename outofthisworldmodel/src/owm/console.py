"""Messages and progress bars of the commands; results go to standard output, these to standard error."""

import contextlib
from collections.abc import Callable, Iterator

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
)

from owm_envs.shell import terminal

console = terminal(stderr=True)


def announce(text: str, style: str | None = None) -> None:
    """Say what begins."""
    console.print(text, style=style, soft_wrap=True)


@contextlib.contextmanager
def bar(description: str, unit: str = "") -> Iterator[Callable[..., None]]:
    """Show a progress bar while the block runs; call the yielded function with (done, total, note)."""
    columns = [
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=28),
        MofNCompleteColumn(),
        TextColumn(f"{unit} {{task.fields[note]}}", markup=False),
        TimeElapsedColumn(),
    ]
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(description, total=None, note="")

        def update(done: float, total: float, note: str = "") -> None:
            progress.update(task, completed=done, total=total, note=note)

        yield update


@contextlib.contextmanager
def flying(name: str, flights: int, slots: int) -> Iterator[Callable[[int, int, int, int], None]]:
    """A bar for `fly_episodes`: decisions of all batches, the first of which waits for the compiler."""
    batches = -(-flights // slots)
    with bar(f"flying {name}", "decisions") as update:
        update(0, 0, "compiling")

        def progress(before: int, decision: int, decisions: int, running: int) -> None:
            # A batch that ends early has all its decisions behind it.
            done = before // slots * decisions + (decision if running else decisions)
            update(done, batches * decisions, f"{running} flying")

        yield progress
