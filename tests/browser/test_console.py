"""The console in a real browser: missions by clicks and keys, and every way to let go."""

from __future__ import annotations

import asyncio
import math
import os
import signal
import urllib.error
import urllib.parse
import urllib.request
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from m100link import Waypoint, WaypointPlan
from tests.browser.conftest import (
    Console,
    Watch,
    console_in_browser,
    context_of,
    running_console,
    until,
)
from tests.browser.operator import (
    airborne,
    banner,
    fold,
    hold_key,
    hold_until,
    in_control,
    is_still,
    look_around,
    look_at,
    press,
    press_for,
    press_until,
    shows,
    take_off,
)
from tests.waiting import PATIENCE, again_and_again

pytestmark = [pytest.mark.anyio]


def heading(watch: Watch) -> float:
    """By the first parts of the attitude, rad."""
    attitude = watch.newest["attitude"]["quaternion"]
    return 2.0 * math.atan2(attitude["z"], attitude["w"])


async def test_a_whole_mission_by_clicks_and_keys(console: Console) -> None:
    watch = console.watch
    page = await airborne(console)
    await page.click("#pad")
    await page.keyboard.press("Digit3")
    for key, moves in (
        ("w", lambda: watch.speed[1] > 0.5),
        ("s", lambda: watch.speed[1] < -0.3),
        ("d", lambda: watch.speed[0] > 0.5),
        ("a", lambda: watch.speed[0] < -0.3),
        ("z", lambda: watch.speed[2] > 0.2),
        ("c", lambda: watch.speed[2] < -0.2),
    ):
        await hold_key(page, key, moves)
        await page.keyboard.up(key)
        await until(lambda: is_still(console), what=f"{key} released")
    before = heading(watch)
    await hold_key(page, "e", lambda: math.cos(heading(watch) - before) < math.cos(0.1))
    await page.keyboard.up("e")
    await page.keyboard.press("Digit9")
    await hold_key(page, "w", lambda: watch.speed[1] > 1.0)
    await page.keyboard.up("w")
    await until(lambda: is_still(console))
    await hold_until(page, "land", lambda: watch.status == 1)
    await page.wait_for_function("document.querySelector('#task').textContent === ''")
    await press_for(page, "release", "#banner", "Nobody has control")
    assert await page.inner_text("#problem") == ""


# Both by the page's clock, so that no machine is so busy that it becomes a long one.
SHORT_PRESS = """() => new Promise((done) => {
  const say = (kind) => document.querySelector("[data-act=take_off]").dispatchEvent(
    new PointerEvent(kind, {bubbles: true, pointerId: 1}));
  say("pointerdown");
  setTimeout(() => { say("pointerup"); done(); }, 400);
})"""


async def test_a_short_press_neither_takes_off_nor_lands(console: Console) -> None:
    page = await console.open()
    await in_control(page)
    await look_around(page)
    await page.wait_for_selector("[data-act=take_off]:not([disabled])")
    await page.evaluate(SHORT_PRESS)
    await page.click("[data-act=take_off]")
    await asyncio.sleep(1.5)
    assert console.watch.status == 1
    await take_off(page, console)


# In the frame in which the orders shift: the page's own observer was there first.
PRESS_AS_IT_SHIFTS = """() => {
  const dock = document.querySelector("#dock"), height = dock.offsetHeight;
  new ResizeObserver((_, observer) => {
    if (dock.offsetHeight === height) return;
    observer.disconnect();
    document.querySelector("[data-act=take_off]").dispatchEvent(
      new PointerEvent("pointerdown", {bubbles: true, pointerId: 1}));
  }).observe(dock, {box: "border-box"});
  document.documentElement.style.setProperty("--dock", "90px");
}"""


async def test_buttons_stay_where_the_finger_is_or_say_that_they_moved(console: Console) -> None:
    page = await console.open()
    places = """() => [...document.querySelectorAll('#strip .act')].map((one) => {
      const box = one.getBoundingClientRect();
      return [box.left, box.top];
    })"""
    before = await page.evaluate(places)
    await in_control(page)
    await look_around(page)  # the missing values above them are named no more
    await page.wait_for_selector("[data-act=take_off]:not([disabled])")
    await page.wait_for_selector("#why-not", state="hidden")
    await page.evaluate("document.querySelector('#header').style.paddingBottom = '80px'")
    await page.wait_for_timeout(100)
    assert await page.evaluate(places) == before  # whatever the header has to say
    await page.evaluate(PRESS_AS_IT_SHIFTS)
    await shows(page, "#problem", "the page shifted during the press")
    assert console.watch.status == 1
    await take_off(page, console)


async def test_the_pad_shows_what_is_flown_and_not_what_is_sent(console: Console) -> None:
    panel = await console.open()  # of the virtual aircraft, and another operator
    await look_at(panel, "settings")
    page = await console.open()
    green = "() => document.querySelector('#pad').dataset.fate === 'flown'"

    async def is_not_flown(why: str) -> None:
        """Held; and again where a busy page let go by itself."""
        for _ in again_and_again():
            await page.click("#pad")
            await page.keyboard.down("w")
            with suppress(AssertionError):
                await until(lambda: told(why), within=PATIENCE / 6)
                break
            await page.keyboard.up("w")
        assert not await page.evaluate(green)

    async def told(why: str) -> bool:
        return f"{why} · W" in await page.inner_text("#did")

    async def flies() -> None:
        await page.click("#pad")
        await hold_key(page, "w", lambda: not is_still(console))
        await page.wait_for_function(green)
        await shows(page, "#did", "flown · W: forward")

    await is_not_flown("not flown: you have no control")
    await page.keyboard.up("w")
    await in_control(page)
    await is_not_flown("not flown: the aircraft is on the ground")
    await page.keyboard.up("w")
    await look_around(page)
    await take_off(page, console)
    await page.wait_for_selector("[data-act=land]:not([disabled])")
    await flies()
    await panel.click("#sim-mode >> text=P")
    await is_not_flown("not flown: the pilot has control, mode switch not in F")
    await banner(page, "mode switch in P")
    await panel.click("#sim-mode >> text=F")
    await shows(page, "#did", "let go")  # and press again, if the page has not by itself
    assert not await page.evaluate(green)
    await page.keyboard.up("w")
    await until(lambda: is_still(console))
    await flies()
    await press(panel, "stop")
    await shows(page, "#did", "let go")
    assert not await page.evaluate(green)
    await page.keyboard.up("w")
    await flies()
    await press(page, "stop")
    await page.wait_for_function("document.querySelector('#pad').dataset.fate === ''")
    await page.keyboard.up("w")
    await until(lambda: is_still(console))
    assert await page.inner_text("#problem") == "", "a STOP that stops is no error"


PITCH = """() => Number(
  document.querySelector("#camera-state").textContent.match(/pitch (-?[0-9]+)/)?.[1])"""


async def test_a_photo_is_one_tap_and_the_camera_looks_where_it_is_dragged(browser: Any) -> None:
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page = await console.open()
        await in_control(page)
        await fold(page, "camera", is_shown=False)
        await press_for(page, "photo", "#camera-state", "photo sent")
        await shows(page, "#camera-state", "not confirmed")
        assert await page.is_visible("#camera-state"), "said although the card is folded"
        await fold(page, "camera", is_shown=True)
        box = await page.locator(".look").bounding_box()
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        await page.mouse.move(x, y)
        await page.mouse.down()
        await page.mouse.move(x, y + box["height"] / 2)  # down
        await page.wait_for_function(f"({PITCH})() < -20")
        await page.mouse.up()
        await press_for(page, "gimbal_centre", "#camera-state", "pitch 0°")
        await page.locator("#gimbal-pitch").click(position={"x": 4, "y": 10})  # its lower end
        await page.wait_for_function(f"({PITCH})() < -80")
        await press_for(page, "video_start", "#camera-state", "start of video sent")
        assert await page.inner_text("#problem") == ""
        await look_at(page, "events")
        await shows(page, "#events", "start video, sent")


async def test_closing_the_tab_in_flight_stops_and_frees_control(console: Console) -> None:
    page = await airborne(console)
    await page.click("#pad")
    await page.keyboard.press("Digit4")
    await hold_key(page, "w", lambda: console.watch.speed[1] > 0.5)
    await page.close()
    await until(lambda: is_still(console))
    assert console.watch.height > 0.8
    other = await console.open()
    await banner(other, "Nobody has control")


SLOW = """
const Native = WebSocket;
window.WebSocket = class extends Native {
  constructor(url, ...rest) {
    super(url, ...rest);
    this.isSlow = String(url).includes("/steer/");
  }
  send(data) {
    if (this.isSlow) setTimeout(() => super.send(data), 1000);
    else super.send(data);
  }
  set onmessage(handler) {
    super.onmessage = this.isSlow ? (e) => setTimeout(() => handler(e), 1000) : handler;
  }
};
"""


async def test_nobody_steers_with_a_second_each_way_and_the_page_says_why(
    console: Console,
) -> None:
    first, page = await console.open(), await console.open(SLOW)
    await airborne(console, page=first)
    await look_at(page, "check")
    await page.wait_for_selector("[data-check=quality].wrong")  # it would offer no take-off, either
    await look_at(page, "fly")
    await press_until(page, "obtain", lambda: page.is_visible("#confirm"))
    await page.click("#confirm")
    await banner(page, "You have control")
    await first.close()
    await page.click("#pad")
    await page.keyboard.press("Digit4")
    await page.keyboard.down("w")
    await shows(page, "#problem", "the round trip to the page takes")
    await page.wait_for_function("document.body.classList.contains('station-lost')")
    assert is_still(console)
    assert await page.evaluate("window.m100.socket.age") > 0.9
    await page.keyboard.up("w")


async def test_a_browser_that_hangs_stops_the_aircraft(console: Console) -> None:
    page = await airborne(console)
    await page.click("#pad")
    await page.keyboard.press("Digit4")
    await hold_key(page, "w", lambda: console.watch.speed[1] > 0.5)
    hanging = asyncio.create_task(
        page.evaluate("() => { const end = Date.now() + 8000; while (Date.now() < end); }")
    )
    fastest = console.watch.speed[1]
    await until(lambda: console.watch.speed[1] < fastest / 2, within=7.0)
    assert not hanging.done(), "the key was released, the browser did not hang"
    await hanging


async def test_two_tabs_and_a_take_over(console: Console) -> None:
    first, second = await console.open(), await console.open()
    await airborne(console, page=first)
    await banner(second, "console 1 has control")
    assert await second.locator("[data-act=land]").is_disabled()
    await press_until(second, "obtain", lambda: second.is_visible("#take-over"))
    assert "console 1 has control" in await second.inner_text("#take-over")
    await second.click("#confirm")
    await banner(second, "You have control")
    await banner(first, "console 2 has control")
    await shows(first, "[data-alarm=lease_taken].raised", "console 2 took control from you")
    await first.click("#pad")
    await first.keyboard.down("w")
    await asyncio.sleep(1.0)
    assert is_still(console)
    await press(first, "stop")  # anybody may stop
    await hold_until(second, "land", lambda: console.watch.status == 1)


async def test_fields_grey_out_by_age_each_in_its_time(console: Console) -> None:
    page = await console.open()
    field = ".field:has([data-field={}])"
    await page.wait_for_selector(field.format("battery") + ":not(.stale)")
    await look_at(page, "settings")
    await page.click("#sim-stall")
    await look_at(page, "fly")
    await page.wait_for_function(
        "([height, battery]) => document.querySelector(height).matches('.stale')"
        " && !document.querySelector(battery).matches('.stale')",
        arg=[field.format("height"), field.format("battery")],
    )
    await page.wait_for_selector(field.format("battery") + ".stale")
    assert await page.get_attribute("#horizon", "data-stale") == "stale"
    assert await page.get_attribute("#map", "data-stale") == "stale"
    await look_at(page, "settings")
    await page.click("#sim-stall")
    await look_at(page, "fly")
    await page.wait_for_selector(field.format("height") + ":not(.stale)")


def child_of(process: int) -> int:
    [child] = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    return int(child)


async def test_everything_greys_when_the_station_is_gone(console: Console) -> None:
    page = await console.open()
    front = child_of(console.process.pid)
    console.process.kill()
    await page.wait_for_function("document.body.classList.contains('station-lost')")
    await page.wait_for_selector("#page-lost:visible")
    await page.wait_for_function("window.m100.heard.level === 'danger'")
    assert "does not hear the station" in await page.inner_text("#page-lost")
    await page.click("#page-lost-seen")
    await page.wait_for_function("window.m100.heard.level === ''")
    with suppress(ProcessLookupError):
        os.kill(front, signal.SIGTERM)  # by itself it would say so for 5 s
    console.watch.newest.clear()


async def test_a_refusal_says_why(console: Console) -> None:
    page = await console.open()
    await look_at(page, "settings")
    await page.click("#sim-refuse")
    await press_for(page, "obtain", "#problem", "the server refused")
    await look_at(page, "check")
    await shows(page, "[data-check=activation]", "the server refused")


@pytest.mark.parametrize(
    "headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}]
)
async def test_the_console_is_not_for_pages_from_elsewhere(
    address: str, headers: dict[str, str]
) -> None:
    request = urllib.request.Request(address, headers=headers)
    with pytest.raises(urllib.error.HTTPError) as caught:
        await asyncio.to_thread(urllib.request.urlopen, request)
    assert caught.value.code == 403
    caught.value.close()


async def test_a_page_elsewhere_cannot_show_the_console_in_a_frame(console: Console) -> None:
    # Seen by the user: a game. Clicked by the user: take-off, in an invisible frame above it.
    page = await console.context.new_page()
    asked = []
    page.on("response", lambda answer: asked.append((answer.url, answer.status)))
    trap = f"<button>play</button><iframe style='opacity:0' src='{console.url}'></iframe>"
    await page.route(
        "http://game.example/", lambda route: route.fulfill(body=trap, content_type="text/html")
    )
    await page.goto("http://game.example/")
    await page.wait_for_timeout(500)
    assert (console.url, 403) in asked or not any(url == console.url for url, _ in asked)
    shown = [await frame.content() for frame in page.frames[1:]]
    assert not any("startConsole" in text for text in shown)


async def test_what_the_console_answers_forbids_frames(address: str) -> None:
    for path in ("", "console/shell.js", "none"):
        try:
            answer = await asyncio.to_thread(urllib.request.urlopen, address + path)
        except urllib.error.HTTPError as error:
            answer = error
        with answer:
            assert answer.headers["X-Frame-Options"] == "DENY"
            assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"


async def test_a_token_stands_neither_in_the_address_nor_on_a_command_line(
    browser: Any, tmp_path: Path
) -> None:
    token = "0123456789abcdefXY"
    path = tmp_path / "token"
    path.write_text(token)
    path.chmod(0o600)
    async with (
        running_console("--token-file", str(path)) as (report, _),
        context_of(browser) as context,
        context_of(browser) as elsewhere,
    ):
        url = report["console"]
        assert token not in url
        page = await context.new_page()
        await context.add_cookies([{"name": "json", "value": '{"a":1}', "url": url}])
        await page.goto(url)
        await page.wait_for_function("window.m100?.steering && window.m100.socket.heardAt > 0")
        assert page.url == url.partition("?")[0]
        assert token not in str(await context.cookies())
        assert (await page.reload()).ok
        other = await elsewhere.new_page()
        assert (await other.goto(url)).status == 403  # used already
        assert (await other.goto(f"{page.url}?token={token}")).ok
        assert other.url == page.url


async def test_a_mission_from_a_file(browser: Any, tmp_path: Path) -> None:
    path = tmp_path / "triangle.json"
    places = [(22.54325, 113.9589), (22.54325, 113.95905), (22.5431, 113.95905)]
    plan = WaypointPlan([Waypoint(*place, height=6) for place in places], speed=5)
    plan.write(path)
    async with console_in_browser(browser, "--firmware", "3.1") as console:
        page = await airborne(console)
        await look_at(page, "plan")
        await page.set_input_files("#plan-file", path)
        await shows(page, "#plan-summary", "3 waypoints")
        await press_for(page, "mission_upload", "#plan-uploaded", "Uploaded")

        async def is_under_way() -> bool:
            return "to waypoint" in await page.inner_text("#mission")

        await hold_until(page, "mission_start", is_under_way)
        await shows(page, "#mission", "to waypoint 2 of 3")
        await press_for(page, "mission_stop", "#mission", "no mission")
        await until(lambda: is_still(console))
