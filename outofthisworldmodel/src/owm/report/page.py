"""Reports: written once, in Markdown; the HTML page is that Markdown with its pictures inside."""

import base64
import html
import itertools
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

from owm_envs.files import write_atomically
from owm_envs.words import inert


@dataclass(frozen=True)
class Table:
    """Columns and rows of text; columns of numbers are aligned to the right, those that say nothing are left out."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    strong: Sequence[int] = ()
    """Rows to set apart."""

    def __post_init__(self):
        said = [
            i for i in range(len(self.columns)) if not self.rows or any(row[i] not in ("", "–") for row in self.rows)
        ]
        object.__setattr__(self, "columns", [self.columns[i] for i in said])
        object.__setattr__(self, "rows", [[row[i] for i in said] for row in self.rows])

    def is_numeric(self, column: int) -> bool:
        """Whether a column holds numbers, or nothing, in every row."""
        return column > 0 and all(re.match(r"[-+–]?\d|–?$", row[column]) for row in self.rows)

    def to_markdown(self) -> str:
        """The table, and its caption in italics."""
        rule = ["--:" if self.is_numeric(i) else "---" for i in range(len(self.columns))]
        rows = [[f"**{c}**" if i in self.strong and c else c for c in row] for i, row in enumerate(self.rows)]
        texts = [[" ".join(inert(cell).split()) for cell in row] for row in (self.columns, rule, *rows)]
        cells = [[text.replace("|", "\\|") for text in row] for row in texts]
        lines = "\n".join(f"| {' | '.join(row)} |" for row in cells)
        return f"{lines}\n\n*{inert(self.caption)}*" if self.caption else lines


@dataclass(frozen=True)
class Picture:
    """A PNG beside the report; the HTML page holds a copy."""

    path: Path
    caption: str


@dataclass(frozen=True)
class Code:
    """Lines as they are."""

    text: str

    def to_markdown(self) -> str:
        """The lines between fences that none of them can close."""
        fence = "`" * max(3, 1 + max(map(len, re.findall("`+", self.text)), default=0))
        return f"{fence}\n{self.text}\n{fence}"


Block = str | Table | Picture | Code
"""Markdown without HTML in it, or what is written as such."""


def bullets(items: Sequence[str]) -> str:
    """A list of short texts."""
    return "\n".join(f"- {item}" for item in items)


def write_report(title: str, blocks: Sequence[Block], folder: str | os.PathLike, name: str = "report") -> list[Path]:
    """Write `name`.md and `name`.html.

    Args:
        blocks: in order; pictures lie in `folder` or below.

    Returns:
        The two paths.
    """
    folder, parts, pictures = Path(folder), [inert(f"# {' '.join(title.split())}")], {}
    for block in blocks:
        match block:
            case Picture(path, caption):
                link = _MARKDOWN.normalizeLink(Path(os.path.relpath(path, folder)).as_posix())
                pictures[link] = path
                parts.append(inert(f"![{caption}]({link})\n\n*{caption}*"))
            case str():
                parts.append(inert(block))
            case _:
                parts.append(block.to_markdown())
    markdown = "\n\n".join(parts) + "\n"
    contents = {"md": markdown, "html": to_html(markdown, pictures)}
    paths = [folder / f"{name}.{suffix}" for suffix in contents]
    for path, content in zip(paths, contents.values()):
        write_atomically(path, lambda file, content=content: file.write(content), text=True)
    return paths


def to_html(markdown: str, pictures: Mapping[str, Path]) -> str:
    """Markdown that opens with its title as one HTML page that needs nothing else, light or dark as the reader's is.

    Args:
        pictures: PNG by the link in the Markdown; other images are left out but for their captions.
    """
    tokens, links, anchors = _MARKDOWN.parse(markdown), [], {""}
    render = _MARKDOWN.renderer
    for opening, inline in itertools.pairwise(tokens):
        for token in inline.children or ():
            if token.type == "image" and (path := pictures.get(token.attrs["src"])):
                token.attrs["src"] = f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
            elif token.type == "image":
                token.type = "text"
        if opening.type == "heading_open" and opening.tag == "h2":
            anchor = re.sub(r"[\W_]+", "-", inline.content.lower()).strip("-")
            while anchor in anchors:
                anchor += "-"
            anchors.add(anchor)
            opening.attrSet("id", anchor)
            links.append(f'<a href="#{anchor}">{render.renderInline(inline.children, _MARKDOWN.options, {})}</a>')
    head, body = (render.render(some, _MARKDOWN.options, {}) for some in (tokens[:3], tokens[3:]))
    title = html.escape("".join(token.content for token in tokens[1].children))
    return _PAGE.format(title=title, style=_STYLE, head=head, links="\n".join(links), body=body)


_MARKDOWN = MarkdownIt("commonmark", {"html": False, "xhtmlOut": False}).enable("table")
_MARKDOWN.add_render_rule("table_open", lambda *_: '<div class="scroll"><table>\n')
_MARKDOWN.add_render_rule("table_close", lambda *_: "</table></div>\n")


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
p:has(> img) { max-width: none; margin: 1.2rem 0 .4rem; }
img { width: 100%; height: auto; background: #fff; border: 1px solid var(--line); border-radius: 8px; }
p > em:only-child { color: var(--faint); font-size: .88rem; font-style: normal; }
.scroll { overflow-x: auto; border: 1px solid var(--line); border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; color: var(--faint); background: var(--card); vertical-align: bottom; }
th, td { padding: .42rem .65rem; }
td { vertical-align: top; border-top: 1px solid var(--line); }
td:first-child, td[style] { white-space: nowrap; }
td:last-child:not([style]) { min-width: 14rem; }
tr:has(td:first-child > strong) td { background: color-mix(in srgb, var(--accent) 9%, transparent); }
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
{head}<nav>
{links}
</nav>
{body}
</main>
</body>
</html>
"""
