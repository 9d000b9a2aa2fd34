"""Every kind of training and scoring of a preset, end to end on made-up buildings, and what each may see."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file

import fploc.experiments.reproduce
from fploc.datasets.packed import MANIFEST, packed_folder, read_packed
from fploc.datasets.path_parts import halves
from fploc.datasets.recordings import Recording
from fploc.evaluation.protocols import protocol_of
from fploc.evaluation.records import Record, read_tracked_records
from fploc.experiments.preset import Preset, read_ablation
from fploc.experiments.reproduce import Reproduction, run_stage
from fploc.experiments.scoring import BEFORE_TUNING
from fploc.experiments.stages import StageBook
from fploc.experiments.world import World

SOURCE, TARGET, VALIDATES, POOLED_TOO = "office", "laboratory", "library", "shopping-mall"
WORLD = World(SOURCE, (TARGET, VALIDATES, POOLED_TOO), made_up=False)
PLACES = {
    "seen": f"full/seen/{SOURCE}",
    "zero-shot": f"full/zero-shot/{TARGET}",
    "fine-tuned": f"full/fine-tuned/{TARGET}",
    "zero-shot-pooled": f"full/zero-shot-pooled/{TARGET}",
}
Bools = NDArray[np.bool_]
Weights = dict[str, torch.Tensor]


@dataclass(frozen=True)
class Done:
    """A reproduction of which every stage has run."""

    root: Path
    runs: Path
    made: Reproduction

    def weights(self, place: str, method: str = "gnn-fpdnn") -> Weights:
        """Return every weight of an artifact, by file and name."""
        folder = self.runs / "artifacts" / place / method / "seed-0"
        return {
            f"{file.name}/{name}": value
            for file in sorted(folder.glob("*.safetensors"))
            for name, value in load_file(file).items()
        }

    def described(self, place: str) -> dict[str, Any]:
        """Return what stands beside the weights of an artifact."""
        file = self.runs / "artifacts" / place / "gnn-fpdnn" / "seed-0" / "artifact.json"
        return dict(json.loads(file.read_text(encoding="utf-8")))

    def records(self, scoring: str) -> list[Record]:
        """Return the records of a scoring, repaired labels alone."""
        tracked = read_tracked_records(self.made.folder / "scores" / f"{scoring}--seed-0.jsonl")
        return [one.record for one in tracked if one.record.labels == "repaired"]


def reproduction(preset: Preset, root: Path, runs: Path) -> Reproduction:
    protocols = {name: list(sites) for name, sites in preset.protocols.items()}
    return Reproduction(preset, WORLD, protocols, root, runs)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, every_kind: Preset, pack: Any) -> Done:
    root, runs = tmp_path_factory.mktemp("data"), tmp_path_factory.mktemp("runs")
    pack(root, SOURCE, seed=1, duration_s=20.0)
    pack(root, TARGET, seed=2, laps=2, duration_s=60.0)
    pack(root, VALIDATES, seed=3, laps=1, duration_s=12.0)
    pack(root, POOLED_TOO, seed=4, laps=1, duration_s=12.0)
    made = reproduction(every_kind, root, runs)
    StageBook(made.folder / "stages").run(made.stages())
    return Done(root, runs, made)


def trained(made: Reproduction, runs: Path) -> Done:
    """Return a reproduction that has trained everything and scored nothing."""
    wanted = [one for one in made.stages() if one.name.startswith(("calibrate--", "train--"))]
    StageBook(made.folder / "stages").run(wanted)
    return Done(made.data_root, runs, made)


def alike(one: Weights, other: Weights) -> bool:
    """Return whether all weights are the same to the bit."""
    assert one.keys() == other.keys() and one
    return all(torch.equal(value, other[name]) for name, value in one.items())


def part(weights: Weights, network: str) -> Weights:
    return {name: value for name, value in weights.items() if name.startswith(f"{network}.")}


def test_every_stage_is_done_and_nothing_is_left(done: Done) -> None:
    stages = done.made.stages()
    assert StageBook(done.made.folder / "stages").left(stages) == []
    trainings = {stage.name for stage in stages if stage.name.startswith("train--")}
    ablated = {
        f"train--{name}--{place}--seed-0"
        for name in ("bare-distance", "measured-only", "linear-solver")
        for place in (f"seen--{SOURCE}", f"zero-shot--{TARGET}")
    }
    plain = {f"train--{protocol}--{TARGET}--seed-0" for protocol in PLACES if protocol != "seen"}
    assert trainings == {
        "train--generator--seed-0",
        f"train--seen--{SOURCE}--seed-0",
        *plain,
        *ablated,
        f"train--virtual-only--zero-shot--{TARGET}--seed-0",
    }


def test_facts_say_why_each_ablation_is_there_and_what_each_training_took(done: Done) -> None:
    facts = json.loads((done.made.folder / "facts.json").read_text(encoding="utf-8"))
    assert facts["ablations"] == {name: read_ablation(name).reason for name in done.made.preset.ablations}
    stages = [stage.name for stage in done.made.stages() if stage.name.startswith("train--")]
    assert [one["stage"] for one in facts["training_cost"]] == stages


def test_each_artifact_names_the_recordings_that_it_learned_from(done: Done) -> None:
    learned = {
        protocol: {name.split("/")[0] for name in done.described(place)["recordings"]}
        for protocol, place in PLACES.items()
    }
    assert learned == {
        "seen": {SOURCE},
        "zero-shot": {SOURCE},
        "fine-tuned": {SOURCE, TARGET},
        "zero-shot-pooled": {SOURCE, POOLED_TOO},
    }
    tested = {name for _, name in read_packed(done.root, SOURCE).splits.test}
    source = set(done.described(PLACES["seen"])["recordings"])
    assert not source & {f"{SOURCE}/{name}" for name in tested}
    assert done.described(f"full--virtual-only/zero-shot/{TARGET}")["recordings"] == []


def test_tuned_networks_keep_the_offsets_of_those_that_they_go_on_from(done: Done) -> None:
    offsets = {protocol: done.described(place)["constants"]["offsets"] for protocol, place in PLACES.items()}
    assert offsets["fine-tuned"] == offsets["zero-shot"] == offsets["seen"]
    fitted_on = {name.split("/")[0] for name in offsets["zero-shot-pooled"]["recordings"]}
    assert fitted_on == {SOURCE, POOLED_TOO}


def test_before_and_after_tuning_are_scored_on_the_same_second_parts(done: Done) -> None:
    records = done.records(f"fine-tuned--{TARGET}--gnn-fpdnn--thin-4")
    after = [one for one in records if one.condition == ""]
    before = [one for one in records if one.condition == BEFORE_TUNING]
    assert len(after) == len(before) == len(records) / 2 == 4
    packed = read_packed(done.root, TARGET)
    for one, other in zip(after, before, strict=True):
        parts = protocol_of("fine-tuned", SOURCE).testing(packed, str(one.device))
        labelled = sum(int(np.isfinite(part.thinned(4).repaired_m).all(axis=1).sum()) for part in parts)
        assert one.n + one.n_before_first_fix == other.n + other.n_before_first_fix == labelled
        assert (one.device, one.filter) == (other.device, other.filter)
        assert one.artifact == f"{PLACES['fine-tuned']}/gnn-fpdnn/seed-0"
        assert other.artifact == f"{PLACES['zero-shot']}/gnn-fpdnn/seed-0"
        assert one.rmse_m != other.rmse_m
    untrained = done.records(f"fine-tuned--{TARGET}--nls-onesided--thin-4")
    assert {one.condition for one in untrained} == {""}


def test_thins_and_plans_are_scored_beside_the_headline(done: Done) -> None:
    plain = f"zero-shot--{TARGET}--gnn-fpdnn"
    headline, thinner = done.records(f"{plain}--thin-4"), done.records(f"{plain}--thin-12")
    assert {one.thin for one in thinner} == {12}
    for one, other in zip(headline, thinner, strict=True):
        ratio = (one.n + one.n_before_first_fix) / (other.n + other.n_before_first_fix)
        assert ratio == pytest.approx(3.0, rel=0.1)
    for plan in ("blank", VALIDATES):
        lent = done.records(f"{plain}--plan-{plan}--thin-4")
        assert {one.plan for one in lent} == {plan}
        assert [one.rmse_m for one in lent] != [one.rmse_m for one in headline]
    assert not list((done.made.folder / "scores").glob("*carpark*")), "its plan is not there to be lent"


def test_a_change_of_the_solver_alone_trains_nothing(done: Done) -> None:
    changed = f"full--linear-solver/zero-shot/{TARGET}"
    assert alike(done.weights(changed), done.weights(PLACES["zero-shot"]))
    assert done.described(changed)["constants"]["solver"] == "lls"
    plain = f"zero-shot--{TARGET}--gnn-fpdnn"
    scored = done.records(f"{plain}--linear-solver--thin-4")
    assert {one.preset for one in scored} == {"full--linear-solver"}
    assert [one.rmse_m for one in scored] != [one.rmse_m for one in done.records(f"{plain}--thin-4")]


def test_a_change_of_fpdnn_alone_shares_the_gnn(done: Done) -> None:
    for place in (f"seen/{SOURCE}", f"zero-shot/{TARGET}"):
        changed, plain = done.weights(f"full--bare-distance/{place}"), done.weights(f"full/{place}")
        assert alike(part(changed, "gnn"), part(plain, "gnn"))
        vision = [name for name in part(changed, "fpdnn") if name in plain and "vision." in name]
        assert vision and not all(torch.equal(changed[name], plain[name]) for name in vision)


def test_without_virtual_intervals_a_target_teaches_nothing(done: Done) -> None:
    seen = done.weights(f"full--measured-only/seen/{SOURCE}")
    assert alike(done.weights(f"full--measured-only/zero-shot/{TARGET}"), seen)
    assert not alike(seen, done.weights(PLACES["seen"]))


def test_without_measured_intervals_networks_begin_anew(done: Done) -> None:
    virtual = done.weights(f"full--virtual-only/zero-shot/{TARGET}")
    assert not alike(part(virtual, "gnn"), part(done.weights(PLACES["zero-shot"]), "gnn"))


def test_measured_intervals_of_the_target_or_of_other_sites_are_learned_from_without_virtual_ones(
    done: Done, every_kind: Preset, tmp_path: Path
) -> None:
    """A preset without virtual intervals tunes and pools all the same."""
    made = reproduction(replace(every_kind, streams="measured", ablations=()), done.root, tmp_path)
    other = trained(made, tmp_path)
    seen = other.weights(PLACES["seen"])
    assert alike(other.weights(PLACES["zero-shot"]), seen)
    assert not alike(other.weights(PLACES["fine-tuned"]), seen)
    assert not alike(other.weights(PLACES["zero-shot-pooled"]), seen)


def test_a_stage_in_a_process_of_its_own_gives_what_it_gives_among_the_others(
    done: Done, every_kind: Preset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing that an earlier stage leaves in memory, random states included, may count."""
    for stage in done.made.stages():
        if stage.name.startswith(("calibrate--", "train--")) and not ablated(stage.name, every_kind):
            monkeypatch.setattr(fploc.experiments.reproduce, "_OPENED", {})
            torch.rand(7)
            run_stage(every_kind, WORLD, None, done.root, tmp_path, stage.name)
    alone = Done(done.root, tmp_path, done.made)
    for place in PLACES.values():
        assert alike(alone.weights(place), done.weights(place))


def ablated(stage: str, preset: Preset) -> bool:
    return any(f"--{name}--" in stage for name in preset.ablations)


def second_parts(recording: Recording) -> Bools:
    return halves(recording)[1]


def first_parts(recording: Recording) -> Bools:
    return halves(recording)[0]


def everything(recording: Recording) -> Bools:
    return np.ones(len(recording), dtype=bool)


def changed_root(done: Done, folder: Path, site: str, chosen: Callable[[Recording], Bools]) -> Path:
    """Return a data root in which the measurements of chosen intervals of a site are others.

    Ranges, signal strengths and labels change. Labels are turned by half a turn about the first chosen one, so
    that every path is as long as before and is cut at the same place.

    Args:
        done: What to take everything else from.
        folder: Where it goes.
        site: Whose measurements change.
        chosen: From a recording to which intervals change, shape (T,).
    """
    for name in (SOURCE, *WORLD.others):
        shutil.copytree(packed_folder(done.root, name), packed_folder(folder, name))
    place = packed_folder(folder, site)
    intervals = pd.read_parquet(place / "intervals.parquet")
    readings = pd.read_parquet(place / "readings.parquet")
    for one in read_packed(done.root, site).recordings():
        rows = intervals[(intervals["device"] == one.device) & (intervals["recording"] == one.name)]
        rows = rows.sort_values("interval")[chosen(one)]
        for kind in ("published", "repaired"):
            labels = [f"x_{kind}_m", f"y_{kind}_m"]
            about = rows[labels].dropna().iloc[0].to_numpy()
            intervals.loc[rows.index, labels] = 2 * about - rows[labels].to_numpy()
        hit = (readings["device"] == one.device) & (readings["recording"] == one.name)
        hit &= readings["interval"].isin(rows["interval"])
        readings.loc[hit, "range_slant_m"] = readings.loc[hit, "range_slant_m"] * 1.3 + 0.7
        readings.loc[hit, "rss_dbm"] = readings.loc[hit, "rss_dbm"] - 5.0
    manifest = json.loads((place / MANIFEST).read_text(encoding="utf-8"))
    for table, frame in {"intervals": intervals, "readings": readings}.items():
        file = place / f"{table}.parquet"
        frame.to_parquet(file)
        manifest["files"][file.name] = hashlib.sha256(file.read_bytes()).hexdigest()
    (place / MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")
    return folder


def trained_again(done: Done, root: Path, folder: Path, protocols: Iterable[str]) -> Done:
    """Return the chains of ``protocols`` trained on other data."""
    wanted = {name: done.made.protocols[name] for name in protocols}
    return trained(Reproduction(replace(done.made.preset, ablations=()), WORLD, wanted, root, folder), folder)


def test_no_measurement_of_the_second_parts_reaches_tuned_networks(done: Done, tmp_path: Path) -> None:
    root = changed_root(done, tmp_path / "data", TARGET, second_parts)
    again = trained_again(done, root, tmp_path / "runs", ("seen", "zero-shot", "fine-tuned"))
    for protocol in ("seen", "zero-shot", "fine-tuned"):
        assert alike(again.weights(PLACES[protocol]), done.weights(PLACES[protocol])), protocol
        assert again.described(PLACES[protocol])["constants"] == done.described(PLACES[protocol])["constants"]
    hashes = [one.described(PLACES["fine-tuned"])["data_hash"] for one in (again, done)]
    assert hashes[0] != hashes[1], "the data did change"


def test_a_measurement_of_the_first_parts_does_reach_tuned_networks_and_no_others(
    done: Done, tmp_path: Path
) -> None:
    """The control: the comparison above sees a change where there is one."""
    root = changed_root(done, tmp_path / "data", TARGET, first_parts)
    again = trained_again(done, root, tmp_path / "runs", ("seen", "zero-shot", "fine-tuned"))
    same = {p: alike(again.weights(PLACES[p]), done.weights(PLACES[p])) for p in list(PLACES)[:3]}
    assert same == {"seen": True, "zero-shot": True, "fine-tuned": False}


def test_no_measurement_of_the_target_reaches_pooled_networks(done: Done, tmp_path: Path) -> None:
    root = changed_root(done, tmp_path / "data", TARGET, everything)
    again = trained_again(done, root, tmp_path / "runs", ("seen", "zero-shot-pooled"))
    place = PLACES["zero-shot-pooled"]
    assert alike(again.weights(place), done.weights(place))
    assert again.described(place)["constants"] == done.described(place)["constants"]
    assert again.described(place)["data_hash"] != done.described(place)["data_hash"]


@pytest.mark.parametrize(("site", "weights_alike"), [(POOLED_TOO, False), (VALIDATES, True)])
def test_of_pooled_sites_those_that_are_learned_from_reach_the_weights_and_the_validating_one_the_spread(
    site: str, weights_alike: bool, done: Done, tmp_path: Path
) -> None:
    """The control; FPDNN learns on positions as far off as the GNN is where it is validated."""
    root = changed_root(done, tmp_path / "data", site, everything)
    again = trained_again(done, root, tmp_path / "runs", ("seen", "zero-shot-pooled"))
    place = PLACES["zero-shot-pooled"]
    assert alike(part(again.weights(place), "gnn"), part(done.weights(place), "gnn")) == weights_alike
    spreads = [one.described(place)["constants"]["variance_m2"] for one in (again, done)]
    assert spreads[0] != spreads[1]
    assert alike(again.weights(PLACES["seen"]), done.weights(PLACES["seen"]))
