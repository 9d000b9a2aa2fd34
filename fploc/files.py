"""Files that are there whole or not at all, and what to do where one cannot be written."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_FULL = {errno.ENOSPC, errno.EFBIG, errno.EDQUOT}
_FORBIDDEN = {errno.EACCES, errno.EPERM, errno.EROFS}


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Yield a name beside ``path`` to write to; it becomes ``path`` when all went well, else it goes.

    Raises:
        OSError: If it cannot be written; it names ``path``.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        yield part
        part.replace(path)
    except OSError as error:
        if error.filename is None or Path(error.filename) == part:
            error.filename = str(path)
        raise
    finally:
        with suppress(OSError):
            part.unlink()


def advice(error: OSError, path: Path | None) -> str:
    """Return what a user can do about ``error``, met at ``path`` where that is known."""
    if error.errno in _FULL:
        return "free some space"
    if error.errno in _FORBIDDEN:
        return "name a folder that can be written to"
    if path is None or error.errno not in (errno.ENOENT, errno.ENOTDIR, errno.EEXIST, errno.EISDIR):
        return "name another place"
    if error.errno == errno.EISDIR:
        return f"{path} is a folder: name a file"
    first = next((folder for folder in reversed(path.parents) if not folder.is_dir()), None)
    if first is None:
        return "name another place"
    if first.exists():
        return f"{first} is no folder: name another"
    return f"{first} does not exist: make the folder or name another"
