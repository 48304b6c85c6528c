# SPDX-License-Identifier: Apache-2.0
"""Registry of the sources of tracker samples: one line each. See docs/extend.md."""

from __future__ import annotations

from importlib import import_module

from otf_tracker_driver.backends.base import Backend, CommonConfig

_CLASSES = (
    'simulated.SimulatedTracker',
    'replay.Replay',
    'emscon.Emscon',
    'stream.Stream',
)
"""FILE.CLASS, by the files of this folder; FILE also names the backend and its parameters."""


def _loaded(entry: str) -> tuple[str, type[Backend]]:
    name, _, kind = entry.partition('.')
    return name, getattr(import_module(f'{__name__}.{name}'), kind)


BACKENDS: dict[str, type[Backend]] = dict(map(_loaded, _CLASSES))

__all__ = ['BACKENDS', 'Backend', 'CommonConfig']
