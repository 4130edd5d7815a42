"""Tables in the terminal: results go to standard output."""

from rich.console import Console

from owm.report.page import Table
from owm.report.tables import to_rich

_WIDTH = 160
"""Columns where there is no terminal to ask."""


def print_table(table: Table, title: str = "") -> None:
    """Print a table as results are printed: to standard output."""
    terminal = Console(highlight=False)
    if not terminal.is_terminal:
        terminal = Console(highlight=False, width=_WIDTH)
    terminal.print(to_rich(table, title))
    if table.caption:
        terminal.print(table.caption, style="dim")
