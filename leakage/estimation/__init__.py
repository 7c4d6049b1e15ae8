"""Estimation from one night: statistics of blocks, least squares, intervals, residual analysis."""
