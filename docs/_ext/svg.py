"""A few shapes of SVG, for pictures that follow the page's colours, light and dark."""

from __future__ import annotations

from html import escape

from docutils import nodes

__all__ = ["STYLE", "Drawing", "picture"]

# As wide as drawn, so that its words can be read: a narrow page scrolls it sideways.
STYLE = "height:auto;color:var(--color-foreground-primary)"
_SOFT = "var(--color-background-secondary)"
_STRONG = "var(--color-brand-primary)"
_FONT = "font-family:var(--font-stack,sans-serif)"


def picture(svg: str, description: str) -> nodes.Node:
    """A picture as a document node; builders that are not for HTML leave it out.

    Args:
        svg: The whole element.
        description: What it shows, for those who cannot see it.
    """
    html = f'<p role="img" aria-label="{escape(description)}" style="overflow-x:auto">{svg}</p>'
    return nodes.raw("", html, format="html")


class Drawing:
    """Shapes on a canvas whose unit is a CSS pixel.

    Args:
        width: Of the canvas.
        height: Of the canvas.
    """

    def __init__(self, width: float, height: float) -> None:
        self._size = width, height
        self._parts: list[str] = []

    def box(self, x: float, y: float, width: float, height: float, *, soft: bool = True) -> None:
        """A rectangle, filled softly or not at all."""
        fill = _SOFT if soft else "none"
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="4" '
            f'fill="{fill}" stroke="currentColor"/>'
        )

    def circle(self, x: float, y: float, radius: float) -> None:
        """A circle."""
        self._parts.append(
            f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="{_SOFT}" stroke="currentColor"/>'
        )

    def path(self, commands: str, *, dashed: bool = False, head: bool = False) -> None:
        """A path in SVG's own letters, with an arrow's head at its end if wanted."""
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        end = ' marker-end="url(#head)"' if head else ""
        colour = _STRONG if head else "currentColor"
        self._parts.append(
            f'<path d="{commands}" fill="none" stroke="{colour}" stroke-width="1.5"{dash}{end}/>'
        )

    def arrow(self, x: float, y: float, to_x: float, to_y: float, *, dashed: bool = False) -> None:
        """A straight arrow."""
        self.path(f"M{x:g} {y:g}L{to_x:g} {to_y:g}", dashed=dashed, head=True)

    def line(self, x: float, y: float, to_x: float, to_y: float, *, dashed: bool = False) -> None:
        """A straight line."""
        self.path(f"M{x:g} {y:g}L{to_x:g} {to_y:g}", dashed=dashed)

    def text(
        self,
        x: float,
        y: float,
        words: str,
        *,
        at: str = "middle",
        size: float = 13,
        bold: bool = False,
        code: bool = False,
    ) -> None:
        """One line of text; ``at`` says which end of it, ``start``, ``middle`` or ``end``."""
        font = "font-family:var(--font-stack--monospace,monospace)" if code else _FONT
        weight = ";font-weight:600" if bold else ""
        self._parts.append(
            f'<text x="{x:g}" y="{y:g}" text-anchor="{at}" fill="currentColor" '
            f'style="{font};font-size:{size:g}px{weight}">{escape(words)}</text>'
        )

    def svg(self) -> str:
        """The whole element."""
        width, height = self._size
        head = (
            '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
            f'markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8z" fill="{_STRONG}"/>'
            "</marker></defs>"
        )
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
            f'width="{width:g}" style="{STYLE}">{head}{"".join(self._parts)}</svg>'
        )
