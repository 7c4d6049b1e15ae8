"""The report: a folder of pages, made from the tables alone, that opens from a file share.

Doors: `build` (the pages), `status` (states on the terminal), `explain` (a night in words). Below
them `tables` has a motor over its nights, `charts` what is drawn of it, and `plotly_json` how.
"""
