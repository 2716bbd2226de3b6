"""Nobody gets in by a page opened elsewhere, by a name that points here, or without the token."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import MutableMapping
from typing import Any

import pytest

from m100link.apps.station.web.access_control import (
    COOKIE,
    Access,
    AccessControl,
    host_of,
    is_loopback,
)
from tests.apps.agent.test_background import Clock

pytestmark = pytest.mark.anyio

TOKEN = "0123456789abcdefXY"
HERE = ("host", "127.0.0.1:9090")


class Visit:
    """What a request gets; the application behind the gate notes that it was reached."""

    def __init__(self, **options: Any) -> None:
        self.is_in = False
        self.sent: list[MutableMapping[str, Any]] = []
        self.gate = AccessControl(self._app, **options)

    @property
    def status(self) -> int:
        """That of the answer; 0 when the gate gave none."""
        return int(self.sent[0].get("status", 0)) if self.sent else 0

    @property
    def headers(self) -> dict[str, str]:
        pairs = self.sent[0]["headers"]
        return {name.decode(): value.decode() for name, value in pairs}

    async def _app(self, scope: Any, receive: Any, send: Any) -> None:
        self.is_in = True
        if scope["type"] == "http":
            await send({"type": "http.response.start", "status": 200, "headers": []})

    async def ask(
        self,
        *headers: tuple[str, str],
        kind: str = "websocket",
        query: str = "",
        path: str = "/",
        method: str = "GET",
        tls: bool = False,
    ) -> bool:
        scheme = {"websocket": "ws", "http": "http"}[kind] + ("s" if tls else "")
        scope = {
            "type": kind,
            "scheme": scheme,
            "headers": [(name.encode(), value.encode()) for name, value in headers],
            "query_string": query.encode(),
            **({"method": method} if kind == "http" else {}),
            "path": path,
            "raw_path": path.encode(),
        }

        async def receive() -> dict[str, Any]:
            return {"type": "websocket.connect"}

        async def send(message: MutableMapping[str, Any]) -> None:
            self.sent.append(message)

        await self.gate(scope, receive, send)
        return self.is_in


@pytest.mark.parametrize("host", ["127.0.0.1:9090", "localhost", "LOCALHOST:1", "[::1]:9090"])
async def test_programs_of_this_machine_send_no_origin_and_get_in(host: str) -> None:
    assert await Visit().ask(("host", host))


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:9090",
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "192.168.1.5",
        "127.0.0.1@evil.example",
        "127.0.0.1:port",
        "127.0.0.1/evil.example",
        "127.0.0.1?evil.example",
        "127.0.0.1#evil.example",
        "127.0.0.1\\evil.example",
        "",
    ],
)
async def test_a_name_that_points_here_is_not_this_station(host: str) -> None:
    # DNS rebinding: the page's own name resolves to 127.0.0.1, and Host and Origin agree.
    visit = Visit()
    assert not await visit.ask(("host", host), ("origin", f"http://{host}"))
    assert visit.sent == [{"type": "websocket.close", "code": 1008}]  # before it was accepted


async def test_two_hosts_or_none_are_refused() -> None:
    assert not await Visit().ask()
    assert not await Visit().ask(HERE, HERE)


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "https://127.0.0.1:9090",
        "http://127.0.0.1:9091",
        "http://127.0.0.1",
        "http://localhost:9090",
        "http://127.0.0.1:9090.evil.example",
        "null",
        "",
        "file://",
    ],
)
@pytest.mark.parametrize("kind", ["websocket", "http"])
async def test_pages_from_elsewhere_are_refused(origin: str, kind: str) -> None:
    assert not await Visit().ask(HERE, ("origin", origin), kind=kind)


async def test_pages_of_the_station_itself_get_in() -> None:
    assert await Visit().ask(HERE, ("origin", "http://127.0.0.1:9090"))
    assert await Visit().ask(HERE, ("origin", "https://127.0.0.1:9090"), tls=True)
    assert not await Visit().ask(HERE, ("origin", "http://127.0.0.1:9090"), tls=True)


@pytest.mark.parametrize(
    ("origin", "gets_in"),
    [
        # DJI's page of 2016 has port 19871 in it, and is served on 9090.
        ("http://127.0.0.1:9090", True),
        ("http://localhost:9090", True),
        ("http://LOCALHOST:19871", True),
        ("http://[::1]:9090", True),
        ("http://field-laptop:9090", True),
        ("http://localhost:9091", False),
        ("http://localhost", False),
        ("http://localhost:090909", False),
        ("http://localhost:9090:9090", False),
        ("http://localhost:9090/", False),
        ("http://x@localhost:9090", False),
        ("http://localhost.evil.example:9090", False),
        ("http://evil.example:9090", False),
        ("https://localhost:9090", False),
        ("localhost:9090", False),
        ("://:9090", False),
    ],
)
async def test_a_page_of_one_port_of_rosbridge_connects_to_another(
    origin: str, gets_in: bool
) -> None:
    visit = Visit(hosts=["field-laptop"], own_ports=(9090, 19871))
    assert await visit.ask(("host", "localhost:19871"), ("origin", origin)) == gets_in


async def test_pages_allowed_by_name_get_in_and_null_is_such_a_name() -> None:
    options = {"origins": ["http://127.0.0.1:8000/", "null"], "hosts": ["Field-Laptop"]}
    assert await Visit(**options).ask(HERE, ("origin", "http://127.0.0.1:8000"))
    assert await Visit(**options).ask(("host", "field-laptop:9090"), ("origin", "null"))
    assert not await Visit(**options).ask(HERE, ("origin", "http://127.0.0.1:8001"))
    two = (("origin", "null"), ("origin", "null"))
    assert not await Visit(**options).ask(HERE, *two)


OWN_COOKIE = Access(TOKEN).cookie


@pytest.mark.parametrize(
    ("header", "query", "gets_in"),
    [
        (None, "", False),
        (None, f"token={TOKEN}", True),
        (None, f"token={TOKEN[:-1]}", False),
        (None, f"token=x&token={TOKEN}", False),
        (None, f"token={TOKEN}" + "&x=1" * 19, True),
        (None, f"token={TOKEN}" + "&x=1" * 20, False),
        (None, f"token={OWN_COOKIE}", False),
        (("authorization", f"Bearer {TOKEN}"), "", True),
        (("authorization", f"Bearer {TOKEN}"), "x=1&" * 30, False),
        (("authorization", f"bearer  {TOKEN} "), "", True),
        (("authorization", f"Basic {TOKEN}"), "", False),
        (("cookie", f"a=b; {COOKIE}={OWN_COOKIE}"), "", True),
        (("cookie", f'settings={{"a": [1, "b;"]}}; {COOKIE}={OWN_COOKIE}; x'), "", True),
        (("cookie", f"{COOKIE}=wrong; {COOKIE}={OWN_COOKIE}"), "", True),
        (("cookie", f"{COOKIE}={OWN_COOKIE}x"), "", False),
        (("cookie", f"{COOKIE}={TOKEN}"), "", False),
        (("cookie", f"__Host-{COOKIE}={OWN_COOKIE}"), "", False),
        (("cookie", "\x01"), "", False),
        (("cookie", f"{COOKIE}=ü"), "", False),
        (("authorization", "Bearer ü"), "", False),
    ],
)
@pytest.mark.parametrize("kind", ["websocket", "http"])
async def test_a_token_is_needed_where_one_is_set(
    header: tuple[str, str] | None, query: str, gets_in: bool, kind: str
) -> None:
    headers = [HERE, *([header] if header else [])]
    visit = Visit(access=Access(TOKEN))
    is_in = await visit.ask(*headers, query=query, kind=kind)
    if kind == "http" and gets_in and query:
        assert visit.status == 303
    else:
        assert is_in is gets_in
        assert gets_in or kind == "websocket" or visit.status == 403


@pytest.mark.parametrize(
    ("path", "query", "leads_to"),
    [
        ("/", "token={token}", "/"),
        ("/page.html", "a=1&token={token}&b=%20", "/page.html?a=1&b=%20"),
        ("//evil.example/", "token={token}", "/evil.example/"),
        ("/\\evil.example/", "token={token}", "/evil.example/"),
        ("/x", "code={code}&a=1", "/x?a=1"),
        ("/", "%74oken={token}", "/"),
    ],
)
@pytest.mark.parametrize("tls", [False, True])
async def test_the_token_leaves_the_address_at_once(
    path: str, query: str, leads_to: str, tls: bool
) -> None:
    access = Access(TOKEN)
    visit = Visit(access=access)
    query = query.format(token=TOKEN, code=access.new_code())
    assert not await visit.ask(HERE, kind="http", query=query, path=path, tls=tls)
    assert visit.status == 303
    assert visit.headers["location"] == leads_to
    assert visit.headers["cache-control"] == "no-store"
    name, more = (f"__Host-{COOKIE}", "; Secure") if tls else (COOKIE, "")
    cookie = f"{name}={OWN_COOKIE}"
    assert visit.headers["set-cookie"] == f"{cookie}; HttpOnly; SameSite=Strict; Path=/{more}"
    assert TOKEN not in cookie
    assert await Visit(access=access).ask(HERE, ("cookie", cookie), tls=tls)


async def test_a_code_works_once_and_for_a_while() -> None:
    clock = Clock()
    access = Access(TOKEN, clock=clock)
    code = access.new_code()
    first, second = Visit(access=access), Visit(access=access)
    await first.ask(HERE, kind="http", query=f"code={code}")
    await second.ask(HERE, kind="http", query=f"code={code}")
    assert (first.status, second.status) == (303, 403)
    again = Visit(access=access)  # the page of the history, opened by the browser that had it
    cookie = ("cookie", f"{COOKIE}={access.cookie}")
    await again.ask(HERE, cookie, kind="http", query=f"code={code}")
    assert again.status == 303
    late = access.new_code()
    clock.now = 601.0
    third = Visit(access=access)
    await third.ask(HERE, kind="http", query=f"code={late}")
    assert third.status == 403


def test_a_code_is_in_force_for_ten_minutes_and_one_of_the_last_sixteen() -> None:
    clock = Clock()
    access = Access(TOKEN, clock=clock)
    codes = [access.new_code() for _ in range(17)]
    assert len(set(codes)) == 17
    assert [access.redeem(one) for one in codes] == [False] + [True] * 16
    for age, is_in_force in ((599.9, True), (600.0, False)):
        clock.now = 1000.0
        code = access.new_code()
        clock.now += age
        assert access.redeem(code) is is_in_force


@pytest.mark.parametrize("kind", ["websocket", "http"])
async def test_a_code_opens_a_page_and_nothing_else(kind: str) -> None:
    access = Access(TOKEN)
    code = access.new_code()
    visit = Visit(access=access)
    assert not await visit.ask(HERE, kind=kind, method="HEAD", query=f"code={code}")
    ahead = Visit(access=access)
    purpose = ("sec-purpose", "prefetch")
    await ahead.ask(HERE, ("sec-fetch-site", "none"), purpose, kind="http", query=f"code={code}")
    assert ahead.status == 403  # looked at ahead, it must not be used up
    opened = Visit(access=access)
    await opened.ask(HERE, kind="http", query=f"code={code}")
    assert opened.status == 303


async def test_a_page_hears_why_it_was_refused() -> None:
    visit = Visit()
    await visit.ask(HERE, ("origin", "http://evil.example"), kind="http")
    assert visit.sent[0]["status"] == 403
    assert visit.headers == {
        "content-type": "text/plain; charset=utf-8",
        "connection": "close",
        "cache-control": "no-store",
        "content-length": str(len(visit.sent[1]["body"])),
    }
    assert visit.gate.refused == 1


@pytest.mark.parametrize(
    ("options", "headers", "query", "why"),
    [
        ({}, [("host", "evil.example")], "", "that name (Host); see --allow-host"),
        (
            {},
            [HERE, ("origin", "http://a.b")],
            "",
            "other sites may not connect (Origin); see -",
        ),
        ({}, [HERE, ("sec-fetch-dest", "iframe")], "", "but not embed or request it (Sec-Fetch)"),
        ({"access": Access(TOKEN)}, [HERE], "", "a token is needed: ?token=…, a Bearer header or"),
        ({"access": Access(TOKEN)}, [HERE], "code=x", "used already, or is too old: open the stat"),
        ({"access": Access(TOKEN)}, [HERE], "x=1&" * 21, "an address has at most 20 query fields"),
    ],
)
async def test_each_refusal_has_its_reason(
    options: dict[str, Any], headers: list[tuple[str, str]], query: str, why: str
) -> None:
    visit = Visit(**options)
    assert not await visit.ask(*headers, query=query, kind="http")
    assert why in visit.sent[1]["body"].decode()


@pytest.mark.parametrize("method", ["HEAD", "POST"])
async def test_only_a_page_that_is_opened_is_sent_on(method: str) -> None:
    visit = Visit(access=Access(TOKEN))
    assert await visit.ask(HERE, kind="http", method=method, query=f"token={TOKEN}")


async def test_what_is_no_request_goes_to_the_application() -> None:
    """The server tells it that it starts and ends (ASGI: ``lifespan``), without headers."""
    visit = Visit(access=Access(TOKEN))
    await visit.gate({"type": "lifespan"}, None, None)  # type: ignore[arg-type]  # not called
    assert visit.is_in


def test_hosts_and_addresses() -> None:
    assert host_of("[::1]:9090") == "[::1]"
    assert host_of("Name:1") == "name"
    assert is_loopback("127.0.0.1")
    assert is_loopback("::1")
    assert is_loopback("127.0.0.2")
    assert is_loopback("localhost")
    assert not is_loopback("")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("127.example.com")


NAVIGATION = (("sec-fetch-mode", "navigate"), ("sec-fetch-dest", "document"))


@pytest.mark.parametrize("site", ["same-origin", "none"])
async def test_what_the_stations_own_page_asks_for_gets_in(site: str) -> None:
    own = ("sec-fetch-site", site)
    assert await Visit().ask(HERE, own, *NAVIGATION, kind="http")
    assert await Visit().ask(HERE, own, ("sec-fetch-dest", "script"), kind="http")


@pytest.mark.parametrize("site", ["cross-site", "same-site", "elsewhere", ""])
@pytest.mark.parametrize(
    ("mode", "dest", "status"),
    [
        ("navigate", "document", 200),
        ("navigate", "empty", 200),  # through the console's own worker
        ("navigate", "iframe", 403),
        ("navigate", "embed", 403),
        ("no-cors", "image", 403),
        ("no-cors", "script", 403),
        ("cors", "empty", 403),
        ("websocket", "websocket", 403),
        ("", "", 403),
    ],
)
async def test_from_elsewhere_a_page_is_asked_about_and_nothing_else_answered(
    site: str, mode: str, dest: str, status: int
) -> None:
    headers = [("sec-fetch-site", site), ("sec-fetch-mode", mode), ("sec-fetch-dest", dest)]
    headers = [(name, value) for name, value in headers if value or name == "sec-fetch-site"]
    visit = Visit()
    assert not await visit.ask(HERE, *headers, kind="http")
    assert visit.status == status


@pytest.mark.parametrize(
    ("path", "query", "link"),
    [
        ("/", "", "/"),
        ("//evil.example/x", "", "/evil.example/x"),
        ("/\\evil.example", "", "/evil.example"),
        ("/x", "aircraft=a&b=%22", "/x?aircraft=a&amp;b=%22"),
        ("/", '"><script>1</script>{}', "/?&quot;&gt;&lt;script&gt;1&lt;/script&gt;{}"),
    ],
)
async def test_the_question_leads_to_what_was_asked_for_and_runs_nothing(
    path: str, query: str, link: str
) -> None:
    visit = Visit(access=Access(TOKEN))  # a visitor needs no token yet
    there = ("sec-fetch-site", "cross-site")
    assert not await visit.ask(HERE, there, *NAVIGATION, kind="http", path=path, query=query)
    page = visit.sent[1]["body"].decode()
    assert page.count("<a ") == 1
    assert f'<a href="{link}">' in page
    for banned in ("<script", " id=", "autofocus", "<button", "<form"):
        assert banned not in page
    rules = visit.headers["content-security-policy"].split("; ")
    assert {"default-src 'none'", "frame-ancestors 'none'", "form-action 'none'"} < set(rules)
    assert not any(rule.startswith("script-src") for rule in rules)
    assert visit.headers["cache-control"] == "no-store"
    assert visit.headers["content-type"] == "text/html; charset=utf-8"
    assert visit.headers["vary"] == "sec-fetch-site"
    style = page.partition("<style>")[2].partition("</style>")[0].encode()
    digest = base64.b64encode(hashlib.sha256(style).digest()).decode()
    assert f"style-src 'sha256-{digest}'" in rules
    assert visit.gate.refused == 0


async def test_from_elsewhere_nothing_is_posted_or_fetched_ahead() -> None:
    there = ("sec-fetch-site", "cross-site")
    assert not await Visit().ask(HERE, there, *NAVIGATION, kind="http", method="POST")
    ahead = ("sec-purpose", "prefetch;prerender")
    assert not await Visit().ask(HERE, there, *NAVIGATION, ahead, kind="http")


@pytest.mark.parametrize("dest", ["iframe", "frame", "embed", "object", "fencedframe"])
@pytest.mark.parametrize("site", ["same-origin", "none"])
async def test_no_page_stands_in_a_frame_not_even_of_the_station(site: str, dest: str) -> None:
    headers = (("sec-fetch-site", site), ("sec-fetch-dest", dest))
    assert not await Visit().ask(HERE, *headers, kind="http")


async def test_a_page_allowed_by_name_is_judged_by_its_origin() -> None:
    page = ("origin", "http://127.0.0.1:8000")
    visit = Visit(origins=["http://127.0.0.1:8000"])
    assert await visit.ask(HERE, page, ("sec-fetch-site", "same-site"))


async def test_a_flood_of_refusals_is_a_few_lines_and_a_number(
    caplog: pytest.LogCaptureFixture,
) -> None:
    visit = Visit()
    for _ in range(1000):
        await visit.ask(HERE, ("origin", "http://evil.example"), kind="http")
    assert 1 <= len(caplog.records) <= 20
    assert visit.gate.refused == 1000
