"""Each motor against its own past, from the published tables alone."""
