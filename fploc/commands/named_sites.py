"""Sites that the option ``--sites`` names."""

from __future__ import annotations

from collections.abc import Sequence

from jsonargparse import Namespace

from fploc.errors import FplocError, UnknownNameError

SITE_FILES = (".yaml", ".yml")


def named_sites(text: str | None, also: Sequence[str] = ()) -> list[str]:
    """Return the sites that ``--sites`` names, each once; None stands for the whole registry.

    Args:
        text: Names or site files, separated by commas.
        also: Names that may be given beside those of the registry.

    Raises:
        UnknownNameError: If a site is unknown.
        FplocError: If none is named.
    """
    from fploc.sites.registry import known_sites

    known = list(dict.fromkeys((*known_sites(), *also)))
    if text is None:
        return list(known_sites())
    names = list(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if not names:
        raise FplocError(
            "--sites",
            value=repr(text),
            expected=f"names separated by commas, of {', '.join(known)}",
            way_out="or leave it out for all sites",
        )
    for name in names:
        if name not in known and not name.endswith(SITE_FILES):
            raise UnknownNameError(
                "--sites", name, known=known, way_out="or give the path of a site file (.yaml)"
            )
    return names


def packed_names(options: Namespace) -> list[str]:
    """Return the packed sites that ``--sites`` names; all of them without it."""
    from fploc.datasets.packed import packed_sites

    sites = packed_sites(options.data_root)
    if options.sites is None:
        return sites
    return [_packed_name(name) for name in named_sites(options.sites, also=sites)]


def _packed_name(name_or_file: str) -> str:
    from fploc.sites.registry import load_spec

    return load_spec(name_or_file).site.name if name_or_file.endswith(SITE_FILES) else name_or_file
