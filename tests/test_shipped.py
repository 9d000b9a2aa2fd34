from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch

from fploc.artifacts import ArtifactKey, offsets_of
from fploc.errors import UnknownNameError
from fploc.evaluation.protocols import POOLED_SITES, PUBLIC_SOURCE
from fploc.methods.learned_grid import LearnedGridSettings
from fploc.methods.stored_grid import learned_places, restored
from fploc.shipped import (
    POOLED,
    PRETRAINED,
    SOURCE_ONLY,
    Reading,
    leave_one_out_key,
    reading_set,
    shipped_artifact,
    shipped_localizer,
)
from fploc.sites.site import AccessPoint, Site

CORNERS = [(0.0, 0.0), (12.0, 0.0), (12.0, 9.0), (0.0, 9.0)]
SITE = Site(
    name="hall",
    place="hall",
    access_points=tuple(
        AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", x, y, 1.5)
        for index, (x, y) in enumerate(CORNERS)
    ),
    device_height_m=1.5,
)
MACS = [one.mac for one in SITE.access_points]


@pytest.mark.parametrize("key", [POOLED, SOURCE_ONLY], ids=lambda key: key.protocol)
def test_what_ships_can_be_loaded_and_says_where_it_comes_from(key: ArtifactKey) -> None:
    artifact = shipped_artifact(key)
    sites = set(POOLED_SITES) if key == POOLED else {PUBLIC_SOURCE}
    assert set(artifact.constants["sites"]) == sites
    assert {name.split("/")[0] for name in artifact.recordings} == sites
    assert all(len(one) == 64 for one in artifact.constants["sites"].values())
    assert 0.5 < offsets_of(artifact).offset_m < 2.0 and artifact.command.startswith("fploc model")
    assert restored(artifact).networks


@pytest.mark.parametrize("key", [POOLED, SOURCE_ONLY], ids=lambda key: key.protocol)
def test_what_ships_has_the_settings_that_the_method_has_now(key: ArtifactKey) -> None:
    assert restored(shipped_artifact(key)).settings == LearnedGridSettings.read()


def test_it_learned_at_no_site_that_judges_it_from_outside() -> None:
    text = json.dumps(shipped_artifact(POOLED).constants) + " ".join(shipped_artifact(POOLED).recordings)
    assert "canteen" not in text and "carpark" not in text
    assert learned_places(shipped_artifact(SOURCE_ONLY)) < learned_places(shipped_artifact(POOLED))


def test_it_takes_less_than_a_megabyte_and_no_pickle() -> None:
    files = [path for path in PRETRAINED.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 1_000_000
    assert {path.suffix for path in files} == {".safetensors", ".json", ".md"}


def test_keys_tell_a_site_left_out_from_what_ships() -> None:
    keys = {POOLED, SOURCE_ONLY, leave_one_out_key("laboratory"), leave_one_out_key("library")}
    assert len({key.folder(Path()) for key in keys}) == 4


def test_one_reading_set_is_localized() -> None:
    localizer = shipped_localizer(SITE, None)
    truth = (4.0, 6.0)
    heard = {
        mac: Reading(math.dist(truth, corner) + localizer.offsets.offset_m, -55.0, 0.2)
        for mac, corner in zip(MACS, CORNERS, strict=True)
    }
    _, fix = localizer.advance(localizer.init(devices=1), reading_set(localizer, heard))
    assert math.dist(fix.positions[0].tolist(), truth) < 1.0
    assert (torch.linalg.eigvalsh(fix.covariances[0]) > 0).all()


def test_a_reading_set_holds_what_was_heard_and_no_more() -> None:
    localizer = shipped_localizer(SITE, None)
    heard = {MACS[2]: Reading(5.0, -60.0, math.nan), MACS[0]: Reading(math.nan, -70.0)}
    made = reading_set(localizer, heard, t_s=3.0)
    assert made.heard.tolist() == [[False, False, True, False]] and made.t_s.tolist() == [3.0]
    assert made.ranges[0, 2].item() == pytest.approx(5.0 - localizer.offsets.offset_m)
    assert made.rss.tolist() == [[0.0, 0.0, -60.0, 0.0]] and not made.stds.any()


def test_an_unknown_access_point_is_named() -> None:
    localizer = shipped_localizer(SITE, None)
    with pytest.raises(UnknownNameError, match="access point of hall: found 'ff:ff'"):
        reading_set(localizer, {"ff:ff": Reading(5.0, -60.0)})
