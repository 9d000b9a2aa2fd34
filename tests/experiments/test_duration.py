from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest

from datamodules.measured import MeasuredDataModule
from fploc.experiments import duration
from fploc.experiments.duration import announce_duration, estimate_seconds, training_steps, virtual_draws
from fploc.experiments.plan import Learning
from fploc.experiments.preset import Preset

CHAINS = (Learning("seen", "office", 0), Learning("zero-shot", "laboratory", 0))


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory, pack: Any) -> MeasuredDataModule:
    root = tmp_path_factory.mktemp("data")
    pack(root, "office", seed=1, duration_s=15.0)
    module = MeasuredDataModule(data_root=root, batch_size=4, batches=2)
    module.setup()
    return module


def test_steps_are_counted_over_epochs_streams_targets_and_seeds(miniature: Preset) -> None:
    epochs = {"generator": 3, "gnn": 7, "fpdnn": 5, "gnn_adapted": 11, "fpdnn_adapted": 2}
    preset = replace(miniature, epochs=epochs, batches_per_epoch=10, seeds=(0, 1))
    targets = [
        Learning(protocol, "laboratory", seed)
        for protocol in ("zero-shot", "fine-tuned", "zero-shot-pooled")
        for seed in (0, 1)
    ]
    sources = [Learning("seen", "office", seed) for seed in (0, 1)]
    every = [*sources, *targets]
    assert training_steps(preset, every) == {"generator": 3 * 10 * 2, "fpdnn": 2 * (5 + 3 * 2) * 10 * 2}
    assert training_steps(preset, sources) == {"generator": 60, "fpdnn": 2 * 5 * 10 * 2}
    assert training_steps(preset, []) == {"generator": 60, "fpdnn": 0}


def test_the_estimate_is_steps_times_the_time_of_one(
    miniature: Preset, measured: MeasuredDataModule, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = []

    def two_seconds(step: Any) -> float:
        step()
        ran.append(step)
        return 2.0

    monkeypatch.setattr(duration, "_seconds", two_seconds)
    steps = training_steps(miniature, CHAINS)
    draws = virtual_draws(miniature, CHAINS)
    assert draws == miniature.pool_batches * 2 * len(miniature.seeds)
    assert estimate_seconds(miniature, measured, CHAINS, "cpu") == 2.0 * (sum(steps.values()) + draws)
    assert len(ran) == 3


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(61.2, "about 0:01:01 on this CPU"), (90_000, "about 1 day, 1:00:00 on this CPU; a GPU is advised")],
)
def test_one_line_says_how_long_it_takes(
    seconds: float,
    said: str,
    miniature: Preset,
    measured: MeasuredDataModule,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(duration, "estimate_seconds", lambda *_: seconds)
    monkeypatch.setattr(duration.torch.cuda, "is_available", lambda: False)
    announce_duration(miniature, measured, CHAINS)
    out, err = capsys.readouterr()
    assert out == "" and err == f"preset smoke: trainings take {said}\n"


def test_the_real_estimate_is_a_short_time(
    miniature: Preset, measured: MeasuredDataModule, capsys: pytest.CaptureFixture[str]
) -> None:
    announce_duration(miniature, measured, CHAINS)
    assert re.fullmatch(
        r"preset smoke: trainings take about 0:00:\d\d on this \w+\n", capsys.readouterr().err
    )
