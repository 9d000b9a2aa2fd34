"""Stages of a long run: each is done once, and again only when something that it depends on has changed.

Stages that do not take each other's results can run side by side in several processes.
"""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from types import FrameType

from fploc.errors import FplocError
from fploc.evaluation.revision import running_commit
from fploc.files import whole
from fploc.progress import hush_imports, is_shown

PATIENCE_S = 10.0
"""How long an interrupted process may take to clean up."""
POLL_S = 0.05
"""How often it is looked whether one has ended."""

RunByName = Callable[[str], None]
"""Runs the stage of a name in another process: it can be pickled."""


@dataclass(frozen=True)
class Stage:
    """One step of a run.

    Args:
        name: Short, used as a file name.
        inputs: Everything that its result depends on, as texts: settings, hashes of data, earlier stages.
        outputs: Files or folders that must still be there for the stage to count as done.
        after: Names of stages whose results it takes: when one of them runs again, so does this one.
        run: Does the work.
    """

    name: str
    inputs: Sequence[str]
    outputs: Sequence[Path]
    after: Sequence[str]
    run: Callable[[], None]

    @property
    def key(self) -> str:
        """Hash over the inputs."""
        return hashlib.sha256(json.dumps(list(self.inputs)).encode()).hexdigest()


@dataclass(frozen=True)
class Cost:
    """What a finished stage took.

    Args:
        seconds: From its start to its end.
        commit: Git revision of the code that ran it; None outside a checkout.
    """

    seconds: float
    commit: str | None


@contextmanager
def _interrupted_by_termination() -> Iterator[None]:
    """Take SIGTERM, which a scheduler or a container sends, as an interruption."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class StageBook:
    """Remembers finished stages in a folder, one file each.

    Args:
        folder: Where the files go.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def is_done(self, stage: Stage) -> bool:
        """Return whether ``stage`` was finished with the same inputs and its outputs are still there."""
        file = self._file(stage)
        if not file.is_file() or not all(output.exists() for output in stage.outputs):
            return False
        return bool(json.loads(file.read_text())["key"] == stage.key)

    def left(self, stages: Sequence[Stage]) -> list[Stage]:
        """Return the stages that must run: not done, or after one that must."""
        left: dict[str, Stage] = {}
        for stage in stages:
            if not self.is_done(stage) or any(name in left for name in stage.after):
                left[stage.name] = stage
        return list(left.values())

    def cost(self, name: str) -> Cost:
        """Return what the finished stage ``name`` took, and which revision of the code ran it."""
        noted = json.loads((self.folder / f"{name}.json").read_text())
        return Cost(float(noted["seconds"]), noted.get("commit"))

    def run(self, stages: Sequence[Stage]) -> None:
        """Run those of ``stages`` that are not done, in order, and say on stderr what happens."""
        left = self._announced(stages)
        labels = _labels(stages)
        began = time.perf_counter()
        for done, stage in enumerate(left):
            _say(f"{labels[stage.name]} …{_time_left(done, len(left), time.perf_counter() - began)}")
            self._forget(stage, stages)
            started = time.perf_counter()
            stage.run()
            self._finish(stage, time.perf_counter() - started, labels)

    @_interrupted_by_termination()
    def run_side_by_side(self, stages: Sequence[Stage], workers: int, run_by_name: RunByName) -> None:
        """Run those of ``stages`` that are not done in ``workers`` processes; none of them outlives this one's end.

        Args:
            stages: In an order in which they could run one after the other.
            workers: Number of processes.
            run_by_name: Runs one stage in such a process.
        """
        waiting = {stage.name: stage for stage in self._announced(stages)}
        if not waiting:
            return
        labels = _labels(stages)
        running: dict[Future[float], Stage] = {}
        began, left = time.perf_counter(), len(waiting)
        context = multiprocessing.get_context("spawn")
        threads = max(1, (os.cpu_count() or 1) // workers)
        pool = ProcessPoolExecutor(
            workers, mp_context=context, initializer=_prepare_process, initargs=(threads,)
        )
        try:
            while waiting or running:
                unfinished = set(waiting) | {stage.name for stage in running.values()}
                for stage in list(waiting.values()):
                    if len(running) < workers and not unfinished.intersection(stage.after):
                        done_before = left - len(waiting) - len(running)
                        passed_s = time.perf_counter() - began
                        _say(f"{labels[stage.name]} …{_time_left(done_before, left, passed_s)}")
                        self._forget(stage, stages)
                        running[pool.submit(_timed, run_by_name, stage.name)] = waiting.pop(stage.name)
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in sorted(done, key=_has_failed):
                    self._finish(running[future], future.result(), labels)
                    del running[future]
        except BrokenProcessPool as error:
            raise FplocError(
                f"a process of {' or '.join(stage.name for stage in running.values())}",
                value="it ended abruptly",
                expected="enough memory for all processes",
                way_out="call again with `--workers 1`; what is done is kept",
            ) from error
        except BaseException:
            # Interrupted processes end once nothing more can come, and not before.
            pool.shutdown(wait=False, cancel_futures=True)
            _interrupt_children()
            raise
        pool.shutdown()

    def _announced(self, stages: Sequence[Stage]) -> list[Stage]:
        left = self.left(stages)
        labels = _labels(stages)
        for stage in stages:
            if stage not in left:
                _say(f"{labels[stage.name]}: done before")
        return left

    def _finish(self, stage: Stage, seconds: float, labels: dict[str, str]) -> None:
        self._write(stage, seconds)
        _say(f"{labels[stage.name]}: {seconds:.1f} s")

    def _forget(self, stage: Stage, stages: Sequence[Stage]) -> None:
        """Take what takes the result of ``stage`` as not done: an interruption must not leave it standing."""
        for later in stages:
            if stage.name in later.after:
                self._file(later).unlink(missing_ok=True)

    def _write(self, stage: Stage, seconds: float) -> None:
        file = self._file(stage)
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole(file) as part:
            noted = {"key": stage.key, "seconds": round(seconds, 2), "commit": running_commit()}
            part.write_text(json.dumps(noted) + "\n")

    def _file(self, stage: Stage) -> Path:
        return self.folder / f"{stage.name}.json"


def _labels(stages: Sequence[Stage]) -> dict[str, str]:
    return {stage.name: f"[{number}/{len(stages)}] {stage.name}" for number, stage in enumerate(stages, 1)}


def _time_left(done: int, stages: int, passed_s: float) -> str:
    """Return how long the rest takes if its stages are like those done, for a person who watches."""
    if not done or not is_shown():
        return ""
    return f" (about {timedelta(seconds=round(passed_s / done * (stages - done)))} left)"


def _has_failed(future: Future[float]) -> bool:
    return future.exception() is not None


def _timed(run_by_name: RunByName, name: str) -> float:
    signal.signal(signal.SIGINT, _interrupt_once)
    started = time.perf_counter()
    try:
        run_by_name(name)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    return time.perf_counter() - started


def _prepare_process(threads: int) -> None:
    """Keep processes from crowding each other's cores and progress bars, and idle ones from complaining.

    Libraries of numbers are not imported yet: they read how many threads they may start when they are.
    """
    os.environ.setdefault("OMP_NUM_THREADS", str(threads))
    hush_imports()
    os.environ["TTY_COMPATIBLE"] = "0"
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _interrupt_once(number: int, frame: FrameType | None) -> None:
    """Let the first interruption stop the stage, and none its cleaning up."""
    signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def _interrupt_children() -> None:
    """Stop the processes of this one, first as a person would."""
    for child in multiprocessing.active_children():
        if child.pid is not None:
            os.kill(child.pid, signal.SIGINT)
    if not _children_end_within(PATIENCE_S):
        for child in multiprocessing.active_children():
            child.terminate()
        _children_end_within(math.inf)


def _children_end_within(seconds: float) -> bool:
    """Wait for all processes of this one; asked for anew, since their pool waits for them, too, and may be first."""
    until = time.monotonic() + seconds
    while children := multiprocessing.active_children():
        if time.monotonic() > until:
            return False
        children[0].join(POLL_S)
    return True


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)  # noqa: T201
