"""Reasons of a state in plain words, and the path or the cause that they name."""
