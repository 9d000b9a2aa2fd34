"""A box with made-up recordings, and what answers for its server."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.recordings import Recording
from fploc.filters.kalman import KalmanSettings
from fploc.floorplan.georeference import Georeference
from fploc.localizer import Localizer
from fploc.methods.registry import geometric_method
from fploc.serve.messages import PlanPlace
from fploc.serve.settings import ServeSettings
from fploc.serve.site_service import ServedSite, now_ms
from fploc.serve.store import Store, sqlite_url
from fploc.serve.tokens import make_token, scopes_of
from fploc.sites.site import AccessPoint, Site

BOX = Site(
    name="box",
    place="box",
    access_points=tuple(
        AccessPoint(f"AP{index}", f"00:00:00:00:00:0{index}", x, y, 1.0 + index)
        for index, (x, y) in enumerate([(0.0, 0.0), (20.0, 0.0), (20.0, 15.0), (0.0, 15.0)])
    ),
    device_height_m=1.0,
    made_up=True,
)
OFFSETS = RangeOffsets("0.5", 0.5)


def walked(steps: int, seed: int) -> Recording:
    """Return a recording in the box: noise of 0.3 m, now and then access points that do not answer."""
    random = np.random.default_rng(seed)
    t_s = np.round(np.cumsum(random.uniform(0.15, 0.6, steps)), 3)
    path = np.column_stack([4 + seed + 0.3 * t_s, 3 + 0.1 * t_s])
    across = np.linalg.norm(path[:, None] - BOX.positions_m, axis=2)
    slant = np.hypot(across, BOX.height_differences_m) + 0.5 + random.normal(0.0, 0.3, across.shape)
    heard = random.random(slant.shape) < 0.9
    heard[steps // 2] = False
    return Recording(
        site="box",
        device=1,
        name=f"lap{seed}",
        t_s=t_s,
        slant_m=np.where(heard, np.maximum(slant, 0.1), 0.0),
        std_m=np.where(heard, 0.2, 0.0),
        rss_dbm=np.where(heard, -40.0 - 1.5 * across, 0.0),
        heard=heard,
        published_m=path,
        repaired_m=path,
    )


@pytest.fixture(scope="session")
def recordings() -> list[Recording]:
    return [walked(24 - 3 * seed, seed) for seed in range(4)]


@pytest.fixture(scope="session")
def settings() -> ServeSettings:
    """Return settings that never hold uploads back, however busy the machine is."""
    return replace(
        ServeSettings.read("default"),
        requests_per_s=1e6,
        request_burst=1_000_000,
        late_share=1e6,
        waiting_share=1e6,
    )


@pytest.fixture(scope="session")
def localizer() -> Localizer:
    return Localizer(geometric_method("nls-onesided"), BOX, OFFSETS, KalmanSettings())


@pytest.fixture(scope="session")
def served(localizer: Localizer) -> ServedSite:
    """The box, with a plan of 24 × 19 m at 10 pixels a metre, white."""
    georeference = Georeference.of_raster((-2.0, 17.0), 0.1)
    done, encoded = cv2.imencode(".png", np.full((190, 240), 255, dtype=np.uint8))
    assert done
    place = PlanPlace(
        url="/v1/sites/box/plan.png",
        width_px=240,
        height_px=190,
        metres_from_pixels=georeference.metres_from_pixels.tolist(),
    )
    return ServedSite(localizer, place, encoded.tobytes(), 0.5)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    store = Store(sqlite_url(tmp_path))
    yield store
    store.close()


@pytest.fixture
def token_of(store: Store) -> Callable[[str], str]:
    """Return what makes a token with some scopes."""

    def token_of(scopes: str, days: float = 1.0) -> str:
        return make_token(store, "test", scopes_of(scopes), days, now_ms())

    return token_of
