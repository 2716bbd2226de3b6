"""All verbs of ``m100link fleet``, wherever they stand."""

from __future__ import annotations

from m100link.apps.cli.fleet import app
from m100link.apps.cli.fleet_agent import agent, console, router
from m100link.apps.cli.fleet_mission import app as mission
from m100link.apps.cli.fleet_pki import acl, pki
from m100link.apps.cli.fleet_show import app as show
from m100link.apps.cli.fleet_watch import app as log
from m100link.apps.cli.fleet_watch import lease, monitor, watch

for _verb in (router, agent, console, monitor, watch, lease, mission, log, show, pki, acl):
    app.command(_verb)
