"""Plants' logs as their historians write them, and the mapping that a person would make."""
