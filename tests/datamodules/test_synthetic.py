from __future__ import annotations

from typing import Any

import pytest
import torch

from datamodules.synthetic import SyntheticDataModule
from fploc.conf import instantiate, read_conf
from fploc.datasets.build import build_sites
from fploc.datasets.packed import read_packed
from fploc.datasets.samples import LabelledIntervals
from fploc.models.generator import Generator
from fploc.sites.made_up import made_up_site
from fploc.virtual.dropout import Dropout
from fploc.virtual.site import VirtualSite


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> VirtualSite:
    folder = tmp_path_factory.mktemp("data")
    build_sites(None, folder, [made_up_site(6, folder / "files", laps=1, duration_s=12.0)])
    packed = read_packed(folder, "made-up-6")
    torch.manual_seed(0)
    generator = instantiate(Generator, read_conf("model", "generator"))
    dropout = Dropout((1.0, 0.9, 0.5))
    return VirtualSite(packed.site, packed.plan, generator, generator.vision.crops, dropout, 0.5)


def module(site: VirtualSite, **changes: Any) -> SyntheticDataModule:
    sizes = {"pairs": 3, "batches": 7, "pool_batches": 2, "seed": 0, **changes}
    made = SyntheticDataModule(site, **sizes)
    made.setup()
    return made


def places(batches: list[LabelledIntervals]) -> list[list[float]]:
    return [batch.positions.flatten().tolist() for batch in batches]


def test_the_pool_is_drawn_once(site: VirtualSite) -> None:
    made = module(site)
    pool = made.pool
    made.setup()
    made.setup("fit")
    assert made.pool is pool and len(pool) == 2
    assert all(batch.positions.shape == (6, 2) for batch in pool)


def test_one_seed_gives_one_pool(site: VirtualSite) -> None:
    first, again, other = (module(site, seed=seed).pool for seed in (3, 3, 4))
    for one, two in zip(first, again, strict=True):
        assert torch.equal(one.intervals.ranges, two.intervals.ranges)
        assert torch.equal(one.intervals.heard, two.intervals.heard)
    assert places(first) == places(again) and places(first) != places(other)


def test_an_epoch_takes_its_batches_from_the_pool_in_a_seeded_order(site: VirtualSite) -> None:
    made = module(site)
    stream = made.train_dataloader()
    assert list(stream) == ["virtual"]
    first = places(list(stream["virtual"]))
    assert len(first) == 7 and all(one in places(made.pool) for one in first)
    assert places(list(made.train_dataloader()["virtual"])) == first
    assert [places(list(stream["virtual"])) for _ in range(3)] != [first] * 3, "epochs differ"


def test_the_global_generator_is_not_touched(site: VirtualSite) -> None:
    torch.manual_seed(5)
    before = torch.get_rng_state()
    made = module(site)
    list(made.train_dataloader()["virtual"].sampler)
    assert torch.equal(before, torch.get_rng_state())
