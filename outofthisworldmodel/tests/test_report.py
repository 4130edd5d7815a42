from html.parser import HTMLParser

import pytest
from markdown_it import MarkdownIt

from owm.report.page import Code, Picture, Table, bullets, to_html, write_report

PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c4944415408d763f8cfc0"
    "000003010100c9fe92ef0000000049454e44ae426082"
)


class Page(HTMLParser):
    """Checks that tags nest, and collects what a reader sees."""

    def __init__(self):
        super().__init__()
        self.open, self.text, self.images, self.links, self.ids, self.fetched = [], [], [], [], [], []

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag == "img":
            self.images.append(attributes["src"])
        if tag in ("script", "link", "iframe"):
            self.fetched.append(tag)
        if tag == "a":
            self.links.append(attributes["href"])
        if "id" in attributes:
            self.ids.append(attributes["id"])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture
def written(tmp_path):
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "a.png").write_bytes(PNG)
    blocks = [
        "Speeds < 1 m/s & **bold** `a < b`",
        "## Docking & more",
        Table(["policy", "x|y"], [["<b>dock</b>", "1"], ["pd", "2"]], "A caption", [1]),
        bullets(["first", "second `code`"]),
        Code("owm demo <x>"),
        Picture(tmp_path / "figures" / "a.png", 'A "picture"'),
    ]
    markdown, html = write_report("Title <1>", blocks, tmp_path)
    return markdown.read_text(encoding="utf-8"), html.read_text(encoding="utf-8"), tmp_path


def test_the_page_nests_escapes_and_needs_nothing_else(written):
    _, html, _ = written
    page = Page()
    page.feed(html)
    assert not page.open and not page.fetched
    text = "".join(page.text)
    assert "Speeds < 1 m/s & bold a < b" in text and "Title <1>" in text and "owm demo <x>" in text
    assert "<b>dock</b>" in text and "x|y" in text and '<td style="text-align:right"><strong>2</strong></td>' in html
    assert len(page.images) == 1 and page.images[0].startswith("data:image/png;base64,iVBOR")
    assert page.links == ["#docking-more"] and "docking-more" in page.ids
    assert "http" not in html


def test_the_markdown_has_the_same_and_links_its_pictures(written):
    markdown, _, folder = written
    assert markdown.startswith("# Title <1>\n\nSpeeds")
    assert (
        "| policy | x\\|y |\n| --- | --: |\n| &#60;b>dock&#60;/b> | 1 |\n| **pd** | **2** |\n\n*A caption*" in markdown
    )
    assert "(figures/a.png)" in markdown and (folder / "figures/a.png").is_file()
    assert "```\nowm demo <x>\n```" in markdown and "- first\n- second" in markdown


@pytest.mark.parametrize(
    "text",
    ["<script>alert(1)</script>", "![far](https://example.org/a.png)", "[go](javascript:alert(1))", "a <img src=x> b"],
)
def test_what_users_write_runs_and_fetches_nothing(text):
    page = Page()
    page.feed(to_html(f"# {text}\n\n{text}\n\n## {text}\n\n{Table(['policy'], [[text]], text).to_markdown()}\n", {}))
    assert not page.open and not page.fetched and not page.images
    assert all(link.startswith("#") for link in page.links)


HOSTILE = (
    "<script>alert(1)</script>",
    "`<script>",
    "\\`<script>`",
    "\\<img src=x onerror=alert(1)>",
    "```\n<script>alert(1)</script>\n```",
    "~~~\n\n<iframe src=x>",
    "a\n\n<!-- <svg onload=alert(1)>",
    "<https://example.org>",
    "|<b>`|`<?php",
    "a\n```<b>",
)


@pytest.mark.parametrize("text", HOSTILE)
def test_nothing_that_users_write_opens_a_tag_in_the_markdown(text, tmp_path):
    """As a viewer reads it that lets HTML through, whatever of ours stands before and after."""
    picture = tmp_path / "a.png"
    picture.write_bytes(PNG)
    table = Table([text, "`"], [["`", text], [text, text]], text, [1])
    blocks = [
        f"## {text}",
        f"Flown: {text} and `{text}`.",
        bullets([text, text]),
        table,
        Code(text),
        Picture(picture, text),
    ]
    markdown = write_report(text, [*blocks, *blocks], tmp_path)[0].read_text(encoding="utf-8")
    tokens = MarkdownIt("commonmark", {"html": True}).enable("table").parse(markdown)
    kinds = {each.type for token in tokens for each in (token, *(token.children or ()))}
    assert not kinds & {"html_block", "html_inline"}


def test_a_title_reads_as_it_was_written(tmp_path):
    _, page = write_report("5 <b> & `c`", ["text"], tmp_path)
    assert "<title>5 &lt;b&gt; &amp; c</title>" in page.read_text(encoding="utf-8")


def test_headings_of_one_name_have_places_of_their_own():
    page = Page()
    page.feed(to_html("# t\n\n## Same\n\n## same!\n\n## 模型\n\n## +\n", {}))
    assert len(set(page.links)) == 4 and [link.removeprefix("#") for link in page.links] == page.ids


def test_a_column_that_says_nothing_is_left_out():
    table = Table(["policy", "Δv m/s", "time s", ""], [["pd", "–", "–", ""], ["dock", "–", "9", ""]], strong=[1])
    assert table.to_markdown() == "| policy | time s |\n| --- | --: |\n| pd | – |\n| **dock** | **9** |"
    assert Table(["a", "b"], []).columns == ["a", "b"]


def test_a_missing_picture_leaves_no_report_behind(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_report("Title", [Picture(tmp_path / "none.png", "")], tmp_path)
    assert not list(tmp_path.iterdir())
