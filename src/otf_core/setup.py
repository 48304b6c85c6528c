# SPDX-License-Identifier: Apache-2.0
"""What pyproject.toml cannot say to every setuptools and to colcon.

The licence: no form of it suits both setuptools 68 and 80. The oldest Python: colcon reads back
what setuptools makes of pyproject.toml, and cannot read that. The files by which ROS finds the
package: they have no place in an environment of pip, so that wheels go without them.
"""

import sys

from setuptools import setup

FOUND_BY_ROS = [
    ('share/ament_index/resource_index/packages', ['resource/otf_core']),
    ('share/otf_core', ['package.xml']),
]

setup(
    license='Apache-2.0',
    python_requires='>=3.10',
    data_files=[] if 'bdist_wheel' in sys.argv else FOUND_BY_ROS,
)
