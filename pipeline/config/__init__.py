"""Typed config: the only door for settings.

`loading` reads a fleet's files, with the faults that only show between them, into `fleet`. A module
a file: `settings` (fleet file), `motors` (with `logs` and `channels`), `motor_types`
(with oils). `hashes` says what a change of settings makes anew; `nights` are a fleet's days.
"""

from pipeline.config.channels import Channel
from pipeline.config.fleet import Fleet, MotorSpec, absolute, overlap
from pipeline.config.loading import load_fleet
from pipeline.config.motors import MotorFile
from pipeline.config.section import ConfigError, Fault
from pipeline.config.settings import (
    Alarms,
    Cleaning,
    Execution,
    Nights,
    SensorHealth,
    Settings,
    Smoothing,
    TransportDelay,
    Windows,
)

__all__ = [
    "Alarms",
    "Channel",
    "Cleaning",
    "ConfigError",
    "Execution",
    "Fault",
    "Fleet",
    "MotorFile",
    "MotorSpec",
    "Nights",
    "SensorHealth",
    "Settings",
    "Smoothing",
    "TransportDelay",
    "Windows",
    "absolute",
    "load_fleet",
    "overlap",
]
