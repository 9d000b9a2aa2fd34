from __future__ import annotations

from html.parser import HTMLParser

from fploc.datasets.pages import (
    Code,
    Grid,
    Page,
    Picture,
    Section,
    Text,
    markdown_grid,
    to_html,
    to_markdown,
    without_pictures,
)

PAGE = Page(
    "Of <metres> & more",
    [Text("See `walls.png`, **all of it**, [here](other.html) or at https://example.org/a_b.")],
    [
        Section(
            "Table", [Grid([{"name": "a|b", "n": "1,200"}, {"name": "c", "n": "–"}]), Grid([], "Nothing.")]
        ),
        Section("Pictures", [Picture("map.png", "A map")]),
        Section("How", [Code("print(1 < 2)\n", "python")]),
    ],
)


class Outline(HTMLParser):
    """Counts tags and fails where they do not nest."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_markdown_holds_every_block() -> None:
    assert to_markdown(PAGE).split("\n\n") == [
        "# Of <metres> & more",
        "See `walls.png`, **all of it**, [here](other.html) or at https://example.org/a_b.",
        "## Table",
        "| name | n |\n| --- | --- |\n| a\\|b | 1,200 |\n| c | – |",
        "Nothing.",
        "## Pictures",
        "![A map](map.png)",
        "## How",
        "```python\nprint(1 < 2)\n```\n",
    ]


def test_html_nests_escapes_and_links() -> None:
    text = to_html(PAGE)
    outline = Outline()
    outline.feed(text)
    assert not outline.open
    assert "<title>Of &lt;metres&gt; &amp; more</title>" in text and "print(1 &lt; 2)" in text
    assert "<code>walls.png</code>, <strong>all of it</strong>" in text
    links = [attrs["href"] for tag, attrs in outline.seen if tag == "a"]
    assert links == ["other.html", "https://example.org/a_b", "#table", "#pictures", "#how", "map.png"]
    assert {attrs["id"] for tag, attrs in outline.seen if tag == "section"} == {"table", "pictures", "how"}
    assert ("img", {"src": "map.png", "alt": "A map"}) in outline.seen


def test_columns_of_numbers_are_set_to_the_right() -> None:
    text = to_html(PAGE)
    assert '<th>name</th><th class="number">n</th>' in text
    assert text.count('<td class="number">') == 2


def test_a_page_needs_nothing_from_elsewhere_and_knows_dark_screens() -> None:
    text = to_html(PAGE)
    assert "<script" not in text and "<link" not in text and "url(" not in text
    assert "light-dark(" in text and 'content="light dark"' in text


def test_without_pictures_their_sections_go() -> None:
    page = without_pictures(PAGE)
    assert [section.title for section in page.sections] == ["Table", "How"]
    assert "map.png" not in to_markdown(page) + to_html(page)


def test_no_rows_make_no_table() -> None:
    assert markdown_grid([]) == ""
