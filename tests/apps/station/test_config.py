"""Where each setting comes from, and files that are not what they seem."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest

from m100link.apps.station.config import LAUNCH_NAMES, Settings, Video, resolve
from m100link.errors import BadKey, UsageError

KEY = "00112233445566778899aabbccddeeff" * 2

LAUNCH = f"""
<launch>
  <node pkg="dji_sdk" type="dji_sdk_node" name="dji_sdk_node" output="screen">
    <!-- node parameters -->
    <param name="serial_name" type="string" value="/dev/ttyUSB7"/>
    <param name="baud_rate" type="int" value="115200"/>
    <param name="app_id" type="int" value="10086"/>
    <param name="app_api_level" type="int" value="1"/>
    <param name="app_version" type="int" value="3"/>
    <param name="app_bundle_id" type="string" value="12345678901234567890123456789012"/>
    <param name="enc_key" type="string" value="{KEY}"/>
    <param name="something_else" type="string" value="ignored"/>
  </node>
</launch>
"""


@pytest.fixture
def launch(tmp_path: Path) -> Path:
    path = tmp_path / "sdk_demo.launch"
    path.write_text(LAUNCH)
    return path


def write(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def test_a_launch_file_is_read_as_it_is(launch: Path) -> None:
    settings = resolve({}, {}, launch=launch)
    assert (settings.url, settings.baud_rate) == ("/dev/ttyUSB7", 115200)
    credentials = settings.credentials()
    assert credentials is not None
    assert (credentials.app_id, credentials.level, credentials.app_version) == (10086, 1, 3)
    assert credentials.key.reveal().hex() == KEY
    assert KEY not in repr(settings)
    assert settings.unused == ("something_else",)


def test_the_migration_guide_lists_what_a_launch_file_may_say() -> None:
    guide = Path(__file__).parents[3] / "docs" / "howto" / "migrate-from-dji-sdk.md"
    text = guide.read_text(encoding="utf-8")
    for name, setting in LAUNCH_NAMES.items():
        assert f"| `{name}` | `{setting}` |" in text


def test_flags_before_environment_before_launch_before_the_aircrafts(launch: Path) -> None:
    own = {"app_id": 3, "level": 0, "port": 1234}
    environment = {"M100LINK_APP_ID": "2", "M100LINK_LEVEL": "", "M100LINK_URL": "tcp://a:1"}
    settings = resolve(
        {"app_id": 1, "port": None},
        environment,
        launch=launch,
        of_aircraft=lambda _: [("own", own)],
    )
    assert settings.app_id == 1
    assert settings.level == 1
    credentials = settings.credentials()
    assert credentials is not None
    assert (credentials.app_id, credentials.level) == (1, 1)
    assert settings.url == "tcp://a:1"
    assert settings.port == 1234
    assert settings.baud_rate == 115200
    assert settings.origins["app_id"] == "command line"
    assert settings.origins["url"] == "environment"
    assert settings.origins["port"] == "own"
    assert settings.origins["baud_rate"] == str(launch)


def test_a_key_file_of_a_stronger_source_hides_a_key_of_a_weaker_one(
    tmp_path: Path, launch: Path
) -> None:
    other = "ff" * 32
    path = write(tmp_path / "key", other)
    settings = resolve({}, {"M100LINK_KEY_FILE": str(path)}, launch=launch)
    credentials = settings.credentials()
    assert credentials is not None
    assert credentials.key.reveal().hex() == other


def test_a_virtual_aircraft_is_asked_for_louder_than_a_port_in_a_file(launch: Path) -> None:
    settings = resolve({"sim": True}, {}, launch=launch)
    assert settings.sim
    assert settings.url is None
    with pytest.raises(UsageError, match="url and --sim"):
        resolve({"sim": True, "url": "tcp://a:1"}, {})


def test_a_mistake_in_the_environment_names_its_variable() -> None:
    with pytest.raises(UsageError, match=r"^M100LINK_BAUD_RATE cannot be 'fast'") as caught:
        resolve({}, {"M100LINK_BAUD_RATE": "fast"})
    assert caught.value.remedy == "a whole number above 0 is needed"


@pytest.mark.parametrize(
    "given",
    [
        {"baud_rate": 0},
        {"baud_rate": -9600},
        {"timeout": 0.0},
        {"timeout": math.nan},
        {"timeout": math.inf},
        {"max_clients": 0},
        {"max_height": 0.0},
        {"max_radius": -1.0},
        {"sysid": 0},
    ],
)
def test_what_has_to_be_above_0_is(given: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="cannot be") as caught:
        resolve(given, {})
    assert "number above 0" in caught.value.remedy


@pytest.mark.parametrize(
    ("name", "said", "value"),
    [
        ("app_id", "0x10", 16),
        ("baud_rate", "1", 1),
        ("timeout", "2.5", 2.5),
        ("timeout", 3, 3.0),
        ("max_height", 0.1, 0.1),
        ("record_keep", 0, 0),
        ("also_ports", "19871", (19871,)),
        ("also_ports", [1, "2"], (1, 2)),
        ("allow_host", "laptop", ("laptop",)),
        ("sim", True, True),
        ("token_file", "/x", Path("/x")),
        ("url", Path("/dev/ttyUSB0"), "/dev/ttyUSB0"),
    ],
)
def test_a_value_becomes_one_of_its_setting(name: str, said: object, value: object) -> None:
    found = getattr(resolve({name: said}, {}), name)
    assert (found, type(found)) == (value, type(value))


def test_what_an_aircraft_has_of_its_own_comes_last_and_its_url_is_that_of_the_name() -> None:
    asked: list[str | None] = []

    def of_aircraft(name: str | None) -> list[tuple[str, dict[str, object]]]:
        asked.append(name)
        return [("kite", {"url": "tcp://kite:1", "app_id": 9, "level": 0})]

    settings = resolve({"url": "kite", "app_id": 1}, {}, of_aircraft=of_aircraft)
    assert (settings.url, settings.app_id, settings.level) == ("tcp://kite:1", 1, 0)
    assert settings.origins == {"url": "kite", "app_id": "command line", "level": "kite"}
    resolve({"sim": True}, {}, of_aircraft=lambda name: asked.append(name) or [])  # type: ignore[func-returns-value]
    assert asked == ["kite", "sim://"]


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"app_id": True}, "app_id cannot be True"),
        ({"timeout": True}, "timeout cannot be True"),
        ({"record_keep": -1}, "record_keep cannot be -1.*0 or more, is needed"),
        ({"app_id": "x"}, "app_id cannot be 'x'"),
        ({"app_id": 1.5}, "app_id cannot be"),
        ({"sim": 1}, "sim cannot be"),
        ({"url": 5}, "url cannot be"),
        ({"key": 5}, "key cannot be its value"),
    ],
)
def test_errors_name_the_source_and_the_setting(given: dict[str, object], says: str) -> None:
    with pytest.raises(UsageError) as caught:
        resolve({}, {}, of_aircraft=lambda _: [("kite", given)])
    assert re.search(says, str(caught.value), re.DOTALL)
    assert "kite" in str(caught.value)


BOMB = """<?xml version="1.0"?>
<!DOCTYPE launch [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]>
<launch><param name="app_id" value="&b;"/></launch>"""
OUTSIDE = """<!DOCTYPE launch [<!ENTITY x SYSTEM "file:///etc/passwd">]>
<launch><param name="app_bundle_id" value="1"/>&x;</launch>"""


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BOMB, "document type or entities"),
        (OUTSIDE, "document type or entities"),
        ('<!DOCTYPE launch SYSTEM "http://a/b.dtd"><launch/>', "document type or entities"),
        ("<launch>", "is not XML"),
        ("", "is not XML"),
        ('<launch><param name="app_id" value="<!-- your appid -->"/></launch>', "own values"),
        ('<launch><param name="app_id" value="$(arg id)"/></launch>', "only roslaunch"),
        ('<launch><param name="app_id" value="ten"/></launch>', "app_id cannot be 'ten'"),
        ("<launch>" + " " * 300_000 + "</launch>", "name a launch file"),
    ],
)
def test_launch_files_made_to_harm_or_not_filled_in(tmp_path: Path, text: str, says: str) -> None:
    path = write(tmp_path / "x.launch", text)
    with pytest.raises(UsageError, match=says):
        resolve({}, {}, launch=path)


def test_a_key_that_is_none_is_reported_without_being_shown(tmp_path: Path) -> None:
    text = LAUNCH.replace(KEY, "DJI-DEMO AES256 KEY-lala-haha-MA")  # what DJI's file has there
    with pytest.raises(BadKey) as caught:
        resolve({}, {}, launch=write(tmp_path / "x.launch", text)).credentials()
    assert "lala" not in str(caught.value)


def test_an_app_id_needs_a_key_and_a_key_file_is_private(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no key"):
        resolve({"app_id": 1}, {}).credentials()
    assert resolve({}, {}).credentials() is None
    open_file = write(tmp_path / "key", KEY, 0o644)
    with pytest.raises(UsageError, match="read by others"):
        resolve({"app_id": 1, "key_file": open_file}, {}).credentials()
    with pytest.raises(UsageError, match="cannot be read"):
        resolve({"app_id": 1, "key_file": tmp_path / "none"}, {}).credentials()


def test_beyond_this_machine_a_token_is_needed(tmp_path: Path) -> None:
    assert resolve({}, {}).access_token() is None
    with pytest.raises(UsageError, match="no token"):
        resolve({"host": "0.0.0.0"}, {}).access_token()
    token = "0123456789abcdefXY"
    settings = resolve({"host": "0.0.0.0", "token_file": write(tmp_path / "t", token + "\n")}, {})
    assert settings.access_token() == token
    assert settings.is_plain_beyond_loopback()
    for bad in ("short", "with space in the middle", "ümlaut ümlaut ümlaut"):
        with pytest.raises(UsageError, match="token"):
            resolve({"token": bad}, {}).access_token()


@pytest.mark.parametrize(
    ("host", "at"),
    [
        ("127.0.0.1", "127.0.0.1:80"),
        ("127.0.0.2", "127.0.0.2:80"),
        ("::1", "[::1]:80"),
        ("localhost", "localhost:80"),
        ("0.0.0.0", "127.0.0.1:80"),
        ("::", "[::1]:80"),
        ("field.local", "field.local:80"),
    ],
)
def test_the_address_that_is_announced_is_one_where_it_listens(host: str, at: str) -> None:
    assert Settings(host=host).authority(80) == at
    name = at.rpartition(":")[0]
    assert name in {*Settings(host=host).host_names(), "127.0.0.1", "[::1]", "localhost"}


def test_the_scheme_says_whether_the_aircraft_is_virtual() -> None:
    for url in ("sim://", "sim://?firmware=3.1"):
        assert Settings(url=url).is_virtual
    assert Settings(sim=True).is_virtual
    for url in ("/dev/ttyUSB0", "tcp://sim:5760", "replay:///sim.mcap"):
        assert not Settings(url=url).is_virtual


def test_a_name_of_the_station_is_announced_where_it_listens_everywhere() -> None:
    settings = Settings(host="0.0.0.0", allow_host=("field-laptop.local",))
    assert settings.authority(80) == "field-laptop.local:80"
    assert settings.host_names() == {"field-laptop.local"}


def test_the_domain_of_ros_is_looked_at_by_who_speaks_ros() -> None:
    wrong, right = {"ROS_DOMAIN_ID": "base"}, {"ROS_DOMAIN_ID": "7"}
    assert resolve({}, wrong).ros2_domain == 0
    with pytest.raises(UsageError, match="ROS_DOMAIN_ID cannot be 'base'"):
        resolve({"ros2": True}, wrong)
    own = {"ros2": True, "ros2_domain": 3}

    def in_file(_: object) -> list[tuple[str, dict[str, Any]]]:
        return [("own", own)]

    assert resolve({}, {}, of_aircraft=in_file).ros2_domain == 3
    found = resolve({}, right, of_aircraft=in_file)
    assert (found.ros2_domain, found.origins["ros2_domain"]) == (7, "environment")
    assert resolve({"ros2_domain": 5}, right, of_aircraft=in_file).ros2_domain == 5


# -- videos ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("url", "kind", "origin"),
    [
        ("http://192.168.1.20:8080/?action=stream", "mjpeg", "http://192.168.1.20:8080"),
        ("http://Camera.test/front/whep?key=a=b", "whep", "http://camera.test"),
        ("https://[fe80::1]:8889/rtc/v1/WHEP/", "whep", "https://[fe80::1]:8889"),
    ],
)
def test_a_video_has_a_kind_and_an_origin(url: str, kind: str, origin: str) -> None:
    assert Settings(video=(url,)).videos([""]) == {"": Video(kind, url, origin)}
    assert Settings(video=(f"kite={url}",)).videos(["kite", "crow"])["kite"].url == url


@pytest.mark.parametrize(
    "url",
    [
        "",
        "camera",
        "rtsp://camera/stream",
        "file:///etc/passwd",
        "javascript:alert(1)",
        "data:text/html,x",
        "http://",
        "http:///path",
        "http://camera:port/",
        "http://camera:99999/",
        "http://[::1/",
        "http://a b/",
        "http://camera;script-src/x",
        "http://camera,other/x",
        "http://*/x",
        "http://anna:hunter2@camera/x",
        "http://anna@camera/x",
    ],
)
def test_an_address_that_is_no_video_is_refused_and_not_repeated(url: str) -> None:
    with pytest.raises(UsageError) as caught:
        Settings(video=(url,)).videos([""])
    assert "hunter2" not in str(caught.value)


def test_a_video_belongs_to_an_aircraft() -> None:
    for given in ("http://camera/x", "swan=http://camera/x"):
        with pytest.raises(UsageError, match="a video is for"):
            Settings(video=(given,)).videos(["kite", "crow"])
    assert Settings().videos(["kite"]) == {}
