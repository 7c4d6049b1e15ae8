"""Physics of a motor: oil, laws of the leakage paths, conditions. Source: the thesis."""
