# SPDX-License-Identifier: Apache-2.0
"""A result in an interactive session: short in words, whole as data frame and figure."""

import csv
import io
import re
import sys

import numpy as np
import pytest

from otf_core.errors import ConfigError
from otf_core.model.motions import MOTIONS
from otf_core.reports.calibration import write_calibration


def test_a_result_is_one_line_that_says_what_is_stated_first(calibrated):
    line = repr(calibrated)
    assert '\n' not in line and len(line) < 600
    head = calibrated.headline
    assert all(words in line for words in head.sentences[:2])
    assert 'measurement: good' in line and 'machine: no limits' in line


def test_a_notebook_shows_a_short_table_and_no_markup_from_names(calibrated):
    page = calibrated._repr_html_()
    assert len(page) < 2500 and 'µm' in page and ' um' not in page
    # the uncertainty of a squareness error is that of the headline: systematic contributions in it
    k, u = 2.0, np.sqrt(calibrated.covariance[0, 0])
    stated = re.search(r'C0Y</th><td>[\d. -]+ ± ([\d.]+) µrad', page)[1]
    assert float(stated) == pytest.approx(1e6 * k * u, rel=0.06)
    unseen = [m for m in MOTIONS if not calibrated.tables.motions[m].identifiable]
    assert unseen and ', '.join(unseen) in page


def test_a_data_frame_holds_what_the_csv_holds(calibrated, tmp_path):
    pandas = pytest.importorskip('pandas', reason='optional: to_frame needs pandas')
    frame = calibrated.to_frame()
    write_calibration(calibrated, tmp_path, report=False)
    text = (tmp_path / 'error_tables.csv').read_text(encoding='utf-8')
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(frame) == len(rows)
    assert list(frame.error) == [r['motion'] for r in rows]
    assert list(frame.axis) == [r['axis'] for r in rows]
    assert list(frame.unit) == [r['unit'] for r in rows]
    assert [str(v).lower() for v in frame.identifiable] == [r['identifiable'] for r in rows]
    for name in ('position', 'value', 'u', 'u_run', 'k'):
        stated = [float(r[name]) if r[name] else np.nan for r in rows]
        np.testing.assert_allclose(frame[name], stated, rtol=1e-12, atol=1e-15, err_msg=name)
    offset = tuple(calibrated.tables.machine.target_offset.tolist())
    stated = [tuple(map(float, r['target_offset'].split())) or None for r in rows]
    assert list(frame.target_offset) == stated and set(stated) == {None, offset}
    assert frame.attrs['target_offset'] == calibrated.tables.machine.target_offset.tolist()
    assert isinstance(frame, pandas.DataFrame)


def test_a_figure_has_a_panel_an_error_motion_in_mm_and_um(calibrated):
    pytest.importorskip('matplotlib', reason='optional: plot needs matplotlib').use('agg')
    drawn = calibrated.plot()
    panels = {panel.get_title(): panel for panel in drawn.axes}
    assert list(panels) == [str(m) for m in MOTIONS]
    table = calibrated.tables.motions['EXX']
    (line,) = panels['EXX'].get_lines()
    np.testing.assert_allclose(line.get_xdata(), 1e3 * table.position)
    np.testing.assert_allclose(line.get_ydata(), 1e6 * table.value)
    assert panels['EAX'].get_ylabel() == 'µrad' and panels['EXX'].get_ylabel() == 'µm'
    for motion in MOTIONS:
        seen = calibrated.tables.motions[motion].identifiable
        assert bool(panels[motion].get_lines()) == seen
    (band,) = panels['EXX'].collections
    wide = np.ptp(
        [v[1] for v in band.get_paths()[0].vertices if abs(v[0] - line.get_xdata()[-1]) < 1e-9]
    )
    place = 3 + len(table.position) - 1
    u = np.sqrt(calibrated.covariance[place, place])
    assert wide == pytest.approx(2 * 2.0 * 1e6 * u, rel=0.02)
    import matplotlib.pyplot as plt

    plt.close(drawn)


@pytest.mark.parametrize(('method', 'package'), [('to_frame', 'pandas'), ('plot', 'matplotlib')])
def test_what_needs_a_package_names_it(calibrated, monkeypatch, method, package):
    for name in [n for n in sys.modules if n.partition('.')[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=f'pip install {package}'):
        getattr(calibrated, method)()
