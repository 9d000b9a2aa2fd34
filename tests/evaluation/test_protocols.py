from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from datamodules.first_part import FirstPartDataModule
from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.packed import read_packed
from fploc.datasets.path_parts import GAP_M, along_path_m, halves, sides
from fploc.errors import FplocError, UnknownNameError
from fploc.evaluation.protocols import (
    LINKED_SITES,
    MADE_UP_SITES,
    MOVED_SITES,
    POOLED_SITES,
    PROTOCOLS,
    SOURCE_FLOOR,
    VALIDATION_SITES,
    protocol_of,
    validation_site,
)
from fploc.experiments.world import MADE_UP_SEEDS
from fploc.sites.registry import known_sites, load_spec
from fploc.sites.site import Site

HELD_OUT = ("canteen", "carpark")
PUBLIC = {name: load_spec(name).site for name in known_sites()}
MADE_UP = {f"made-up-{n}": Site(f"made-up-{n}", f"made-up-{n}", (), 1.0, made_up=True) for n in (1, 2, 3)}
ADMITTED = {
    "seen": {"office"},
    "zero-shot": set(PUBLIC) - {"office"},
    "zero-shot-pooled": {"laboratory", "library", "shopping-mall", *HELD_OUT},
    "fine-tuned": set(PUBLIC) - {"office"},
    "ap-moved": {"office-position1", "office-position2"},
    "multi-device": {"shopping-mall"},
}


def test_zero_shot_learns_from_the_office_and_tests_on_all_of_another_site(data_root: Path) -> None:
    protocol = protocol_of("zero-shot")
    office, mall = read_packed(data_root, "office"), read_packed(data_root, "shopping-mall")
    assert [one.name for one in protocol.training(office)] == ["lab1", "lab2", "lab4"]
    assert [one.name for one in protocol.testing(mall, "1")] == ["1013", "1113", "713", "913"]
    assert {one.device for one in protocol.testing(mall, "all")} == {1, 2}


def test_seen_tests_on_the_last_lap_of_its_source_alone(data_root: Path) -> None:
    protocol = protocol_of("seen")
    office = read_packed(data_root, "office")
    tested = protocol.testing(office, "all")
    assert [one.name for one in tested] == ["lab5"]
    validating = {name for _, name in office.splits.validate}
    assert not {one.name for one in tested} & ({one.name for one in protocol.training(office)} | validating)


def test_names_are_unique_and_every_protocol_is_checked_here() -> None:
    assert [one.name for one in PROTOCOLS] == list(dict.fromkeys(one.name for one in PROTOCOLS))
    assert set(ADMITTED) == {one.name for one in PROTOCOLS}


@pytest.mark.parametrize("name", ADMITTED)
def test_every_public_site_is_admitted_or_refused_with_what_is_expected(name: str) -> None:
    protocol = protocol_of(name)
    assert {site for site in PUBLIC if protocol.admits(site)} == ADMITTED[name]
    for site in PUBLIC:
        if site in ADMITTED[name]:
            protocol.check_target(site)
        else:
            with pytest.raises(FplocError) as refused:
                protocol.check_target(site)
            told = str(refused.value)
            assert told.startswith(f"--site with --protocol {name}: found {site}, expected ")
            assert told.endswith("; choose another site or another protocol")


@pytest.mark.parametrize(
    ("name", "site", "expected"),
    [
        ("seen", "laboratory", "office"),
        ("zero-shot", "office", "any site but office, the source"),
        ("fine-tuned", "office", "any site but office, the source"),
        ("zero-shot-pooled", "conference-room", "a site of another place than that of office"),
        ("ap-moved", "library", "office-position1 or office-position2"),
        ("multi-device", "library", "shopping-mall"),
    ],
)
def test_a_refusal_names_what_would_do(name: str, site: str, expected: str) -> None:
    with pytest.raises(FplocError, match=f"found {site}, expected {expected};"):
        protocol_of(name).check_target(site)


def test_among_made_up_buildings_the_source_is_another() -> None:
    protocol = protocol_of("zero-shot-pooled", "made-up-1")
    assert protocol.admits("made-up-2") and not protocol.admits("made-up-1")
    assert protocol_of("seen", "made-up-1").admits("made-up-1")


def test_sites_named_in_protocols_are_public_and_of_the_place_that_is_said() -> None:
    assert set(POOLED_SITES) | set(MOVED_SITES) | set(LINKED_SITES) <= set(PUBLIC)
    floor = {name for name, site in PUBLIC.items() if site.place == PUBLIC["office"].place}
    assert floor == {"office", *SOURCE_FLOOR}


@pytest.mark.parametrize("target", [*POOLED_SITES, *HELD_OUT])
def test_pooled_sources_are_all_sites_of_other_places_and_never_those_held_out(target: str) -> None:
    protocol = protocol_of("zero-shot-pooled")
    sources = protocol.sources(PUBLIC[target], list(PUBLIC.values()))
    assert sources[0] == "office" and len(set(sources)) == len(sources)
    assert not set(sources) & set(HELD_OUT)
    if protocol.admits(target):
        assert PUBLIC[target].place not in {PUBLIC[name].place for name in sources}
        assert set(sources) == {one for one in POOLED_SITES if PUBLIC[one].place != PUBLIC[target].place}


def test_pooled_sources_do_not_depend_on_the_order_of_what_is_packed() -> None:
    protocol = protocol_of("zero-shot-pooled")
    some = [PUBLIC[name] for name in ("office", "library", "laboratory", "shopping-mall")]
    found = {tuple(protocol.sources(PUBLIC["shopping-mall"], order)) for order in permutations(some)}
    assert found == {("office", "laboratory", "library")}


def test_real_and_made_up_buildings_are_never_pooled() -> None:
    both = [*PUBLIC.values(), *MADE_UP.values()]
    real = protocol_of("zero-shot-pooled").sources(PUBLIC["library"], both)
    assert not set(real) & set(MADE_UP)
    made_up = protocol_of("zero-shot-pooled", "made-up-1").sources(MADE_UP["made-up-2"], both)
    assert made_up == ["made-up-1", "made-up-3"]


def test_a_building_of_ones_own_beside_them_changes_no_sources() -> None:
    own = [Site("made-up-77", "made-up-77", (), 1.0, made_up=True), Site("barn", "barn", (), 1.0)]
    pooled = protocol_of("zero-shot-pooled", "made-up-1")
    assert pooled.sources(MADE_UP["made-up-2"], [*MADE_UP.values(), *own]) == ["made-up-1", "made-up-3"]
    assert pooled.sources(own[0], [*MADE_UP.values(), *own]) == ["made-up-1", "made-up-2", "made-up-3"]
    real = protocol_of("zero-shot-pooled")
    assert "barn" not in real.sources(PUBLIC["library"], [*PUBLIC.values(), *own])
    assert set(real.sources(own[1], [*PUBLIC.values(), *own])) == set(POOLED_SITES)


def test_the_made_up_buildings_of_a_reproduction_are_those_that_are_pooled() -> None:
    assert [f"made-up-{seed}" for seed in MADE_UP_SEEDS] == list(MADE_UP_SITES)
    assert set(MADE_UP_SITES[1:]) <= set(VALIDATION_SITES)


@pytest.mark.parametrize("name", sorted(set(ADMITTED) - {"zero-shot-pooled"}))
def test_other_protocols_learn_from_their_source_alone(name: str) -> None:
    for target in ADMITTED[name]:
        assert protocol_of(name).sources(PUBLIC[target], list(PUBLIC.values())) == ["office"]


@pytest.mark.parametrize("target", sorted(ADMITTED["zero-shot-pooled"]))
def test_of_pooled_sources_one_validates_and_is_of_a_place_that_is_not_learned_from(target: str) -> None:
    sources = protocol_of("zero-shot-pooled").sources(PUBLIC[target], list(PUBLIC.values()))
    validating = validation_site(sources)
    learned = [name for name in sources if name != validating]
    assert validating in VALIDATION_SITES and "office" in learned
    assert PUBLIC[validating].place not in {PUBLIC[name].place for name in [*learned, target]}


@pytest.mark.parametrize("sources", [[], ["office"], ["library"], ["office", "shopping-mall"]])
def test_sources_that_cannot_be_pooled_are_told(sources: list[str]) -> None:
    with pytest.raises(FplocError, match=r"packed sites to learn from together: .*fploc data build"):
        validation_site(sources)


def test_networks_go_on_from_a_protocol_that_trains_its_own_for_the_same_site() -> None:
    expected = {
        "seen": {None},
        "zero-shot": {"seen"},
        "zero-shot-pooled": {"seen"},
        "ap-moved": {"seen"},
        "multi-device": {None},
    }
    for name, starts in expected.items():
        assert {protocol_of(name).starts_from(site) for site in ADMITTED[name]} == starts
    tuned = {site: protocol_of("fine-tuned").starts_from(site) for site in ADMITTED["fine-tuned"]}
    assert {site for site, start in tuned.items() if start == "ap-moved"} == set(MOVED_SITES)
    assert {start for site, start in tuned.items() if site not in MOVED_SITES} == {"zero-shot"}
    for site, start in tuned.items():
        assert protocol_of(str(start)).admits(site)
    assert protocol_of("multi-device").trained_under == "zero-shot"
    assert all(protocol_of(name).trained_under == name for name in set(ADMITTED) - {"multi-device"})


@pytest.mark.parametrize("site", ["conference-room", "office-position1"])
def test_fine_tuned_tests_on_the_second_part_alone_and_shares_nothing_with_what_is_learned(
    site: str, data_root: Path
) -> None:
    protocol = protocol_of("fine-tuned")
    packed = read_packed(data_root, site)
    module = FirstPartDataModule(protocol, site, RangeOffsets("none", 0.0), data_root=data_root)
    module.setup()
    learned, validating = (
        {(one.device, one.name): one for one in module.recordings(part)} for part in ("train", "validate")
    )
    tested = protocol.testing(packed, "all")
    whole = {(one.device, one.name): one for one in packed.recordings()}
    assert {(one.device, one.name) for one in tested} == set(learned) == set(validating) == set(whole)
    places = np.concatenate([one.repaired_m for part in (learned, validating) for one in part.values()])
    places = places[np.isfinite(places).all(axis=1)]
    for one in tested:
        key = (one.device, one.name)
        mask = sides(whole[key], packed.site)[1] if site in MOVED_SITES else halves(whole[key])[1]
        assert set(one.t_s) <= set(whole[key].t_s[mask])
        known = one.repaired_m[np.isfinite(one.repaired_m).all(axis=1)]
        assert cdist(known, places).min() > GAP_M, "nor where the path comes back"
        times = [set(part.t_s) for part in (one, learned[key], validating[key])]
        assert sum(len(part) for part in times) == len(set.union(*times)) < len(whole[key])
        if site not in MOVED_SITES:
            along = along_path_m(whole[key].repaired_m)
            seen = np.isin(whole[key].t_s, [*learned[key].t_s, *validating[key].t_s])
            assert along[mask].min() - along[seen].max() > GAP_M


def test_in_the_sources_own_rooms_one_side_is_learned_and_the_other_tested(data_root: Path) -> None:
    packed = read_packed(data_root, "office-position2")
    protocol = protocol_of("fine-tuned")
    parts = protocol.parts(packed.recordings(), packed.site)
    x_m = [one.repaired_m[:, 0] for one in packed.recordings()]
    left = max(np.nanmax(x[first]) for x, (first, _) in zip(x_m, parts, strict=True))
    right = min(np.nanmin(x[second]) for x, (_, second) in zip(x_m, parts, strict=True))
    assert right - left > GAP_M, "of all laps together: they go the same way"


def test_one_device_of_the_second_part_can_be_chosen(data_root: Path) -> None:
    packed = read_packed(data_root, "conference-room")
    both = protocol_of("fine-tuned").testing(packed, "all")
    one = protocol_of("fine-tuned").testing(packed, "2")
    assert [len(rec) for rec in one] == [len(rec) for rec in both if rec.device == 2] and one


def test_a_device_without_recordings_is_refused(data_root: Path) -> None:
    office = read_packed(data_root, "office")
    with pytest.raises(FplocError, match=r"--device for office: found 2, expected .*: 1;"):
        protocol_of("seen").testing(office, "2")
    with pytest.raises(UnknownNameError, match="'3', expected one of 1, 2, all"):
        protocol_of("seen").testing(office, "3")


def test_an_unknown_protocol_is_named_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="'one-shot', expected one of seen, zero-shot"):
        protocol_of("one-shot")


def test_a_protocol_of_another_source_differs_in_nothing_else() -> None:
    for one in PROTOCOLS:
        assert replace(protocol_of(one.name, "made-up-1"), source="office") == one
