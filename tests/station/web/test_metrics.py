"""What a scraper reads, read by the parser of Prometheus itself. Real time and sockets."""

from __future__ import annotations

import asyncio
import json
import re
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable
from typing import Any

import pytest

pytest.importorskip("uvicorn")
pytest.importorskip("prometheus_client")
from prometheus_client.metrics_core import Metric
from prometheus_client.openmetrics.parser import text_string_to_metric_families as read_openmetrics
from prometheus_client.parser import text_string_to_metric_families as read_text
from websockets.asyncio.client import connect

from m100link.protocol.items import ITEMS
from m100link.sim.line import LineFaults
from m100link.station.config import Settings
from m100link.station.run import Running
from m100link.station.web.metrics import DASHBOARD
from tests.station.web.test_server import TOKEN, address, station, until

pytestmark = pytest.mark.anyio

READ: Callable[[str], Iterable[Metric]] = read_openmetrics  # it has no types
OPENMETRICS = "application/openmetrics-text; version=1.0.0"


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"  # real time: sockets are not virtual


class Refused(Exception):
    """An answer that is an error, by its status."""


def got(url: str, **headers: str) -> tuple[str, str]:
    """Content type and text of a page."""
    asked = urllib.request.Request(url, headers=headers)
    try:
        with urllib.request.urlopen(asked, timeout=20) as answer:
            return answer.headers["content-type"], answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            raise Refused(error.code) from None


async def page(one: Running, path: str = "/metrics", **headers: str) -> tuple[str, str]:
    return await asyncio.to_thread(got, f"http://127.0.0.1:{one.metrics_port}{path}", **headers)


async def scraped(one: Running) -> dict[str, Metric]:
    kind, text = await page(one, Accept=OPENMETRICS)
    assert kind.startswith("application/openmetrics-text")
    return {family.name: family for family in READ(text)}


def values(family: Metric, suffix: str = "") -> dict[tuple[str, ...], float]:
    """Values by the labels, that of the aircraft left out."""
    return {
        tuple(value for name, value in one.labels.items() if name != "aircraft"): one.value
        for one in family.samples
        if one.name == family.name + suffix
    }


async def counted(one: Running) -> None:
    await until(lambda: (link := one.bridge.agent.link) is not None and link.counters["acks"] > 1)


async def test_a_scrape_has_what_was_counted_and_goes_on() -> None:
    async with station(metrics_port=0) as one:
        assert one.virtual is not None
        one.virtual.set_faults(LineFaults(damage=0.2))
        await counted(one)
        async with connect(address(one)):
            found = await scraped(one)
            assert values(found["m100_clients"]) == {(): 1.0}
            assert list(values(found["m100_client_dropped_messages"], "_total").values()) == [0.0]
        assert values(found["m100_connection"]) == {
            (state,): float(state == "connected")
            for state in ("connecting", "connected", "lost", "silent", "gone")
        }
        assert {one.labels["aircraft"] for one in found["m100_connection"].samples} == {"m100"}
        assert values(found["m100_link_frames"], "_total")["received",] > 10
        assert values(found["m100_link_bytes"], "_total")["sent",] > 10
        assert sum(values(found["m100_link_discards"], "_total").values()) > 0
        rates = values(found["m100_telemetry_rate_hertz"])
        assert {name for (name,) in rates} <= {item.name for item in ITEMS}
        assert 20 < rates["position",] < 130
        trips = found["m100_link_round_trip_seconds"]
        buckets = list(values(trips, "_bucket").values())
        assert buckets == sorted(buckets)
        assert buckets[-1] == values(trips, "_count")[()] > 0
        assert values(trips, "_sum")[()] > 0
        lag = values(found["m100_agent_loop_lag_seconds"])[()]
        assert 0 <= lag < 5
        before = values(found["m100_link_frames"], "_total")["received",]
        await asyncio.sleep(1.2)
        assert values((await scraped(one))["m100_link_frames"], "_total")["received",] > before


async def test_of_a_lost_aircraft_only_that_is_told() -> None:
    async with station(metrics_port=0) as one:
        await counted(one)
        assert one.virtual is not None
        one.virtual.unplug()
        await until(lambda: not one.bridge.agent.is_connected)
        found = await scraped(one)
        assert values(found["m100_connection"])["connected",] == 0.0
        assert not found["m100_link_frames"].samples
        assert not found["m100_telemetry_rate_hertz"].samples


async def test_every_metric_of_the_dashboard_exists_and_every_metric_is_on_it() -> None:
    async with station(metrics_port=0) as one:
        assert one.virtual is not None
        one.virtual.set_faults(LineFaults(damage=0.3))
        await counted(one)
        await until(lambda: bool((link := one.bridge.agent.link) and link.discards))
        async with connect(address(one)):
            families = await scraped(one)
        kind, text = await page(one, "/dashboard.json")
    assert kind == "application/json"
    assert json.loads(text) == json.loads(DASHBOARD.read_text(encoding="utf-8"))
    names = {one.name for family in families.values() for one in family.samples}
    names.add("m100_console_dropped_pictures_total")  # of tabs, and no console is served here
    shown = set(re.findall(r"m100_\w+", " ".join(expressions(json.loads(text)))))
    assert shown <= names
    assert {re.sub(r"_(total|bucket|sum|count|created)$", "", name) for name in shown} == set(
        families
    )


def expressions(dashboard: dict[str, Any]) -> list[str]:
    return [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]


def test_the_panels_of_the_dashboard_have_places_of_their_own() -> None:
    panels = json.loads(DASHBOARD.read_text(encoding="utf-8"))["panels"]
    places = {(one["gridPos"]["x"], one["gridPos"]["y"]) for one in panels}
    assert len(places) == len(panels) == len({one["id"] for one in panels})
    for expression in expressions({"panels": panels}):
        assert expression.count("(") == expression.count(")")
        assert expression.count("{") == expression.count("}")


@pytest.mark.parametrize("accept", ["text/plain; version=0.0.4", "*/*", "", "a; version=x, ;;"])
async def test_who_does_not_ask_for_openmetrics_gets_the_text_of_old(accept: str) -> None:
    async with station(metrics_port=0) as one:
        kind, text = await page(one, Accept=accept)
    assert kind.startswith("text/plain")
    assert "m100_connection" in {family.name for family in read_text(text)}


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Origin": "http://evil.example"}, 403),
        ({"Host": "evil.example:9464"}, 403),
        ({"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors"}, 403),
    ],
)
async def test_the_gate_of_the_station_stands_before_it(
    headers: dict[str, str], status: int
) -> None:
    async with station(metrics_port=0) as one:
        for path in ("/metrics", "/dashboard.json", "/"):
            with pytest.raises(Refused, match=str(status)):
                await page(one, path, **headers)


async def test_with_a_token_a_scraper_has_to_know_it() -> None:
    async with station(metrics_port=0, token=TOKEN) as one:
        with pytest.raises(Refused, match="403"):
            await page(one)
        _, text = await page(one, Authorization=f"Bearer {TOKEN}")
        assert "m100_connection" in text
        assert TOKEN not in text


async def test_it_is_on_this_machine_only_and_not_there_unasked() -> None:
    async with station() as one:
        assert one.metrics_port is None
    async with station(metrics_port=0) as one:
        assert one.sockets.metrics is not None
        assert one.sockets.metrics.getsockname()[0] == "127.0.0.1"
    assert Settings().metrics_port is None
