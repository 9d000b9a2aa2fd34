import errno
from pathlib import Path

import pytest

from fploc.files import whole


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "one.txt"
    with whole(path) as part:
        part.write_text("half")
        assert not path.exists()
    assert path.read_text() == "half" and list(tmp_path.iterdir()) == [path]


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "one.txt"
    path.write_text("before")
    with pytest.raises(OSError, match="full"), whole(path) as part:
        part.write_text("half")
        raise OSError(errno.ENOSPC, "full")
    assert path.read_text() == "before" and list(tmp_path.iterdir()) == [path]
