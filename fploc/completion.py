"""Completion scripts for shells: what the parser knows, and the names of methods, protocols, sites and presets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from jsonargparse import ArgumentParser

from fploc.conf import conf_folder


def completion_script(parser: ArgumentParser, shell: str) -> str:
    """Return the script for ``shell``, ``bash`` or ``zsh``; the parser is of no use afterwards."""
    names = {option: known() for option, known in _NAMES.items()}
    for one in _parsers(parser):
        for action in one._actions:
            if action.dest in names and action.option_strings:
                action.choices = names[action.dest]
    script: str = parser.get_completion_script(f"shtab-{shell}")
    return script


def _parsers(parser: ArgumentParser) -> Iterator[ArgumentParser]:
    yield parser
    if parser._subcommands_action is not None:
        for one in parser._subcommands_action._name_parser_map.values():
            yield from _parsers(one)


def _methods() -> Sequence[str]:
    from fploc.experiments.scoring import METHODS

    return METHODS


def _protocols() -> Sequence[str]:
    from fploc.evaluation.protocols import PROTOCOLS

    return [one.name for one in PROTOCOLS]


def _sites() -> Sequence[str]:
    from fploc.sites.registry import known_sites

    return list(known_sites())


def _presets() -> Sequence[str]:
    return sorted(file.name.removesuffix(".yaml") for file in (conf_folder() / "preset").iterdir())


_NAMES: Mapping[str, Callable[[], Sequence[str]]] = {
    "method": _methods,
    "methods": _methods,
    "protocol": _protocols,
    "site": _sites,
    "sites": _sites,
    "source": _sites,
    "preset": _presets,
    "device": lambda: ("1", "2", "all"),
    "labels": lambda: ("published", "repaired", "both"),
}
"""What may stand behind an option: offered, not demanded, since a site may be a file and names may be listed."""
