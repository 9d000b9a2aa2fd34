"""`fploc tune`: settings of a method, chosen on the source alone, with the same number of trials for every method.

The objective is the mean logarithm of the RMSE, last fix held, on the recordings that validate at the source
(repaired labels), each run as recorded and with every tenth interval (the robot then goes as fast as people do), with
all access points and with each of them silent half of the time, as they are where rooms are many. Offsets, and what
methods learn of the source, come from its training recordings.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import yaml

from fploc.calibration.offsets import ESTIMATORS, LABELS, NONE, RangeOffsets, SourceRecordings, fit_offsets
from fploc.conf import conf_folder
from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.recordings import Recording
from fploc.errors import FplocError, UnknownNameError
from fploc.evaluation.metrics import score
from fploc.evaluation.protocols import PUBLIC_SOURCE
from fploc.experiments.search_spaces import SPACES, Choice, Count, Dimension, Interval
from fploc.experiments.source_fit import fitted_on
from fploc.files import whole
from fploc.filters.kalman import KalmanSettings
from fploc.localizer import localize
from fploc.methods.interface import SourceFitted
from fploc.methods.registry import made
from fploc.progress import track

EVERY = (1, 10)
SILENCE_S = 5.0
"""Mean time that an access point of the second kind of runs answers, and that it is silent."""
NOTHING_FOUND_M = 100.0
"""Error of settings with which a run has no fix at all."""
ORIGIN = "# Tuned: "

Setting = float | int | str


@dataclass(frozen=True)
class Tuned:
    """What tuning found.

    Args:
        settings: By key.
        before: RMSE of the settings in the file, geometric mean over all runs, metres.
        after: RMSE of those found, metres.
        text: The method's file with them.
    """

    settings: Mapping[str, Setting]
    before: float
    after: float
    text: str


def method_file(name: str) -> Path:
    """Return conf/method/<name>.yaml of the checkout.

    Raises:
        FplocError: If fploc runs from an installed wheel, whose files are not to be written.
    """
    folder = conf_folder()
    if not isinstance(folder, Path) or folder.name.startswith("_"):
        raise FplocError(
            "fploc tune",
            value="an installed package without conf/",
            expected="a checkout, whose conf/ it writes",
            way_out="run it in one",
        )
    return folder / "method" / f"{name}.yaml"


def tune(name: str, *, trials: int, seed: int, data_root: Path, source: str = PUBLIC_SOURCE) -> Tuned:
    """Return the best settings of a method among those in its file and so many others.

    Args:
        name: Of the method.
        trials: How many settings to try; the first are those in its file.
        seed: Of the search.
        data_root: Folder of packed sites.
        source: Site to choose on.

    Raises:
        UnknownNameError: If there is nothing to tune by that name.
        FplocError: If ``trials`` is below 1, or the source is not packed or has nothing to validate on.
    """
    if name not in SPACES:
        raise UnknownNameError(
            "--method", name, known=list(SPACES), way_out="others choose their settings in training"
        )
    if trials < 1:
        raise FplocError("--trials", value=trials, expected="1 or more", way_out="write for example 40")
    text = method_file(name).read_text(encoding="utf-8")
    trial_runs = _Runs.of(read_packed(data_root, source))
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    study.enqueue_trial(_settings_in(text, SPACES[name]))

    def objective(trial: optuna.Trial) -> float:
        settings = {dimension.key: _suggested(trial, dimension) for dimension in SPACES[name]}
        return trial_runs.error(name, yaml.safe_load(_with_settings(text, settings)))

    for _ in track(range(trials), f"tune {name}"):
        study.optimize(objective, n_trials=1)
    best = {key: _rounded(value) for key, value in study.best_params.items()}
    before, after = (math.exp(value) for value in (study.trials[0].value or 0.0, study.best_value))
    origin = [
        f"{ORIGIN}`fploc tune --method {name} --trials {trials} --seed {seed}` on {trial_runs.names},",
        f"{ORIGIN}RMSE {before:.3f} -> {after:.3f} m: {', '.join(best)}.",
    ]
    return Tuned(best, before, after, _with_origin(_with_settings(text, best), origin))


def write_tuned(name: str, tuned: Tuned) -> Path:
    """Write what tuning found to the method's file, in one move, and return its path."""
    file = method_file(name)
    with whole(file) as part:
        part.write_text(tuned.text, encoding="utf-8")
    return file


@dataclass(frozen=True)
class _Runs:
    """What settings are tried on.

    Args:
        packed: The source.
        training: Its recordings to learn from.
        offsets: Range offsets fitted on its recordings to learn from, by estimator.
        recordings: Its recordings to validate on, in every condition.
        names: Of these for the origin.
    """

    packed: PackedSite
    training: list[Recording]
    offsets: Mapping[str, RangeOffsets]
    recordings: list[Recording]
    names: str

    @classmethod
    def of(cls, packed: PackedSite) -> _Runs:
        every = packed.recordings()
        training = [one for one in every if (one.device, one.name) in packed.splits.train]
        validating = [one for one in every if (one.device, one.name) in packed.splits.validate]
        if not training or not validating:
            raise FplocError(
                f"fploc tune on {packed.site.name}",
                value=f"{len(training)} recordings to learn from, {len(validating)} to validate on",
                expected="at least one of each",
                way_out="build the site with all its files",
            )
        whole_ones = [one.thinned(every) for one in validating for every in EVERY]
        sparse = [with_silences(one, seed) for seed, one in enumerate(whole_ones)]
        names = ", ".join(f"{packed.site.name}/{one.device}/{one.name}" for one in validating)
        offsets = {
            estimator: RangeOffsets(estimator, 0.0)
            if estimator == NONE
            else fit_offsets(estimator, training, packed.site, packed.plan)
            for estimator in ESTIMATORS
        }
        return cls(packed, training, offsets, [*whole_ones, *sparse], names)

    def error(self, name: str, description: Mapping[str, Any]) -> float:
        """Return the mean logarithm of the RMSE of a method with such settings."""
        method = made(name, description)
        offsets = self.offsets[method.default_calibration]
        if isinstance(method, SourceFitted):
            learned = SourceRecordings(self.training, self.packed.site, self.packed.plan)
            method = fitted_on(method, [learned], offsets)
        tracks = localize(method, self.packed.site, self.recordings, offsets, KalmanSettings())
        logarithms = []
        for one in tracks:
            rmse_m = score([one.once_filtered], [one.recording.labels_m(LABELS)]).rmse_m
            logarithms.append(math.log(rmse_m if math.isfinite(rmse_m) else NOTHING_FOUND_M))
        return float(np.mean(logarithms))


def with_silences(recording: Recording, seed: int) -> Recording:
    """Return a recording whose access points answer and are silent in turn, each for ``SILENCE_S`` on average."""
    generator = np.random.default_rng(seed)
    spans, access_points = 4 + 4 * math.ceil(np.ptp(recording.t_s) / SILENCE_S), recording.heard.shape[1]
    ends = generator.exponential(SILENCE_S, (access_points, spans)).cumsum(axis=1) + recording.t_s[0]
    first = generator.random(access_points) < 0.5
    turns = np.stack([np.searchsorted(one, recording.t_s) for one in ends], axis=1)
    return recording.hearing((turns % 2 == 0) == first)


def _suggested(trial: optuna.Trial, dimension: Dimension) -> Setting:
    """Return what the search wants to try."""
    match dimension:
        case Interval(key, low, high, is_log):
            return _rounded(trial.suggest_float(key, low, high, log=is_log))
        case Count(key, low, high):
            return trial.suggest_int(key, low, high, log=True)
        case Choice(key, options):
            return str(trial.suggest_categorical(key, options))


def _rounded(value: Setting) -> Setting:
    """Return a number with three digits, as it is tried and written."""
    return float(f"{value:.3g}") if isinstance(value, float) else value


def _pattern(key: str) -> re.Pattern[str]:
    return re.compile(rf"(?<![\w-]){key}: ([^,}}\n]+)")


def _settings_in(text: str, space: Sequence[Dimension]) -> dict[str, Setting]:
    """Return the settings of a space as they stand in a method's file."""
    found: dict[str, Setting] = {}
    for dimension in space:
        values = _pattern(dimension.key).findall(text)
        assert len(values) == 1, f"{dimension.key} must stand once"
        found[dimension.key] = yaml.safe_load(values[0])
    return found


def _with_settings(text: str, settings: Mapping[str, Setting]) -> str:
    """Return a method's file with other settings, its comments kept."""
    for key, value in settings.items():
        text = _pattern(key).sub(f"{key}: {_written(value)}", text)
    return text


def _written(value: Setting) -> str:
    """Return a setting as YAML 1.1 reads it back: a number with an exponent needs its point."""
    text = str(value)
    return (
        text.replace("e", ".0e", 1) if isinstance(value, float) and "e" in text and "." not in text else text
    )


def _with_origin(text: str, origin: Sequence[str]) -> str:
    """Return a method's file that says how it was tuned, and that once."""
    lines = [line for line in text.splitlines() if not line.startswith(ORIGIN)]
    return "\n".join([*origin, *lines]) + "\n"
