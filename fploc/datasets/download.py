"""Fetch the public data set from GitHub: in parallel, resumable, each file verified before it gets its name.

A file arrives under ``<name>.part`` and is renamed only once its git blob SHA-1 is right, so an interrupted
download leaves nothing that looks finished; the next call goes on where the partial file ends.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from urllib.parse import quote

import httpx

from fploc.datasets.source_files import (
    REVISIONS,
    SourceFile,
    blob_sha1,
    require_usable,
    site_files,
)
from fploc.errors import DownloadError, HashMismatchError
from fploc.files import advice
from fploc.progress import track

BASE_URL = "https://raw.githubusercontent.com/haiyaoyu/RTT-Indoor-localization-data-set"
SOURCE_VARIABLE = "FPLOC_SOURCE"

_WORKERS = 8
_CHUNK_BYTES = 64 * 1024
_GONE = {HTTPStatus.NOT_FOUND, HTTPStatus.GONE}
# Answers that keep a machine out as a whole, whichever file it asks for.
_REFUSALS = {HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN, HTTPStatus.PROXY_AUTHENTICATION_REQUIRED}
_RESUME = "what has arrived is kept: call again to go on, or name a local copy with --from DIR"


class UnreachableError(DownloadError):
    """The server cannot be reached at all: it has not answered once, or refuses whatever it is asked."""


@dataclass(frozen=True)
class Patience:
    """How long to wait, in seconds, and how often to try."""

    connect_s: float = 3.0
    read_s: float = 10.0
    attempts: int = 4
    backoff_s: float = 0.5


PATIENCE = Patience()


def resolve_source(data_root: Path, given: Path | None, sites: Sequence[str]) -> Path:
    """Return the folder ``<revision>/<path>`` that holds the public files of ``sites``.

    ``given`` (``--from``) comes first, then the environment variable FPLOC_SOURCE; where either is set no
    network is used. Otherwise it is the cache ``<data_root>/source``, and what it lacks is downloaded.

    Raises:
        FplocError: If the named folder is unusable.
        UnreachableError: If files are to be downloaded and GitHub cannot be reached at all.
        DownloadError: If a file cannot be fetched for another reason.
    """
    if given is not None:
        return require_usable(given, named_by="--from")
    named = os.environ.get(SOURCE_VARIABLE, "")
    if named:
        return require_usable(Path(named), named_by=SOURCE_VARIABLE)
    return download(sites, data_root / "source")


def download(
    sites: Sequence[str],
    cache: Path,
    *,
    base_url: str = BASE_URL,
    client: httpx.Client | None = None,
    patience: Patience = PATIENCE,
) -> Path:
    """Fetch every file that ``sites`` need and ``cache`` lacks; return ``cache``; raises as ``fetch``."""
    fetch(site_files(sites), cache, base_url=base_url, client=client, patience=patience)
    return cache


def fetch(
    files: Sequence[SourceFile],
    cache: Path,
    *,
    base_url: str = BASE_URL,
    client: httpx.Client | None = None,
    patience: Patience = PATIENCE,
) -> None:
    """Bring ``files`` into ``cache``, laid out ``<revision>/<path>``; present and intact ones are kept.

    Raises:
        UnreachableError: If the server does not answer, or refuses, before anything was fetched.
        DownloadError: If the server answers, but not with a file after all attempts, or if the file
            cannot be written. What has arrived is kept, and the next call goes on from there.
        HashMismatchError: If the server sends other contents than the pinned ones.
    """
    wanted = [file for file in files if not _is_intact(file, cache)]
    if not wanted:
        return
    with nullcontext(client) if client is not None else _new_client(patience) as session:
        _require_reachable(session, _url(base_url, wanted[0]), patience)
        stop = threading.Event()
        with ThreadPoolExecutor(_WORKERS) as pool:
            jobs = [
                pool.submit(_fetch_file, file, cache, _url(base_url, file), session, patience, stop)
                for file in wanted
            ]
            try:
                for job in track(jobs, "download"):
                    job.result()
            except BaseException:
                stop.set()
                pool.shutdown(wait=False, cancel_futures=True)
                raise


class _TryAgainError(Exception):
    """The server answered, but a later attempt may get more."""


class _StoppedError(Exception):
    """Another file failed, or the user interrupted."""


def _new_client(patience: Patience) -> httpx.Client:
    timeout = httpx.Timeout(patience.read_s, connect=patience.connect_s)
    return httpx.Client(timeout=timeout, follow_redirects=True)


def _url(base_url: str, file: SourceFile) -> str:
    return f"{base_url}/{REVISIONS[file.revision]}/{quote(file.path)}"


def _is_intact(file: SourceFile, cache: Path) -> bool:
    target = file.below(cache)
    return target.is_file() and blob_sha1(target.read_bytes()) == file.blob_sha1


def _require_reachable(client: httpx.Client, url: str, patience: Patience) -> None:
    """Ask for the head of ``url`` first, so that a machine without network learns it in seconds."""
    status = _first_status(client, url, patience)
    for attempt in range(1, patience.attempts):
        if status < HTTPStatus.INTERNAL_SERVER_ERROR:
            break
        time.sleep(patience.backoff_s * 2 ** (attempt - 1))
        status = _first_status(client, url, patience)
    if status in _REFUSALS or status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        raise _unreachable(url, f"HTTP {status}")


def _first_status(client: httpx.Client, url: str, patience: Patience) -> int:
    outcome: list[int | str] = []

    def ask() -> None:
        try:
            outcome.append(client.head(url, timeout=patience.connect_s).status_code)
        except httpx.RequestError as error:
            outcome.append(_text(error))

    # A resolver without network may block for half a minute, and httpx's timeouts do not cover it.
    thread = threading.Thread(target=ask, daemon=True)
    thread.start()
    thread.join(2 * patience.connect_s)
    answer = outcome[0] if outcome else "no answer from the name server"
    if isinstance(answer, str):
        raise _unreachable(url, answer)
    return answer


def _text(error: Exception) -> str:
    return str(error) or type(error).__name__


def _unreachable(url: str, reason: str) -> UnreachableError:
    return UnreachableError(
        url, value=reason, expected="an answer from the server", way_out=f"check the network; {_RESUME}"
    )


def _refused(file: SourceFile, url: str, reason: str) -> DownloadError:
    return DownloadError(file.name, value=reason, expected=f"the whole file from {url}", way_out=_RESUME)


def _fetch_file(
    file: SourceFile,
    cache: Path,
    url: str,
    client: httpx.Client,
    patience: Patience,
    stop: threading.Event,
) -> None:
    target = file.below(cache)
    part = target.with_name(f"{target.name}.part")
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        failure = ""
        for attempt in range(patience.attempts):
            if attempt > 0:
                stop.wait(patience.backoff_s * 2 ** (attempt - 1))
            try:
                resumed = _receive(file, part, url, client, stop)
                if _finish(file, part, target, resumed=resumed):
                    return
                failure = "an incomplete file"
            except (httpx.RequestError, _TryAgainError) as error:
                failure = _text(error)
        raise _refused(file, url, failure)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise DownloadError(
            str(target),
            value=error.strerror or str(error),
            expected="a folder with room to write to",
            way_out=f"{advice(error, target)}; --data-root DIR names another folder",
        ) from error


def _receive(file: SourceFile, part: Path, url: str, client: httpx.Client, stop: threading.Event) -> bool:
    """Write to ``part`` what is missing of it; return whether an older part was continued."""
    present = part.stat().st_size if part.exists() else 0
    # Ranges count bytes of what is sent: a compressed answer could not be continued.
    headers = {"Accept-Encoding": "identity"}
    if present > 0:
        headers["Range"] = f"bytes={present}-"
    with client.stream("GET", url, headers=headers) as response:
        status = response.status_code
        if present > 0 and status == HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            return True
        _require_contents(status, file, url)
        continued = status == HTTPStatus.PARTIAL_CONTENT
        with part.open("ab" if continued else "wb") as out:
            for chunk in response.iter_raw(_CHUNK_BYTES):
                if stop.is_set():
                    raise _StoppedError(url)
                out.write(chunk)
    return continued


def _require_contents(status: int, file: SourceFile, url: str) -> None:
    if status in (HTTPStatus.OK, HTTPStatus.PARTIAL_CONTENT):
        return
    if status in _GONE:
        raise DownloadError(
            file.name,
            value=f"HTTP {status}",
            expected=f"a file of the pinned revision at {url}",
            way_out="if the repository has moved, name a local copy with --from DIR",
        )
    if status == HTTPStatus.TOO_MANY_REQUESTS or status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        raise _TryAgainError(f"HTTP {status}")
    raise _refused(file, url, f"HTTP {status}")


def _finish(file: SourceFile, part: Path, target: Path, *, resumed: bool) -> bool:
    """Give a complete ``part`` its name; return False where another attempt may complete it."""
    contents = part.read_bytes()
    found = blob_sha1(contents)
    if found == file.blob_sha1:
        part.replace(target)
        return True
    if file.size is not None and len(contents) < file.size:
        return False
    part.unlink()
    if resumed:
        return False
    raise HashMismatchError(
        target,
        algorithm="git blob SHA-1",
        found=found,
        expected=file.blob_sha1,
        way_out="the received file was deleted: a proxy may have changed it; try another network, "
        "or name a local copy with --from DIR",
    )
