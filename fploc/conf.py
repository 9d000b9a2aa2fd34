"""YAML of conf/: found in a checkout or in an installed wheel, and made into objects."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, TypeVar

import yaml

from fploc.errors import BadFileError, UnknownNameError

Made = TypeVar("Made")


def conf_folder() -> Traversable:
    """Return conf/ of the wheel (``fploc/_conf``), or of the checkout that this module lies in."""
    packaged = resources.files("fploc") / "_conf"
    return packaged if packaged.is_dir() else Path(__file__).parents[1] / "conf"


def read_conf(group: str, name: str) -> dict[str, Any]:
    """Return ``conf/<group>/<name>.yaml``.

    Raises:
        UnknownNameError: If there is no such file.
        BadFileError: If it is no YAML or no mapping.
    """
    folder = conf_folder() / group
    file = folder / f"{name}.yaml"
    if not file.is_file():
        known = sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir())
        raise UnknownNameError(f"conf/{group}", name, known=known, way_out="name one of these")
    try:
        document = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadFileError(
            f"conf/{group}/{name}.yaml",
            "whole file",
            value=" ".join(str(error).split()),
            expected="YAML",
            way_out="correct the file",
        ) from error
    if not isinstance(document, dict):
        raise BadFileError(
            f"conf/{group}/{name}.yaml",
            "whole file",
            value=type(document).__name__,
            expected="a mapping",
            way_out="correct the file",
        )
    return document


def instantiate(kind: type[Made], spec: dict[str, Any], *, source: str = "configuration") -> Made:
    """Return the object that ``class_path`` and ``init_args`` of ``spec`` describe.

    Args:
        kind: Class that the object must have.
        spec: Its description.
        source: Where the description stands, for messages.

    Raises:
        BadFileError: If an argument is unknown, missing or of the wrong type.
    """
    from jsonargparse import ArgumentError, ArgumentParser

    parser = ArgumentParser(exit_on_error=False)
    parser.add_argument("--made", type=kind)
    try:
        return parser.instantiate(parser.parse_object({"made": spec})).made
    except ArgumentError as error:
        raise BadFileError(
            source,
            f"{spec.get('class_path')}, init_args",
            value=" ".join(str(error).replace("made.", "").split()),
            expected=f"what {kind.__name__} takes",
            way_out="correct the configuration",
        ) from error
