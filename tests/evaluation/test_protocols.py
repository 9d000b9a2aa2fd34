from __future__ import annotations

from pathlib import Path

import pytest

from fploc.datasets.packed import read_packed
from fploc.errors import FplocError, UnknownNameError
from fploc.evaluation.protocols import PROTOCOLS, protocol_of


def test_zero_shot_learns_from_the_office_and_tests_on_all_of_another_site(data_root: Path) -> None:
    protocol = protocol_of("zero-shot")
    office, mall = read_packed(data_root, "office"), read_packed(data_root, "shopping-mall")
    assert [one.name for one in protocol.training(office)] == ["lab1", "lab2", "lab4"]
    assert [one.name for one in protocol.validation(office)] == ["lab3"]
    assert [one.name for one in protocol.testing(mall, "1")] == ["1013", "1113", "713", "913"]
    assert {one.device for one in protocol.testing(mall, "all")} == {1, 2}


def test_seen_tests_on_the_last_lap_of_its_source_alone(data_root: Path) -> None:
    protocol = protocol_of("seen")
    office = read_packed(data_root, "office")
    tested = protocol.testing(office, "all")
    assert [one.name for one in tested] == ["lab5"]
    learned = protocol.training(office) + protocol.validation(office)
    assert not {one.name for one in tested} & {one.name for one in learned}


@pytest.mark.parametrize(("name", "site"), [("seen", "laboratory"), ("zero-shot", "office")])
def test_a_site_that_is_no_target_is_refused(name: str, site: str) -> None:
    with pytest.raises(FplocError, match=f"--site with --protocol {name}: found {site}"):
        protocol_of(name).check_target(site)


def test_a_device_without_recordings_is_refused(data_root: Path) -> None:
    office = read_packed(data_root, "office")
    with pytest.raises(FplocError, match=r"--device for office: found 2, expected .*: 1;"):
        protocol_of("seen").testing(office, "2")
    with pytest.raises(UnknownNameError, match="'3', expected one of 1, 2, all"):
        protocol_of("seen").testing(office, "3")


def test_an_unknown_protocol_is_named_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="'one-shot', expected one of seen, zero-shot"):
        protocol_of("one-shot")


def test_names_are_unique() -> None:
    assert len({one.name for one in PROTOCOLS}) == len(PROTOCOLS)
