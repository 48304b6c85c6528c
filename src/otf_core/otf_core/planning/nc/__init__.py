# SPDX-License-Identifier: Apache-2.0
"""NC programs of a plan: one file per dialect, one line here each. There is no generic one."""

from otf_core.planning.nc.dialect import Dialect
from otf_core.planning.nc.fanuc import Fanuc
from otf_core.planning.nc.heidenhain import Heidenhain
from otf_core.planning.nc.linuxcnc import LinuxCnc
from otf_core.planning.nc.sinumerik import Sinumerik
from otf_core.planning.nc.twincat import TwinCat

DIALECTS: dict[str, Dialect] = {
    d.name: d for d in (Sinumerik(), Fanuc(), Heidenhain(), LinuxCnc(), TwinCat())
}

__all__ = ['DIALECTS', 'Dialect']
