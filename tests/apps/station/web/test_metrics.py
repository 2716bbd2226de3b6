"""What a scraper reads, read by the parser of Prometheus itself. Real time and sockets."""

from __future__ import annotations

import asyncio
import json
import re
import urllib.error
import urllib.request
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("uvicorn")
pytest.importorskip("prometheus_client")
from prometheus_client import CollectorRegistry
from prometheus_client.metrics_core import Metric
from prometheus_client.openmetrics.exposition import generate_latest as openmetrics_of
from prometheus_client.openmetrics.parser import text_string_to_metric_families as read_openmetrics
from prometheus_client.parser import text_string_to_metric_families as read_text

from m100link.apps.agent.messages import LinkCounted, State
from m100link.apps.station.config import Settings
from m100link.apps.station.ros.client import Client
from m100link.apps.station.run import RunningStation
from m100link.apps.station.web.metrics import DASHBOARD, StationMetrics
from m100link.protocol.items import ITEMS
from m100link.protocol.records import Battery, Gimbal, Position
from m100link.sim.line import LineFaults
from m100link.telemetry.state import AircraftState
from tests import known
from tests.apps.station.web.test_server import TOKEN, address, station, until
from tests.sockets import connect
from tests.waiting import PATIENCE

pytestmark = pytest.mark.anyio

READ: Callable[[str], Iterable[Metric]] = read_openmetrics  # it has no types
written: Callable[[CollectorRegistry], bytes] = openmetrics_of
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
        with urllib.request.urlopen(asked, timeout=PATIENCE) as answer:
            return answer.headers["content-type"], answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            raise Refused(error.code) from None


async def page(one: RunningStation, path: str = "/metrics", **headers: str) -> tuple[str, str]:
    return await asyncio.to_thread(
        got, f"http://127.0.0.1:{one.sockets.port('metrics')}{path}", **headers
    )


async def scraped(one: RunningStation) -> dict[str, Metric]:
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


async def counted(one: RunningStation) -> None:
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


async def test_of_a_lost_aircraft_only_that_is_reported() -> None:
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
async def test_a_client_that_does_not_ask_for_openmetrics_gets_the_text_of_old(accept: str) -> None:
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
        assert one.sockets.ports("metrics") == []
    async with station(metrics_port=0) as one:
        assert one.sockets.of["metrics"][0].getsockname()[0] == "127.0.0.1"
    assert Settings().metrics_port is None


# -- values ---------------------------------------------------------------------------------------


def slow(name: str, dropped: int) -> Client:
    """A client of rosbridge that did not get everything."""
    client = Client.__new__(Client)
    client.name, client.outbox = name, cast(Any, SimpleNamespace(dropped=dropped))
    return client


COUNTED = LinkCounted(
    at=50.0,
    counters={
        **{"bytes_received": 1001, "bytes_sent": 1002, "frames_received": 103, "frames_sent": 104},
        **{"discarded_bytes": 105, "dropped_writes": 6, "acks": 41, "duplicate_acks": 7},
        **{"late_acks": 8, "foreign_acks": 9, "repeats": 11, "expired": 12, "missed_setpoints": 13},
    },
    discards={"header_crc": 14, "frame_crc": 15, "no_key": 16},
    loop_lag=0.0125,
    # Answers in each class, as `m100link.RoundTrips` has them; the bound belongs to its class.
    round_trips=dict(
        zip(
            ("0.001", "0.002", "0.005", "0.01", "0.02", "0.05", "0.1", "0.2", "0.5"),
            (0, 1, 2, 0, 3, 5, 7, 0, 11),
            strict=True,
        )
    )
    | {"1.0": 0, "2.0": 4, "inf": 8},
    round_trips_s=23.75,
)


def heard() -> AircraftState:
    """Items at 10 Hz, the gimbal at 5 until 1.1 s ago, position and battery until 2.1 s ago."""
    now = [0.0]
    state = AircraftState(lambda: now[0])
    for number in range(122):
        gone = [Position, Battery] if number > 100 else []
        without = [*gone, *([Gimbal] if number % 2 or number > 110 else [])]
        state.update(known.sample(at=number / 10, without=without))
    now[0] = 12.1
    return state


def told() -> list[Metric]:
    """The metrics of three aircraft: one that flies, one that is silent, one that is lost."""

    def agent(connection: str = "connected", *, mismatches: int = 18, **more: Any) -> Any:
        state = State(1.0, connection, has_authority=mismatches == 17, mismatches=mismatches)
        view = known.seen(heard(), 12.1, state=state, **more)
        authority = {"is_connected": view.is_connected, "has_authority": view.has_authority}
        return SimpleNamespace(view=view, state=state, link=COUNTED, **authority)

    flies, silent = agent(mismatches=17), agent(heard_at=1.0)
    gone, lost = agent(is_gone=True), agent("lost")
    bridge = SimpleNamespace(
        agents={"a1": flies, "b2": silent, "c3": lost, "d4": gone},
        graph=SimpleNamespace(sessions=[slow("tablet", 19), object(), slow("laptop", 21)]),
    )
    registry = CollectorRegistry()
    registry.register(StationMetrics(cast(Any, bridge), lambda: {"phone": 22}))
    return list(READ(written(registry).decode()))


A1 = (("aircraft", "a1"),)
VALUES: dict[tuple[str, tuple[tuple[str, str], ...]], float] = {
    ("m100_authority", A1): 1,
    ("m100_authority", (("aircraft", "b2"),)): 0,
    ("m100_authority", (("aircraft", "c3"),)): 0,
    ("m100_authority", (("aircraft", "d4"),)): 0,
    **{
        ("m100_connection", (("aircraft", name), ("m100_connection", one))): float(one == state)
        for name, state in {"a1": "connected", "b2": "silent", "c3": "lost", "d4": "gone"}.items()
        for one in ("connecting", "connected", "lost", "silent", "gone")
    },
    ("m100_link_bytes_total", (*A1, ("direction", "received"))): 1001,
    ("m100_link_bytes_total", (*A1, ("direction", "sent"))): 1002,
    ("m100_link_frames_total", (*A1, ("direction", "received"))): 103,
    ("m100_link_frames_total", (*A1, ("direction", "sent"))): 104,
    ("m100_link_acks_total", (*A1, ("kind", "answered"))): 41,
    ("m100_link_acks_total", (*A1, ("kind", "duplicate"))): 7,
    ("m100_link_acks_total", (*A1, ("kind", "late"))): 8,
    ("m100_link_acks_total", (*A1, ("kind", "foreign"))): 9,
    ("m100_link_discarded_bytes_total", A1): 105,
    ("m100_link_dropped_writes_total", A1): 6,
    ("m100_link_repeats_total", A1): 11,
    ("m100_link_expired_total", A1): 12,
    ("m100_missed_setpoints_total", A1): 13,
    ("m100_link_discards_total", (*A1, ("cause", "header_crc"))): 14,
    ("m100_link_discards_total", (*A1, ("cause", "frame_crc"))): 15,
    ("m100_link_discards_total", (*A1, ("cause", "no_key"))): 16,
    ("m100_agent_loop_lag_seconds", A1): 0.0125,
    # A bucket has all answers up to its bound, those of smaller ones too.
    **{
        ("m100_link_round_trip_seconds_bucket", (*A1, ("le", bound))): count
        for bound, count in {
            **{"0.001": 0, "0.002": 1, "0.005": 3, "0.01": 3, "0.02": 6, "0.05": 11, "0.1": 18},
            **{"0.2": 18, "0.5": 29, "1.0": 29, "2.0": 33, "+Inf": 41},
        }.items()
    },
    ("m100_link_round_trip_seconds_count", A1): 41,
    ("m100_link_round_trip_seconds_sum", A1): 23.75,
    **{
        ("m100_telemetry_rate_hertz", (*A1, ("item", item))): hertz
        for item, hertz in {
            **{"time": 10, "quaternion": 10, "acceleration": 10, "velocity": 10},
            **{"angular_velocity": 10, "position": 0, "magnetometer": 10, "rc": 10, "gimbal": 5},
            **{"flight_status": 10, "battery": 0, "control_device": 10},
        }.items()
    },
    ("m100_telemetry_mismatches_total", A1): 17,
    ("m100_clients", ()): 2,
    ("m100_client_dropped_messages_total", (("client", "tablet"),)): 19,
    ("m100_client_dropped_messages_total", (("client", "laptop"),)): 21,
    ("m100_console_dropped_pictures_total", (("tab", "phone"),)): 22,
}
"""By docs/howto/metrics.md; of who is not connected two alone."""


def test_each_value_has_its_name_labels_and_unit() -> None:
    samples = [one for family in told() for one in family.samples]
    found = {(one.name, tuple(sorted(one.labels.items()))): one.value for one in samples}
    assert len(found) == len(samples)
    assert {key: one for key, one in found.items() if not key[0].endswith("_created")} == {
        (name, tuple(sorted(labels))): pytest.approx(value)
        for (name, labels), value in VALUES.items()
    }
    kinds = {family.name: family.type for family in told()}
    assert {name for name, kind in kinds.items() if kind == "counter"} == {
        key[0].removesuffix("_total") for key in VALUES if key[0].endswith("_total")
    }
    assert {name for name, kind in kinds.items() if kind == "gauge"} == {
        *("m100_authority", "m100_agent_loop_lag_seconds", "m100_telemetry_rate_hertz"),
        "m100_clients",
    }
    assert kinds["m100_connection"] == "stateset"
    assert kinds["m100_link_round_trip_seconds"] == "histogram"


PANELS = {
    "Connection": ("m100_connection", "short"),
    "Control authority": ("m100_authority", "bool"),
    "Round trip": ("m100_link_round_trip_seconds_bucket", "s"),
    "Round trips by class": ("m100_link_round_trip_seconds_bucket", "short"),
    "Mean round trip": ("m100_link_round_trip_seconds_sum", "s"),
    "Bytes per second": ("rate(m100_link_bytes_total", "Bps"),
    "Frames per second": ("rate(m100_link_frames_total", "cps"),
    "Damage by cause": ("rate(m100_link_discards_total", "cps"),
    "Bytes outside any frame": ("rate(m100_link_discarded_bytes_total", "Bps"),
    "Repeats, expired requests, unwritten frames": ("rate(m100_link_repeats_total", "cps"),
    "Acks": ("rate(m100_link_acks_total", "cps"),
    "Telemetry rates": ("m100_telemetry_rate_hertz", "hertz"),
    "Telemetry that does not fit the firmware": ("rate(m100_telemetry_mismatches_total", "cps"),
    "Lag of the agent": ("m100_agent_loop_lag_seconds", "s"),
    "Clients": ("m100_clients", "short"),
    "Dropped for slow clients and tabs": ("rate(m100_client_dropped_messages_total", "cps"),
}
"""Units by Grafana's names; bytes per second are not bits, times are not milliseconds."""


def test_the_dashboard_shows_each_number_in_its_unit() -> None:
    panels = json.loads(DASHBOARD.read_text(encoding="utf-8"))["panels"]
    units = {one["title"]: one["fieldConfig"]["defaults"]["unit"] for one in panels}
    assert units == {title: unit for title, (_, unit) in PANELS.items()}
    for one in panels:
        assert PANELS[one["title"]][0] in one["targets"][0]["expr"], one["title"]
    shares = [target["expr"][:23] for target in panels[2]["targets"]]
    assert shares == [f"histogram_quantile({share}" for share in ("0.5,", "0.95", "0.99")]
    assert [one["legendFormat"][-4:] for one in panels[2]["targets"]] == ["50 %", "95 %", "99 %"]
