# SPDX-License-Identifier: Apache-2.0
"""The recorded run of a machine with rotary axes, its truth; read once."""

from functools import cache
from pathlib import Path

from otf_core.inputs.recordings import read_recording
from otf_core.model.machine import load_machine
from otf_core.model.tables import load_tables

BAG = Path(__file__).parents[3] / 'bags' / 'trunnion'


@cache
def machine():
    return load_machine(BAG / 'machine.yaml')


@cache
def recorded():
    return read_recording([BAG / 'bag'], machine())


def truth():
    return load_tables(BAG / 'truth.json').tables
