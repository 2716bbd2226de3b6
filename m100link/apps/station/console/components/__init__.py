"""Components of the page, a file for each topic; :mod:`.component` says how one is plugged in."""
