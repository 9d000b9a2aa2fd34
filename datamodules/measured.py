"""Measured recordings of one site as batches: built where missing, split, calibrated."""

from __future__ import annotations

from pathlib import Path

import lightning.pytorch as pl
from torch.utils.data import DataLoader

from fploc.calibration.offsets import RangeOffsets, fit_offsets
from fploc.calibration.ranges import calibrated_plan_ranges
from fploc.datasets.build import build_sites
from fploc.datasets.download import resolve_source
from fploc.datasets.loaders import ordered_batches, random_batches
from fploc.datasets.packed import PackedSite, packed_folder, read_packed
from fploc.datasets.recordings import Recording
from fploc.datasets.samples import LabelledIntervals, MeasuredIntervals


class MeasuredDataModule(pl.LightningDataModule):
    """Recordings of a source site.

    ``prepare_data`` builds the packed site where it is missing. ``setup`` splits by recording, fits range
    offsets on the training recordings alone and applies them to all.

    Args:
        data_root: Folder of packed sites.
        site: Name of the source site.
        source: Local copy of the public files; None looks at FPLOC_SOURCE, the cache, then GitHub.
        calibration: How range offsets are fitted (``fploc.calibration``).
        labels: ``published`` or ``repaired``.
        batch_size: Intervals of a training batch.
        batches: Training batches of an epoch.
        seed: Seed of the order of training batches.
        offsets_file: Offsets fitted and saved before; None fits them in ``setup``.
        validation_thin: Every so many-th interval validates.
    """

    def __init__(
        self,
        data_root: Path = Path("data"),
        site: str = "office",
        source: Path | None = None,
        calibration: str = "source-los",
        labels: str = "repaired",
        batch_size: int = 64,
        batches: int = 50,
        seed: int = 0,
        offsets_file: Path | None = None,
        validation_thin: int = 1,
    ) -> None:
        super().__init__()
        self.data_root = data_root
        self.site = site
        self.source = source
        self.calibration = calibration
        self.labels = labels
        self.batch_size = batch_size
        self.batches = batches
        self.seed = seed
        self.offsets_file = offsets_file
        self.validation_thin = validation_thin
        self.packed: PackedSite | None = None
        self.offsets: RangeOffsets | None = None

    def prepare_data(self) -> None:
        """Build the packed site where it is missing."""
        if not packed_folder(self.data_root, self.site).is_dir():
            source = resolve_source(self.data_root, self.source, [self.site])
            build_sites(source, self.data_root, [self.site])

    def setup(self, stage: str | None = None) -> None:
        """Split the recordings, fit the offsets on the training part or load them, and apply them."""
        self.packed = read_packed(self.data_root, self.site)
        self.offsets = (
            self.fitted_offsets() if self.offsets_file is None else RangeOffsets.load(self.offsets_file)
        )

    def fitted_offsets(self) -> RangeOffsets:
        """Return offsets fitted on the training recordings."""
        assert self.packed is not None, "setup() comes first"
        return fit_offsets(self.calibration, self.recordings("train"), self.packed.site, self.packed.plan)

    def recordings(self, part: str) -> list[Recording]:
        """Return the recordings of ``train``, ``validate`` or ``test``."""
        assert self.packed is not None, "setup() comes first"
        chosen = self.packed.splits.part(part)
        every = self.validation_thin if part == "validate" else 1
        recordings = [one for one in self.packed.recordings() if (one.device, one.name) in chosen]
        return [one.thinned(every) for one in recordings]

    def intervals(self, part: str) -> MeasuredIntervals:
        """Return the calibrated intervals of a part."""
        assert self.packed is not None and self.offsets is not None, "setup() comes first"
        recordings = self.recordings(part)
        site = self.packed.site
        ranges = [calibrated_plan_ranges(one, site, self.offsets) for one in recordings]
        return MeasuredIntervals(recordings, ranges, site, self.packed.plan, self.labels)

    def train_dataloader(self) -> dict[str, DataLoader[LabelledIntervals]]:
        """Return the stream of training batches, by name as tasks take it."""
        return self.streams(self.seed)

    def streams(self, seed: int) -> dict[str, DataLoader[LabelledIntervals]]:
        """Return the stream of training batches in the order that ``seed`` gives."""
        batches = random_batches(
            self.intervals("train"), batch_size=self.batch_size, batches=self.batches, seed=seed
        )
        return {"measured": batches}

    def val_dataloader(self) -> DataLoader[LabelledIntervals]:
        """Return the validation recordings in order."""
        return ordered_batches(self.intervals("validate"), batch_size=self.batch_size)
