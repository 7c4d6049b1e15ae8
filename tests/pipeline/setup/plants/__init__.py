"""Plants' files that `init` has to read."""
