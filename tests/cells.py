# SPDX-License-Identifier: Apache-2.0
"""A small machine that is measured quickly, and how much of its errors is left."""

import json

import numpy as np
import yaml

from otf_core.model.chain import Sight, displacement, exact_position
from otf_core.model.evaluation import evenly_spread, lattice, mean_length, without_rigid_motion
from otf_core.model.machine import SPINDLE, TABLE, load_machine
from otf_core.prediction.calibration_document import load_tables, tables_to_dict
from otf_core.sim.cell import random_tables
from otf_core.solving.tabulate import remove_rigid_motions

ERROR_SIZE = 5e-5
MACHINE = {
    'name': 'cell-300',
    'chain': 'w-b-X-Y-Z-t',
    'axes': {
        'X': {'min': 0.0, 'max': 0.3, 'table_pitch': 0.05},
        'Y': {'min': -0.1, 'max': 0.15, 'table_pitch': 0.05},
        'Z': {'min': -0.2, 'max': 0.0, 'table_pitch': 0.05},
    },
    'target_offset': [0.01, 0.0, -0.12],
    'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6},
}
SMALL = {
    axis: {'min': low, 'max': high, 'table_pitch': 0.05}
    for axis, low, high in (('X', 0.0, 0.15), ('Y', 0.0, 0.12), ('Z', -0.1, 0.0))
}
"""Axes of a machine that a run crosses in seconds."""
SHORT = {'passes': 1, 'levels': 2}
"""Parameters of the planner for a short path."""
FAST = {'simulated.rate': 100.0, 'time_scale': 40.0}
"""Parameters of the driver for a fast run: 4000 samples per second."""


def write_machine(folder, **changes):
    """Write a machine.yaml and return its path."""
    path = folder / 'machine.yaml'
    path.write_text(yaml.safe_dump({**MACHINE, **changes}))
    return path


def write_truth(folder, machine_file, seed=3):
    """Draw true errors and write them; return the path."""
    truth = random_tables(load_machine(machine_file), ERROR_SIZE, np.random.default_rng(seed))
    path = folder / f'truth-{seed}.json'
    path.write_text(json.dumps(tables_to_dict(truth)))
    return path


def share_left(found_file, truth_file):
    """Mean error on a grid with compensation, as a share of that without."""
    truth, found = load_tables(truth_file).tables, load_tables(found_file).tables
    if truth.machine.rotary_names:
        return _share_left_over_axes(found, truth)
    q = lattice(truth.machine)
    before = exact_position(truth, q) - q
    fields = (before - displacement(found, q), before)
    left, all_of_it = (mean_length(without_rigid_motion(field, q)) for field in fields)
    return left / all_of_it


def _share_left_over_axes(found, truth):
    """The same over the ranges of all axes, the target in the spindle."""
    machine = truth.machine
    q = evenly_spread(machine.lower, machine.upper, 400)
    sight = Sight(machine, TABLE, SPINDLE, np.array(machine.target_offset))
    before = exact_position(truth, q, sight) - sight.nominal(q)
    fields = (before - displacement(found, q), before)
    free = (remove_rigid_motions(machine, q, field.reshape(-1, 1)) for field in fields)
    left, all_of_it = (float(np.linalg.norm(field)) for field in free)
    return left / all_of_it
