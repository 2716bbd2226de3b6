"""The console for browsers. Needs the extra ``station``.

A topic (header, fly, map, plan, data) has a file of values in ``view/``, a file of NiceGUI elements
in ``components/``, and its words in the files of ``texts/``, one for each language. The page puts
components into its views, a tab is what one operator may do. ``static/`` runs in the browser.
"""
