"""What the watch says of a motor night by night, the zeros of its sensors, and its state."""
