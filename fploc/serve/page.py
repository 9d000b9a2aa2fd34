"""The map page and the API's page: files of this package and of an installed one, no other server's."""

from __future__ import annotations

from importlib import resources, util
from importlib.resources.abc import Traversable
from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import Response

from fploc.serve.refusals import RefusedError

TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}
API_PAGE_PACKAGE = "flask_swagger_ui"
API_PAGE_FILES = ("swagger-ui.css", "swagger-ui-bundle.js")


def page_router() -> APIRouter:
    """Return the routes of both pages; every file is read once."""
    files = {
        name: _file(resources.files("fploc.serve") / "static" / name)
        for name in ("map.html", "map.js", "map.css", "docs.html", "docs.js", "icon.svg")
    }
    package = util.find_spec(API_PAGE_PACKAGE)
    assert package is not None and package.submodule_search_locations, "it is a dependency"
    folder = Path(next(iter(package.submodule_search_locations))) / "dist"
    files |= {name: _file(folder / name) for name in API_PAGE_FILES}
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    async def map_page() -> Response:
        return _response("map.html", files)

    @router.get("/docs")
    async def api_page() -> Response:
        return _response("docs.html", files)

    @router.get("/favicon.ico")
    async def icon() -> Response:
        return _response("icon.svg", files)

    @router.get("/static/{name}")
    async def static_file(name: str) -> Response:
        return _response(name, files)

    return router


def _file(file: Traversable | Path) -> tuple[bytes, str]:
    return file.read_bytes(), TYPES[Path(file.name).suffix]


def _response(name: str, files: dict[str, tuple[bytes, str]]) -> Response:
    if name not in files:
        raise RefusedError(404, "not_found", "there is no such page")
    content, media_type = files[name]
    return Response(content, media_type=media_type)
