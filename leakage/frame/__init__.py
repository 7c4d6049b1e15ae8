"""Fit of a data frame, with its figures and words, for notebooks."""
