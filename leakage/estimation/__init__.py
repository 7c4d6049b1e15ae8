"""Estimation from a night: statistics of blocks, least squares, intervals, residual analysis."""
