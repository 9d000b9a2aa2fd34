"""Which method serves a site: made ready as the offline evaluation does it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fploc.calibration.offsets import RangeOffsets
from fploc.datasets.packed import PLAN, PackedSite, read_packed
from fploc.errors import FplocError
from fploc.evaluation.evaluate import EvaluationRequest, source_offsets
from fploc.filters.kalman import KalmanSettings
from fploc.localizer import Localizer
from fploc.methods.interface import Filtering, Method
from fploc.methods.registry import GEOMETRIC_METHODS, default_calibration, geometric_method
from fploc.serve.messages import PlanPlace
from fploc.serve.site_service import ServedSite
from fploc.shipped import DEFAULT, shipped_localizer

PROTOCOL = "zero-shot"


@dataclass(frozen=True)
class ModelRequest:
    """Which method, and how it is made ready; as the options of `fploc evaluate`.

    Args:
        method: Name of the method.
        calibration: How range offsets are found, or a number of metres; None for the method's own.
        speed_prior: How fast filters take people to be, metres per second.
        preset: That the method was trained with.
        seed: Of its training.
        runs: Folder of trained artifacts.
    """

    method: str
    calibration: str | None
    speed_prior: float
    preset: str
    seed: int
    runs: Path


def packed_place(name_or_folder: str, data_root: Path) -> tuple[Path, str]:
    """Return data root and name of a packed site, given by its name or its folder.

    Raises:
        FplocError: If it is neither.
    """
    if "/" not in name_or_folder and name_or_folder not in (".", ".."):
        return data_root, name_or_folder
    folder = Path(name_or_folder).resolve()
    if folder.parent.name != "packed":
        raise FplocError(
            "--site",
            value=name_or_folder,
            expected="the name of a packed site, or its folder DATA_ROOT/packed/NAME",
            way_out="pack it with `fploc data build --sites SITE_FILE`",
        )
    return folder.parent.parent, folder.name


def served_site(data_root: Path, name: str, request: ModelRequest) -> ServedSite:
    """Return a packed site with its method, ready to be served.

    Raises:
        FplocError: If the site, the method, its artifact or its calibration cannot be used.
    """
    asked = EvaluationRequest(
        PROTOCOL, name, speed_prior=request.speed_prior, preset=request.preset, seed=request.seed
    )
    asked.check()
    packed = read_packed(data_root, name)
    method, offsets = _ready(asked, request, packed)
    if isinstance(method, Filtering):
        localizer = Localizer(method.for_speed(request.speed_prior), packed.site, offsets)
    else:
        settings = KalmanSettings.for_speed(request.speed_prior)
        localizer = Localizer(method, packed.site, offsets, settings)
    return ServedSite(localizer, plan_place(packed), (packed.folder / PLAN).read_bytes(), request.speed_prior)


def _ready(
    asked: EvaluationRequest, request: ModelRequest, packed: PackedSite
) -> tuple[Method, RangeOffsets]:
    data_root = packed.folder.parent.parent
    if request.method == DEFAULT:
        # An evaluation leaves out what was learned at the site itself; people want all that there is.
        shipped = shipped_localizer(packed.site, packed.plan)
        if request.calibration is None:
            return shipped.method, shipped.offsets
        return shipped.method, _offsets(asked, request.calibration, data_root)
    if request.method in GEOMETRIC_METHODS:
        own = default_calibration(request.method) if request.calibration is None else request.calibration
        return geometric_method(request.method), _offsets(asked, own, data_root)
    # Only learned methods need all of this, which takes seconds to import.
    from fploc.experiments.scoring import check_method, ready_method

    check_method(request.method)
    ready = ready_method(request.method, asked, request.calibration, data_root, request.runs)
    return ready.method, ready.offsets


def _offsets(asked: EvaluationRequest, calibration: str, data_root: Path) -> RangeOffsets:
    calibrated = EvaluationRequest(asked.protocol, asked.site, calibration=calibration)
    calibrated.check()
    return source_offsets(calibrated, data_root)


def plan_place(packed: PackedSite) -> PlanPlace:
    """Return where the plan's picture lies in the site."""
    height, width = packed.plan.grey.shape
    return PlanPlace(
        url=f"/v1/sites/{packed.site.name}/plan.png",
        width_px=width,
        height_px=height,
        metres_from_pixels=packed.plan.georeference.metres_from_pixels.tolist(),
    )
