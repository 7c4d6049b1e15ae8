"""Fit of one data frame, with its figures and words, for notebooks."""
