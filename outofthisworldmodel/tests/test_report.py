from html.parser import HTMLParser

import pytest

from owm.report.page import Bullets, Code, Heading, Picture, Table, Text, write_report

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
        Text("Speeds < 1 m/s & **bold** `a<b`"),
        Heading("Docking & more"),
        Table(["policy", "x|y"], [["dock", "1"], ["pd", "2"]], "A caption", [1]),
        Bullets(["first", "second `code`"]),
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
    assert "Speeds < 1 m/s & bold a<b" in text and "Title <1>" in text and "owm demo <x>" in text
    assert len(page.images) == 1 and page.images[0].startswith("data:image/png;base64,iVBOR")
    assert page.links == ["#docking-more"] and "docking-more" in page.ids
    assert "http" not in html


def test_the_markdown_has_the_same_and_links_its_pictures(written):
    markdown, _, folder = written
    assert markdown.startswith("# Title <1>\n\nSpeeds")
    assert "| policy | x\\|y |\n| --- | --: |\n| dock | 1 |\n| **pd** | **2** |\n\n*A caption*" in markdown
    assert "(figures/a.png)" in markdown and (folder / "figures/a.png").is_file()
    assert "```\nowm demo <x>\n```" in markdown and "- first\n- second" in markdown


def test_a_missing_picture_leaves_no_report_behind(tmp_path):
    with pytest.raises(FileNotFoundError):
        write_report("Title", [Picture(tmp_path / "none.png", "")], tmp_path)
    assert not list(tmp_path.iterdir())
