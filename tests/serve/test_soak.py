"""Short runs of soak/: what they find out in minutes, these do in seconds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run(script: str, *arguments: str) -> dict[str, object]:
    command = [sys.executable, str(ROOT / "soak" / script), *arguments]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return dict(json.loads(done.stdout.splitlines()[-1]))


def test_nothing_acknowledged_is_lost_when_the_server_is_killed() -> None:
    found = run("kills.py", "--kills", "2")
    assert (found["lost"], found["elsewhere"]) == (0, 0)
    assert isinstance(found["acknowledged"], int) and found["acknowledged"] > 50
