"""Write CONFORMANCE.md: every model with what it is held against, and the largest error that its tests measured.

    python astrojax/tools/conformance_page.py          # write
    python astrojax/tools/conformance_page.py --check  # fail if the page is out of date

Rows come from `MODELS` in `tests/cases_*.py`, beside the cases of the same models.
"""

import runpy
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "CONFORMANCE.md"
COLUMNS = ("room", "model", "source", "held against", "error or tolerance", "range")
HEAD = """# Conformance

`python astrojax/tools/conformance_page.py` writes this page from the tests' own tables. Errors are the largest that
the tests measured in float64, unless a cell says otherwise. Where none was recorded, the test's tolerance stands. The
models that the docking environments fly on are in the [README](README.md#models).

"""


def page() -> str:
    """The page's text."""
    topics = (runpy.run_path(str(path)) for path in sorted((ROOT / "tests").glob("cases_*.py")))
    rows = sorted((tuple(row) for topic in topics for row in topic.get("MODELS", ())), key=lambda row: row[0])
    lines = [COLUMNS, ("---",) * len(COLUMNS), *rows]
    return HEAD + "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def main() -> None:
    text = page()
    if "--check" in sys.argv[1:]:
        if PAGE.read_text(encoding="utf-8") != text:
            sys.exit(f"{PAGE.name} is out of date: python {Path(__file__).name}")
    else:
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
