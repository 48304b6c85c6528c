# SPDX-License-Identifier: Apache-2.0
"""Files of the package fit the nodes: parameters, quality of service."""

from pathlib import Path

import pytest
import yaml

from otf_bringup import params_file

CONFIG = Path(__file__).resolve().parents[1] / 'config'


def test_parameters_file_is_that_of_the_nodes():
    assert (CONFIG / 'params.yaml').read_text() == '\n'.join(params_file.lines()) + '\n', (
        'run python3 -m otf_bringup.params_file'
    )


@pytest.mark.parametrize(
    'name', ['record_qos.yaml', 'machine.yaml', 'five-axis.yaml', 'backlash.yaml']
)
def test_files_are_yaml(name):
    assert yaml.safe_load((CONFIG / name).read_text())
