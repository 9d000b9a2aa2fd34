"""Requests that are refused: one form of answer for all of them."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi.responses import JSONResponse

from fploc.serve.messages import Refusal


class RefusedError(Exception):
    """A request that is not carried out.

    Args:
        status: HTTP status.
        reason: For programs, and the label in the metrics.
        message: For people.
        retry_after_s: When to try again; None where that would not help.
    """

    def __init__(self, status: int, reason: str, message: str, *, retry_after_s: int | None = None) -> None:
        super().__init__(message)
        self.status, self.reason, self.message = status, reason, message
        self.headers: Mapping[str, str] = {} if retry_after_s is None else {"Retry-After": str(retry_after_s)}
        if status == 401:
            self.headers = {**self.headers, "WWW-Authenticate": "Bearer"}

    def response(self) -> JSONResponse:
        """Return the answer."""
        body = Refusal(reason=self.reason, message=self.message).model_dump()
        return JSONResponse(body, status_code=self.status, headers=dict(self.headers))
