from __future__ import annotations

import importlib
import multiprocessing
import os
import re
import signal
import threading
import time
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import fploc.experiments.stages
from fploc.errors import UnknownNameError
from fploc.evaluation.revision import running_commit
from fploc.experiments.stages import PATIENCE_S, Stage, StageBook


def stage(folder: Path, name: str, done: list[str], *inputs: str, after: tuple[str, ...] = ()) -> Stage:
    output = folder / f"{name}.out"

    def run() -> None:
        done.append(name)
        output.write_text(name)

    return Stage(name=name, inputs=inputs, outputs=(output,), after=after, run=run)


def test_a_finished_stage_is_not_run_again(tmp_path: Path) -> None:
    done: list[str] = []
    stages = [stage(tmp_path, "one", done, "a"), stage(tmp_path, "two", done, "b")]
    StageBook(tmp_path / "book").run(stages)
    StageBook(tmp_path / "book").run(stages)
    assert done == ["one", "two"]


def test_changed_inputs_run_the_stage_again(tmp_path: Path) -> None:
    done: list[str] = []
    book = StageBook(tmp_path / "book")
    book.run([stage(tmp_path, "one", done, "a")])
    book.run([stage(tmp_path, "one", done, "b")])
    assert done == ["one", "one"]


def test_a_lost_output_runs_the_stage_again(tmp_path: Path) -> None:
    done: list[str] = []
    book = StageBook(tmp_path / "book")
    book.run([stage(tmp_path, "one", done, "a")])
    (tmp_path / "one.out").unlink()
    book.run([stage(tmp_path, "one", done, "a")])
    assert done == ["one", "one"]


def test_an_interrupted_run_goes_on_where_it_was(tmp_path: Path) -> None:
    done: list[str] = []

    def interrupted() -> None:
        raise KeyboardInterrupt

    first = stage(tmp_path, "one", done, "a")
    book = StageBook(tmp_path / "book")
    with pytest.raises(KeyboardInterrupt):
        book.run([first, Stage(name="two", inputs=("b",), outputs=(), after=(), run=interrupted)])
    book.run([first, stage(tmp_path, "two", done, "b")])
    assert done == ["one", "two"]


def test_what_takes_a_result_is_done_anew_with_it_even_after_an_interruption(tmp_path: Path) -> None:
    done: list[str] = []

    def stages() -> list[Stage]:
        return [
            stage(tmp_path, "train", done, "a"),
            stage(tmp_path, "score", done, "a", after=("train",)),
            stage(tmp_path, "report", done, "a", after=("score",)),
        ]

    book = StageBook(tmp_path / "book")
    book.run(stages())
    (tmp_path / "train.out").unlink()

    def interrupted() -> None:
        raise KeyboardInterrupt

    train, score, report = stages()
    with pytest.raises(KeyboardInterrupt):
        book.run([train, replace(score, run=interrupted), report])
    book.run(stages())
    assert done == ["train", "score", "report", "train", "score", "report"]


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module whose stages other processes run; they take over the path of this one."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    return importlib.import_module("work_of_stages")


def numbers(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in folder.iterdir() if file.is_file()}


def side_by_side(work: Any, make: Any, folder: Path) -> StageBook:
    """Run the stages that ``make`` makes in two processes, and return their book."""
    book = StageBook(folder / "book")
    book.run_side_by_side(make(folder), 2, partial(work.run, make, folder))
    return book


def test_two_processes_give_what_one_gives_and_keep_the_order(
    work: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone, together = tmp_path / "alone", tmp_path / "together"
    alone.mkdir()
    together.mkdir()
    StageBook(alone / "book").run(work.chain(alone))
    capsys.readouterr()
    book = side_by_side(work, work.chain, together)
    assert numbers(alone) == numbers(together) and numbers(together)["sum"] == "16"
    lines = re.findall(r"^\[\d/5\] (\S+?)( …|: [\d.]+ s)$", capsys.readouterr().err, re.MULTILINE)
    began = {name: index for index, (name, what) in enumerate(lines) if what == " …"}
    ended = {name: index for index, (name, what) in enumerate(lines) if what != " …"}
    stages = work.chain(together)
    assert set(began) == set(ended) == {one.name for one in stages}
    assert all(ended[before] < began[one.name] for one in stages for before in one.after)
    assert all(book.cost(one.name).seconds >= 0.0 for one in stages)
    assert {book.cost(one.name).commit for one in stages} == {running_commit()}
    assert book.left(stages) == []


@pytest.mark.parametrize(("given", "expected"), [(None, "3"), ("5", "5")])
def test_processes_share_the_cores_unless_told_how_many_threads_to_start(
    given: str | None, expected: str, work: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    if given is None:
        monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    else:
        monkeypatch.setenv("OMP_NUM_THREADS", given)
    side_by_side(work, work.counted, tmp_path)
    assert (tmp_path / "threads").read_text() == expected


def test_finished_stages_start_no_process(work: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    StageBook(tmp_path / "book").run(work.chain(tmp_path))
    monkeypatch.setattr(fploc.experiments.stages, "ProcessPoolExecutor", None)
    side_by_side(work, work.chain, tmp_path)


def test_independent_stages_run_at_the_same_time_in_processes_of_their_own(work: Any, tmp_path: Path) -> None:
    side_by_side(work, work.meeting, tmp_path)
    assert len({*numbers(tmp_path).values(), str(os.getpid())}) == 3


def test_a_failure_stops_all_is_told_as_it_was_and_leaves_the_finished_ones(
    work: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    began = time.monotonic()
    with pytest.raises(UnknownNameError) as failed:
        side_by_side(work, work.failing, tmp_path)
    assert time.monotonic() - began < 0.8 * PATIENCE_S, (
        "processes that did as they were told are not waited for"
    )
    assert str(failed.value) == "--plan: found 'moon', expected one of real, blank; choose one of these"
    assert (tmp_path / "slow-interrupted").exists() and not (tmp_path / "later").exists()
    left = StageBook(tmp_path / "book").left(work.failing(tmp_path))
    assert [one.name for one in left] == ["slow", "bad", "later"]
    assert multiprocessing.active_children() == []
    assert "KeyboardInterrupt" not in capfd.readouterr().err, "who has failed already is not interrupted"


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_reaches_the_stages_and_the_caller(
    work: Any, tmp_path: Path, sent: signal.Signals
) -> None:
    before = signal.getsignal(sent)

    def interrupt() -> None:
        work.wait_for(tmp_path / "slow-began")
        os.kill(os.getpid(), sent)

    person = threading.Thread(target=interrupt)
    person.start()
    with pytest.raises(KeyboardInterrupt):
        side_by_side(work, work.waiting, tmp_path)
    person.join()
    assert (tmp_path / "slow-interrupted").exists()
    assert [one.name for one in StageBook(tmp_path / "book").left(work.waiting(tmp_path))] == ["slow"]
    assert multiprocessing.active_children() == []
    assert signal.getsignal(sent) is before


def test_stages_that_end_together_with_a_failure_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both futures are there when the book looks: it must note the good one, whichever it sees first."""
    monkeypatch.setattr(fploc.experiments.stages, "ProcessPoolExecutor", EndedAtOnce)
    done: list[str] = []
    stages = [stage(tmp_path, name, done, "a") for name in ("bad", "good")]
    book = StageBook(tmp_path / "book")
    with pytest.raises(ZeroDivisionError):
        book.run_side_by_side(stages, 2, lambda name: None)
    (tmp_path / "good.out").touch()
    assert [one.name for one in book.left(stages)] == ["bad"]


class EndedAtOnce:
    """Stands in for the processes: every stage has ended before anyone looks, ``bad`` with an error."""

    def __init__(self, *_: object, **__: object) -> None:
        pass

    def submit(self, timed: object, run_by_name: object, name: str) -> Future[float]:
        future: Future[float] = Future()
        if name == "bad":
            future.set_exception(ZeroDivisionError())
        else:
            future.set_result(0.1)
        return future

    def shutdown(self, **_: object) -> None:
        pass


def test_what_is_left_is_what_is_not_done_and_everything_that_takes_its_result(tmp_path: Path) -> None:
    done: list[str] = []
    stages = [
        stage(tmp_path, "train-a", done, "a"),
        stage(tmp_path, "train-b", done, "a"),
        stage(tmp_path, "score-a", done, "a", after=("train-a",)),
        stage(tmp_path, "score-b", done, "a", after=("train-b",)),
        stage(tmp_path, "report", done, "a", after=("score-a", "score-b")),
    ]
    book = StageBook(tmp_path / "book")

    def left() -> list[str]:
        return [one.name for one in book.left(stages)]

    assert left() == [one.name for one in stages]
    book.run(stages)
    assert left() == []
    stages[1] = stage(tmp_path, "train-b", done, "other settings")
    assert left() == ["train-b", "score-b", "report"]
    (tmp_path / "score-a.out").unlink()
    assert left() == ["train-b", "score-a", "score-b", "report"]
