# SPDX-License-Identifier: Apache-2.0
"""What setup.cfg cannot say to colcon as well as to pip.

The text of the README, which colcon does not put beside this file. The oldest Python: colcon reads
back what setuptools makes of setup.cfg, and cannot read that. The files by which ROS finds the
package: they have no place in an environment of pip, so that wheels go without them.
"""

import sys
from pathlib import Path

from setuptools import setup

FOUND_BY_ROS = [
    ('share/ament_index/resource_index/packages', ['resource/otf_core']),
    ('share/otf_core', ['package.xml']),
]

setup(
    long_description=(Path(__file__).resolve().parent / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    python_requires='>=3.10',
    data_files=[] if 'bdist_wheel' in sys.argv else FOUND_BY_ROS,
)
