"""The command ``fploc``: what becomes of words, and of what goes wrong. Sub-commands lie in ``fploc.commands``."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

from jsonargparse import ArgumentError

from fploc.commands import fit
from fploc.commands.printing import remark
from fploc.commands.registry import COMMANDS, FIT, NAMES, make_parser
from fploc.errors import FplocError
from fploc.files import advice
from fploc.progress import hush_imports
from fploc.usage import usage_message

BAD_INPUT = 2
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 2 for bad input, 130 when interrupted."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    hush_imports()
    try:
        if words[:1] == [FIT]:
            fit.run_words(words[1:])
        else:
            options = make_parser().parse_args(words)
            COMMANDS[options.command].run(options[options.command])
        sys.stdout.flush()
    except FplocError as error:
        return _refused(str(error))
    except ArgumentError as error:
        return _refused(usage_message(str(error), words, NAMES))
    except BrokenPipeError:
        # Whoever read the output has had enough; Python must not try to flush the rest.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        path = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else None
        place = "" if path is None else f"{path}: "
        reason = error.strerror or str(error)
        return _refused(f"{place}{reason}; {advice(error, path)}, and run again")
    except KeyboardInterrupt:
        remark("interrupted; the next call goes on from the last finished step")
        return INTERRUPTED
    return 0


def _refused(reason: str) -> int:
    """Say why, and return the exit code."""
    remark(reason)
    return BAD_INPUT
