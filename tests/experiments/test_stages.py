from dataclasses import replace
from pathlib import Path

import pytest

from fploc.experiments.stages import Stage, StageBook


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
