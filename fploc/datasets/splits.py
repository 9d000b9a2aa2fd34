"""Which recordings of a site are for training, validation and testing: by recording, never by sample."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from fploc.errors import UnknownNameError
from fploc.sites.registry import SPLITS, RecordingSpec

# Device and name of a recording.
RecordingKey = tuple[int, str]


@dataclass(frozen=True)
class Splits:
    """Recordings (device, name) of each part; neighbouring samples of one lap lie 2 cm apart."""

    train: tuple[RecordingKey, ...]
    validate: tuple[RecordingKey, ...]
    test: tuple[RecordingKey, ...]

    def part(self, name: str) -> tuple[RecordingKey, ...]:
        """Return the recordings of ``train``, ``validate`` or ``test``.

        Raises:
            UnknownNameError: If there is no such part.
        """
        parts = {"train": self.train, "validate": self.validate, "test": self.test}
        if name not in parts:
            raise UnknownNameError("split", name, known=list(parts), way_out="name one of them")
        return parts[name]


def make_splits(recordings: Iterable[RecordingSpec]) -> Splits:
    """Return the splits that the site file gives to the recordings that are there."""
    chosen = list(recordings)
    parts = {
        part: tuple((recording.device, recording.name) for recording in chosen if recording.split == part)
        for part in SPLITS
    }
    return Splits(train=parts["train"], validate=parts["validate"], test=parts["test"])


def splits_to_json(splits: Splits) -> dict[str, list[dict[str, Any]]]:
    """Return the splits as they stand in splits.json."""
    return {
        part: [{"device": device, "recording": name} for device, name in splits.part(part)] for part in SPLITS
    }


def splits_from_json(document: dict[str, list[dict[str, Any]]]) -> Splits:
    """Return the splits that ``splits_to_json`` wrote."""
    parts = {
        part: tuple((int(entry["device"]), str(entry["recording"])) for entry in document[part])
        for part in SPLITS
    }
    return Splits(train=parts["train"], validate=parts["validate"], test=parts["test"])
