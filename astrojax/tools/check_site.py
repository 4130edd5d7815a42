"""Look over the built site: every public name, program, output and picture is there, no docstring is left as typed.

    python astrojax/tools/check_site.py

`nox -s docs` builds the site first.
"""

import html
import re
import types
from pathlib import Path

import astrojax

ROOT = Path(__file__).parents[1]
SITE = ROOT / "build" / "docs"
ROOMS = {name: getattr(astrojax, name) for name in astrojax.__all__}
ROOMS |= {"sgp4": astrojax.orbits.sgp4, "atmosphere": astrojax.forces.atmosphere}
TYPED = r".*(?:`|(?:Args|Returns|Raises|Attributes|Fields):$).*"


def public(room: types.ModuleType) -> list[str]:
    """Names that the reference owes its reader; rooms in rooms have pages of their own."""
    names = getattr(room, "__all__", [name for name in vars(room) if name.isupper()])
    return [name for name in names if not isinstance(getattr(room, name), types.ModuleType)]


def missing(room: types.ModuleType, page: str) -> list[str]:
    """Public names that a page has no anchor of."""
    anchors = set(re.findall(r'id="([\w.]+)"', page))
    # A function with the name of its file is found there.
    return [n for n in public(room) if not {f"{room.__name__}.{n}", f"{room.__name__}.{n}.{n}"} & anchors]


def prose(page: str) -> str:
    """What a page says outside code, headings of sections aside."""
    body = re.search(r"<article.*?</article>", page, re.DOTALL)[0]
    body = re.sub(
        r"<(code|pre|strong)\b.*?</\1>|<(?:span|p) class=\"doc-section-title\">.*?</(?:span|p)>",
        "",
        body,
        flags=re.DOTALL,
    )
    return html.unescape(re.sub(r"<[^>]+>", "", body))


def main() -> None:
    wrong, count = [], 0
    for name, room in ROOMS.items():
        page = (SITE / "reference" / f"{name}.html").read_text(encoding="utf-8")
        count += len(public(room))
        wrong += [f"{name}.html: one line of two attributes: {text}" for text in re.findall(r">(\w+,)</", page)]
        wrong += [f"{room.__name__}.{lost} is not in the reference" for lost in missing(room, page)]
        wrong += [
            f"{name}.html: as typed: {line.strip()[:100]!r}" for line in re.findall(TYPED, prose(page), re.MULTILINE)
        ]
    guide = sorted((SITE / "guide").glob("*.html"))
    for file in guide:
        page = file.read_text(encoding="utf-8")
        pictures = re.findall(r'<img[^>]+src="(made/[^"]+)"', page)
        if not pictures or not all((file.parent / picture).is_file() for picture in pictures):
            wrong.append(f"{file.name}: no picture, or one that is not there")
        shown = html.unescape(re.sub(r"<[^>]+>", "", page))
        for source in (ROOT / "examples" / f"{file.stem}.py", ROOT / "docs" / "guide" / "made" / f"{file.stem}.txt"):
            if source.read_text(encoding="utf-8").strip() not in shown:
                wrong.append(f"{file.name}: does not show {source.name}")
    if wrong:
        raise SystemExit("\n".join(wrong))
    print(f"{count} public names in the reference, {len(guide)} pages in the guide")


if __name__ == "__main__":
    main()
