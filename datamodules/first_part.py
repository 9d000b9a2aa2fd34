"""The first part of a target's paths as batches, for fine-tuning; the second part is for testing."""

from __future__ import annotations

from pathlib import Path

import lightning.pytorch as pl
from torch.utils.data import DataLoader

from fploc.calibration.offsets import RangeOffsets
from fploc.calibration.ranges import calibrated_plan_ranges
from fploc.datasets.loaders import ordered_batches, random_batches
from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.path_parts import FITTED_SHARE, first_share, only
from fploc.datasets.recordings import Recording
from fploc.datasets.samples import LabelledIntervals, MeasuredIntervals
from fploc.errors import FplocError
from fploc.evaluation.protocols import EvaluationProtocol


class FirstPartDataModule(pl.LightningDataModule):
    """First parts of the paths of all recordings of a target; the last fifth of each validates.

    Args:
        protocol: That cuts the paths (``EvaluationProtocol.parts``).
        site: Name of the target.
        offsets: Range offsets that the networks to be tuned were trained behind.
        data_root: Folder of packed sites.
        labels: ``published`` or ``repaired``.
        batch_size: Intervals of a training batch.
        batches: Training batches of an epoch.
        seed: Seed of the order of training batches.
    """

    def __init__(
        self,
        protocol: EvaluationProtocol,
        site: str,
        offsets: RangeOffsets,
        data_root: Path = Path("data"),
        labels: str = "repaired",
        batch_size: int = 64,
        batches: int = 50,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.protocol = protocol
        self.site = site
        self.offsets = offsets
        self.data_root = data_root
        self.labels = labels
        self.batch_size = batch_size
        self.batches = batches
        self.seed = seed
        self.packed: PackedSite | None = None

    def setup(self, stage: str | None = None) -> None:
        """Read the target."""
        self.packed = read_packed(self.data_root, self.site)

    def recordings(self, part: str) -> list[Recording]:
        """Return what networks learn from (``train``) or are validated on (``validate``).

        Raises:
            FplocError: If no path there is known well enough to be cut.
        """
        assert self.packed is not None, "setup() comes first"
        recordings = self.packed.recordings()
        parts = self.protocol.parts(recordings, self.packed.site)
        index = {"train": 0, "validate": 1}[part]
        shares = [
            first_share(first, one, FITTED_SHARE)[index]
            for (first, _), one in zip(parts, recordings, strict=True)
        ]
        found = only(recordings, shares)
        if not found:
            raise FplocError(
                f"fine-tuning at {self.site}",
                value="no recording whose path is known",
                expected="ground truth along paths that can be cut into two parts",
                way_out="choose another site or another protocol",
            )
        return found

    def streams(self, seed: int) -> dict[str, DataLoader[LabelledIntervals]]:
        """Return the stream of training batches in the order that ``seed`` gives."""
        batches = random_batches(
            self.intervals("train"), batch_size=self.batch_size, batches=self.batches, seed=seed
        )
        return {"target": batches}

    def train_dataloader(self) -> dict[str, DataLoader[LabelledIntervals]]:
        """Return the stream of training batches, by name as tasks take it."""
        return self.streams(self.seed)

    def val_dataloader(self) -> DataLoader[LabelledIntervals]:
        """Return what validates in order."""
        return ordered_batches(self.intervals("validate"), batch_size=self.batch_size)

    def intervals(self, part: str) -> MeasuredIntervals:
        """Return the calibrated intervals of ``train`` or ``validate``."""
        assert self.packed is not None, "setup() comes first"
        recordings = self.recordings(part)
        site = self.packed.site
        ranges = [calibrated_plan_ranges(one, site, self.offsets) for one in recordings]
        return MeasuredIntervals(recordings, ranges, site, self.packed.plan, self.labels)
