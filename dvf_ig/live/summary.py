"""Numbers of a live session: answers, latency, connections, refusals."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dvf_ig.core import IntArray
from dvf_ig.guidance import Status, SupervisorState

from .loop import Answer, LiveLoop

BIN_S = 1e-5
BINS = 100_001
"""10 µs each, and one for all beyond a second."""


@dataclass(slots=True)
class LatencyCount:
    """Latencies from a tool pose's last byte in to the force's first byte out, in bins of BIN_S."""

    counts: IntArray = field(default_factory=lambda: np.zeros(BINS, dtype=np.int64))
    worst_s: float = 0.0

    def add(self, latency_s: float) -> None:
        """Count one; NaN counts nothing."""
        if latency_s >= 0.0:
            self.counts[min(int(latency_s / BIN_S), BINS - 1)] += 1
            self.worst_s = max(self.worst_s, latency_s)

    def percentile_s(self, percent: float) -> float | None:
        """Value at a percentile, rounded up to the end of its bin; None without any."""
        total = int(self.counts.sum())
        if total == 0:
            return None
        at = int(np.searchsorted(np.cumsum(self.counts), 0.01 * percent * total))
        return self.worst_s if at >= BINS - 1 else min(self.worst_s, (at + 1) * BIN_S)


@dataclass(slots=True)
class LiveSummary:
    """Counts answers as they are sent."""

    latency: LatencyCount = field(default_factory=LatencyCount)
    answers: int = 0
    by_state: dict[str, int] = field(default_factory=lambda: dict.fromkeys(SupervisorState.__members__, 0))
    by_status: dict[Status, int] = field(default_factory=lambda: dict.fromkeys(Status, 0))
    largest_n: float = 0.0

    def add(self, answer: Answer) -> None:
        """One answer that was sent."""
        self.answers += 1
        self.latency.add(answer.latency_s)
        self.by_state[answer.supervisor.name] += 1
        self.by_status[answer.state.status] += 1
        self.largest_n = max(self.largest_n, float(np.linalg.norm(answer.force_n)))

    def result(self, loop: LiveLoop) -> dict[str, Any]:
        """JSON values."""
        registrations = loop.session.history.registrations
        return {
            "answers": self.answers,
            "latency_ms": {
                "median": _ms(self.latency.percentile_s(50.0)),
                "p99": _ms(self.latency.percentile_s(99.0)),
                "max": _ms(self.latency.worst_s),
            },
            "servo_states": dict(self.by_state),
            "largest_force_n": self.largest_n,
            "registrations": [
                {"asked_s": one.asked_s, "usable": one.usable, "reason": one.reason} for one in registrations
            ],
            "connections": loop.link.connections,
            "turned_away": loop.link.turned_away,
            "messages_refused": loop.source.refused + loop.refused,
            "messages_dropped_in": loop.inbox.dropped,
            "messages_dropped_out": loop.link.dropped,
            "servo_run_share": loop.running_share,
        }

    def table(self, result: dict[str, Any]) -> list[tuple[str, ...]]:
        """Table of the numbers for people."""
        latency = result["latency_ms"]
        usable = sum(one["usable"] for one in result["registrations"])
        rows: list[tuple[str, ...]] = [
            ("answers", str(result["answers"])),
            ("latency, tool pose in to force out", _latency(latency)),
            ("largest force", f"{self.largest_n:.2f} N"),
            ("registrations", f"{len(result['registrations'])}, of which {usable} could be used"),
            ("connections", str(result["connections"])),
            ("messages refused", str(result["messages_refused"])),
            ("messages dropped", f"{result['messages_dropped_in']} in, {result['messages_dropped_out']} out"),
        ]
        return [*rows, *_device_rows(result["device"])] if "device" in result else rows


def _device_rows(device: dict[str, Any]) -> list[tuple[str, ...]]:
    """Rows of a haptic device's servo."""
    late, deepest = device["lateness_us"], device["deepest_mm"]
    depth = "–" if deepest is None else f"{deepest:.2f} mm"
    return [
        ("device", f"{device['name']}, {device['rate_hz']:.0f} Hz"),
        ("servo's ticks", f"{device['ticks']}, {device['run_share']:.2%} of the deadlines"),
        (
            "lateness",
            f"median {late['median']} us, p99 {late['p99']}, p99.9 {late['p999']}, max {late['max']:.0f}",
        ),
        ("force on the device", f"up to {device['largest_force_n']:.2f} N, deepest tip {depth}"),
        ("latches", "; ".join(device["latches"]) or "none"),
    ]


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds


def _latency(latency: dict[str, float | None]) -> str:
    if latency["median"] is None:
        return "no force was sent for a tool pose"
    return ", ".join(f"{name} {value:.2f} ms" for name, value in latency.items() if value is not None)
