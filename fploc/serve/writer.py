"""One thread that writes to the store: everything that is handed in meanwhile goes into its next transaction."""

from __future__ import annotations

import logging
from concurrent.futures import Future
from dataclasses import dataclass
from queue import SimpleQueue
from threading import Thread

from sqlalchemy.exc import SQLAlchemyError

from fploc.serve.rows import WaitingRow
from fploc.serve.session import Outcome
from fploc.serve.store import Store

MOST_IN_ONE_TRANSACTION = 512

log = logging.getLogger("fploc.serve")


@dataclass(frozen=True)
class _Order:
    received: list[WaitingRow]
    outcomes: list[Outcome]
    done: Future[None]


class StoreWriter:
    """Writes in the order in which things are handed in.

    Args:
        store: Where to.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._orders: SimpleQueue[_Order | None] = SimpleQueue()
        self._thread = Thread(target=self._run, name="fploc-store", daemon=True)
        self._thread.start()
        self.is_failing = False

    def write(self, received: list[WaitingRow], outcomes: list[Outcome]) -> Future[None]:
        """Hand in rows; the future is done when they, and all that was handed in before, are committed."""
        order = _Order(received, outcomes, Future())
        self._orders.put(order)
        return order.done

    def close(self) -> None:
        """Write what was handed in, and end the thread."""
        self._orders.put(None)
        self._thread.join()

    def _run(self) -> None:
        ends = False
        while not ends:
            orders = []
            first = self._orders.get()
            while first is not None:
                orders.append(first)
                if self._orders.empty() or len(orders) == MOST_IN_ONE_TRANSACTION:
                    break
                first = self._orders.get()
            ends = first is None
            if orders:
                self._commit(orders)

    def _commit(self, orders: list[_Order]) -> None:
        received = [row for order in orders for row in order.received]
        outcomes = [outcome for order in orders for outcome in order.outcomes]
        try:
            self._store.write(received, outcomes)
        except SQLAlchemyError as error:
            self.is_failing = True
            log.error("the database refused a transaction: %s", error)
            for order in orders:
                order.done.set_exception(error)
            return
        self.is_failing = False
        for order in orders:
            order.done.set_result(None)
