"""A motor's states night by night: changes, steps, sensors, model, and its oil circuit."""
