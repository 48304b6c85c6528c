# SPDX-License-Identifier: Apache-2.0
"""What goes wrong with an emulated tracker, and how often."""

from __future__ import annotations

from dataclasses import dataclass
from difflib import get_close_matches

from otf_core.config import Parameters, parameter
from otf_core.errors import ConfigError


@dataclass(frozen=True)
class Faults(Parameters):
    """Chances are per packet of samples, three of which are sent per second."""

    beam_loss: float = parameter(0.0, 'chance that the beam is lost', '', 0, 1)
    beam_out: float = parameter(0.5, 'how long nothing can be found after that', 's', 0, 600)
    split: float = parameter(0.0, 'chance that a packet is sent in pieces', '', 0, 1)
    merge: float = parameter(0.0, 'chance that packets are sent together', '', 0, 1)
    close_after: float = parameter(
        0.0,
        'the server announces that it closes, and closes, this long after each connection; '
        '0: never',
        's', 0, 1e6,
    )  # fmt: skip
    cut_after: float = parameter(0.0, 'the same without notice; 0: never', 's', 0, 1e6)
    busy: float = parameter(0.0, 'chance that a command is answered with busy', '', 0, 0.9)
    speed_warning: float = parameter(0.0, 'chance of samples with a speed warning', '', 0, 1)
    speed_exceeded: float = parameter(0.0, 'chance of samples of a target too fast', '', 0, 1)
    unknown: float = parameter(
        0.0, 'chance of an unknown sample status, event, error and packet type', '', 0, 1
    )
    clock_jump: float = parameter(0.0, 'chance that the clock jumps ahead by 2 s', '', 0, 1)
    silent: float = parameter(0.0, 'chance that no more packets come, without notice', '', 0, 1)
    foreign: float = parameter(0.0, 'chance that another program sets millimetres', '', 0, 1)
    jitter: float = parameter(1e-3, 'mean delay of packets', 's', 0, 0.1)
    late: float = parameter(0.01, 'chance that a packet is late by up to 60 ms', '', 0, 1)
    initialize: float = parameter(0.5, 'how long the tracker takes to initialise', 's', 0, 100)


def read_faults(spec: str) -> Faults:
    """Read a list such as ``beam_loss=0.01,split,close_after=20``; without a value it is 1.

    Raises
    ------
    ConfigError
        If a fault is unknown, or its value out of range.
    """
    known = [info.name for info in Faults.infos()]
    values: dict[str, float] = {}
    for entry in filter(None, (part.strip() for part in spec.split(','))):
        name, given, text = entry.partition('=')
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f'did you mean {near[0]}? ' if near else ''
            raise ConfigError(f'--faults: {name!r} is unknown; {hint}possible: {", ".join(known)}')
        try:
            values[name] = float(text) if given else 1.0
        except ValueError:
            raise ConfigError(f'--faults: {name}: {text!r} is not a number') from None
    try:
        return Faults(**values)
    except ConfigError as error:
        raise ConfigError(f'--faults: {error}') from None
