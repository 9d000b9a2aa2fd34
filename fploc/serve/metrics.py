"""What the server counts, for Prometheus."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

LATENCIES_S = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0)


class Metrics:
    """Counters of one server, in a registry of its own."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        self.ticks = Counter("fploc_ticks", "Ticks done", ["site"], registry=self._registry)
        self.missed_ticks = Counter(
            "fploc_missed_ticks",
            "Ticks left out because one took too long",
            ["site"],
            registry=self._registry,
        )
        self.latency = Histogram(
            "fploc_tick_seconds",
            "From when a tick is due until its positions are out",
            ["site"],
            buckets=LATENCIES_S,
            registry=self._registry,
        )
        self.fixes = Counter(
            "fploc_fixes",
            "Reading sets used, by what became of them",
            ["site", "reason"],
            registry=self._registry,
        )
        self.devices = Gauge("fploc_devices", "Devices that are followed", ["site"], registry=self._registry)
        self.waiting = Gauge("fploc_waiting", "Reading sets that wait", ["site"], registry=self._registry)
        self.live = Gauge("fploc_live_connections", "Live connections", ["site"], registry=self._registry)
        self.upload_wait = Gauge(
            "fploc_upload_wait_seconds",
            "How long a phone that asks now waits for its turn to upload; 0 without overload",
            registry=self._registry,
        )
        self.accepted = Counter(
            "fploc_reading_sets_accepted", "Reading sets accepted", ["site"], registry=self._registry
        )
        self.not_used = Counter(
            "fploc_reading_sets_not_used",
            "Reading sets not used, by reason: duplicate, late, skewed",
            ["site", "reason"],
            registry=self._registry,
        )
        self.unknown_access_points = Counter(
            "fploc_unknown_access_points",
            "Readings of access points that the site does not have",
            ["site"],
            registry=self._registry,
        )
        self.links = Counter("fploc_links", "Readings of other devices", ["site"], registry=self._registry)
        self.rejected = Counter(
            "fploc_messages_rejected", "Requests refused, by reason", ["reason"], registry=self._registry
        )

    def text(self) -> bytes:
        """Return everything in the text format of Prometheus."""
        return generate_latest(self._registry)
