"""What presets train and score, and that all that a step needs comes before it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from fploc.evaluation.protocols import MOVED_SITES, POOLED_SITES, protocol_of
from fploc.experiments.plan import (
    LEARNED_METHODS,
    Learning,
    Scoring,
    chosen_protocols,
    is_headline,
    learnings,
    methods_for,
    needed_sites,
    scorings,
    without_lonely,
)
from fploc.experiments.preset import PRESETS, Preset, read_preset
from fploc.experiments.scoring import METHODS
from fploc.sites.registry import load_spec

SOURCE = "office"
THERE = [*POOLED_SITES]
MADE_UP = ["made-up-1", "made-up-2", "made-up-3"]
WORLDS = {
    "everything": (SOURCE, None, THERE),
    "two sites": (SOURCE, None, ["office", "laboratory"]),
    "the source alone": (SOURCE, None, ["office"]),
    "one target": (SOURCE, ["shopping-mall"], THERE),
    "a moved one": (SOURCE, ["office-position2"], THERE),
    "one that no preset names": (SOURCE, ["barn"], [*THERE, "barn"]),
    "made-up": ("made-up-1", MADE_UP[1:], MADE_UP),
}


def planned(preset: Preset, world: str) -> tuple[dict[str, list[str]], list[Learning], list[Scoring], str]:
    source, targets, there = WORLDS[world]
    protocols = chosen_protocols(preset, source, targets, there)
    return protocols, list(learnings(preset, protocols, source)), list(scorings(preset, protocols)), source


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", PRESETS)
def test_whatever_a_training_goes_on_from_is_trained_before_it(name: str, world: str) -> None:
    preset = read_preset(name)
    _, trained, _, source = planned(preset, world)
    before: set[Learning] = set()
    for one in trained:
        start = protocol_of(one.protocol, source).starts_from(one.target)
        variant = preset.variant(one.ablation)
        if start is not None and variant.streams != "virtual":
            target = source if start == "seen" else one.target
            assert Learning(start, target, one.seed, one.ablation) in before, one
        if one.ablation and variant.streams == preset.streams:
            assert replace(one, ablation="") in before, "the chain whose networks it may share"
        before.add(one)
    assert len(before) == len(trained) == len({one.name for one in trained})


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", PRESETS)
def test_whatever_is_scored_is_trained_and_nothing_is_trained_in_vain(name: str, world: str) -> None:
    preset = read_preset(name)
    _, trained, scored, source = planned(preset, world)
    used = {
        Learning(protocol_of(one.protocol, source).trained_under, one.site, one.seed, one.ablation)
        for one in scored
        if one.method in LEARNED_METHODS
    }
    assert used <= set(trained)
    starts = {
        Learning(start, source if start == "seen" else one.target, one.seed, one.ablation)
        for one in trained
        if (start := protocol_of(one.protocol, source).starts_from(one.target)) is not None
    }
    assert set(trained) <= used | starts
    assert len(scored) == len(set(scored)) == len({one.name for one in scored})


@pytest.mark.parametrize("name", PRESETS)
def test_methods_are_scored_at_every_place_and_learned_ones_with_every_seed(name: str) -> None:
    preset = read_preset(name)
    protocols, _, scored, _ = planned(preset, "everything")
    plain = [one for one in scored if not one.ablation and not one.study and one.plan == "real"]
    for protocol, sites in protocols.items():
        for site in sites:
            for method in methods_for(protocol, preset):
                seeds = preset.seeds if method in LEARNED_METHODS else preset.seeds[:1]
                thins = preset.thins if protocol == "zero-shot" else preset.thins[:1]
                found = [
                    (one.seed, one.thin)
                    for one in plain
                    if (one.protocol, one.site, one.method) == (protocol, site, method)
                ]
                assert found == [(seed, thin) for seed in seeds for thin in thins]


def test_all_methods_are_compared_where_nothing_is_learned_of_a_target_and_the_strongest_elsewhere() -> None:
    full = read_preset("full")
    assert methods_for("seen", full) == list(full.methods)
    assert set(methods_for("zero-shot", full)) == set(full.methods) - {"knn"}
    for protocol in set(full.protocols) - {"seen", "zero-shot"}:
        assert set(methods_for(protocol, full)) == {
            "trilateration",
            "nls-onesided",
            "learned-grid",
            "gnn",
            "gnn-fpdnn",
        }
    every = replace(full, methods=METHODS)
    assert set(methods_for("zero-shot", every)) == set(METHODS) - {"knn"}
    assert {"knn", "gbm"} <= set(methods_for("seen", every))


def test_plans_and_ablations_are_scored_zero_shot_with_the_method_that_sees_the_plan() -> None:
    preset = read_preset("full")
    _, _, scored, _ = planned(preset, "everything")
    special = [one for one in scored if one.ablation or one.plan != "real"]
    assert {(one.protocol, one.method, one.thin) for one in special} == {("zero-shot", "gnn-fpdnn", 1)}
    plans = {(one.site, one.plan) for one in special if not one.ablation}
    sites = preset.protocols["zero-shot"]
    assert plans == {(site, plan) for site in sites for plan in preset.plans if plan != site}
    ablated = {(one.site, one.ablation, one.seed) for one in special if one.ablation}
    assert ablated == {
        (site, ablation, seed)
        for site in preset.ablation_targets
        for ablation in preset.ablations
        for seed in preset.ablation_seeds
    }


def test_ablations_are_not_trained_where_nothing_tests_them() -> None:
    preset = read_preset("full")
    for world in ("the source alone", "a moved one", "made-up"):
        _, trained, _, _ = planned(preset, world)
        assert trained and not [one for one in trained if one.ablation]
    _, trained, _, _ = planned(preset, "one target")
    assert {one.target for one in trained if one.ablation} == {"office", "shopping-mall"}


def test_a_chain_of_virtual_intervals_alone_has_none_on_the_source() -> None:
    _, trained, _, _ = planned(read_preset("full"), "everything")
    virtual = [one for one in trained if one.ablation == "virtual-only"]
    assert virtual and {one.protocol for one in virtual} == {"zero-shot"}


def test_one_scoring_of_each_method_and_place_is_the_headline() -> None:
    preset = replace(read_preset("full"), seeds=(5, 6), thins=(3, 30))
    protocols, _, scored, _ = planned(preset, "everything")
    headline = [one for one in scored if is_headline(one, preset)]
    places = [(protocol, site) for protocol, sites in protocols.items() for site in sites]
    expected = [(*place, method) for place in places for method in methods_for(place[0], preset)]
    assert [(one.protocol, one.site, one.method) for one in headline] == expected
    assert {(one.seed, one.thin, one.plan, one.ablation) for one in headline} == {(5, 3, "real", "")}


def test_calibrations_and_equipment_are_studied_at_zero_shot_targets_with_every_method_once() -> None:
    preset = read_preset("full")
    _, _, scored, _ = planned(preset, "everything")
    sites = preset.protocols["zero-shot"]
    studied = [(one.study, one.site, one.method) for one in scored if one.study]
    methods = methods_for("zero-shot", preset)
    untrained = [one for one in methods if one not in LEARNED_METHODS]
    assert set(studied) == {("equipment", site, method) for site in sites for method in methods} | {
        ("calibrations", site, method) for site in sites for method in untrained
    }
    assert len(studied) == len(set(studied))
    default = read_preset("default")
    assert not [one for one in planned(default, "everything")[2] if one.study]


def test_sites_without_others_to_pool_with_are_left_out() -> None:
    sites = {name: load_spec(name).site for name in ("office", "library", "laboratory")}
    protocols = {"seen": ["office"], "zero-shot-pooled": ["library"]}
    assert without_lonely(protocols, SOURCE, [sites["office"], sites["library"]]) == {"seen": ["office"]}
    assert without_lonely(protocols, SOURCE, list(sites.values())) == protocols


def test_names_say_what_is_special() -> None:
    plain = Scoring("gnn", "seen", "office", 2)
    assert plain.name == "seen--office--gnn--seed-2"
    special = Scoring("gnn-fpdnn", "zero-shot", "library", 0, "bare-distance", "blank", 10)
    assert special.name == "zero-shot--library--gnn-fpdnn--bare-distance--plan-blank--thin-10--seed-0"
    assert Learning("zero-shot", "library", 1).name == "train--zero-shot--library--seed-1"
    assert Learning("seen", "office", 0, "finer-plan").name == "train--finer-plan--seen--office--seed-0"


def test_without_sites_protocols_keep_their_own_that_are_packed() -> None:
    full = read_preset("full")
    assert chosen_protocols(full, SOURCE, None, THERE) == {
        name: list(sites) for name, sites in full.protocols.items()
    }
    assert chosen_protocols(full, SOURCE, None, ["office", "library"]) == {
        "seen": ["office"],
        "zero-shot": ["library"],
        "fine-tuned": ["library"],
        "zero-shot-pooled": ["library"],
    }


@pytest.mark.parametrize(
    ("targets", "expected"),
    [
        (
            ["shopping-mall"],
            {
                "zero-shot": ["shopping-mall"],
                "multi-device": ["shopping-mall"],
                "fine-tuned": ["shopping-mall"],
                "zero-shot-pooled": ["shopping-mall"],
            },
        ),
        (
            ["conference-room"],
            {"zero-shot": ["conference-room"], "fine-tuned": ["conference-room"]},
        ),
        (
            ["office-position1"],
            {
                "zero-shot": ["office-position1"],
                "ap-moved": ["office-position1"],
                "fine-tuned": ["office-position1"],
            },
        ),
        (["barn"], {"zero-shot": ["barn"], "fine-tuned": ["barn"], "zero-shot-pooled": ["barn"]}),
        (["moon"], {}),
        ([], {}),
    ],
)
def test_with_sites_protocols_take_those_that_they_admit(
    targets: list[str], expected: dict[str, list[str]]
) -> None:
    found = chosen_protocols(read_preset("full"), SOURCE, targets, [*THERE, "barn"])
    assert found == {"seen": ["office"]} | expected


def test_made_up_buildings_stand_in_for_every_site_that_is_not_special() -> None:
    found = chosen_protocols(read_preset("full"), "made-up-1", MADE_UP[1:], MADE_UP)
    others = ["made-up-2", "made-up-3"]
    assert found == {
        "seen": ["made-up-1"],
        "zero-shot": others,
        "fine-tuned": others,
        "zero-shot-pooled": others,
    }


def test_a_preset_needs_its_sites_those_that_are_pooled_and_plans_that_are_lent() -> None:
    full = read_preset("full")
    assert set(needed_sites(full, None)) == set(POOLED_SITES)
    assert set(needed_sites(full, ["barn"])) == {*POOLED_SITES, "barn"}
    assert len(needed_sites(full, None)) == len(set(needed_sites(full, None)))
    default = read_preset("default")
    assert set(needed_sites(default, None)) == {"office", "shopping-mall", "laboratory"}
    assert needed_sites(default, ["library"]) == ["library"]
    assert set(needed_sites(replace(default, plans=("blank", "library")), ["laboratory"])) == {
        "laboratory",
        "library",
    }


def test_moved_sites_are_tuned_from_networks_of_the_moved_protocol() -> None:
    _, trained, _, _ = planned(read_preset("full"), "everything")
    tuned = [one for one in trained if one.protocol == "fine-tuned" and one.target in MOVED_SITES]
    assert len(tuned) == 2 * 3
    assert all(replace(one, protocol="ap-moved") in trained for one in tuned)
    assert not [one for one in trained if one.protocol == "multi-device"]
