"""The report: a folder of pages, made from the tables alone, that opens from a file share."""
