"""A simulated fleet: six motors, their configs and logs, and the truth behind them."""

from pathlib import Path


def shipped_configs() -> Path:
    """Return the folder of the shipped configs: the package's, or the repository's."""
    package = Path(__file__).resolve().parents[1]
    shipped = package / "shipped_configs"
    return shipped if shipped.is_dir() else package.parent / "configs"
