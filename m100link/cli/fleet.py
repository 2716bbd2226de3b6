"""``m100link fleet``: many aircraft, many machines."""

from __future__ import annotations

import cyclopts

__all__ = ["app"]

app = cyclopts.App(
    name="fleet",
    help="Many aircraft: formations that they fly.",
    version_flags=(),
)
app.command("m100link.cli.fleet_show:app", name="show")
app.command("m100link.cli.fleet_pki:acl", name="acl")
app.command("m100link.cli.fleet_pki:pki", name="pki")
