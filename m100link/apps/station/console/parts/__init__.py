"""Components of the page, one file each; :mod:`.part` says how one is plugged in."""
