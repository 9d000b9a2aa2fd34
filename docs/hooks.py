"""What the documentation needs beyond its pages: formulas as MathML, and a reference page for each package."""

from __future__ import annotations

import html
import re
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PACKAGES = ("fploc", "datamodules")
REFERENCE = "reference"
INDEX = f"{REFERENCE}/index.md"
DISPLAY = re.compile(r'<div class="arithmatex">\\\[(.*?)\\\]</div>', flags=re.DOTALL)
INLINE = re.compile(r'<span class="arithmatex">\\\((.*?)\\\)</span>', flags=re.DOTALL)
ROLE = re.compile(r":math:<code>(.*?)</code>", flags=re.DOTALL)


def reference_pages(root: Path) -> dict[str, str]:
    """Return the text of a page for each package and for each module beside packages, by its file name."""
    pages = {}
    for package in PACKAGES:
        parts = [part for part in sorted((root / package).iterdir()) if not part.name.startswith("_")]
        modules = [part.stem for part in parts if part.suffix == ".py"]
        folders = [part.name for part in parts if (part / "__init__.py").is_file()]
        names = [f"{package}.{name}" for name in sorted([*modules, *folders])] if folders else [package]
        pages |= {f"{REFERENCE}/{name}.md": f"::: {name}\n" for name in names}
    listed = "\n".join(f"- [`{Path(page).stem}`]({Path(page).name})" for page in pages)
    index = (
        "# Python reference\n\nMade from the docstrings. "
        f"Axes, units and frames: [conventions](../conventions.md).\n\n{listed}\n"
    )
    return {INDEX: index, **pages}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """List the reference pages where the navigation names their index."""
    root = Path(config.config_file_path).parent
    listed = [{Path(page).stem: page} for page in list(reference_pages(root))[1:]]
    for chapter in config.nav:
        for pages in chapter.values() if isinstance(chapter, dict) else ():
            for entry in pages if isinstance(pages, list) else ():
                if entry == {"Python": INDEX}:
                    entry["Python"] = [INDEX, *listed]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the reference."""
    for name, text in reference_pages(Path(config.config_file_path).parent).items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn formulas into MathML, which browsers draw by themselves."""
    content = DISPLAY.sub(lambda found: _mathml(found[1], "block"), content)
    return ROLE.sub(
        lambda found: _mathml(found[1], "inline"),
        INLINE.sub(lambda found: _mathml(found[1], "inline"), content),
    )


def _mathml(formula: str, display: str) -> str:
    return convert(html.unescape(formula).strip(), display=display)
