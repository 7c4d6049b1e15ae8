"""Outcomes of a motor's night: `status` of the table `fits`."""

OK, STOOD_STILL, NO_NEW_DATA = "ok", "stood_still", "no_new_data"
INSUFFICIENT_DATA, FAILED = "insufficient_data", "failed"
# Outcomes of nights of which a log could be read.
WITH_SAMPLES = (OK, STOOD_STILL, INSUFFICIENT_DATA)
