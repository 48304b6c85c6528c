# SPDX-License-Identifier: Apache-2.0
"""How well the errors will be known: noise of this run at its pieces, and what is systematic."""

from __future__ import annotations

import numpy as np

from otf_core.checking.checked import Check, Checked, warnings
from otf_core.checking.seen import Seen
from otf_core.planning.forecast import Setup, forecast_of_pieces
from otf_core.planning.planned_budget import planned_systematic, solution_of_pieces
from otf_core.threads import one_thread


def _ask(seen: Seen) -> Checked:
    run = seen.run
    if run is None or run.pieces.standstill or seen.nodes is None:
        return Checked()
    setup = Setup.of(run.machine, run.pose.translation, run.noise)
    with one_thread():
        found = forecast_of_pieces(
            run.pieces, run.pose, dict(seen.nodes), run.path.points, setup, run.pieces.end
        )
        expected = planned_systematic(solution_of_pieces(run, found), found).expected
    unseen = found.not_identifiable
    facts = {
        'mean_grid_u_um': 1e6 * found.mean_grid_u,
        **expected.to_dict(),
        'not_identifiable': list(unseen),
        'mean_u': {
            name: float(np.sqrt(np.mean(u**2)))
            for name, u in found.u.items()
            if name not in unseen
        },
    }
    words = f'{expected.expanded_words}\n{expected.forecast_words}'
    if unseen:
        words += f'\nnot seen by this path: {", ".join(map(str, unseen))}'
    loose = ', '.join(map(str, found.loose_nodes))
    said = f'parts of {loose} will be interpolated only: no line passes there' if loose else ''
    return Checked(words, {'forecast': facts}, warnings(said))


FORECAST = Check('forecast', _ask)
