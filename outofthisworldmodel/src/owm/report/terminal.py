"""Tables in the terminal: results go to standard output."""

from owm.report.page import Table
from owm.report.tables import to_rich
from owm_envs.shell import terminal

_WIDTH = 160
"""Columns where there is no terminal to ask."""


def print_table(table: Table, title: str = "") -> None:
    """Print a table as results are printed: to standard output."""
    console = terminal()
    if not console.is_terminal:
        console = terminal(width=_WIDTH)
    console.print(to_rich(table, title))
    if table.caption:
        console.print(table.caption, style="dim")
