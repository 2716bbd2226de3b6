"""The numbers of a station as OpenMetrics, for Prometheus and other readers.

The agent sends its counters to its fronts once a second, and they come out unchanged, with the name
of the aircraft. Counters of a link begin anew with each connection, as readers of counters
expect. Nothing here asks an aircraft or an agent anything: a scrape costs them nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib.resources import files
from itertools import accumulate
from typing import TYPE_CHECKING, Any

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
    StateSetMetricFamily,
)
from prometheus_client.openmetrics import exposition as openmetrics
from prometheus_client.registry import Collector
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from m100link.apps.agent.client import AgentClient, Hearing
from m100link.apps.agent.messages import LinkCounted
from m100link.apps.station.listeners import Fronts
from m100link.apps.station.ros.client import Client
from m100link.apps.station.web.access_control import AccessControl
from m100link.apps.station.web.protocol import serve_http
from m100link.apps.station.web.server import RosbridgeServer
from m100link.protocol.items import ITEMS

if TYPE_CHECKING:
    from starlette.requests import Request

    from m100link.apps.station.config import Settings


DASHBOARD = files("m100link.apps.station.web") / "grafana.json"
"""A dashboard for Grafana that shows all of them."""

# Without types in their package.
_in_openmetrics: Callable[[CollectorRegistry], bytes] = openmetrics.generate_latest

_STATES = ("connecting", "connected", "lost", "silent", "gone")

_COUNTED: tuple[tuple[str, str, str, Mapping[str, str]], ...] = (
    (
        *("m100_link_bytes", "Bytes on the link to the aircraft", "direction"),
        {"received": "bytes_received", "sent": "bytes_sent"},
    ),
    (
        *("m100_link_frames", "Frames on the link to the aircraft", "direction"),
        {"received": "frames_received", "sent": "frames_sent"},
    ),
    (
        *("m100_link_acks", "Acks by what they answered", "kind"),
        {
            "answered": "acks",
            "duplicate": "duplicate_acks",
            "late": "late_acks",
            "foreign": "foreign_acks",
        },
    ),
    (*("m100_link_discarded_bytes", "Bytes outside any frame", ""), {"": "discarded_bytes"}),
    (
        *("m100_link_dropped_writes", "Frames not written because the link did not drain", ""),
        {"": "dropped_writes"},
    ),
    (*("m100_missed_setpoints", "Setpoints sent too late", ""), {"": "missed_setpoints"}),
    ("m100_link_repeats", "Transmissions beyond the first of a request", "", {"": "repeats"}),
    ("m100_link_expired", "Requests that ran out of tries", "", {"": "expired"}),
)
"""Name, help, label, and the counters of :class:`~m100link.LinkStatistics` by the label's value."""


_Family = tuple[type[Any], str, str, list[str], list[tuple[Any, ...]]]


class StationMetrics(Collector):
    def __init__(
        self, bridge: RosbridgeServer, dropped_by_tabs: Callable[[], Mapping[str, int]] = dict
    ) -> None:
        self._bridge = bridge
        self._dropped_by_tabs = dropped_by_tabs

    def collect(self) -> Iterator[Metric]:
        for kind, name, text, labels, samples in self._families():
            family = kind(name, text, labels=labels)
            for values, *rest in samples:
                family.add_metric(values, *rest)
            yield family

    def _families(self) -> Iterator[_Family]:
        """Class, name, help, labels, and of each sample the labels' values and its own."""
        agents = self._bridge.agents.items()
        # The counters of each aircraft that is known now.
        links = [
            (name, agent.link)
            for name, agent in agents
            if agent.link is not None and agent.is_connected
        ]
        yield (
            *(StateSetMetricFamily, "m100_connection", "State of the connection to the aircraft"),
            ["aircraft"],
            [([name], {one: one == _state_of(agent) for one in _STATES}) for name, agent in agents],
        )
        yield (
            *(GaugeMetricFamily, "m100_authority", "Whether control authority is held"),
            ["aircraft"],
            [([name], agent.has_authority) for name, agent in agents],
        )
        for metric, text, label, counted in _COUNTED:
            yield (
                *(CounterMetricFamily, metric, text),
                ["aircraft", label] if label else ["aircraft"],
                [
                    ([name, value] if label else [name], link.counters.get(counter, 0))
                    for name, link in links
                    for value, counter in counted.items()
                ],
            )
        yield (
            *(CounterMetricFamily, "m100_link_discards"),
            "Starts of frames and frames that were discarded, by cause",
            ["aircraft", "cause"],
            [([name, why], count) for name, link in links for why, count in link.discards.items()],
        )
        yield (
            *(GaugeMetricFamily, "m100_agent_loop_lag_seconds"),
            "Largest delay of the agent in the last second",
            ["aircraft"],
            [([name], link.loop_lag) for name, link in links],
        )
        yield (
            *(HistogramMetricFamily, "m100_link_round_trip_seconds"),
            "Round trips of answered requests, repeats included",
            ["aircraft"],
            [([name], _buckets(link), link.round_trips_s) for name, link in links],
        )
        yield from self._telemetry()
        yield from self._clients()

    def _telemetry(self) -> Iterator[_Family]:
        agents = self._bridge.agents.items()
        connected = [(name, view) for name, agent in agents if (view := agent.view).is_connected]
        yield (
            *(GaugeMetricFamily, "m100_telemetry_rate_hertz"),
            "Arrivals of a telemetry item per second, 0 when it stopped",
            ["aircraft", "item"],
            [
                ([name, item.name], view.rate_hz(item.record))
                for name, view in connected
                for item in ITEMS
                if view.age(item.record) is not None
            ],
        )
        yield (
            *(CounterMetricFamily, "m100_telemetry_mismatches"),
            "Telemetry packages that do not fit the firmware",
            ["aircraft"],
            [([name], view.state.mismatches) for name, view in connected],
        )

    def _clients(self) -> Iterator[_Family]:
        clients = [one for one in self._bridge.graph.sessions if isinstance(one, Client)]
        yield GaugeMetricFamily, "m100_clients", "Clients of rosbridge", [], [([], len(clients))]
        yield (
            *(CounterMetricFamily, "m100_client_dropped_messages"),
            "Messages that a client of rosbridge did not get because it is slow",
            ["client"],
            [([client.name], client.outbox.dropped) for client in clients],
        )
        yield (
            *(CounterMetricFamily, "m100_console_dropped_pictures"),
            "Telemetry frames that a tab of the console did not get because it is slow",
            ["tab"],
            [([name], count) for name, count in self._dropped_by_tabs().items()],
        )


def _buckets(link: LinkCounted) -> list[tuple[str, int]]:
    bounds = [one if one != "inf" else "+Inf" for one in link.round_trips]
    return list(zip(bounds, accumulate(link.round_trips.values()), strict=True))


def _state_of(agent: AgentClient) -> str:
    return "gone" if agent.view.hearing is Hearing.GONE else agent.view.connection


def metrics_app(
    bridge: RosbridgeServer,
    settings: Settings,
    dropped_by_tabs: Callable[[], Mapping[str, int]] = dict,
) -> AccessControl:
    """``/metrics`` and ``/dashboard.json``, behind the gate of the station."""
    registry = CollectorRegistry()
    registry.register(StationMetrics(bridge, dropped_by_tabs))

    async def metrics(request: Request) -> Response:
        if "application/openmetrics-text" in request.headers.get("accept", ""):
            text, kind = _in_openmetrics(registry), openmetrics.CONTENT_TYPE_LATEST
        else:
            text, kind = generate_latest(registry), CONTENT_TYPE_LATEST
        return Response(text, headers={"content-type": kind, "cache-control": "no-store"})

    async def dashboard(request: Request) -> Response:
        return Response(DASHBOARD.read_bytes(), media_type="application/json")

    async def greet(request: Request) -> Response:
        return PlainTextResponse("m100link station: /metrics, and /dashboard.json for Grafana.\n")

    routes = [Route("/", greet), Route("/metrics", metrics), Route("/dashboard.json", dashboard)]
    return settings.gate(Starlette(routes=routes))


async def serve(fronts: Fronts) -> None:
    bridge = fronts.made["rosbridge"]
    assert isinstance(bridge, RosbridgeServer)
    app = metrics_app(bridge, fronts.settings, fronts.dropped.get("console", dict))
    await serve_http(fronts, "metrics", app)
