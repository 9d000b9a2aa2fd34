"""Short runs of soak/: what they find out in minutes, these do in seconds."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]


def run(script: str, *arguments: str) -> dict[str, Any]:
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
    assert found["acknowledged"] > 50


def test_fixes_of_fifty_phones_come_out_and_no_queue_is_left() -> None:
    found = run("load.py", "--method", "nls-onesided", "--devices", "50", "--seconds", "20")
    assert set(found["answers"]) <= {"202", "503"}
    assert found["fixes_made"] == found["accepted"] >= 50 * 20 * 5
    assert found["waiting_at_the_end"] == 0
    assert min(found["fixes_seen_of_least_and_most"]) > 0
    # How soon they come out is for `make soak` to find, on a machine that does nothing else.
    assert found["latency_p50_ms"] < 2000
