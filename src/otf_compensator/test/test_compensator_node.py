# SPDX-License-Identifier: Apache-2.0
"""The compensator answers while it is active, and only then."""

import json
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import Point

from otf_compensator.node import Compensator
from otf_core.errors import ConfigError
from otf_core.model.machine import machine_from_dict
from otf_core.prediction.calibration_document import tables_to_dict
from otf_core.sim.cell import random_tables
from otf_msgs.srv import Compensate
from otf_ros.testing import SMALL_MACHINE, node_on_bench


@pytest.fixture
def tables_file(tmp_path) -> Path:
    file, rng = tmp_path / 'tables.json', np.random.default_rng(5)
    file.write_text(
        json.dumps(tables_to_dict(random_tables(machine_from_dict(SMALL_MACHINE), 5e-5, rng)))
    )
    return file


@pytest.mark.parametrize('auto_start', [True, False])
def test_compensator_answers_while_it_is_active(tables_file, auto_start):
    request = Compensate.Request(wanted=[Point(x=0.1, y=0.2, z=-0.1)])
    with node_on_bench(Compensator, tables_file=tables_file, auto_start=auto_start) as bench:
        answer = bench.call(Compensate, 'compensator/compensate', request)
        assert answer.success == auto_start
        if not auto_start:
            assert 'configure and activate it' in answer.message
            bench.node.trigger_configure()
            bench.node.trigger_activate()
            answer = bench.call(Compensate, 'compensator/compensate', request)
        (found,) = answer.compensations
        assert found.wanted.x == 0.1 and 0.0 < abs(found.corrected.x - 0.1) < 1e-3
        bench.node.trigger_deactivate()
        assert not bench.call(Compensate, 'compensator/compensate', request).success


def test_compensator_without_tables_says_what_is_missing():
    with pytest.raises(ConfigError, match='tables_file: missing'), node_on_bench(Compensator):
        pass
