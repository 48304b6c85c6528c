# SPDX-License-Identifier: Apache-2.0
"""Effects of a visible size for the tests, and states to evaluate them at."""

import numpy as np
from core_cells import small_plan, some_machine
from scipy.spatial.transform import Rotation

from otf_core.effects import REGISTRY, AppliedEffect, State
from otf_core.model.frames import RigidTransform
from otf_core.sim.cell import random_tables
from otf_core.sim.drive import drives_of
from otf_core.sim.effects import run_state

EXAMPLES = {
    'backlash': {'B_X': 5e-6, 'B_Y': -3e-6, 'B_Z': 2e-6},
    'direction_dependent_tables': {'EYX_1': 6e-6, 'EZY_0': 4e-6, 'EBX_0': 2e-5},
    'thermal_axis_expansion': {'tau': 60.0, 'S_X': 3e-5, 'S_Z': -2e-5},
    'thermal_structure_drift': {'tau': 60.0, 'until': 150.0, 'D_Z': 8e-6, 'D_X_2': 3e-6},
    'cross_coupling': {'Z_X2Y': 5e-6, 'X_XYZ': 4e-6},
    'servo_mismatch': {'T_X': 4e-5, 'T_Y': -2e-5},
    'corner_rounding': {'l': 0.02, 'A': 1e-5},
    'cyclic_error': {'period': 0.02, 'S_X': 2e-6, 'C_Y': 2e-6},
    'vibration': {'frequency': 7.3, 'S_Z': 2e-6, 'C_X': 1e-6},
    'table_resolution': {'EYX@0.05..0.1': 4e-6, 'EXY@0.1..0.15_2': 4e-6},
    'table_tilt': {'tilt_X_by_Y': 3e-5},
    'target_offset': {'dT_X': 0.01},
    'target_incidence': {'k': 5e-5, 'k_u': 1e-5},
    'tracker_pose_drift': {'tau': 60.0, 'W_X': 3e-5, 'M_Y': 6e-6},
    'tracker_scale': {'m': 5e-6},
    'tracker_range_offset': {'c': 1e-5},
    'tracker_angles': {'x8x': 1e-5, 'x11a': 1e-5, 'x1z': 3e-6},
    'tracker_noise': {'level_range': 2.0, 'dof': 4.0},
}
DISPLACING = [name for name in EXAMPLES if name != 'tracker_noise']


def shape_of(name):
    """Shape of the example of one effect, complete."""
    effect = REGISTRY[name]
    given = {k: v for k, v in EXAMPLES[name].items() if k in effect.shape_names}
    return effect.complete_shape(given)


def coefficients_of(name, terms):
    return np.array([EXAMPLES[name].get(k, 0.0) for k in terms.names])


def applied(name, **parameters):
    return AppliedEffect(REGISTRY[name], parameters or EXAMPLES[name])


def some_plan(machine, **parameters):
    """Forward and back at two feeds."""
    return small_plan(machine, **({'passes': 2, 'corner_dwell': 0.1, 'end_dwell': 1} | parameters))


def tracker_pose(seed=4):
    rotation = Rotation.random(random_state=np.random.default_rng(seed)).as_matrix()
    return RigidTransform(rotation, np.array([-0.2, 0.5, -0.25]))


def driven_state(machine=None, rate=20.0, pose=None) -> State:
    """Samples of a driven plan, standstills included."""
    machine = machine or some_machine('w-Y-b-X-Z-t')
    plan = some_plan(machine)
    drives = drives_of(machine, plan, 2.0)
    time = np.arange(int(drives[0].duration * rate)) / rate
    truth = random_tables(machine, 2e-5, np.random.default_rng(8))
    return state_of(truth, drives, time, time, pose or tracker_pose())


def state_of(truth, drives, time, clock, pose):
    """State of the samples of the only part of a run."""
    places = {name: np.array(own.place) for name, own in truth.machine.targets.items()}
    return run_state(drives, 0, time, clock, truth, places, pose, float(clock[-1]))
