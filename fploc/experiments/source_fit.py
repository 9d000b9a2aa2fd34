"""Makes methods ready that learn from source recordings whenever they are asked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from fploc.calibration.offsets import LABELS, RangeOffsets, SourceRecordings
from fploc.calibration.ranges import recorded_intervals
from fploc.errors import FplocError
from fploc.evaluation.protocols import EvaluationProtocol, Targets
from fploc.methods.interface import Examples, Method, SourceFitted


def examples_of(source: SourceRecordings, offsets: RangeOffsets) -> Examples:
    """Return the recordings of a source site with calibrated ranges and repaired ground truth."""
    intervals = recorded_intervals(source.recordings, source.site, offsets)
    labels = [one.labels_m(LABELS) for one in source.recordings]
    longest = max(len(one) for one in labels)
    filled = [np.pad(one, [(0, longest - len(one)), (0, 0)], constant_values=np.nan) for one in labels]
    devices = torch.tensor([one.device for one in source.recordings])
    return Examples(source.site, source.plan, intervals, torch.from_numpy(np.stack(filled, axis=1)), devices)


def fitted_on(method: SourceFitted, sources: Sequence[SourceRecordings], offsets: RangeOffsets) -> Method:
    """Return a method that has learned from source recordings, their offsets removed."""
    return method.fitted([examples_of(one, offsets) for one in sources])


def check_protocol(method: SourceFitted, protocol: EvaluationProtocol) -> None:
    """Raise where a method that learns places is asked for another site than that of its places.

    Raises:
        FplocError: Naming the protocols that it can run in.
    """
    if method.learns_places and protocol.targets is not Targets.SOURCE:
        raise FplocError(
            f"--protocol with --method {method.name}",
            value=protocol.name,
            expected="seen, since it knows only places that it has been to",
            way_out="write `--protocol seen --site office`, or choose another method",
        )
