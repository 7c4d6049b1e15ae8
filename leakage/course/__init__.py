"""A motor over its nights, for show: slopes, times to a limit, zeros of sensors."""
