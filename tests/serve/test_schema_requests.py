"""Requests that schemathesis makes out of the server's own OpenAPI document."""

from __future__ import annotations

import importlib.util
from collections import Counter
from pathlib import Path
from typing import Any

import httpx
import schemathesis
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings

from fploc.serve.app import make_app
from fploc.serve.settings import ServeSettings
from fploc.serve.site_service import ServedSite, now_ms
from fploc.serve.store import Store
from fploc.serve.tokens import Scope, make_token

_spec = importlib.util.spec_from_file_location("serving", Path(__file__).with_name("serving.py"))
assert _spec is not None and _spec.loader is not None
serving = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(serving)

CASES = 8


def test_no_request_made_from_the_document_is_a_server_error(
    served: ServedSite, store: Store, settings: ServeSettings
) -> None:
    token = make_token(store, "tester", frozenset({Scope.ADMIN}), 1.0, now_ms())
    answered: Counter[tuple[str, int]] = Counter()
    with serving.running(make_app([served], store, settings)) as port:
        url = f"http://127.0.0.1:{port}"
        schema = schemathesis.openapi.from_dict(httpx.get(f"{url}/openapi.json").json())
        for found in schema.get_all_operations():
            operation = found.ok()

            @hypothesis_settings(
                max_examples=CASES, deadline=None, database=None, derandomize=True,
                suppress_health_check=list(HealthCheck),
            )  # fmt: skip
            @given(case=operation.as_strategy())
            def check(case: Any) -> None:
                if "site" in case.path_parameters:
                    case.path_parameters["site"] = "box"
                answer = case.call(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=60)
                answered[case.path, answer.status_code] += 1
                assert answer.status_code < 500, (case.path, answer.text)

            check()
        assert httpx.get(f"{url}/readyz").status_code == 200
    assert len({path for path, _ in answered}) == 10
    assert any(path.endswith("/measurements") and status == 202 for path, status in answered)
