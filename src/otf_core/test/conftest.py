# SPDX-License-Identifier: Apache-2.0
"""Cells and recordings that several test files share; made once."""

import os
from pathlib import Path
from types import SimpleNamespace

# many small products: threads of the linear algebra only fight for busy cores (15 times slower)
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import numpy as np
import pytest
import yaml
from core_cells import record, small_plan, some_machine

from otf_core.calibration.calibrate import calibrate
from otf_core.sim.cell import random_tables


@pytest.fixture(scope='session')
def cell():
    """Small cell: machine, plan, recording at 100 Hz and a truth machine of 20 um."""
    machine = some_machine()
    plan = small_plan(machine)
    truth = random_tables(machine, 2e-5, np.random.default_rng(3))
    return SimpleNamespace(
        machine=machine, plan=plan, path=plan.path, recording=record(machine, plan), truth=truth
    )


@pytest.fixture(scope='session')
def calibrated(cell):
    """Calibration of the small cell with white noise as specified."""
    return calibrate(cell.recording.measured(cell.truth), cell.path, cell.machine)


@pytest.fixture
def bag(tmp_path):
    """Folder of a bag with the content of ``bag_cells``."""
    from bag_cells import CONTENT

    from otf_core.bags.bag import write_bag

    write_bag(tmp_path / 'bag', CONTENT)
    return tmp_path / 'bag'


@pytest.fixture
def place(tmp_path, monkeypatch):
    """An empty working folder with a machine.yaml."""
    monkeypatch.chdir(tmp_path)
    Path('machine.yaml').write_text(yaml.safe_dump(some_machine(pitch=0.1).to_dict()))
    return tmp_path
