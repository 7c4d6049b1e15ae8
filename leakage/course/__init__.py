"""A motor over its nights: baselines, monitoring of changes, forecasts."""
