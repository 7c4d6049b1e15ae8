"""Versions of the program and of what makes its figures, as every run records them."""

from __future__ import annotations

import platform
from functools import lru_cache
from importlib.metadata import version

DEPENDENCIES = ("polars", "pyarrow", "numpy", "scipy")


@lru_cache(maxsize=1)
def own_version() -> str:
    """Version of motor-leakage."""
    return version("motor-leakage")


def versions() -> dict[str, str]:
    """Versions by column of `runs`.

    Examples
    --------
    >>> sorted(versions())
    ['numpy_version', 'polars_version', 'pyarrow_version', 'python_version', 'scipy_version', \
'version']
    """
    found = {f"{name}_version": version(name) for name in DEPENDENCIES}
    return {"version": own_version(), "python_version": platform.python_version(), **found}
