# SPDX-License-Identifier: Apache-2.0
"""A path beside that of the present run: the samples tell which of the two is driven."""

from __future__ import annotations

from dataclasses import dataclass, field

from otf_core.calibration.first_sight import first_legs
from otf_core.config import CalibrationConfig
from otf_core.model.path import NominalPath
from otf_core.tracking.path_watch import PathWatcher

SHARE = 0.05
"""Share of the path that is driven between two comparisons."""


@dataclass
class OtherPath:
    """A path that the target may turn out to follow.

    Parameters
    ----------
    newer : bool
        It was published after that of the run: it is the one of the next run.
    since : int
        Samples of the run that had come before it.
    message : bytes
        In which it came.
    """

    path: NominalPath
    config: CalibrationConfig
    newer: bool
    since: int = 0
    message: bytes = b''
    watcher: PathWatcher = field(init=False)
    _asked: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        """Begin to follow the target."""
        self.watcher = PathWatcher(self.path, self.config)

    def worth_asking(self, at_the_end: bool) -> bool:
        """Tell whether the samples should be compared with both paths; once per so much travel.

        Parameters
        ----------
        at_the_end : bool
            The run is about to be calibrated.
        """
        travelled = self.watcher.travelled
        more = travelled - self._asked
        if travelled < first_legs(self.path) or not more:
            return False
        return at_the_end or not self._asked or more > SHARE * self.path.length

    def asked(self) -> None:
        """Take note that they are compared."""
        self._asked = self.watcher.travelled
