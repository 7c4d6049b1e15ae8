"""Changes of state on their way to people: the outbox, and the receivers that take from it."""
