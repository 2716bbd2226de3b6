"""Settings of the station: flags before environment before TOML before a ROS launch file."""

from __future__ import annotations

import math
import re
import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit
from xml.parsers import expat

from m100link.apps.station.web.access_control import Access, AccessControl, is_loopback
from m100link.errors import UsageError
from m100link.errors.texts import read_path
from m100link.errors.usage import unread
from m100link.link.keyfile import read_key, read_token
from m100link.protocol.commands.activation import Credentials

if TYPE_CHECKING:
    from starlette.types import ASGIApp

Sources = Sequence[tuple[str, Mapping[str, Any]]]
"""Settings by name with who says them, strongest first."""

PORT = 9090
"""Where rosbridge listens, and DJI's page of 2015 connects."""

CONSOLE_PORT = 8090  # where the console is served

ONLY_NAME = "m100"  # name of the only aircraft of a station

MOST_AIRCRAFT = 8  # aircraft of one station: each costs a process, and nobody watches more

RECORD_KEEP, RECORD_KEEP_MB = 200, 2000
"""Flight logs, and megabytes of them: an hour has ten to forty."""

_MIN_TOKEN = 16
_APP: dict[str, Any] = {one.name: one.default for one in fields(Credentials)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The settings of the station.

    The command line is made from these fields and their sentences; see
    ``m100link.apps.cli.common``.

    Attributes:
        url: Where the aircraft is: a URL, a port, or a name of the configuration file.
        baud_rate: Baud rate, if the URL has none.
        firmware: Firmware profile, in place of the one that the aircraft's version selects.
        timeout: Seconds to wait for an answer of the aircraft.
        acceleration: How the PC assistant has acceleration sent: raw (body axes, in g, with
            gravity) or fused (ground axes, m/s²).
        sim: Bring a virtual aircraft.
        app_id: App id that DJI assigned.
        key: The app's key itself. Every user of this machine can see it: prefer a file.
        key_file: File with the key: 64 hex digits, readable by you alone.
        level: Authorization level of the app.
        app_version: Version of the app (firmware 1.0).
        bundle_id: Bundle id of the app.
        host: Address to listen on; beyond this machine, clients need a token.
        port: Port of rosbridge.
        also_ports: Another port of rosbridge; repeatable.
        console_port: Port of the console.
        metrics_port: Serve metrics to Prometheus on this port; 9464 is usual.
        foxglove_port: Serve Foxglove and Lichtblick, read-only, on this port; 8765 is usual.
        allow_host: A host name by which clients may address this station; repeatable.
        allow_origin: Let pages of this origin connect, such as http://127.0.0.1:8000; null is a
            page opened from a file. Repeatable.
        token: Token that clients must present.
        token_file: File with the token that clients must present.
        tls_cert: TLS certificate, PEM.
        tls_key: Its private key, PEM.
        pages: Folder of web pages to serve on the rosbridge port, such as DJI's keyboard page.
        tiles: MBTiles file of the console's map; by default map.mbtiles in m100link of your state
            folder (~/.local/state), which `map download` fills. Without tiles there is a grid.
        video: Live video for the console: the address of an MJPEG stream, or of a WHEP endpoint
            (with whep in its path); NAME=URL for one of several aircraft. Repeatable.
        max_clients: Greatest number of clients at once.
        max_height: Greatest height above the take-off point, m.
        max_radius: Greatest distance from the point where control was obtained, m.
        mavlink: Serve MAVLink at this address, usually udp://127.0.0.1:14550; repeatable. Beyond
            this machine it needs a signing key.
        mavlink_to: Send MAVLink to this address first, such as udp://127.0.0.1:14540 of a program
            that listens; repeatable.
        sysid: MAVLink system id of the first aircraft, 1 to 250; further ones count up.
        autopilot: Autopilot in the heartbeat: px4, which ground stations know, or generic.
        signing_key_file: File with the MAVLink signing key: 64 hex digits, readable by you alone.
            Messages that are not signed with it move nothing.
        ros2: Run a ROS 2 node: every program in its graph can fly.
        ros2_rmw: Middleware of the graph: zenoh, or dds (Fast DDS, Cyclone) by an installed rclpy.
        ros2_namespace: Namespace of the node, such as /drones.
        ros2_node: Name of the node; its private names stand below it: /m100/imu.
        ros2_domain: Domain id of the graph.
        ros2_remap: Rename a topic or service, from:=to, such as ~/imu:=/imu; repeatable.
        ros2_dji_names: Also publish with the names and types of DJI's node, such as dji_sdk/imu.
        record: Folder for a flight log of each connection; m100link removes nothing there. By
            default logs are kept in m100link/flights of your state folder (~/.local/state).
        no_record: Record nothing.
        record_keep: Flight logs to keep in that default folder; m100link removes older ones of
            its own; 0 keeps all.
        record_keep_mb: Megabytes of flight logs to keep there; 0 for any number.
        origins: Where each value came from.
        unused: Parameters of the launch file that have no use here.
    """

    url: str | None = None
    baud_rate: int | None = None
    firmware: str | None = None
    timeout: float | None = None
    acceleration: str | None = None
    sim: bool = False
    app_id: int | None = None
    key: str | None = field(default=None, repr=False)
    key_file: Path | None = None
    level: int = _APP["level"]
    app_version: int = _APP["app_version"]
    bundle_id: str = _APP["bundle_id"]
    host: str = "127.0.0.1"
    port: int = PORT
    also_ports: tuple[int, ...] = ()
    console_port: int = CONSOLE_PORT
    metrics_port: int | None = None
    foxglove_port: int | None = None
    allow_host: tuple[str, ...] = ()
    allow_origin: tuple[str, ...] = ()
    token: str | None = field(default=None, repr=False)
    token_file: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None
    pages: Path | None = None
    tiles: Path | None = None
    video: tuple[str, ...] = ()
    max_clients: int = 32
    max_height: float = 50.0
    max_radius: float = 150.0
    mavlink: tuple[str, ...] = ()
    mavlink_to: tuple[str, ...] = ()
    sysid: int = 1
    autopilot: str = "px4"
    signing_key_file: Path | None = None
    ros2: bool = False
    ros2_rmw: str = "zenoh"
    ros2_namespace: str = "/"
    ros2_node: str = ONLY_NAME
    ros2_domain: int = 0
    ros2_remap: tuple[str, ...] = ()
    ros2_dji_names: bool = False
    record: Path | None = None
    no_record: bool = False
    record_keep: int = RECORD_KEEP
    record_keep_mb: int = RECORD_KEEP_MB
    origins: dict[str, str] = field(default_factory=dict)
    unused: tuple[str, ...] = ()

    @property
    def is_virtual(self) -> bool:
        """Whether the aircraft is a virtual one of this process."""
        return self.sim or (self.url or "").startswith("sim:")

    @property
    def is_replay(self) -> bool:
        """Whether the aircraft is a recorded flight."""
        return (self.url or "").startswith("replay://")

    def credentials(self) -> Credentials | None:
        """The credentials for activation, or None when there is no app id.

        Raises ``UsageError, BadKey``: the key is missing or cannot be one.
        """
        if self.app_id is None:
            return None
        key = read_key(self.key_file) if self.key_file is not None else self.key
        if key is None:
            raise UsageError(
                f"there is an app id ({self.app_id}) and no key",
                remedy="give --key-file, or set M100LINK_KEY_FILE",
            )
        return Credentials(
            self.app_id,
            key,
            level=self.level,
            app_version=self.app_version,
            bundle_id=self.bundle_id,
        )

    def access_token(self) -> str | None:
        """The token that clients have to know; None on the own machine unless one was set.

        Raises ``UsageError``: the bind needs one and none was given, or it is too short.
        """
        token = self.token
        if self.token_file is not None:
            token = read_token(self.token_file)
        if token is None:
            if not is_loopback(self.host):
                raise UsageError(
                    f"binding {self.host} lets other machines in, and there is no token",
                    remedy="give --token-file with a long random text, for example "
                    f"{secrets.token_urlsafe(16)}",
                )
            return None
        if len(token) < _MIN_TOKEN or not token.isascii() or not token.isprintable():
            raise UsageError(
                f"the token is shorter than {_MIN_TOKEN} characters, or not printable ASCII",
                remedy=f"take a long random text, for example {secrets.token_urlsafe(16)}",
            )
        if set(token) & set(' ";,\\%&+#='):
            raise UsageError(
                'the token has a space or one of " ; , \\ % & + # =',
                remedy="take letters, digits, - and _",
            )
        return token

    def host_names(self) -> set[str]:
        """Names and addresses, as URLs have them, under which the station is reached."""
        everywhere = {"0.0.0.0", "::"}
        return set(self.allow_host) | {_in_url(one) for one in {self.host} - everywhere}

    def authority(self, port: int) -> str:
        """Host and port for a URL by which the station is reached."""
        nearest = {"0.0.0.0": "127.0.0.1", "::": "::1"}
        named = self.allow_host[0] if self.allow_host and self.host in nearest else self.host
        return f"{_in_url(nearest.get(named, named))}:{port}"

    def gate(self, app: ASGIApp, own_ports: Iterable[int] = ()) -> AccessControl:
        """An application behind its gate: the allowed peers, and the token to show.

        ``own_ports``: those whose pages may connect to it, besides its own.

        Raises ``UsageError``: see :meth:`access_token`.
        """
        token = self.access_token()
        access = None if token is None else Access(token)
        names = self.host_names()
        return AccessControl(
            app, hosts=names, origins=self.allow_origin, access=access, own_ports=own_ports
        )

    def videos(self, names: Sequence[str]) -> dict[str, Video]:
        """The video of each of these aircraft that has one.

        Raises ``UsageError``: an address cannot be one, or belongs to none of them.
        """
        found: dict[str, Video] = {}
        for given in self.video:
            name, _, url = given.partition("=") if re.match(r"[\w-]+=", given) else ("", "", given)
            name = name or (names[0] if len(names) == 1 else "")
            if name not in names:
                of_which = f"NAME=URL, with NAME of {', '.join(names)}"
                raise UsageError(f"a video is for {name or 'no aircraft'}", remedy=of_which)
            found[name] = Video.of(url)
        return found

    def is_plain_beyond_loopback(self) -> bool:
        """Whether the token and everything else would travel readable through a network."""
        return not is_loopback(self.host) and self.tls_cert is None


@dataclass(frozen=True, slots=True)
class Video:
    """A live video that pages fetch by themselves; the station never does."""

    kind: str  # whep or mjpeg
    url: str
    origin: str  # scheme, host and port: all that pages may reach beside the station

    @classmethod
    def of(cls, url: str) -> Video:
        """The video at an address. Raises ``UsageError``, which does not repeat it."""
        try:
            parts = urlsplit(url)
            port = "" if parts.port is None else f":{parts.port}"
        except ValueError:
            parts, port = urlsplit(""), ""
        host = parts.hostname or ""
        if parts.scheme not in ("http", "https") or not re.fullmatch(r"[\w.:-]+", host, re.ASCII):
            raise UsageError("the address of the video is none", remedy="http://HOST:PORT/PATH")
        if parts.username is not None:
            raise UsageError(
                "the address of the video has a user or password in it",
                cause="browsers refuse such addresses, and pages would show them",
                remedy="let the video server admit the page without, or stand in front of it",
            )
        kind = "whep" if "whep" in parts.path.lower() else "mjpeg"
        return cls(kind, url, f"{parts.scheme}://{_in_url(host)}{port}")


ENVIRONMENT = {
    "url": "M100LINK_URL",
    "baud_rate": "M100LINK_BAUD_RATE",
    "firmware": "M100LINK_PROFILE",
    "app_id": "M100LINK_APP_ID",
    "key": "M100LINK_KEY",
    "key_file": "M100LINK_KEY_FILE",
    "level": "M100LINK_LEVEL",
    "host": "M100LINK_HOST",
    "port": "M100LINK_PORT",
    "ros2_domain": "ROS_DOMAIN_ID",
    "console_port": "M100LINK_CONSOLE_PORT",
    "token": "M100LINK_TOKEN",
    "token_file": "M100LINK_TOKEN_FILE",
}
"""Environment variable of a setting."""

_IF = {"ros2_domain": "ros2"}
"""Settings with a variable that is not ours alone, and what has to be on for it to be looked at."""

_KINDS = {one.name: one.type for one in fields(Settings) if one.name not in ("origins", "unused")}


def resolve(
    flags: Mapping[str, Any],  # values from the command line; None where nothing was given
    environment: Mapping[str, str],
    *,
    launch: Path | None = None,  # ROS launch file
    # The weakest sources, by the URL of the others; a ``url`` there is what that one stands for.
    of_aircraft: Callable[[str | None], Sources] | None = None,
) -> Settings:
    """Put the settings together; the first source that has a value decides.

    Raises ``UsageError``: a file cannot be read, or a value cannot be right; the source is named.
    """
    sources: list[tuple[str, Mapping[str, Any]]] = [
        ("command line", {name: value for name, value in flags.items() if value is not None}),
        (
            "environment",
            {
                name: environment[variable]
                for name, variable in ENVIRONMENT.items()
                if environment.get(variable) and name not in _IF
            },
        ),
    ]
    unused: list[str] = []
    if launch is not None:
        used, unused = read_launch(launch)
        sources.append((str(launch), used))
    values: dict[str, Any] = {}
    origins: dict[str, str] = {}

    def take(source: str, given: Mapping[str, Any]) -> None:
        for name, value in given.items():
            if name not in values and not _is_shadowed(name, values):
                values[name] = _convert(name, value, source)
                origins[name] = source

    for source, given in sources:
        take(source, given)
    if of_aircraft is not None:
        for source, given in of_aircraft("sim://" if values.get("sim") else values.get("url")):
            if "url" in given:
                values.pop("url", None)
            take(source, given)
    for name, needed in _IF.items():
        value = environment.get(ENVIRONMENT[name])
        if value and values.get(needed) and origins.get(name) != "command line":
            values.pop(name, None)
            take("environment", {name: value})
    settings = Settings(**values, origins=origins, unused=tuple(unused))
    if settings.url is not None and settings.sim:
        # A virtual aircraft is asked for louder than an address in a file is.
        if origins["url"] == origins["sim"]:
            raise UsageError("a url and --sim were given", remedy="choose one of them")
        settings = replace(settings, url=None)
    return settings


def namespace_of(name: str) -> str:
    """An aircraft's name as ROS takes it in the name of a topic: letters, digits, underscores."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host and not host.startswith("[") else host


def _is_shadowed(name: str, values: Mapping[str, Any]) -> bool:
    """A key of a stronger source hides a key file of a weaker one, and the other way round."""
    twins = {"key": "key_file", "key_file": "key", "token": "token_file", "token_file": "token"}
    return twins.get(name) in values


_NOT_BELOW_0 = ("record_keep", "record_keep_mb")
_ABOVE_0 = ("baud_rate", "timeout", "max_clients", "max_height", "max_radius", "sysid")

_WANTED = {"int": "a whole number", "float": "a number", "bool": "true or false", "tuple": "a list"}


def _convert(name: str, value: Any, source: str) -> Any:
    kind = str(_KINDS[name])
    above = " above 0" if name in _ABOVE_0 else ""
    not_below = ", 0 or more," if name in _NOT_BELOW_0 else ""
    try:
        made = _as(kind, value)
        if (above and not 0 < made < math.inf) or (not_below and made < 0):
            raise ValueError
        return made
    except (TypeError, ValueError):
        shown = "its value" if name in ("key", "token") else repr(value)
        # Nobody finds the setting `app_id` in an environment that has M100LINK_APP_ID.
        called = ENVIRONMENT[name] if source == "environment" else f"{source}: {name}"
        wanted = next((words for start, words in _WANTED.items() if kind.startswith(start)), "text")
        raise UsageError(
            f"{called} cannot be {shown}", remedy=f"{wanted}{above}{not_below} is needed"
        ) from None


def _as(kind: str, value: Any) -> Any:
    """A value as a setting of this type. Raises ``TypeError, ValueError``: it cannot be one."""
    if kind.startswith("tuple"):
        items = value if isinstance(value, list | tuple) else [value]
        return tuple(int(one) if "int" in kind else str(one) for one in items)
    if kind.startswith("int"):
        if isinstance(value, bool | float):
            raise ValueError
        return int(value, 0) if isinstance(value, str) else int(value)
    if kind.startswith("float"):
        if isinstance(value, bool):
            raise ValueError
        return float(value)
    if kind.startswith("bool"):
        if not isinstance(value, bool):
            raise ValueError
        return value
    if not isinstance(value, str | Path):
        raise ValueError
    return Path(value) if kind.startswith("Path") else str(value)


# -- ROS launch files of DJI's node, read as they are ----------------------------------------------
# The file may come from anywhere, so it is read with nothing but the tokenizer: no document type,
# no entities, a size limit.

LAUNCH_NAMES = {
    "serial_name": "url",
    "baud_rate": "baud_rate",
    "app_id": "app_id",
    "app_api_level": "level",
    "app_version": "app_version",
    "app_bundle_id": "bundle_id",
    "enc_key": "key",
}
"""Parameter of DJI's node, and its name here."""

_MAX_SIZE = 256 * 1024


def read_launch(path: Path) -> tuple[dict[str, str], list[str]]:
    """The parameters of DJI's node in a launch file, and the names of those without a use here.

    Raises ``UsageError``: the file cannot be read, is not XML, has a document type or a value that
    needs roslaunch to be understood.
    """
    try:
        text = read_path(path).read_bytes()
    except OSError as error:
        raise unread(f"the launch file {path}", error) from error
    if len(text) > _MAX_SIZE:
        raise UsageError(f"{path} has {len(text)} bytes", remedy="name a launch file")
    found = _parameters(text, path)
    used = {
        LAUNCH_NAMES[name]: _known(LAUNCH_NAMES[name], value, path)
        for name, value in found.items()
        if name in LAUNCH_NAMES
    }
    return used, [name for name in found if name not in LAUNCH_NAMES]


def _parameters(text: bytes, path: Path) -> dict[str, str]:
    found: dict[str, str] = {}

    def element(name: str, attributes: dict[str, str]) -> None:
        if name == "param" and "name" in attributes and "value" in attributes:
            found[attributes["name"].rpartition("/")[2]] = attributes["value"]

    def refuse(*_: object) -> None:
        raise UsageError(
            f"{path} has a document type or entities",
            cause="launch files have none; files made to harm a reader do",
            remedy="remove both from the file",
        )

    parser = expat.ParserCreate()
    parser.StartElementHandler = element
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        hint = ""
        if b"<!-- your" in text:
            hint = "replace the places like <!-- your appid --> by your own values"
        raise UsageError(f"{path} is not XML: {error}", remedy=hint) from error
    return found


def _known(name: str, value: str, path: Path) -> str:
    if "$(" in value:
        raise UsageError(
            f"{path}: {name} is {value!r}, which only roslaunch understands",
            remedy="write the value itself there, or give it by flag or environment",
        )
    return value
