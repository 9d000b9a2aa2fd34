from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from starlette.websockets import WebSocketDisconnect

from fploc.datasets.recordings import Recording
from fploc.serve.app import CLOSED_FORBIDDEN, CLOSED_UNAUTHORIZED, CLOSED_UNKNOWN, make_app
from fploc.serve.guard import HEADERS
from fploc.serve.messages import Measurements, Positions
from fploc.serve.recorded import recorded_intervals
from fploc.serve.server import announcement, listening_socket
from fploc.serve.settings import ServeSettings
from fploc.serve.site_service import ServedSite
from fploc.serve.store import Store

TokenOf = Callable[..., str]
READING = {"bssid": "00:00:00:00:00:00", "range_m": 5.0, "rss_dbm": -60.0}
MESSAGE: dict[str, Any] = {"device": "a", "intervals": [{"t_ms": 1.0, "readings": [READING]}]}
UPLOADS = "/v1/sites/box/measurements"


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@pytest.fixture
def client(served: ServedSite, store: Store, settings: ServeSettings) -> Iterator[TestClient]:
    with TestClient(make_app([served], store, settings), raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def phone(token_of: TokenOf) -> dict[str, str]:
    return bearer(token_of("upload"))


@pytest.fixture
def reader(token_of: TokenOf) -> dict[str, str]:
    return bearer(token_of("read"))


def wait_for_fixes(client: TestClient, reader: dict[str, str], count: int) -> Positions:
    until = time.monotonic() + 60.0
    while time.monotonic() < until:
        if len(client.get("/v1/sites/box/devices/a/track", headers=reader).json().get("points", [])) >= count:
            break
        time.sleep(0.05)
    return Positions.model_validate_json(client.get("/v1/sites/box/positions", headers=reader).content)


def test_what_a_phone_sends_comes_out_as_position_and_track(
    client: TestClient, phone: dict[str, str], reader: dict[str, str], recordings: list[Recording],
    served: ServedSite,
) -> None:  # fmt: skip
    intervals = recorded_intervals(recordings[0], served.localizer.site)
    body = Measurements(device="a", recording="lap", intervals=intervals).model_dump_json(exclude_none=True)
    answer = client.post(UPLOADS, content=body, headers=phone)
    assert (answer.status_code, answer.json()["accepted"]) == (202, len(intervals))
    (shown,) = wait_for_fixes(client, reader, len(intervals)).devices
    assert shown.reason == "fixed" and shown.x_m is not None and shown.truth_x_m is not None
    assert abs(shown.x_m - shown.truth_x_m) < 1.5
    detail = client.get("/v1/sites/box/devices/a", headers=reader).json()
    assert {one["name"] for one in detail["readings"]} <= {"AP0", "AP1", "AP2", "AP3"}
    path = "/v1/sites/box/devices/a/track"
    cut = client.get(path, params={"from": 1000, "to": 3000}, headers=reader).json()
    assert cut["is_complete"] and all(1000 <= point["t_ms"] <= 3000 for point in cut["points"])
    table = client.get(path, params={"format": "csv"}, headers=reader)
    assert table.headers["content-type"].startswith("text/csv")
    assert table.text.startswith("recording,t_ms,x_m,y_m,") and table.text.count("\n") == 1 + len(intervals)
    assert client.post(UPLOADS, content=body, headers=phone).json()["duplicate"] == len(intervals)


def test_the_site_and_its_plan(client: TestClient, reader: dict[str, str]) -> None:
    site = client.get("/v1/sites/box/site", headers=reader).json()
    assert [ap["name"] for ap in site["access_points"]] == ["AP0", "AP1", "AP2", "AP3"]
    assert site["speed_prior_mps"] == 0.5
    picture = client.get(site["plan"]["url"], headers=reader)
    assert picture.headers["content-type"] == "image/png" and picture.content[:4] == b"\x89PNG"
    assert client.get("/v1/sites", headers=reader).json() == ["box"]


def test_the_first_line_says_what_is_served_and_who_can_reach_it(served: ServedSite) -> None:
    with listening_socket("127.0.0.1", 0) as listening:
        line = announcement([replace(served, speed_prior_mps=1.4)], listening)
    assert "box with nls-onesided for people at 1.4 m/s on http://127.0.0.1:" in line
    assert "only this machine can reach it" in line


def test_live_connections_get_the_newest_and_go_quietly(
    client: TestClient, phone: dict[str, str], token_of: TokenOf
) -> None:
    token = token_of("read")
    protocols = ["fploc.v1", f"bearer.{token}"]
    with client.websocket_connect("/v1/sites/box/live", subprotocols=protocols) as socket:
        assert socket.accepted_subprotocol == "fploc.v1"
        first = Positions.model_validate_json(socket.receive_text())
        client.post(UPLOADS, json=MESSAGE, headers=phone)
        until = time.monotonic() + 60.0
        message = first
        while not message.devices and time.monotonic() < until:
            message = Positions.model_validate_json(socket.receive_text())
        assert message.tick > first.tick and message.devices[0].reason == "too_few_ranges"


@pytest.mark.parametrize(
    ("scopes", "path", "origin", "code"),
    [
        (None, "/v1/sites/box/live", None, CLOSED_UNAUTHORIZED),
        ("upload", "/v1/sites/box/live", None, CLOSED_FORBIDDEN),
        ("read", "/v1/sites/nowhere/live", None, CLOSED_UNKNOWN),
        ("read", "/v1/sites/box/live", "https://elsewhere.example", CLOSED_FORBIDDEN),
    ],
)
def test_live_connections_need_a_token_a_site_and_a_page_of_this_server(
    client: TestClient, token_of: TokenOf, scopes: str | None, path: str, origin: str | None, code: int
) -> None:
    headers = {} if scopes is None else bearer(token_of(scopes))
    headers |= {} if origin is None else {"Origin": origin}
    with client.websocket_connect(path, headers=headers) as socket:
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_text()
        assert closed.value.code == code


def test_tokens_open_what_their_scopes_say(client: TestClient, token_of: TokenOf, store: Store) -> None:
    expired = token_of("upload,read,admin", days=1e-9)
    time.sleep(0.01)
    for headers, reason in (
        ({}, "no_token"),
        ({"Authorization": "Basic abc"}, "no_token"),
        (bearer("wrong"), "bad_token"),
        (bearer(f"fploc_{'0' * 12}_{'A' * 43}"), "bad_token"),
        (bearer(expired), "bad_token"),
    ):
        for method, path in (("POST", UPLOADS), ("GET", "/v1/sites/box/positions"), ("GET", "/metrics")):
            refused = client.request(method, path, headers=headers, json=MESSAGE)
            assert (refused.status_code, refused.json()["reason"]) == (401, reason)
            assert refused.headers["www-authenticate"] == "Bearer"
    phone, reader, admin = (bearer(token_of(scope)) for scope in ("upload", "read", "admin"))
    assert client.post(UPLOADS, json=MESSAGE, headers=reader).json()["reason"] == "wrong_scope"
    assert client.get("/v1/sites/box/positions", headers=phone).status_code == 403
    assert client.delete("/v1/sites/box/devices/a", headers=phone).status_code == 403
    assert client.post(UPLOADS, json=MESSAGE, headers=admin).status_code == 202
    assert client.delete("/v1/sites/box/devices/a", headers=admin).status_code == 204
    assert client.delete("/v1/sites/box/devices/a", headers=admin).status_code == 404
    assert not store.is_known("box", "a")


def test_reading_without_a_token_is_possible_where_it_is_switched_on(
    served: ServedSite, store: Store, settings: ServeSettings
) -> None:
    with TestClient(make_app([served], store, replace(settings, is_read_anonymous=True))) as client:
        assert client.get("/v1/sites/box/positions").status_code == 200
        assert client.post(UPLOADS, json=MESSAGE).status_code == 401
        with client.websocket_connect("/v1/sites/box/live") as socket:
            assert Positions.model_validate_json(socket.receive_text()).site == "box"


def test_rates_bodies_and_devices_are_limited(
    served: ServedSite, store: Store, settings: ServeSettings, phone: dict[str, str], token_of: TokenOf
) -> None:
    tight = replace(
        settings, requests_per_s=0.01, request_burst=5, most_body_bytes=300, most_devices=1, most_waiting=3,
        tick_ms=3_600_000.0,
    )  # fmt: skip
    with TestClient(make_app([served], store, tight)) as client:
        assert client.post(UPLOADS, json=MESSAGE, headers=phone).status_code == 202
        other = client.post(UPLOADS, json=MESSAGE | {"device": "b"}, headers=phone)
        assert (other.status_code, other.json()["reason"]) == (429, "too_many_devices")
        times = [{"t_ms": t, "readings": []} for t in range(2, 7)]
        crowded = client.post(UPLOADS, json=MESSAGE | {"intervals": times}, headers=phone)
        assert (crowded.status_code, crowded.json()["reason"]) == (503, "overloaded")
        assert int(crowded.headers["retry-after"]) > 0
        parts = iter([b" " * 200] * 3)
        for large in ({"content": b" " * 301}, {"content": parts}):
            assert client.post(UPLOADS, headers=phone, **large).status_code == 413
        limited = client.post(UPLOADS, json=MESSAGE, headers=phone)
        assert (limited.status_code, limited.json()["reason"]) == (429, "rate_limited")
        reader = bearer(token_of("read"))
        text = client.get("/metrics", headers=reader).text
        for reason in ("too_many_devices", "overloaded", "too_large", "rate_limited"):
            assert f'fploc_messages_rejected_total{{reason="{reason}"}}' in text


@pytest.mark.parametrize("announced", [None, "1000000000", "9" * 40])
def test_huge_bodies_are_refused_however_they_are_announced(
    client: TestClient, phone: dict[str, str], announced: str | None
) -> None:
    content = b" " * 10_000_000 if announced is None else b"{}"
    headers = phone if announced is None else phone | {"Content-Length": announced}
    refused = client.post(UPLOADS, content=content, headers=headers)
    assert (refused.status_code, refused.json()["reason"]) == (413, "too_large")


def test_more_readings_than_fit_are_refused(client: TestClient, phone: dict[str, str]) -> None:
    crowded = MESSAGE | {"intervals": [{"t_ms": 1.0, "readings": [READING] * 10_000}]}
    refused = client.post(UPLOADS, json=crowded, headers=phone)
    assert (refused.status_code, refused.json()["reason"]) == (422, "malformed")
    assert len(refused.content) < 600


def test_what_finds_no_room_is_refused_before_it_is_read(
    served: ServedSite, store: Store, settings: ServeSettings, phone: dict[str, str]
) -> None:
    full = replace(settings, most_waiting=1, tick_ms=3_600_000.0)
    with TestClient(make_app([served], store, full)) as client:
        assert client.post(UPLOADS, json=MESSAGE, headers=phone).status_code == 202
        refused = client.post(UPLOADS, content=b"nonsense", headers=phone)
        assert (refused.status_code, refused.json()["reason"]) == (503, "overloaded")
        assert int(refused.headers["retry-after"]) > 0


def test_too_many_requests_at_once_are_turned_away(
    served: ServedSite, store: Store, settings: ServeSettings
) -> None:
    with TestClient(make_app([served], store, replace(settings, most_requests_in_flight=0))) as client:
        refused = client.get("/healthz")
        assert (refused.status_code, refused.json()["reason"]) == (503, "overloaded")
        assert "content-security-policy" in refused.headers


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"null", b"[" * 100_000, b"\xff\xfe", b'{"device": "\\ud800", "intervals": []}', b"1" * 5000,
        b'{"device":"a","intervals":[{"t_ms":1e999,"readings":[]}]}',
        b'{"device":"a","intervals":[{"t_ms":1,"readings":[{"bssid":"00:00:00:00:00:00","range_m":NaN}]}]}',
        json.dumps(MESSAGE | {"device": "\u202eabc"}).encode(),
    ],
)  # fmt: skip
def test_malformed_bodies_are_refused_without_an_echo(
    client: TestClient, phone: dict[str, str], body: bytes
) -> None:
    refused = client.post(UPLOADS, content=body, headers=phone)
    assert (refused.status_code, refused.json()["reason"]) == (422, "malformed")
    assert len(refused.content) < 600


def test_other_kinds_of_content_are_refused(client: TestClient, phone: dict[str, str]) -> None:
    refused = client.post(UPLOADS, content="a=b", headers=phone | {"Content-Type": "text/plain"})
    assert (refused.status_code, refused.json()["reason"]) == (415, "not_json")


@pytest.mark.parametrize(
    "site", ["nowhere", "..", "%2e%2e", "..%2f..%2fetc%2fpasswd", "box%00", "x" * 65, "box%2f..%2fbox", "."]
)
def test_site_names_lead_nowhere_else(client: TestClient, reader: dict[str, str], site: str) -> None:
    for path in ("site", "positions", "plan.png"):
        assert client.get(f"/v1/sites/{site}/{path}", headers=reader).status_code in (404, 422)


@pytest.mark.parametrize(
    "query", ["from=nan", "from=-1", "to=inf", "to=1e300", "format=xml", "from=a", "from=1&from=b"]
)
def test_bad_parameters_are_refused(client: TestClient, reader: dict[str, str], query: str) -> None:
    refused = client.get(f"/v1/sites/box/devices/a/track?{query}", headers=reader)
    assert (refused.status_code, refused.json()["reason"]) == (422, "malformed")


def test_every_answer_has_the_headers(client: TestClient, reader: dict[str, str]) -> None:
    for path in ("/", "/docs", "/static/map.js", "/static/nothing", "/healthz", "/nowhere", "/v1/sites"):
        answer = client.get(path, headers=reader)
        for name, value in HEADERS:
            assert answer.headers[name.decode()] == value.decode()


def test_pages_use_nothing_of_other_servers_and_nothing_inline(client: TestClient) -> None:
    for page in ("/", "/docs"):
        text = client.get(page).text
        assert "http://" not in text and "https://" not in text and "style=" not in text
        assert "<script>" not in text and "onclick" not in text
    for file in ("map.css", "map.js", "docs.js", "icon.svg", "swagger-ui.css", "swagger-ui-bundle.js"):
        assert client.get(f"/static/{file}").status_code == 200
    script = client.get("/static/map.js").text
    assert "innerHTML" not in script and "eval(" not in script and "https://" not in script


def test_health_readiness_and_metrics(
    client: TestClient, reader: dict[str, str], phone: dict[str, str]
) -> None:
    assert client.get("/healthz").json() == {"status": "ok"}
    assert client.get("/readyz").json() == {"status": "ready"}
    client.post(UPLOADS, json=MESSAGE, headers=phone)
    client.post(UPLOADS, json=MESSAGE, headers=phone)
    wait_for_fixes(client, reader, 1)
    text = client.get("/metrics", headers=reader).text
    assert 'fploc_reading_sets_accepted_total{site="box"} 1.0' in text
    assert 'fploc_reading_sets_not_used_total{reason="duplicate",site="box"} 1.0' in text
    assert 'fploc_tick_seconds_bucket{le="0.2",site="box"}' in text


def test_a_server_goes_on_where_another_ended(
    served: ServedSite, store: Store, settings: ServeSettings, phone: dict[str, str], reader: dict[str, str]
) -> None:
    slow = replace(settings, tick_ms=3_600_000.0)
    with TestClient(make_app([served], store, slow)) as client:
        client.post(UPLOADS, json=MESSAGE, headers=phone)
    with TestClient(make_app([served], store, settings)) as client:
        (shown,) = wait_for_fixes(client, reader, 1).devices
        assert (shown.device, shown.t_ms, shown.access_points) == ("a", 1.0, 1)


def test_the_document_describes_what_is_checked_by_hand(client: TestClient) -> None:
    document = client.get("/openapi.json").json()
    assert set(document["paths"]) >= {UPLOADS.replace("box", "{site}"), "/v1/sites/{site}/positions"}
    schemas = document["components"]["schemas"]
    assert schemas["Reading"]["properties"]["range_m"] and schemas["Measurements"]["required"]
    references = {part.partition('"')[0] for part in json.dumps(document).split('"#/components/schemas/')[1:]}
    assert references <= set(schemas)


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=12,
)


@hypothesis_settings(
    deadline=None, max_examples=30, database=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)  # fmt: skip
@given(JSON, st.sampled_from(["device", "intervals", "recording", "version", "other"]))
def test_whatever_is_sent_is_taken_or_refused(
    client: TestClient, phone: dict[str, str], value: object, key: str
) -> None:
    answer = client.post(UPLOADS, content=json.dumps(MESSAGE | {key: value}), headers=phone)
    assert answer.status_code in (202, 422), answer.text
