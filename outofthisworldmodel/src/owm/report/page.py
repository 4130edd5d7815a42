"""Reports: blocks of text, tables and figures, written as Markdown and as one self-contained HTML page."""

import base64
import html
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from owm_envs.files import write_atomically


@dataclass(frozen=True)
class Heading:
    """A section's title."""

    text: str
    level: int = 2


@dataclass(frozen=True)
class Text:
    """A paragraph; `code` and **strong** are understood."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """A list of short texts."""

    items: Sequence[str]


@dataclass(frozen=True)
class Code:
    """Lines as they are."""

    text: str


@dataclass(frozen=True)
class Table:
    """Columns and rows of text; columns of numbers are aligned to the right."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    strong: Sequence[int] = ()
    """Rows to set apart."""
    words: bool = False
    """The cells hold sentences, which may wrap."""

    def is_numeric(self, column: int) -> bool:
        """Whether a column holds numbers, or nothing, in every row."""
        return column > 0 and all(re.match(r"[-+–]?\d|–?$", row[column]) for row in self.rows)


@dataclass(frozen=True)
class Picture:
    """A PNG beside the report; the HTML page holds a copy."""

    path: Path
    caption: str


Block = Heading | Text | Bullets | Code | Table | Picture


def write_report(title: str, blocks: Sequence[Block], folder: str | os.PathLike, name: str = "report") -> list[Path]:
    """Write `name`.md and `name`.html.

    Args:
        blocks: in order; pictures lie in `folder` or below.

    Returns:
        The two paths.
    """
    folder = Path(folder)
    contents = {"md": to_markdown(title, blocks, folder), "html": to_html(title, blocks)}
    paths = [folder / f"{name}.{suffix}" for suffix in contents]
    for path, content in zip(paths, contents.values()):
        write_atomically(path, lambda file, content=content: file.write(content), text=True)
    return paths


def to_markdown(title: str, blocks: Sequence[Block], folder: Path) -> str:
    """The report as Markdown, pictures linked relative to `folder`."""
    parts = [f"# {title}"]
    for block in blocks:
        match block:
            case Heading(text, level):
                parts.append(f"{'#' * level} {text}")
            case Text(text):
                parts.append(text)
            case Bullets(items):
                parts.append("\n".join(f"- {item}" for item in items))
            case Code(text):
                parts.append(f"```\n{text}\n```")
            case Table():
                parts.append(_markdown_table(block))
            case Picture(path, caption):
                parts.append(f"![{caption}]({Path(os.path.relpath(path, folder)).as_posix()})\n\n*{caption}*")
    return "\n\n".join(parts) + "\n"


def _markdown_table(table: Table) -> str:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    rule = ["--:" if table.is_numeric(i) else "---" for i in range(len(table.columns))]
    rows = [[f"**{cell}**" if i in table.strong and cell else cell for cell in row] for i, row in enumerate(table.rows)]
    lines = [line(table.columns), line(rule), *map(line, rows)]
    return "\n".join(lines) + (f"\n\n*{table.caption}*" if table.caption else "")


def to_html(title: str, blocks: Sequence[Block]) -> str:
    """The report as one HTML page that needs nothing else, light or dark as the reader's system is."""
    headings = [block for block in blocks if isinstance(block, Heading) and block.level == 2]
    links = "\n".join(f'<a href="#{_anchor(h.text)}">{_inline(h.text)}</a>' for h in headings)
    body = "\n".join(map(_html_block, blocks))
    return _PAGE.format(title=html.escape(title), style=_STYLE, links=links, body=body)


def _html_block(block: Block) -> str:
    match block:
        case Heading(text, level):
            return f'<h{level} id="{_anchor(text)}">{_inline(text)}</h{level}>'
        case Text(text):
            return f"<p>{_inline(text)}</p>"
        case Bullets(items):
            return "<ul>" + "".join(f"<li>{_inline(item)}</li>" for item in items) + "</ul>"
        case Code(text):
            return f"<pre><code>{html.escape(text)}</code></pre>"
        case Table():
            return _html_table(block)
        case Picture(path, caption):
            data = base64.b64encode(path.read_bytes()).decode("ascii")
            image = f'<img src="data:image/png;base64,{data}" alt="{html.escape(caption, quote=True)}">'
            return f"<figure>{image}<figcaption>{_inline(caption)}</figcaption></figure>"


def _html_table(table: Table) -> str:
    kinds = [' class="number"' if table.is_numeric(i) else "" for i in range(len(table.columns))]
    head = "".join(f"<th{kind}>{_inline(text)}</th>" for kind, text in zip(kinds, table.columns))
    rows = []
    for i, row in enumerate(table.rows):
        mark = ' class="strong"' if i in table.strong else ""
        cells = "".join(f"<td{kind}>{_inline(cell)}</td>" for kind, cell in zip(kinds, row))
        rows.append(f"<tr{mark}>{cells}</tr>")
    caption = f"<figcaption>{_inline(table.caption)}</figcaption>" if table.caption else ""
    kind = ' class="words"' if table.words else ""
    table_html = f"<table{kind}><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return f'<figure class="table"><div class="scroll">{table_html}</div>{caption}</figure>'


def _inline(text: str) -> str:
    escaped = html.escape(text, quote=False)
    escaped = re.sub(r"`([^`]+)`", r"<code>\1</code>", escaped)
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", escaped)


def _anchor(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")


_STYLE = """
:root { color-scheme: light dark; --ink: #1d2430; --faint: #657084; --paper: #ffffff; --card: #f6f8fb;
  --line: #dfe4ec; --accent: #0b63a5; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ef; --faint: #97a2b4; --paper: #12161d;
  --card: #1a202a; --line: #2c3543; --accent: #6cb6f2; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1160px; margin: 0 auto; padding: 2.5rem 1.5rem 5rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .6rem; letter-spacing: -.01em; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .6rem; padding-top: .9rem; border-top: 1px solid var(--line); }
h3 { font-size: 1.05rem; margin: 1.8rem 0 .4rem; }
p, ul { max-width: 78ch; }
li { margin: .2rem 0; }
nav { display: flex; flex-wrap: wrap; gap: .35rem 1.1rem; font-size: .9rem; margin: 0 0 1.5rem; }
a { color: var(--accent); text-decoration: none; }
a:hover { text-decoration: underline; }
code { font: .88em ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; background: var(--card);
  padding: .1em .3em; border-radius: 4px; }
pre { background: var(--card); border: 1px solid var(--line); border-radius: 8px; padding: .9rem 1.1rem;
  overflow-x: auto; }
pre code { background: none; padding: 0; }
figure { margin: 1.2rem 0; }
figure img { width: 100%; height: auto; background: #fff; border: 1px solid var(--line); border-radius: 8px; }
figcaption { color: var(--faint); font-size: .88rem; margin-top: .4rem; max-width: 90ch; }
.scroll { overflow-x: auto; border: 1px solid var(--line); border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: var(--faint); background: var(--card); vertical-align: bottom; }
th, td { padding: .42rem .65rem; }
td { white-space: nowrap; border-top: 1px solid var(--line); }
.number { text-align: right; }
table.words td { white-space: normal; vertical-align: top; }
table.words td:first-child { white-space: nowrap; }
tr.strong td { font-weight: 650; background: color-mix(in srgb, var(--accent) 9%, transparent); }
""".strip()

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}
</style>
</head>
<body>
<main>
<h1>{title}</h1>
<nav>
{links}
</nav>
{body}
</main>
</body>
</html>
"""
