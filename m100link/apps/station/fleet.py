"""Agents of a fleet: each owns an aircraft and serves it under keys of its own, in one process."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from m100link.apps.agent.client import AgentClient
from m100link.apps.agent.messages import Event
from m100link.apps.agent.transports import memory_channels
from m100link.apps.bus.network import Bus
from m100link.apps.fleet.agent import FleetAgent, Verify
from m100link.apps.fleet.identity import nobody
from m100link.apps.fleet.keys import DEFAULT_SITE, Keys, check_name
from m100link.apps.fleet.logs.service import RATE, LogService
from m100link.apps.fleet.lost_link import LostPlan
from m100link.apps.fleet.missions.board import MissionTeller
from m100link.apps.fleet.order_log import FileLedger, Ledger, MemoryLedger
from m100link.apps.fleet.publisher import AgentTold
from m100link.apps.fleet.revocations import Revocations, RevocationService
from m100link.apps.fleet.session import open_fleet
from m100link.apps.fleet.show.service import Beside, ShowService
from m100link.apps.station.config import Settings
from m100link.apps.station.run import owning
from m100link.log.folder import state_folder

__all__ = ["FleetSettings", "default_ledgers", "recorded_apart", "serving_fleet"]


def default_ledgers() -> Path:
    """Where ledgers are kept, in the user's folder for the state of programs."""
    return state_folder() / "fleet"


def recorded_apart(settings: Settings, name: str) -> Settings:
    """The settings with a folder of its own for the logs of this aircraft.

    Whoever may watch one aircraft may fetch its logs, and those of no other.
    """
    if settings.record is None:
        return settings
    return replace(settings, record=settings.record / check_name(name))


@dataclass(frozen=True)
class FleetSettings:
    """How agents are part of a fleet.

    Attributes:
        connect: Endpoints of routers.
        site: Which site.
        lost: What happens when whoever flies is lost.
        ledgers: Folder of what outlives an agent; None: nothing does, as for virtual aircraft.
        options: More options of zenoh, by name, as JSON.
        verify: Looks at each order; None: the router alone decides who may ask.
        revocations: Who is shut out, whatever the file of rights says.
        log_rate: Bytes of flight logs a second that each aircraft gives away at most.
    """

    connect: tuple[str, ...] = ()
    site: str = DEFAULT_SITE
    lost: LostPlan = field(default_factory=LostPlan)
    ledgers: Path | None = None
    options: dict[str, str] = field(default_factory=dict)
    verify: Verify | None = None
    revocations: Revocations | None = None
    log_rate: float = RATE


@asynccontextmanager
async def serving_fleet(
    aircraft: Mapping[str, Settings],
    fleet: FleetSettings,
    tell: Callable[[str, Event], None],
) -> AsyncIterator[dict[str, FleetAgent]]:
    """Own aircraft and be part of a fleet while the block runs.

    Args:
        aircraft: Settings by name.
        fleet: Which fleet.
        tell: Called with the name and each event.

    Raises:
        UsageError: A name is taken or cannot be, a ledger cannot be written, no session can be.
    """
    keys = {name: Keys(fleet.site, name) for name in aircraft}  # before anything is opened
    async with AsyncExitStack() as stack:
        bus = await stack.enter_async_context(
            open_fleet("client", connect=fleet.connect, options=fleet.options, is_patient=True)
        )
        agents = {}
        for place, (name, settings) in enumerate(aircraft.items()):
            ledger = _ledger(stack, fleet, keys[name])
            agents[name] = await _agent(stack, settings, place, ledger, keys[name], bus, fleet)
            await agents[name].require_alone()
            for event in agents[name].client.events:
                tell(name, event)
            agents[name].client.on_event.append(_teller(tell, name))
        # One that fails takes the process with it, which is started again.
        async with asyncio.TaskGroup() as group:
            running = [
                group.create_task(one.run(), name=f"m100link fleet: {name}")
                for name, one in agents.items()
            ]
            beside = Beside()
            running += [
                group.create_task(service.run(), name=f"m100link fleet {what}: {name}")
                for name, one in agents.items()
                for what, service in _services(
                    one, bus, keys[name], aircraft[name], fleet, beside
                ).items()
            ]
            try:
                yield agents
            finally:
                for work in running:
                    work.cancel()


def _teller(tell: Callable[[str, Event], None], name: str) -> Callable[[Event], None]:
    return lambda event: tell(name, event)


class _Service(Protocol):
    async def run(self) -> None: ...


def _services(
    one: FleetAgent,
    bus: Bus,
    keys: Keys,
    settings: Settings,
    fleet: FleetSettings,
    beside: Beside,
) -> dict[str, _Service]:
    """What is served for an aircraft beside its agent, by what it is."""
    verify, revocations = fleet.verify, fleet.revocations
    folder = None if settings.no_record else settings.record
    show = ShowService(one.client, bus, keys, verify=verify, namesakes=one.namesakes, beside=beside)
    served: dict[str, _Service] = {
        "fronts": AgentTold(one.client, bus, keys, one.boot),
        "show": show,
        "missions": MissionTeller(one.missions, bus, keys, one.boot),
        "logs": LogService(bus, keys, folder, verify=verify, rate=fleet.log_rate),
    }
    if revocations is not None:
        shut_out = (one.shut_out, lambda: show.shut_out(revocations.since))
        served["revoked"] = RevocationService(
            bus, keys, one.boot, revocations, shut_out=shut_out, note=one.client.note
        )
    return served


def _ledger(stack: AsyncExitStack, fleet: FleetSettings, keys: Keys) -> Ledger:
    if fleet.ledgers is None:
        return MemoryLedger()
    ledger = FileLedger(fleet.ledgers / keys.site / f"{keys.name}.jsonl", time.time)
    stack.callback(ledger.close)
    return ledger


async def _agent(
    stack: AsyncExitStack,
    settings: Settings,
    place: int,
    ledger: Ledger,
    keys: Keys,
    bus: Bus,
    fleet: FleetSettings,
) -> FleetAgent:
    owner = await stack.enter_async_context(
        owning(settings, place=place, leases_before=ledger.leases_before)
    )
    ours, its = memory_channels()
    owner.service.attach(its)
    client = await stack.enter_async_context(AgentClient(ours, "fleet"))
    revoked = nobody if fleet.revocations is None else fleet.revocations.since
    return FleetAgent(
        client, bus, keys, ledger, lost=fleet.lost, verify=fleet.verify, revoked=revoked
    )
