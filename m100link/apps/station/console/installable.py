"""What makes the console a program that can be installed, and opens without its station.

A browser keeps one page of it, which says that the station is not reached, and nothing else: no
telemetry, no answer of the station, no script of the console. Whatever shows a value was sent by a
station that runs.
"""

from __future__ import annotations

from pathlib import Path

from starlette.responses import FileResponse, Response
from starlette.routing import BaseRoute, Route

__all__ = ["HEAD", "routes"]

STATIC = Path(__file__).parent / "static"

# With credentials: behind a token nothing is sent to whoever has no cookie.
HEAD = (
    '<link rel="manifest" href="/console/manifest.webmanifest" crossorigin="use-credentials">'
    '<link rel="icon" type="image/svg+xml" href="/console/icon.svg">'
    '<meta name="theme-color" content="#12202f">'
    '<meta name="mobile-web-app-capable" content="yes">'
    # What shell.js imports, asked for with it and not after it.
    + "".join(
        f'<link rel="modulepreload" href="/console/{name}.js">'
        for name in ("shell", "press", "orders", "said", "socket", "steer", "instruments", "map")
    )
    + "<script>navigator.serviceWorker?.register('/sw.js').catch(() => {})</script>"
)
"""What the page has in its head. Beyond this machine workers need TLS; without, there is none."""


def routes() -> list[BaseRoute]:
    """The worker, from where it may stand before the whole console."""
    return [Route("/sw.js", _worker)]


async def _worker(request: object) -> Response:
    return FileResponse(
        STATIC / "sw.js", media_type="text/javascript", headers={"cache-control": "no-cache"}
    )
