"""Pages of text, tables, pictures and code, written as Markdown or as one HTML file without scripts."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

STYLE = "card.css"


@dataclass(frozen=True)
class Text:
    """A paragraph; ``code``, **bold** and links as in Markdown."""

    text: str


@dataclass(frozen=True)
class Grid:
    """A table of rows of equal keys; what it says instead where there is no row."""

    rows: Sequence[Mapping[str, str]]
    without_rows: str = "None."


@dataclass(frozen=True)
class Picture:
    """An image file, named from the page's own folder."""

    file: str
    caption: str


@dataclass(frozen=True)
class Code:
    """Lines of a program."""

    text: str
    language: str


Block = Text | Grid | Picture | Code


@dataclass(frozen=True)
class Section:
    """A part of a page under its own title."""

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A page.

    Args:
        title: Its title.
        lead: What stands before the first section.
        sections: Its sections.
    """

    title: str
    lead: Sequence[Block]
    sections: Sequence[Section]


def without_pictures(page: Page) -> Page:
    """Return a page for where no picture lies beside it; sections of pictures alone go."""
    sections = [Section(one.title, _unpictured(one.blocks)) for one in page.sections]
    return Page(page.title, _unpictured(page.lead), [one for one in sections if one.blocks])


def to_markdown(page: Page) -> str:
    """Return a page as Markdown."""
    parts = [f"# {page.title}\n", *map(_markdown_block, page.lead)]
    for section in page.sections:
        parts += [f"## {section.title}\n", *map(_markdown_block, section.blocks)]
    return "\n".join(parts)


def to_html(page: Page) -> str:
    """Return a page as HTML with its style inside, for light and dark screens and for paper."""
    entries = "".join(
        f'<li><a href="#{_anchor(section.title)}">{html.escape(section.title)}</a></li>'
        for section in page.sections
    )
    sections = "".join(
        f'<section id="{_anchor(section.title)}">\n<h2>{html.escape(section.title)}</h2>\n'
        f"{''.join(map(_html_block, section.blocks))}</section>\n"
        for section in page.sections
    )
    style = resources.files("fploc.datasets").joinpath(f"files/{STYLE}").read_text(encoding="utf-8")
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{html.escape(page.title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>\n"
        f"<h1>{html.escape(page.title)}</h1>\n{''.join(map(_html_block, page.lead))}"
        f"<nav><ul>{entries}</ul></nav>\n{sections}</main>\n</body>\n</html>\n"
    )


def markdown_grid(rows: Sequence[Mapping[str, str]]) -> str:
    """Return rows of equal keys as a Markdown table; nothing for no rows."""
    if not rows:
        return ""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *(list(row.values()) for row in rows)]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def _unpictured(blocks: Sequence[Block]) -> list[Block]:
    return [block for block in blocks if not isinstance(block, Picture)]


def _markdown_block(block: Block) -> str:
    match block:
        case Text(text):
            return f"{text}\n"
        case Grid(rows, without_rows):
            return markdown_grid(rows) or f"{without_rows}\n"
        case Picture(file, caption):
            return f"![{caption}]({file})\n"
        case Code(text, language):
            return f"```{language}\n{text}```\n"


def _html_block(block: Block) -> str:
    match block:
        case Text(text):
            return f"<p>{_inline(text)}</p>\n"
        case Grid(rows, without_rows):
            return _html_grid(rows) if rows else f"<p>{_inline(without_rows)}</p>\n"
        case Picture(file, caption):
            shown = html.escape(caption)
            return (
                f'<figure><a href="{html.escape(file)}"><img src="{html.escape(file)}" alt="{shown}"></a>'
                f"<figcaption>{shown}</figcaption></figure>\n"
            )
        case Code(text, language):
            return f'<pre><code class="language-{language}">{html.escape(text)}</code></pre>\n'


def _html_grid(rows: Sequence[Mapping[str, str]]) -> str:
    numeric = [
        all(_is_number(value) for value in column)
        for column in zip(*(row.values() for row in rows), strict=True)
    ]
    classes = [' class="number"' if one else "" for one in numeric]
    head = "".join(f"<th{kind}>{_inline(name)}</th>" for name, kind in zip(rows[0], classes, strict=True))
    body = "".join(
        "<tr>"
        + "".join(f"<td{kind}>{_inline(cell)}</td>" for cell, kind in zip(row.values(), classes, strict=True))
        + "</tr>\n"
        for row in rows
    )
    return (
        f'<div class="table" tabindex="0"><table>\n<thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}</tbody></table></div>\n"
    )


def _is_number(cell: str) -> bool:
    return bool(re.fullmatch(r"–|[+−-]?[\d,]*\.?\d+( %)?", cell))


def _inline(text: str) -> str:
    shown = re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text))
    shown = re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", shown)
    shown = re.sub(r"\[([^\]]+)\]\(([^)\s]+)\)", r'<a href="\2">\1</a>', shown)
    return re.sub(r"(?<![\"'>])(https://[^\s<]*[^\s<.,;:])", r'<a href="\1">\1</a>', shown)


def _anchor(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
