# SPDX-License-Identifier: Apache-2.0
"""Sources of tracker samples. A new one is a file here and a line in names.py."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from otf_tracker_driver.backends.base import Backend
from otf_tracker_driver.backends.names import BACKENDS

if TYPE_CHECKING:
    from otf_core.config import SimulationConfig
    from otf_tracker_driver.params import DriverConfig

__all__ = ['BACKENDS', 'Backend', 'create_backend']


def create_backend(config: DriverConfig, simulation: SimulationConfig) -> Backend:
    """Return the backend that the parameters name, not yet connected."""
    module, _, name = BACKENDS[config.backend].partition(':')
    backend: Backend = getattr(import_module(module), name)(config, simulation)
    return backend
