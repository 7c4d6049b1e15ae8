"""The report: a folder of pages, made from the tables alone, that opens from a file share.

Doors: `build` (the pages), `status` (states on the terminal), `explain` (a night in words). Below
them `charts` is what is drawn, and `plotly_json` how.
"""
