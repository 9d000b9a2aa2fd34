"""The documentation builds with warnings as errors, leads nowhere wrong, and loads nothing from elsewhere."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
from mkdocs.commands.build import build
from mkdocs.config import load_config

ROOT = Path(__file__).parents[1]
LOADING = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src"}


class Page(HTMLParser):
    """What a page links to, what it loads, and the anchors that it has."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = {name: value for name, value in attrs if value is not None}
        self.anchors |= {named[key] for key in ("id", "name") if key in named}
        if tag == "a" and "href" in named:
            self.links.append(named["href"])
        if tag in LOADING and LOADING[tag] in named:
            self.loaded.append(named[LOADING[tag]])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setenv("NO_MKDOCS_2_WARNING", "1")
        # Raises where anything is warned about.
        build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder), strict=True))
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path.read_text("utf-8")) for path in site.rglob("*.html") if path.name != "404.html"}


def targets(path: Path, links: list[str]) -> Iterator[tuple[Path, str]]:
    for link in links:
        parts = urlsplit(link)
        if not parts.scheme and not parts.netloc:
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            yield target / "index.html" if target.is_dir() else target, unquote(parts.fragment)


def test_every_link_leads_to_a_page_and_an_anchor(pages: dict[Path, Page]) -> None:
    wrong = [
        f"{path.name}: {target.name}#{anchor}"
        for path, page in pages.items()
        for target, anchor in targets(path.resolve(), page.links + page.loaded)
        if not target.is_file()
        or (anchor and anchor != "__top" and target in pages and anchor not in pages[target].anchors)
    ]
    assert not wrong


def test_pages_load_nothing_from_elsewhere(site: Path, pages: dict[Path, Page]) -> None:
    assert not [url for page in pages.values() for url in page.loaded if urlsplit(url).netloc]
    styles = [file.read_text("utf-8") for file in site.rglob("*.css")]
    assert styles and not [url for text in styles for url in re.findall(r"url\(\W?https?:[^)]*", text)]


def test_every_package_has_its_reference(site: Path) -> None:
    packages = {path.parent.name for path in (ROOT / "fploc").glob("*/__init__.py")}
    written = {path.stem.removeprefix("fploc.") for path in (site / "reference").glob("fploc.*.html")}
    assert packages <= written
    assert "solve_nonlinear" in (site / "reference" / "fploc.solvers.html").read_text("utf-8")


def test_formulas_are_drawn_by_the_browser_itself(site: Path) -> None:
    texts = [path.read_text("utf-8") for path in site.rglob("*.html")]
    assert sum(text.count("<math") for text in texts) > 20
    assert not [text for text in texts if ":math:" in text or 'class="arithmatex"' in text]
    # What the converter does not know it writes as it is.
    assert not re.findall(r"<m[ion]>\\\w+", "".join(texts))
