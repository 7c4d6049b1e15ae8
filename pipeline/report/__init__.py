"""The report: a folder of pages, made from the tables alone, that opens from a file share.

Doors: `build` (the pages), `paper` (a page for a work order), `status` (states on the terminal),
`explain` and `audit` (a night in words). Below them `tables` has a motor over its nights, `charts`
what is drawn of it, by `plotly_json` on pages and by `paper`.
"""
