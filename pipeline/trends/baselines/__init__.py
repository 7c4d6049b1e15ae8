"""Quantities frozen with a motor's baseline, and nights of another duty against them."""
