"""Where bytes and texts of others come in, found in the source: a reader is a function that parses.

A function that calls one of :data:`PARSERS`, by its own name or by an alias of its module, is a
reader. The seeds of some target have to run it, or :data:`WITHOUT` says why none does.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.test_house import PACKAGE, tree

__all__ = ["PARSERS", "WITHOUT", "readers"]

PARSERS = frozenset(
    {
        *("read_json", "read_toml", "fromhex", "b64decode", "decode", "decompress"),
        *("from_bytes", "unpack", "unpack_from", "iter_unpack"),
        *("parse_qs", "parse_qsl", "fromstring", "DictReader", "ElementTree", "XMLParser"),
        *("read_bytes", "read_text", "readline", "readexactly"),
        *("recv", "recvfrom", "recv_into", "pread", "data_received", "datagram_received"),
        *("load_pem_x509_certificate", "load_pem_private_key"),
    }
)
"""What turns bytes or texts into values, or brings them."""

_REASONS: dict[str, tuple[str, ...]] = {
    "a pipe or memory to a process of ours": (
        "apps/station/supervisor.py run_child",
        "flight/guardian.py Guardian._on_word",
        "flight/guardian_process.py Watch._refresh",
        "flight/guardian_process.py Watch._word",
        "flight/guardian_process.py opened",
        "apps/station/supervisor.py ChildProcess._ask",
        "apps/station/supervisor.py ChildProcess._take_answer",
    ),
    "a test of its own room draws what it is given": (
        "apps/mavlink/files.py _path",
        "apps/station/web/tiles.py _big",
        "apps/station/web/tiles.py _size_of_webp",
        "log/records.py by_index",
        "log/share.py _Cleaner.package",
    ),
    "hands bytes on as they are, to readers that have targets": (
        "apps/cli/plan.py show",
        "apps/fleet/signing.py _copy",
        "apps/station/console/kept.py analysed",
        "aircraft/replaying.py open_replay",
        "apps/cli/fleet_setup.py push",
        "link/serial_transport.py SerialTransport._deliver",
        "link/statistics.py TappedProtocol.data_received",
        "log/player.py Player._take",
        "apps/mavlink/bridge.py _Datagrams.datagram_received",
        "apps/station/mavlink.py _drained",
        "apps/station/ros/client.py Client._ends",
        "sim/orders.py CtlServer._serve",
        "apps/station/web/intake.py Metered.step",
        "apps/station/web/protocol.py WebSocketConnection.data_received",
    ),
    "a file of the installation, or what the kernel tells": (
        "apps/station/console/view/texts.py translations",
        "apps/station/ros/messages.py message_type",
        "apps/station/ros/messages.py types_of",
        "log/cdr.py _read_types",
        "apps/cli/app.py _version",
        "apps/cli/manual.py _Page.text",
        "apps/cli/manual.py _pages",
        "apps/cli/manual.py _unfenced",
        "apps/fleet/order_log.py since_boot",
        "log/channels.py layout",
        "log/pcapng.py dissector",
        "sim/ports/pty.py PtyPort.unread",
        "apps/station/console/app.py _rules",
        "apps/station/web/metrics.py metrics_app.<locals>.dashboard",
    ),
    "writes or compares what is ours": (
        "apps/cli/log.py layout",
        "apps/cli/plan.py write_plan",
        "apps/fleet/client.py _remedies",
        "apps/fleet/pki.py _hand_out",
        "apps/fleet/pki.py _is_good",
        "apps/fleet/signing.py Seal.read",
        "apps/fleet/signing.py _warn_of_end",
        "apps/mavlink/translator/payload.py device_information",
        "apps/ros2/dds.py DdsBus._others",
        "apps/ros2/dds.py DdsBus._type",
        "apps/bus/session.py open_session",
        "apps/cli/fleet.py shared",
        "apps/fleet/pki.py _authority",
        "apps/fleet/pki.py _kept",
        "apps/fleet/pki.py listed",
        "apps/station/ros/messages.py _base64",
        "log/pcapng.py _Tables.made",
        "protocol/items.py ItemLayout.__post_init__",
        "protocol/items.py ItemLayout.span",
        "wire/crc.py _sequence_crc16",
    ),
    "a bare conversion that cannot fail, or as another reader that has a target": (
        "apps/cli/terminal.py read_line",
        "apps/doctor/line.py _length",
        "apps/fleet/identity.py _names",
        "apps/doctor/line.py _text",
        "apps/doctor/machine.py Machine.is_left_alone",
        "link/transport.py port_owners",
        "telemetry/sample.py _values",
    ),
    "the simulator's answer, which the account that asks runs": ("sim/orders.py send_order",),
}

WITHOUT: dict[str, str] = {name: why for why, names in _REASONS.items() for name in names}
"""Readers without a target, as module and function, and why."""


def readers() -> Iterator[tuple[str, str]]:
    """Module, as a path from the package, and qualified name of each reader."""
    for path in sorted(PACKAGE.rglob("*.py")):
        yield from ((str(path.relative_to(PACKAGE)), name) for name in _in(path))


def _in(path: Path) -> list[str]:
    program = tree(path)
    aliases = {
        target.id
        for one in program.body
        if isinstance(one, ast.Assign) and _parses(one.value, frozenset())
        for target in one.targets
        if isinstance(target, ast.Name)
    }
    found: list[str] = []

    def look(node: ast.AST, names: tuple[str, ...], *, is_function: bool) -> None:
        for inner in ast.iter_child_nodes(node):
            if isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef):
                own = (*names, inner.name)
                if any(_parses(one, aliases) for one in _body(inner)):
                    found.append(".".join(own))
                look(inner, (*own, "<locals>"), is_function=True)
            elif isinstance(inner, ast.ClassDef):
                look(inner, (*names, inner.name), is_function=False)
            elif is_function or not isinstance(inner, ast.expr):
                look(inner, names, is_function=is_function)

    look(program, (), is_function=False)
    return found


def _body(function: ast.AST) -> Iterator[ast.AST]:
    """What runs in a function itself, not in those that are defined in it."""
    for inner in ast.iter_child_nodes(function):
        if not isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield inner
            yield from _body(inner)


def _parses(node: ast.AST, aliases: set[str] | frozenset[str]) -> bool:
    if isinstance(node, ast.Attribute):
        return node.attr in PARSERS
    if isinstance(node, ast.Name):
        return node.id in aliases or node.id in PARSERS
    return isinstance(node, ast.Call) and _parses(node.func, aliases)
