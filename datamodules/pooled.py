"""Measured recordings of several sites as one stream of batches, places and devices balanced."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import lightning.pytorch as pl
from torch.utils.data import DataLoader

from fploc.calibration.offsets import RangeOffsets, SourceRecordings, fit_pooled_offsets
from fploc.calibration.ranges import calibrated_plan_ranges
from fploc.datasets.loaders import balanced_batches, ordered_batches
from fploc.datasets.packed import PackedSite, read_packed
from fploc.datasets.recordings import Recording
from fploc.datasets.samples import LabelledIntervals, MeasuredIntervals
from fploc.errors import FplocError


class PooledDataModule(pl.LightningDataModule):
    """All recordings of packed source sites; one of the sites validates.

    Each batch comes from one recording device of one site: places are drawn alike, then the sites of a place,
    then the devices there. Sites of one floor are one place. Range offsets are fitted on the training sites.

    Args:
        sites: Names of the source sites.
        validation_site: One of them, which networks do not learn from.
        data_root: Folder of packed sites.
        calibration: How range offsets are fitted (``fploc.calibration``).
        labels: ``published`` or ``repaired``.
        batch_size: Intervals of a training batch.
        batches: Training batches of an epoch.
        seed: Seed of the order of training batches.
        offsets_file: Offsets fitted and saved before; None fits them in ``setup``.

    Raises:
        FplocError: If the validation site is not among the sites, or is all of them.
    """

    def __init__(
        self,
        sites: Sequence[str],
        validation_site: str,
        data_root: Path = Path("data"),
        calibration: str = "source-los",
        labels: str = "repaired",
        batch_size: int = 64,
        batches: int = 50,
        seed: int = 0,
        offsets_file: Path | None = None,
    ) -> None:
        super().__init__()
        if validation_site not in sites or len(set(sites)) < 2:
            raise FplocError(
                "validation_site",
                value=validation_site,
                expected=f"one of at least two sites, which are {', '.join(sites) or 'none'}",
                way_out="name a site of `sites`, and one more to learn from",
            )
        self.sites = tuple(sites)
        self.validation_site = validation_site
        self.data_root = data_root
        self.calibration = calibration
        self.labels = labels
        self.batch_size = batch_size
        self.batches = batches
        self.seed = seed
        self.offsets_file = offsets_file
        self.packed: dict[str, PackedSite] = {}
        self.offsets: RangeOffsets | None = None

    def setup(self, stage: str | None = None) -> None:
        """Read the sites, and fit the offsets on those that networks learn from or load them."""
        self.packed = {name: read_packed(self.data_root, name) for name in self.sites}
        self.offsets = (
            self.fitted_offsets() if self.offsets_file is None else RangeOffsets.load(self.offsets_file)
        )

    def fitted_offsets(self) -> RangeOffsets:
        """Return offsets fitted on the recordings of the training sites."""
        learned = [self.packed[name] for name in self.sites if name != self.validation_site]
        return fit_pooled_offsets(
            self.calibration,
            [SourceRecordings(one.recordings(), one.site, one.plan) for one in learned],
        )

    def recordings(self, part: str) -> list[Recording]:
        """Return the recordings of ``train`` or ``validate``."""
        return [one for packed in self._part(part) for one in packed.recordings()]

    def streams(self, seed: int) -> dict[str, DataLoader[LabelledIntervals]]:
        """Return the stream of training batches in the order that ``seed`` gives."""
        places: dict[str, list[list[MeasuredIntervals]]] = {}
        for packed in self._part("train"):
            places.setdefault(packed.site.place, []).append(self._by_device(packed))
        batches = balanced_batches(
            list(places.values()), batch_size=self.batch_size, batches=self.batches, seed=seed
        )
        return {"measured": batches}

    def train_dataloader(self) -> dict[str, DataLoader[LabelledIntervals]]:
        """Return the stream of training batches, by name as tasks take it."""
        return self.streams(self.seed)

    def val_dataloader(self) -> DataLoader[LabelledIntervals]:
        """Return the recordings of the validation site in order."""
        (packed,) = self._part("validate")
        return ordered_batches(self._intervals(packed, packed.recordings()), batch_size=self.batch_size)

    def _part(self, part: str) -> list[PackedSite]:
        validates = {"train": False, "validate": True}[part]
        return [self.packed[name] for name in self.sites if (name == self.validation_site) == validates]

    def _by_device(self, packed: PackedSite) -> list[MeasuredIntervals]:
        recordings = packed.recordings()
        devices = sorted({one.device for one in recordings})
        return [
            self._intervals(packed, [one for one in recordings if one.device == device]) for device in devices
        ]

    def _intervals(self, packed: PackedSite, recordings: Sequence[Recording]) -> MeasuredIntervals:
        assert self.offsets is not None, "setup() comes first"
        ranges = [calibrated_plan_ranges(one, packed.site, self.offsets) for one in recordings]
        return MeasuredIntervals(recordings, ranges, packed.site, packed.plan, self.labels)
