"""Errors of every interval of a scoring, on disk: what figures and comparisons of methods are made from."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fploc.errors import BadFileError, MissingFileError
from fploc.evaluation.metrics import arc_length_m, held_error_series_m
from fploc.files import whole
from fploc.localizer import Track

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_BY_INTERVAL = ("t_s", "unfiltered_m", "filtered_m", "fixed")


@dataclass(frozen=True, eq=False)
class ErrorSeries:
    """Errors of one recording, last fix held; NaN before the first fix and where there is no label.

    Args:
        device: 1 or 2.
        recording: Name of the recording.
        arc_length_m: Length of the labelled path, metres.
        t_s: Device time, shape (T,), seconds.
        unfiltered_m: Errors of the method's own fixes, shape (T,), metres.
        filtered_m: Errors behind the Kalman filter, shape (T,), metres; a method that filters by itself has
            no other filter behind it and both are equal.
        fixed: True where the method has a fix of its own, shape (T,).
    """

    device: int
    recording: str
    arc_length_m: float
    t_s: Floats
    unfiltered_m: Floats
    filtered_m: Floats
    fixed: Bools


def error_series(track: Track, labels: str) -> ErrorSeries:
    """Return the errors of a track against the ground truth ``published`` or ``repaired``."""
    truth = track.recording.labels_m(labels)
    return ErrorSeries(
        device=track.recording.device,
        recording=track.recording.name,
        arc_length_m=arc_length_m(truth),
        t_s=track.t_s,
        unfiltered_m=held_error_series_m(track.unfiltered, truth),
        filtered_m=held_error_series_m(track.once_filtered, truth),
        fixed=track.unfiltered.fixed,
    )


def pooled_errors_m(series: Sequence[ErrorSeries], device: int, *, filtered: bool) -> Floats:
    """Return the scored errors of all recordings of a device, shape (N,), metres."""
    chosen = [one.filtered_m if filtered else one.unfiltered_m for one in series if one.device == device]
    pooled = np.concatenate(chosen) if chosen else np.empty(0)
    return pooled[np.isfinite(pooled)]


def write_error_series(series: Sequence[ErrorSeries], path: Path) -> None:
    """Write the errors of at least one recording as a NumPy archive (.npz), in one move."""
    arrays = {name: np.concatenate([getattr(one, name) for one in series]) for name in _BY_INTERVAL}
    with whole(path) as part, part.open("wb") as file:
        np.savez_compressed(
            file,
            device=np.array([one.device for one in series]),
            recording=np.array([one.recording for one in series]),
            arc_length_m=np.array([one.arc_length_m for one in series]),
            intervals=np.array([len(one.t_s) for one in series]),
            t_s=arrays["t_s"],
            unfiltered_m=arrays["unfiltered_m"],
            filtered_m=arrays["filtered_m"],
            fixed=arrays["fixed"],
        )


def read_error_series(path: Path) -> list[ErrorSeries]:
    """Return what ``write_error_series`` wrote.

    Raises:
        MissingFileError: If there is no such file.
        BadFileError: If it holds no error series.
    """
    way_out = "make it again: fploc reproduce"
    if not path.is_file():
        raise MissingFileError(path, expected="errors of every interval", way_out=way_out)
    try:
        with np.load(path) as stored:
            ends = np.cumsum(stored["intervals"])[:-1]
            split = {name: np.split(stored[name], ends) for name in _BY_INTERVAL}
            return [
                ErrorSeries(
                    device=int(device),
                    recording=str(recording),
                    arc_length_m=float(length),
                    t_s=split["t_s"][index],
                    unfiltered_m=split["unfiltered_m"][index],
                    filtered_m=split["filtered_m"][index],
                    fixed=split["fixed"][index],
                )
                for index, (device, recording, length) in enumerate(
                    zip(stored["device"], stored["recording"], stored["arc_length_m"], strict=True)
                )
            ]
    except (ValueError, KeyError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise BadFileError(
            path,
            "whole file",
            value=f"{type(error).__name__} {error}",
            expected="errors of every interval",
            way_out=way_out,
        ) from error
