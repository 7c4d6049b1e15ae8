"""A simulated fleet: six motors, their configs and logs, and the truth behind them."""

from pipeline.demo.writing import shipped_configs, write_demo

__all__ = ["shipped_configs", "write_demo"]
