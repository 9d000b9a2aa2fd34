"""What a preset's stages have left, as pages, facts and figures."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from fploc.conf import read_conf
from fploc.datasets.packed import PackedSite
from fploc.evaluation.certainty import difference_rows, recording_rows, rows_against_best
from fploc.evaluation.chain_stages import ChainTrack, chain_stages, chain_tracks
from fploc.evaluation.complexity import complexity_rows
from fploc.evaluation.conditions import is_studied
from fploc.evaluation.error_series import ErrorSeries, read_error_series
from fploc.evaluation.evaluate import EvaluationRequest
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import TrackedRecord, read_tracked_records, write_records
from fploc.evaluation.report import headline_records, page
from fploc.experiments.figures import LABELS, Place, write_figures
from fploc.experiments.plan import SEEN, SEES_THE_PLAN, ZERO_SHOT, Scoring, is_headline
from fploc.experiments.preset import NETWORKS, Preset, read_ablation
from fploc.experiments.scoring import ready_method
from fploc.experiments.stages import Cost
from fploc.experiments.tracked_scoring import ScoreFiles
from fploc.files import whole
from fploc.filters.kalman import KalmanSettings
from fploc.methods.gnn_fpdnn import GNNFPDNN

RECORDS, PAGE, FACTS, FIGURES = "records.jsonl", "results.md", "facts.json", "figures"
SHOWN_STAGE_BY_STAGE = (SEEN, ZERO_SHOT)


class Report:
    """Everything that is written once all has been scored.

    Args:
        preset: That was run.
        source: Site that was learned from.
        packed: All packed sites at hand, by name.
        scorings: Everything that was scored.
        files: Where the scores lie; what is written goes to the same folder.
        data_root: Folder of packed sites.
        runs: Folder of runs.
    """

    def __init__(
        self,
        preset: Preset,
        source: str,
        packed: Mapping[str, PackedSite],
        scorings: Sequence[Scoring],
        files: ScoreFiles,
        data_root: Path,
        runs: Path,
    ) -> None:
        self.preset = preset
        self.source = source
        self.packed = packed
        self.scorings = scorings
        self.files = files
        self.data_root = data_root
        self.runs = runs

    def write(self, costs: Mapping[str, Cost], matches: Sequence[Path]) -> None:
        """Write records, page, facts and figures.

        Args:
            costs: What each training took, by the name of its stage.
            matches: Files with the match of generated with measured data, one for each site.
        """
        records = [
            one for scoring in self.scorings for one in read_tracked_records(self.files.records(scoring))
        ]
        places = list(self._places())
        write_records(records, self.files.folder / RECORDS)
        self._write(PAGE, page(records, preset=self.preset.name))
        facts = self._facts(places, costs, [json.loads(file.read_text()) for file in matches])
        self._write(FACTS, json.dumps(facts, indent=1) + "\n")
        studied = [one for one in records if is_studied(one.record.condition)]
        write_figures(places, self._plain(records), studied, self.files.folder / FIGURES)

    def _write(self, name: str, text: str) -> None:
        with whole(self.files.folder / name) as part:
            part.write_text(text, encoding="utf-8")

    def _plain(self, records: Sequence[TrackedRecord]) -> list[TrackedRecord]:
        """Return the records of the first seed that nothing special was done for."""
        return [one for one in headline_records(records) if one.record.seed == self.preset.seeds[0]]

    def _places(self) -> Iterator[Place]:
        """Yield every protocol and site whose recordings were localized one by one."""
        plain = [one for one in self.scorings if is_headline(one, self.preset)]
        for protocol, site in dict.fromkeys((one.protocol, one.site) for one in plain):
            errors = {
                one.method: read_error_series(self.files.errors(one))
                for one in plain
                if (one.protocol, one.site) == (protocol, site) and self.files.errors(one).is_file()
            }
            if errors:
                yield self._place(protocol, site, errors)

    def _place(self, protocol: str, site: str, errors: Mapping[str, Sequence[ErrorSeries]]) -> Place:
        place = Place(
            protocol=protocol_of(protocol, self.source),
            source=self.packed[self.source],
            target=self.packed[site],
            errors=errors,
        )
        if protocol not in SHOWN_STAGE_BY_STAGE or SEES_THE_PLAN not in errors:
            return place
        chain, tracks = self._chain(protocol, site)
        return replace(place, chain=chain, tracks=tracks)

    def _chain(self, protocol: str, site: str) -> tuple[GNNFPDNN, list[ChainTrack]]:
        """Return the chain ready for a target, and what each of its stages makes of the recordings."""
        request = EvaluationRequest(
            protocol, site, preset=self.preset.name, seed=self.preset.seeds[0], source=self.source
        )
        ready = ready_method(SEES_THE_PLAN, request, None, self.data_root, self.runs)
        assert isinstance(ready.method, GNNFPDNN)
        target = self.packed[site]
        recordings = protocol_of(protocol, self.source).testing(target, "all")
        thinned = [one.thinned(self.preset.thins[0]) for one in recordings]
        settings = KalmanSettings.for_speed(request.speed_prior)
        return ready.method, chain_tracks(ready.method, target.site, thinned, ready.offsets, settings)

    def _facts(
        self, places: Sequence[Place], costs: Mapping[str, Cost], matches: Sequence[dict[str, Any]]
    ) -> dict[str, Any]:
        """Return what the results page says beside the records, as plain JSON values."""
        specs = {f"{name}-paper": read_conf("model", f"{name}-paper") for name in NETWORKS}
        return {
            "complexity": complexity_rows(self.preset.network_specs | specs),
            "generator_match": list(matches),
            "chain_stages": [
                {
                    "protocol": place.protocol.name,
                    "site": place.target.site.name,
                    "device": device,
                    "labels": LABELS,
                    **chain_stages(
                        [one for one in place.tracks if one.recording.device == device],
                        place.target.site,
                        LABELS,
                    ),
                }
                for place in places
                for device in sorted({one.recording.device for one in place.tracks})
            ],
            "differences": _by_place(places, lambda errors: difference_rows(errors, base=SEES_THE_PLAN)),
            "against_best": _by_place(places, rows_against_best),
            "recordings": _by_place(places, recording_rows),
            "training_cost": [{"stage": name} | asdict(cost) for name, cost in costs.items()],
            "ablations": {name: read_ablation(name).reason for name in self.preset.ablations},
        }


def _by_place(
    places: Sequence[Place],
    rows_of: Callable[[Mapping[str, Sequence[ErrorSeries]]], list[dict[str, Any]]],
) -> list[dict[str, Any]]:
    return [
        {"protocol": place.protocol.name, "site": place.target.site.name, **row}
        for place in places
        for row in rows_of(place.errors)
    ]
