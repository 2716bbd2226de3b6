"""A page of another site gives no order, whatever its user does; the user here gives all."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from tests.browser.conftest import Console, running_console, until
from tests.browser.operator import banner, hold_key, is_still, shows
from tests.waiting import PATIENCE

pytestmark = [pytest.mark.anyio]

OBTAIN = "[data-act=obtain]"
TABS = 80  # more than there are places to come to


@contextlib.asynccontextmanager
async def site(target: str) -> AsyncIterator[str]:
    """A page of another site (localhost, not 127.0.0.1) with a button and a link."""
    body = (
        f"<a id=link href={target!r}>look</a>"
        f'<button id=go onclick="window.w = window.open({target!r})">press and hold Enter</button>'
    ).encode()

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        head = f"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: {len(body)}\r\n"
        writer.write(f"{head}Connection: close\r\n\r\n".encode() + body)
        writer.close()

    async with await asyncio.start_server(answer, "localhost", 0) as server:
        yield f"http://localhost:{server.sockets[0].getsockname()[1]}/"


async def place_of(page: Any, selector: str) -> str:
    """The id of an element, which every page of the console has the same."""
    return str(await page.evaluate(f"document.querySelector({selector!r}).id"))


async def has_ordered_nothing(page: Any) -> bool:
    """Whether the aircraft is as it was: what would be ordered first activates it."""
    return "not activated" in str(await page.text_content("#banner"))


async def tab_to(page: Any, selector: str) -> None:
    """Come there with the keyboard alone."""
    for _ in range(TABS):
        await page.keyboard.press("Tab")
        if await page.evaluate(f"document.activeElement?.matches({selector!r}) ?? false"):
            return
    raise AssertionError(f"no Tab leads to {selector}")


async def focused(page: Any) -> str:
    return str(await page.evaluate("document.activeElement?.dataset.act ?? ''"))


async def is_gone(page: Any) -> bool:
    """Whether the page that opened it has lost hold of the console's window."""
    return bool(await page.evaluate("window.w.closed"))


async def test_a_popup_of_another_site_cannot_be_flown_by_fragments(
    browser: Any, console: Console
) -> None:
    own = await console.open()
    fragment = await place_of(own, OBTAIN)
    other = await browser.new_context()  # nothing of the console is kept there
    async with site(console.url) as evil:
        page = await other.new_page()
        await page.goto(evil)
        async with other.expect_page() as opening:  # it may have lost its opener by then
            await page.click("#go")
        popup = await opening.value
        await popup.wait_for_load_state()
        await until(lambda: popup.url.startswith(console.url))
        for _ in range(30):  # seconds, as they hold and press what the page names
            await page.evaluate(f"window.w.location = {console.url + '#' + fragment!r}")
            await popup.keyboard.down("Enter")
            await asyncio.sleep(0.1)
            await popup.keyboard.up("Enter")
        assert await has_ordered_nothing(own)
        assert await popup.evaluate("window.m100 === undefined")
        assert await is_gone(page)
    await other.close()


async def test_a_link_asks_first_and_leads_on_also_through_the_worker(
    console: Console,
) -> None:
    for visit in ("the first", "with the worker"):
        page = await console.context.new_page()
        async with site(console.url) as evil:
            await page.goto(evil)
            await page.click("#link")
            await page.wait_for_url(f"{console.url}**")
            question = await page.inner_text("h1")
            assert question == "Open this ground station?", visit
            assert await page.evaluate("document.activeElement === document.body")
            await page.click("a")
            await page.wait_for_function("window.m100?.socket?.heardAt > 0")
        await page.evaluate("navigator.serviceWorker.ready.then(() => 1)")


async def test_no_fragment_leads_the_focus_to_an_order(console: Console) -> None:
    page = await console.open()
    fragment = await place_of(page, OBTAIN)
    for _ in range(2):
        await page.evaluate(f"location.hash = {fragment!r}")
        await until(lambda: _is_told(page, "location.hash === '#fly'"))
        assert await focused(page) == ""
        await page.keyboard.press("Enter")
    again = await console.context.new_page()
    await again.goto(f"{console.url}#{fragment}")
    await again.wait_for_function("window.m100?.socket?.heardAt > 0")
    await asyncio.sleep(1.2)  # past the quiet second
    await again.keyboard.press("Enter")
    assert await focused(again) == ""
    assert await has_ordered_nothing(page)


async def _is_told(page: Any, expression: str) -> bool:
    return bool(await page.evaluate(expression))


async def test_a_focus_that_came_by_itself_takes_no_key_for_a_second(console: Console) -> None:
    page = await console.open()
    await asyncio.sleep(1.2)
    await page.evaluate(f"document.querySelector({OBTAIN!r}).focus()")
    for key in ("Enter", "Space"):
        await page.keyboard.press(key)
    assert "focus had moved here on its own" in await page.inner_text("#page-said")
    assert await has_ordered_nothing(page)
    await page.evaluate("document.querySelector('#pad').focus()")
    await page.keyboard.down("w")
    await asyncio.sleep(1.2)
    assert await page.evaluate("window.m100.steering.wasActive") is False
    await page.keyboard.up("w")


async def test_a_key_held_since_before_gives_no_order(console: Console) -> None:
    page = await console.open()
    for key in ("Enter", "Space"):
        await page.keyboard.down(key)
        await tab_to(page, OBTAIN)
        for _ in range(3):
            await page.keyboard.down(key)  # by now it repeats
        await page.keyboard.up(key)
    await page.evaluate(f"document.querySelector({OBTAIN!r}).click()")  # and no script
    await asyncio.sleep(0.5)
    assert await has_ordered_nothing(page)
    await page.keyboard.press("Space")
    await banner(page, "You have control")


async def test_the_keyboard_alone_flies(console: Console) -> None:
    page = await console.open()
    await tab_to(page, OBTAIN)
    await page.keyboard.press("Enter")
    await banner(page, "You have control")
    await tab_to(page, "#ground [role=checkbox]")
    await page.keyboard.press("Space")
    await page.wait_for_selector("#ground [aria-checked=true]")
    for _ in range(6):  # a page that stood still asks for it again
        await tab_to(page, "[data-act=take_off]:not([disabled])")
        await page.keyboard.down("Enter")
        await asyncio.sleep(2.0)
        await page.keyboard.up("Enter")
        with contextlib.suppress(AssertionError):
            await until(lambda: console.watch.height > 1.0, within=PATIENCE / 6)
            break
    await page.wait_for_selector("[data-act=land]:not([disabled])")
    await tab_to(page, "#pad")
    await hold_key(page, "w", lambda: not is_still(console))
    await page.keyboard.up("w")
    await until(lambda: is_still(console))


async def test_markup_that_gets_into_the_page_runs_nothing(console: Console) -> None:
    page = await console.open()
    hits = await page.evaluate("""async () => {
        window.hits = [];
        const into = document.body.appendChild(document.createElement("div"));
        into.innerHTML = '<img src="data:," onerror="hits.push(1)">'
            + '<a href="javascript:hits.push(2)">x</a>';
        into.querySelector("a").click();
        const script = document.createElement("script");
        script.textContent = "hits.push(3)";
        document.body.append(script);
        const far = document.createElement("script");
        far.src = "http://localhost:1/x.js";
        const blocked = new Promise((found) => addEventListener("securitypolicyviolation",
            (event) => event.blockedURI.includes("localhost:1") && found("blocked")));
        document.body.append(far);
        hits.push(await blocked);
        return window.hits;
    }""")
    assert hits == ["blocked"]
    console.foreign.clear()  # it was asked for, and not fetched


async def test_the_page_that_is_kept_for_a_station_that_is_gone_still_runs(
    browser: Any,
) -> None:
    context = await browser.new_context()
    async with running_console() as (report, _):
        page = await context.new_page()
        await page.goto(report["console"])
        await page.evaluate("navigator.serviceWorker.ready.then(() => 1)")
    await page.reload()
    await shows(page, "#tries", "tried")
    await context.close()
