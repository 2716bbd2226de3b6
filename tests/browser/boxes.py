"""Where things stand on a page: what covers what, what cannot be hit, what is too small."""

from __future__ import annotations

from pathlib import Path
from typing import Any

__all__ = ["SIZES", "faults", "steady"]

SIZES = ((390, 844), (844, 390), (768, 1024), (1024, 768), (1440, 900), (2560, 1440))
"""Phone upright and on its side, tablet both ways, two desks."""

_FAULTS = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")


async def steady(page: Any) -> None:
    """Wait until two frames have passed without a change of size."""
    await page.evaluate(
        "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame("
        "() => setTimeout(done, 60))))"
    )


async def faults(page: Any) -> list[str]:
    """What is wrong with where things stand; best an empty list."""
    await steady(page)
    found: list[str] = await page.evaluate(_FAULTS)
    return found
