"""Stages of a long run: each is done once, and again only when something that it depends on has changed."""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fploc.files import whole


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

    def run(self, stages: Sequence[Stage]) -> None:
        """Run those of ``stages`` that are not done, in order, and say on stderr what happens."""
        for number, stage in enumerate(stages, start=1):
            label = f"[{number}/{len(stages)}] {stage.name}"
            if self.is_done(stage):
                _say(f"{label}: done before")
                continue
            _say(f"{label} …")
            self._forget([later for later in stages if stage.name in later.after])
            started = time.perf_counter()
            stage.run()
            seconds = time.perf_counter() - started
            self._write(stage, seconds)
            _say(f"{label}: {seconds:.1f} s")

    def _forget(self, stages: Sequence[Stage]) -> None:
        for stage in stages:
            self._file(stage).unlink(missing_ok=True)

    def _write(self, stage: Stage, seconds: float) -> None:
        file = self._file(stage)
        file.parent.mkdir(parents=True, exist_ok=True)
        with whole(file) as part:
            part.write_text(json.dumps({"key": stage.key, "seconds": round(seconds, 2)}) + "\n")

    def _file(self, stage: Stage) -> Path:
        return self.folder / f"{stage.name}.json"


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)  # noqa: T201
