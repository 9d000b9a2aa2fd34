"""The application: routes of version 1, health, metrics, and the pages."""

from __future__ import annotations

import asyncio
import csv
import io
import logging
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import Depends, FastAPI, Query, Request, WebSocket, WebSocketDisconnect
from fastapi import Path as PathParameter
from fastapi.exceptions import RequestValidationError
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse, PlainTextResponse, Response
from pydantic import ValidationError
from pydantic.json_schema import models_json_schema
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException

from fploc import __version__
from fploc.serve.access import Access
from fploc.serve.guard import Guard, sender_of
from fploc.serve.limits import limited_body
from fploc.serve.messages import (
    LATEST_MS,
    AccessPointPlace,
    DeviceDetail,
    DeviceTrack,
    HeardReading,
    Measurements,
    Position,
    Positions,
    Receipt,
    Refusal,
    SiteDescription,
    TrackPoint,
)
from fploc.serve.metrics import Metrics
from fploc.serve.page import page_router
from fploc.serve.refusals import RefusedError
from fploc.serve.rows import FixRow
from fploc.serve.session import position_of
from fploc.serve.settings import ServeSettings
from fploc.serve.site_service import ServedSite, SiteService, now_ms
from fploc.serve.store import Store
from fploc.serve.tokens import Scope
from fploc.serve.upload_turns import UploadTurns
from fploc.serve.writer import StoreWriter

log = logging.getLogger("fploc.serve")

LIVE_PROTOCOL = "fploc.v1"
CLOSED_UNAUTHORIZED, CLOSED_FORBIDDEN, CLOSED_UNKNOWN, CLOSED_FULL = 4401, 4403, 4404, 4429
CLOSE_CODES = {401: CLOSED_UNAUTHORIZED, 403: CLOSED_FORBIDDEN, 404: CLOSED_UNKNOWN, 429: CLOSED_FULL}
TRACK_COLUMNS = tuple(TrackPoint.model_fields)

SiteName = Annotated[str, PathParameter(max_length=64)]
DeviceName = Annotated[str, PathParameter(max_length=64)]
Milliseconds = Annotated[float, Query(ge=0.0, le=LATEST_MS, allow_inf_nan=False)]


async def service_of(request: Request, site: SiteName) -> SiteService:
    """Return the site that a request names."""
    # Not a plain function: each of those would wait for a thread.
    return _known_site(request.app.state.services, site)


Service = Annotated[SiteService, Depends(service_of)]


def make_app(sites: Sequence[ServedSite], store: Store, settings: ServeSettings) -> FastAPI:
    """Return the application.

    Args:
        sites: What it serves, by the names of their sites.
        store: What survives it; it stays open.
        settings: Limits and times.
    """
    metrics = Metrics()
    uploads = UploadTurns(time.monotonic)
    access = Access(store, settings)
    services: dict[str, SiteService] = {}
    writers: list[StoreWriter] = []

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        writer = StoreWriter(store)
        writers.append(writer)
        for site in sites:
            service = SiteService(site, settings, store, writer, uploads, metrics)
            await asyncio.to_thread(service.restore)
            services[service.name] = service
        ticking = [asyncio.create_task(service.run()) for service in services.values()]
        yield
        for task in ticking:
            task.cancel()
        await asyncio.gather(*ticking, return_exceptions=True)
        for service in services.values():
            service.close()
        await asyncio.to_thread(writer.close)

    app = FastAPI(
        title="fploc",
        summary="Where phones are, from their round-trip times and a floor plan.",
        version=__version__,
        lifespan=lifespan,
        docs_url=None,
        redoc_url=None,
        responses={
            status: {"model": Refusal, "description": text}
            for status, text in (
                (401, "No valid token."),
                (403, "The token does not allow it."),
                (404, "No such site or device."),
                (422, "It does not fit the schema."),
                (429, "Too often, or too many devices."),
                (503, "Overloaded: try again."),
            )
        },
    )
    app.state.services = services
    app.add_middleware(
        Guard, most_in_flight=settings.most_requests_in_flight, uploads=uploads, metrics=metrics
    )
    _add_refusals(app, metrics)
    app.include_router(page_router())
    app.openapi = partial(_schema, app)  # type: ignore[method-assign]

    async def reader(request: Request) -> None:
        await access.require(request, Scope.READ)

    async def uploader(request: Request) -> None:
        await access.require(request, Scope.UPLOAD)

    async def admin(request: Request) -> None:
        await access.require(request, Scope.ADMIN)

    may_read, may_upload, may_manage = [Depends(reader)], [Depends(uploader)], [Depends(admin)]

    @app.get("/v1/sites", dependencies=may_read)
    async def site_names() -> list[str]:
        """Names of the sites that are served."""
        return sorted(services)

    @app.post(
        "/v1/sites/{site}/measurements",
        dependencies=may_upload,
        status_code=202,
        response_model=Receipt,
        openapi_extra={
            "requestBody": {
                "required": True,
                "content": {"application/json": {"schema": {"$ref": "#/components/schemas/Measurements"}}},
            }
        },
        responses={
            400: {"model": Refusal, "description": "Cut short."},
            413: {"model": Refusal, "description": "The body is too large."},
            415: {"model": Refusal, "description": "It is not JSON."},
        },
    )
    async def measurements(request: Request, service: Service) -> Response:
        """One reading set of a device, or a backlog of them; stored before it is answered."""
        kind = request.headers.get("content-type", "application/json").partition(";")[0].strip().lower()
        if kind != "application/json":
            raise RefusedError(415, "not_json", "send application/json")
        sender = sender_of(request.scope)
        service.require_room(sender)
        body = await limited_body(request, settings.most_body_bytes)
        receipt = await service.receive(Measurements.model_validate_json(body), sender)
        return Response(receipt.model_dump_json(), status_code=202, media_type="application/json")

    @app.get("/v1/sites/{site}/positions", dependencies=may_read, response_model=Positions)
    async def positions(service: Service) -> Response:
        """The latest position of every device that is followed."""
        return Response(service.text(now_ms()), media_type="application/json")

    @app.get("/v1/sites/{site}/devices/{device}", dependencies=may_read)
    async def device_detail(service: Service, device: DeviceName) -> DeviceDetail:
        """The latest of one device, with what it heard."""
        return _detail(service, device)

    @app.get("/v1/sites/{site}/devices/{device}/track", dependencies=may_read, response_model=DeviceTrack)
    async def track(
        service: Service,
        device: DeviceName,
        from_ms: Annotated[Milliseconds, Query(alias="from")] = 0.0,
        to_ms: Annotated[Milliseconds, Query(alias="to")] = LATEST_MS,
        format: Literal["json", "csv"] = "json",
    ) -> Response:
        """What was made of each reading set of a device, by its own clock, as JSON or CSV."""
        most = settings.most_track_points
        known = device in service.session.devices or await asyncio.to_thread(
            store.is_known, service.name, device
        )
        if not known:
            raise _unknown_device(device)
        fixes = await asyncio.to_thread(store.track, service.name, device, from_ms, to_ms, most + 1)
        points = [_point(fix) for fix in fixes[:most]]
        if format == "csv":
            return Response(_csv(points), media_type="text/csv")
        answer = DeviceTrack(site=service.name, device=device, is_complete=len(fixes) <= most, points=points)
        return Response(answer.model_dump_json(), media_type="application/json")

    @app.delete("/v1/sites/{site}/devices/{device}", dependencies=may_manage, status_code=204)
    async def forget(service: Service, device: DeviceName) -> None:
        """Delete all that is known of a device."""
        if not await service.forget(device):
            raise _unknown_device(device)

    @app.get("/v1/sites/{site}/site", dependencies=may_read)
    async def site_description(service: Service) -> SiteDescription:
        """The plan's place, the access points, the method."""
        return _description(service, settings)

    @app.get("/v1/sites/{site}/plan.png", dependencies=may_read, response_class=Response)
    async def plan(service: Service) -> Response:
        """The plan's picture."""
        return Response(service.site.plan_png, media_type="image/png")

    @app.get("/healthz")
    async def health() -> dict[str, str]:
        """Answers while the process lives."""
        return {"status": "ok"}

    @app.get("/readyz")
    async def ready() -> dict[str, str]:
        """Answers 200 while positions are computed and stored."""
        try:
            await asyncio.to_thread(store.check)
        except SQLAlchemyError as error:
            raise RefusedError(503, "not_ready", "the database does not answer", retry_after_s=2) from error
        if any(writer.is_failing for writer in writers):
            raise RefusedError(503, "not_ready", "the database refuses to store", retry_after_s=2)
        failing = [name for name, service in services.items() if service.is_failing]
        if failing:
            raise RefusedError(503, "not_ready", f"ticks fail at {', '.join(failing)}", retry_after_s=2)
        return {"status": "ready"}

    @app.get("/metrics", dependencies=may_read, response_class=PlainTextResponse)
    async def metrics_text() -> Response:
        """Counters in the text format of Prometheus."""
        return Response(metrics.text(), media_type="text/plain; version=0.0.4; charset=utf-8")

    @app.websocket("/v1/sites/{site}/live")
    async def live(socket: WebSocket, site: str) -> None:
        offered = LIVE_PROTOCOL if LIVE_PROTOCOL in socket.scope.get("subprotocols", []) else None
        await socket.accept(subprotocol=offered)
        try:
            _require_own_origin(socket)
            await access.require(socket, Scope.READ)
            service = _known_site(services, site)
            if len(service.live) >= settings.most_live:
                raise RefusedError(429, "too_many_live", "too many live connections")
        except RefusedError as refused:
            metrics.rejected.labels(refused.reason).inc()
            await socket.close(CLOSE_CODES[refused.status], refused.reason)
            return
        await _push(socket, service)

    return app


async def _push(socket: WebSocket, service: SiteService) -> None:
    """Send every tick until the other side goes."""

    async def send() -> None:
        async for text in listener.texts():
            await socket.send_text(text)

    with service.live.listening() as listener:
        listener.tell(service.text(now_ms()))
        tasks = {asyncio.create_task(send()), asyncio.create_task(_until_gone(socket))}
        try:
            # Not `gather`: it loses who cancelled it, which the server asks for.
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
        for task in done:
            if (error := task.exception()) is not None:
                log.debug("a live connection of %s ended: %r", service.name, error)


async def _until_gone(socket: WebSocket) -> None:
    """Return when the other side closes, or sends anything: there is nothing to say to the server."""
    try:
        await socket.receive_bytes()
    except (WebSocketDisconnect, KeyError):
        return


def _require_own_origin(socket: WebSocket) -> None:
    """Refuse pages of other servers: browsers let them open sockets anywhere.

    Raises:
        RefusedError: If the page is another server's.
    """
    origin = socket.headers.get("origin")
    if origin is not None and origin.partition("://")[2] != socket.headers.get("host"):
        raise RefusedError(403, "other_origin", "open the page from this server")


def _known_site(services: Mapping[str, SiteService], name: str) -> SiteService:
    if name not in services:
        raise RefusedError(404, "unknown_site", "this server does not serve that site")
    return services[name]


def _unknown_device(device: str) -> RefusedError:
    return RefusedError(404, "unknown_device", f"nothing is known of {device!r}")


def _detail(service: SiteService, device: str) -> DeviceDetail:
    followed = service.session.devices.get(device)
    if followed is None or followed.last is None:
        raise _unknown_device(device)
    readings = []
    if followed.heard is not None:
        columns = zip(
            service.session.localizer.site.access_points,
            followed.heard[0].tolist(),
            followed.heard[2].tolist(),
            strict=True,
        )
        readings = [
            HeardReading(name=ap.name, bssid=ap.mac, range_m=range_m or None, rss_dbm=rss_dbm or None)
            for ap, range_m, rss_dbm in columns
            if range_m or rss_dbm
        ]
    shown = position_of(device, followed, now_ms(), service.settings.silent_ms)
    return DeviceDetail(position=Position.model_validate(shown), readings=readings)


def _description(service: SiteService, settings: ServeSettings) -> SiteDescription:
    site = service.session.localizer.site
    return SiteDescription(
        name=site.name,
        is_made_up=site.made_up,
        device_height_m=site.device_height_m,
        method=service.session.localizer.method.name,
        speed_prior_mps=service.site.speed_prior_mps,
        tick_ms=settings.tick_ms,
        access_points=[
            AccessPointPlace(name=ap.name, bssid=ap.mac, x_m=ap.x_m, y_m=ap.y_m, height_m=ap.height_m)
            for ap in site.access_points
        ],
        plan=service.site.plan,
    )


def _point(fix: FixRow) -> TrackPoint:
    values = vars(fix)
    return TrackPoint(**{name: values[name] for name in TRACK_COLUMNS})


def _csv(points: Sequence[TrackPoint]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, TRACK_COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(point.model_dump() for point in points)
    return text.getvalue()


def _add_refusals(app: FastAPI, metrics: Metrics) -> None:
    """Answer every refusal in one form, and count it."""

    def answered(refused: RefusedError) -> JSONResponse:
        metrics.rejected.labels(refused.reason).inc()
        return refused.response()

    @app.exception_handler(RefusedError)
    async def refusal(_: Request, error: RefusedError) -> JSONResponse:
        return answered(error)

    @app.exception_handler(ValidationError)
    async def bad_message(_: Request, error: ValidationError) -> JSONResponse:
        return answered(RefusedError(422, "malformed", _first_fault(error.errors(include_input=False))))

    @app.exception_handler(RequestValidationError)
    async def bad_parameter(_: Request, error: RequestValidationError) -> JSONResponse:
        return answered(RefusedError(422, "malformed", _first_fault(error.errors())))

    @app.exception_handler(HTTPException)
    async def refused_by_router(_: Request, error: HTTPException) -> JSONResponse:
        reason = {404: "not_found", 405: "method_not_allowed"}.get(error.status_code, "malformed")
        refused = RefusedError(error.status_code, reason, str(error.detail))
        refused.headers = {**refused.headers, **(error.headers or {})}
        return answered(refused)


def _first_fault(errors: Sequence[Any]) -> str:
    """Return where the first fault is and what it is, without what was sent."""
    first = errors[0]
    place = ".".join(str(part) for part in first["loc"])
    return f"{place or 'body'}: {first['msg']}".encode("ascii", "replace").decode()[:300]


def _schema(app: FastAPI) -> dict[str, Any]:
    """Return the OpenAPI document, with the message that is checked by hand, and the tokens."""
    if app.openapi_schema is None:
        document = get_openapi(title=app.title, version=app.version, summary=app.summary, routes=app.routes)
        _, definitions = models_json_schema(
            [(Measurements, "validation")], ref_template="#/components/schemas/{model}"
        )
        document["components"]["schemas"].update(definitions["$defs"])
        document["components"]["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
        document["security"] = [{"token": []}]
        app.openapi_schema = document
    return app.openapi_schema
