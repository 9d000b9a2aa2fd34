"""Methods ready to run at a site: geometric ones from nothing, learned ones out of their artifact."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

from fploc.artifacts import Artifact, ArtifactKey, load_artifact, offsets_of
from fploc.calibration.offsets import RangeOffsets, fit_pooled_offsets
from fploc.datasets.packed import (
    PackedSite,
    manifest_hash,
    packed_folder,
    packed_sites,
    read_manifest,
    read_packed,
)
from fploc.errors import FplocError, UnknownNameError
from fploc.evaluation.evaluate import (
    EvaluationRequest,
    evaluate,
    every_source_recording,
    records_of,
    source_offsets,
    tracks_of,
)
from fploc.evaluation.multi_device import multi_device_records
from fploc.evaluation.protocols import PUBLIC_SOURCE, EvaluationProtocol, Targets, Tested, protocol_of
from fploc.evaluation.records import Record
from fploc.evaluation.relative_figures import BEFORE_TUNING
from fploc.experiments.plan import LEARNED_METHODS, SEEN
from fploc.experiments.preset import VARIANT, check_preset
from fploc.experiments.source_fit import check_protocol, fitted_on
from fploc.experiments.training import trained_from
from fploc.filters.kalman import KalmanSettings
from fploc.floorplan.plan import FloorPlan
from fploc.floorplan.raster import PlanRaster
from fploc.localizer import Track
from fploc.methods.gnn import GNNMethod
from fploc.methods.gnn_fpdnn import GNNFPDNN
from fploc.methods.interface import Method, ReadsPlan
from fploc.methods.one_shot import RangeSolver
from fploc.methods.registry import (
    GEOMETRIC_METHODS,
    SOURCE_FITTED_METHODS,
    default_calibration,
    geometric_method,
)
from fploc.methods.stored_grid import learned_places, restored
from fploc.models.fpdnn import Sight
from fploc.progress import busy
from fploc.shipped import (
    DEFAULT,
    POOLED,
    PRETRAINED,
    SEED,
    SOURCE_ONLY,
    leave_one_out_key,
    model_command,
    shipped_artifact,
)
from fploc.solvers.linear import solve_linear
from fploc.solvers.losses import OneSidedLoss
from fploc.solvers.nonlinear import solve_nonlinear

METHODS = (*GEOMETRIC_METHODS, *SOURCE_FITTED_METHODS, *LEARNED_METHODS, DEFAULT)
DEFAULT_CALIBRATION = "source-los"
PLANS = {"real": Sight.PLAN, "blank": Sight.PLAN, "length": Sight.LENGTH, "none": Sight.NOTHING}
"""What FPDNN is given under each value of --plan that names no site."""


@dataclass(frozen=True)
class ReadyMethod:
    """A method that can run at its target.

    Args:
        method: The method.
        offsets: Range offsets to remove first.
        artifact: Name of what was trained; None where nothing was.
    """

    method: Method
    offsets: RangeOffsets
    artifact: str | None


def data_hash(*packed: PackedSite) -> str:
    """Return one hash that stands for the data of several packed sites."""
    return hashlib.sha256("".join(site.manifest_hash for site in packed).encode()).hexdigest()


def reproduce_command(preset: str, target: str) -> str:
    """Return the command that makes the artifacts of a preset for a target, or for the source alone."""
    sites = "" if target == PUBLIC_SOURCE else f" --sites {target}"
    return f"fploc reproduce --preset {preset.partition(VARIANT)[0]}{sites}"


def artifacts_folder(runs: Path) -> Path:
    """Return the folder of artifacts below the folder of runs."""
    return runs / "artifacts"


def ready_method(
    name: str, request: EvaluationRequest, calibration: str | None, data_root: Path, runs: Path
) -> ReadyMethod:
    """Return the method ``name`` for the target of ``request``.

    Args:
        name: Of the method.
        request: What is asked of it.
        calibration: As asked for; None takes the artifact's, or a geometric method's own default.
        data_root: Folder of packed sites.
        runs: Folder of runs.

    Raises:
        UnknownNameError: If there is no such method.
        MissingArtifactError: If a learned method's artifact is not there.
        FplocError: If the plan that was asked for cannot be used.
    """
    if name == DEFAULT:
        return _default_method(request, calibration, data_root, runs)
    if name not in LEARNED_METHODS:
        own = default_calibration(name) if calibration is None else calibration
        if name in SOURCE_FITTED_METHODS:
            ready = _fitted_method(name, request, own, data_root)
            return replace(ready, method=_with_plan(ready.method, request, data_root))
        offsets = source_offsets(replace(request, calibration=own), data_root)
        return ReadyMethod(geometric_method(name), offsets, artifact=None)
    protocol = protocol_of(request.protocol, request.source)
    protocol.check_target(request.site)
    target = read_packed(data_root, request.site)
    key = ArtifactKey(name, protocol.trained_under, request.site, request.preset, request.seed)
    artifact = load_artifact(
        artifacts_folder(runs),
        key,
        data_hash=data_hash(*learned_and_tested(protocol, target, data_root)),
        command=reproduce_command(request.preset, request.site),
    )
    offsets = (
        offsets_of(artifact)
        if calibration is None
        else source_offsets(replace(request, calibration=calibration), data_root)
    )
    plan = chosen_plan(request.plan, target, data_root)
    return ReadyMethod(
        learned_method(
            artifact, plan, KalmanSettings.for_speed(request.speed_prior), PLANS.get(request.plan, Sight.PLAN)
        ),
        offsets,
        artifact=str(key.folder(Path())),
    )


def _default_method(
    request: EvaluationRequest, calibration: str | None, data_root: Path, runs: Path
) -> ReadyMethod:
    """Return the default method as it comes with the package, or as trained without the place of its target."""
    protocol = protocol_of(request.protocol, request.source)
    protocol.check_target(request.site)
    if request.seed != SEED:
        raise FplocError(
            f"--seed with --method {DEFAULT}",
            value=request.seed,
            expected=f"{SEED}, the one that it was trained with",
            way_out=f"leave it out, or train with `--method {SOURCE_ONLY.method}`",
        )
    target = read_packed(data_root, request.site)
    artifact = shipped_artifact(POOLED if protocol.pools else SOURCE_ONLY)
    name = f"{PRETRAINED.name}/{artifact.key.folder(Path())}"
    if protocol.pools and target.site.place in learned_places(artifact):
        key = leave_one_out_key(request.site)
        artifact = load_artifact(
            artifacts_folder(runs),
            key,
            data_hash=data_hash(*learned_and_tested(protocol, target, data_root)),
            command=model_command(request.site),
        )
        name = str(key.folder(Path()))
    if calibration is None:
        offsets = offsets_of(artifact)
    else:
        offsets = source_offsets(replace(request, calibration=calibration), data_root)
    return ReadyMethod(_with_plan(restored(artifact), request, data_root), offsets, artifact=name)


def _with_plan(method: Method, request: EvaluationRequest, data_root: Path) -> Method:
    """Return a method with the plan that a request asks for, where it reads plans."""
    if not isinstance(method, ReadsPlan):
        return method
    target = read_packed(data_root, request.site)
    return method.for_plan(chosen_plan(request.plan, target, data_root))


def _fitted_method(name: str, request: EvaluationRequest, calibration: str, data_root: Path) -> ReadyMethod:
    """Return a method that is fitted on its sources now, without a plan."""
    protocol = protocol_of(request.protocol, request.source)
    check_protocol(SOURCE_FITTED_METHODS[name](), protocol)
    # What is learned from one source depends neither on the target nor on the rest of the protocol.
    learned = (
        EvaluationRequest(request.protocol, request.site, source=request.source)
        if protocol.pools
        else EvaluationRequest(SEEN, protocol.source, source=request.source)
    )
    there = [packed_folder(data_root, site) for site in packed_sites(data_root)]
    hashes = tuple(manifest_hash(read_manifest(folder)) for folder in there)
    return _fitted(name, learned, calibration, data_root, hashes)


@lru_cache(maxsize=8)
def _fitted(
    name: str, request: EvaluationRequest, calibration: str, data_root: Path, hashes: tuple[str, ...]
) -> ReadyMethod:
    """Fit a method and its offsets once for many targets, as long as no packed site changes its hash."""
    sources = every_source_recording(request, data_root)
    offsets = fit_pooled_offsets(calibration, sources)
    with busy(f"fit {name} on the source"):
        return ReadyMethod(fitted_on(SOURCE_FITTED_METHODS[name](), sources, offsets), offsets, artifact=None)


def learned_and_tested(protocol: EvaluationProtocol, target: PackedSite, data_root: Path) -> list[PackedSite]:
    """Return the packed sites that networks for ``target`` depend on, itself last."""
    there = packed_sites(data_root) if protocol.pools else [protocol.source]
    packed = {name: read_packed(data_root, name) for name in there}
    names = protocol.sources(target.site, [one.site for one in packed.values()])
    return [*(packed[name] for name in names if name != target.site.name), target]


def check_method(name: str) -> None:
    """Raise where there is no method ``name``.

    Raises:
        UnknownNameError: Listing all methods.
    """
    if name not in METHODS:
        raise UnknownNameError("--method", name, known=list(METHODS), way_out="choose one of these")


def range_solver(name: str) -> RangeSolver:
    """Return the solver behind FPDNN: ``lls`` (published), ``nls`` or ``nls-onesided``.

    The settings of the rivals by these names are tuned on measured ranges and are not those of corrected ones:
    the one-sided loss stays as specified (issue 4).
    """
    solvers: dict[str, RangeSolver] = {
        "lls": solve_linear,
        "nls": solve_nonlinear,
        "nls-onesided": partial(solve_nonlinear, loss=OneSidedLoss(short_weight=4.0, long_scale=0.3)),
    }
    return solvers[name]


def learned_method(
    artifact: Artifact, plan: FloorPlan, filter_settings: KalmanSettings, sight: Sight = Sight.PLAN
) -> Method:
    """Return the method that an artifact holds.

    Args:
        artifact: The artifact.
        plan: Plan to look at.
        filter_settings: Of its filter on coarse positions.
        sight: What it is given of the plan.
    """
    if artifact.key.method == "gnn":
        gnn = artifact.networks["gnn"]
        return GNNMethod(gnn, float(artifact.constants["variance_m2"]))  # type: ignore[arg-type]
    trained = trained_from(artifact)
    return GNNFPDNN(
        coarse=GNNMethod(trained.gnn, trained.variance_m2),
        network=trained.fpdnn,
        plan=PlanRaster.of(plan),
        crops=trained.fpdnn.vision.crops,
        solver=range_solver(artifact.constants["solver"]),
        sigma_m=trained.sigma_m,
        filter_settings=filter_settings,
        sight=sight,
    )


def chosen_plan(name: str, target: PackedSite, data_root: Path) -> FloorPlan:
    """Return the plan that a method is to see.

    Args:
        name: ``real``; ``blank`` (nothing is drawn on it); ``length`` or ``none``, where nothing looks at
            it, so that it is blank as well; or another packed site, whose plan is laid over the target
            corner to corner.
        target: The target.
        data_root: Folder of packed sites.

    Raises:
        UnknownNameError: If it is none of these.
    """
    check_plan(name, data_root)
    if name == "real":
        return target.plan
    if name in PLANS:
        return target.plan.blank()
    return read_packed(data_root, name).plan.placed_as(target.plan)


def check_plan(name: str, data_root: Path) -> None:
    """Raise where no plan has this name: methods that look at none would record it all the same.

    Raises:
        UnknownNameError: If it is none of those that ``chosen_plan`` knows.
    """
    if name in PLANS:
        return
    known = packed_sites(data_root)
    if name not in known:
        raise UnknownNameError("--plan", name, known=[*PLANS, *known], way_out="choose one of these")


def answer(
    name: str, request: EvaluationRequest, calibration: str | None, data_root: Path, runs: Path
) -> list[Record]:
    """Return the records of `fploc evaluate`; a calibration of None is the method's own.

    Raises:
        FplocError: If an option cannot be used, or data or artifact are not there.
    """
    check_method(name)
    request.check()
    check_preset(request.preset)
    check_plan(request.plan, data_root)
    return scored(name, request, calibration, data_root, runs).records


@dataclass(frozen=True)
class Scored:
    """What a method made of a target.

    Args:
        records: The scores.
        tracks: What they were made from; empty where two devices were localized at once.
    """

    records: list[Record]
    tracks: list[Track]


def scored(
    name: str, request: EvaluationRequest, calibration: str | None, data_root: Path, runs: Path
) -> Scored:
    """Run and score a method; arguments and errors as ``ready_method``.

    Where networks were tuned for the target, those before the tuning are scored beside them.
    """
    ready = ready_method(name, request, calibration, data_root, runs)
    request = replace(request, calibration=ready.offsets.estimator)
    protocol = protocol_of(request.protocol, request.source)
    if protocol.targets is Targets.LINKED:
        if request.smoother:
            raise FplocError(
                f"--smoother with --protocol {protocol.name}",
                value="two devices at once",
                expected="a protocol that localizes each device alone",
                way_out="leave --smoother out, or write `--protocol zero-shot`",
            )
        return Scored(multi_device_records(name, ready, request, data_root), tracks=[])
    tracks = tracks_of(ready.method, request, data_root, offsets=ready.offsets)
    records = records_of(name, request, tracks, artifact=ready.artifact)
    if protocol.tested is Tested.SECOND_PART and name in LEARNED_METHODS:
        untuned = replace(request, protocol=str(protocol.starts_from(request.site)))
        before = ready_method(name, untuned, calibration, data_root, runs)
        records += [
            replace(one, condition=BEFORE_TUNING)
            for one in evaluate(
                before.method, request, data_root, offsets=before.offsets, artifact=before.artifact
            )
        ]
    return Scored(records, tracks)
