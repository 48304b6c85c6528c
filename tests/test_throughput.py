# SPDX-License-Identifier: Apache-2.0
"""No sample is lost, at the rate of a fast tracker and beyond it."""

import pytest
from cells import SHORT


@pytest.mark.parametrize(('rate', 'time_scale'), [(1000.0, 1.0), (1000.0, 6.0)])
def test_no_sample_is_lost(graph, machine_file, rate, time_scale):
    fast = {'feed': 2.0, 'corner_dwell': 0.0, 'end_dwell': 1.5}
    graph.start('path_planner', machine_file=machine_file, **SHORT, **fast)
    out = graph.folder / 'out'
    given = {'machine_file': machine_file, 'output_directory': out, 'save_bag': False}
    graph.start('calibrator', **given, finish_at_standstill=False)
    driver = {'rate': rate, 'time_scale': time_scale, 'max_rate': 10000.0, 'acceleration': 20.0}
    graph.start('tracker_driver', machine_file=machine_file, **driver)
    result, state = graph.wait_for_result()
    status = graph.wait_for_status('FINISHED')
    assert result.samples_lost == 0
    assert state.samples == status.samples_published == status.samples_expected
