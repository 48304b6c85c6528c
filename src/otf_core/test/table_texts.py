# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: E501
"""Tables of samples in the forms that people have, and what is done with each.

``KINDS`` is the grammar: docs/commands.md shows it as a table, and test_text_tables.py holds every
row of it with the texts that it names.
"""

import numpy as np

COUNT = 120
_RNG = np.random.default_rng(3)
_START = np.array([219.0, -206.0, 178.0])
XYZ = np.round(np.cumsum(_RNG.normal(0.0, 0.7, (COUNT, 3)), axis=0) + _START, 4)
"""mm; a target that moves like a machine, 2 m/s at most."""
NOMINAL = np.round(XYZ, 3) + 0.5
SECONDS = [f'{0.04 * k:.5f}' for k in range(COUNT)]
ROWS = [[SECONDS[k], *(f'{v:.4f}' for v in XYZ[k])] for k in range(COUNT)]
HEAD = ['time_s', 'x_mm', 'y_mm', 'z_mm']


def table(head, rows, separator=';'):
    """A text of a head, as it is, and rows of fields."""
    return ''.join(f'{line}\n' for line in [*([head] if head else []),
                                            *(separator.join(row) for row in rows)])  # fmt: skip


def changed(row, column, text):
    """The plain table with one field in other words."""
    rows = [list(fields) for fields in ROWS]
    rows[row][column] = text
    return table(';'.join(HEAD), rows)


def both(head):
    """Nominal and measured points under a head."""
    rows = [[SECONDS[k], *(f'{v:.3f}' for v in NOMINAL[k]), *ROWS[k][1:]] for k in range(COUNT)]
    return table(head, rows)


def commas(rows):
    """Decimal commas."""
    return [[field.replace('.', ',') for field in row] for row in rows]


def grouped(group, mark):
    """Coordinates in µm, thousands set off."""

    def one(value):
        text = f'{1e3 * value:,.1f}'
        return text.replace(',', '_').replace('.', mark).replace('_', group)

    return [
        [SECONDS[k].replace('.', mark), *map(one, XYZ[k].tolist())] for k in range(COUNT)
    ]  # fmt: skip


def polar(turn, zenith, unit):
    """Direction, vertical angle (per rad ``unit``) and distance of the points."""
    rows = []
    for k, (x, y, z) in enumerate(XYZ.tolist()):
        distance = float(np.linalg.norm([x, y, z]))
        direction, elevation = turn * np.arctan2(y, x), np.arcsin(z / distance)
        vertical = np.pi / 2 - elevation if zenith else elevation
        fields = [float(unit * direction), float(unit * vertical), distance]
        rows.append([SECONDS[k], *map(repr, fields)])
    return rows


def in_units(factor, digits):
    """Coordinates in another unit, of so many to the mm."""
    return [
        [SECONDS[k], *(f'{factor * v:.{digits}f}' for v in XYZ[k].tolist())] for k in range(COUNT)
    ]


def points(form):
    """Lines without a time; ``form`` takes the number and three texts."""
    return ''.join(f'{form(k, *ROWS[k][1:])}\n' for k in range(COUNT))


GON, DEG = 200 / np.pi, 180 / np.pi
AXES = '// SpatialAnalyzer SA 2024.1 ( x64 )\n// AXES = CARTESIAN: X,  Y,  Z (mm)\n'
RATE = {'rate': 25.0}
READ = {
    'commas': (table(','.join(HEAD), ROWS, ','), {}),
    'tabs': (table('\t'.join(HEAD), ROWS, '\t'), {}),
    'strokes': (table('| ' + ' | '.join(HEAD) + ' |', [['', *r, ''] for r in ROWS], ' | '), {}),
    'spaces, unit once': (table('# t x y z [mm]', ROWS, '  '), {}),
    'spaces, units apart': (table('t [s] X [mm] Y [mm] Z [mm]', ROWS, '  '), {}),
    'spaces': (table('# t x y z', ROWS, '  '), {}),
    'date and time between spaces': (
        table('date time x_mm y_mm z_mm',
              [['2026-03-14', f'09:30:{0.04 * k:08.5f}', *ROWS[k][1:]] for k in range(COUNT)], ' '),
        {},
    ),
    'time in another form': (
        table(';'.join(['time', *HEAD[1:]]),
              [[f'14.03.2026 09:30:{0.04 * k:08.5f}', *ROWS[k][1:]] for k in range(COUNT)]),
        {'time_format': '%d.%m.%Y %H:%M:%S.%f'},
    ),
    'quotes': (table('"time_s","x_mm","y_mm","z_mm"', [[f'"{f}"' for f in r] for r in ROWS], ','), {}),
    'quoted decimal commas': (
        table(','.join(HEAD), [[f'"{f}"' for f in r] for r in commas(ROWS)], ','), {}
    ),
    'decimal commas': (table('Zeit [s];X [mm];Y [mm];Z [mm]', commas(ROWS)), {}),
    'decimal commas between spaces': (table('Zeit X Y Z', commas(ROWS), ' '), {}),
    'comment among the data': (
        '# t x y z\n' + points(lambda k, *p: f'{SECONDS[k]} {" ".join(p)}' + '\n# pause' * (k == 9)), {}
    ),
    'separator at the end of lines': (table(';'.join(HEAD), [[*r, ''] for r in ROWS]), {}),
    'separator at the end of the head': (table(';'.join([*HEAD, '']), ROWS), {}),
    'empty rows of a spreadsheet': (table(';'.join(HEAD), ROWS) + ';;;\n;;;\n', {}),
    'units in a line of their own': (table('t;X;Y;Z\ns;mm;mm;mm', ROWS), {}),
    'English': (both('Time [s];Nom X [mm];Nom Y [mm];Nom Z [mm];Meas X [mm];Meas Y [mm];Meas Z [mm]'), {}),
    'English, in brackets': (both('t [s];X (cmd);Y (cmd);Z (cmd);X (act);Y (act);Z (act)'), {}),
    'English, one word': (both('time [s];xCmd;yCmd;zCmd;xAct;yAct;zAct'), {}),
    'German, measured': (both('Zeit [s];XSoll;YSoll;ZSoll;XIst;YIst;ZIst'), {}),
    'German, with units': (
        both('Zeit [s];' + ';'.join(f'{a}-{w}wert [mm]' for w in ('Soll', 'Ist') for a in 'XYZ')), {}
    ),
    'only the other one is said to be nominal': (both('time_s;x_ref;y_ref;z_ref;x;y;z'), {}),
    'velocity beside': (both('time_s;vx;vy;vz;x;y;z'), {}),
    'rotation beside': (both('time_s;Rot X;Rot Y;Rot Z;Pos X;Pos Y;Pos Z'), {}),
    'deviation beside': (both('time_s;dX;dY;dZ;X;Y;Z'), {}),
    'twist beside': (
        both('time_s;' + ';'.join(f'{w}.{a}' for w in ('twist.linear', 'pose.position') for a in 'xyz')), {}
    ),
    'TUM': (
        table('# timestamp tx ty tz qx qy qz qw',
              [[*r, '0', '0', '0', '1'] for r in in_units(1e-3, 7)], ' '), {}
    ),
    'x y z t': (table('x y z t', [[*r[1:], r[0]] for r in ROWS], ' '), {}),
    'number of points first': (f'{COUNT}\n' + points(lambda k, *p: ' '.join(p)), RATE),
    'SpatialAnalyzer, names': (AXES + points(lambda k, *p: f'p{k},  {",  ".join(p)}'), RATE),
    'SpatialAnalyzer, numbers': (AXES + points(lambda k, *p: f'{k + 1},  {",  ".join(p)}'), RATE),
    'SpatialAnalyzer, group, number': (AXES + points(lambda k, *p: f'A, F9, {k}, {", ".join(p)}'), RATE),
    'SpatialAnalyzer, spaces': (AXES + points(lambda k, *p: f'Run1 p{k} {" ".join(p)}'), RATE),
    'SpatialAnalyzer, stamps': (
        AXES + points(lambda k, *p: f'A, p{k}, {", ".join(p)}, 03/14/25 16:56:{0.04 * k:08.5f}'),
        {'time_format': '%m/%d/%y %H:%M:%S.%f'},
    ),
    'numbers first, on request': (
        points(lambda k, *p: f'{k + 1};{";".join(p)}'), {**RATE, 'columns': '-,x_mm,y_mm,z_mm'}
    ),
    'micrometres': (table('time [s];X [µm];Y [µm];Z [µm]', in_units(1e3, 1)), {}),
    'inches': (table('time_s,x_in,y_in,z_in', in_units(1 / 25.4, 9), ','), {}),
    'inches in brackets': (table('t [s],X [inch],Y [inch],Z [inch]', in_units(1 / 25.4, 9), ','), {}),
    'units after a word': (table('Zeit in s;X in mm;Y in mm;Z in mm', ROWS), {}),
    'Hz, V, D': (table('Zeit [s];Hz [gon];V [gon];D [mm]', polar(-1, True, GON)), {}),
    'azimuth, elevation, range': (table('time_s;az_rad;el_rad;range_mm', polar(1, False, 1.0)), {}),
    'angles in words': (
        table('t [s];Horizontal angle (deg);Vertical angle (deg);Slope distance (mm)',
              polar(-1, True, DEG)), {}
    ),
    'zenith': (table('t [s];Azimuth [deg];Zenith angle [deg];Range [mm]', polar(1, True, DEG)), {}),
}  # fmt: skip
"""Text and options; all hold the same points."""

LEFT_OUT = {
    '#DIV/0!': (7, changed(7, 1, '#DIV/0!'), "x_mm is '#DIV/0!' (line 9)"),
    '*** first': (0, changed(0, 0, '***'), "time_s is '***' (line 2)"),
    '#WERT!': (5, changed(5, 3, '#WERT!'), "z_mm is '#WERT!' (line 7)"),
    '---': (0, changed(0, 2, '---'), "y_mm is '---' (line 2)"),
    'empty': (0, changed(0, 1, ''), 'x_mm is empty (line 2)'),
    'n/a in the time': (3, changed(3, 0, 'n/a'), "time_s is 'n/a' (line 5)"),
    'a field too few': (4, changed(4, 3, '1').replace(';1\n', '\n'), '3 columns instead of 4 (line 6)'),
    'another separator': (
        4, table(';'.join(HEAD), ROWS).replace(';'.join(ROWS[4]), ','.join(ROWS[4])),
        'no line of 4 columns (line 6)',
    ),
    'commented out': (
        0, '# t x y z\n' + points(lambda k, *p: f'{"# " * (k == 0)}{SECONDS[k]} {" ".join(p)}'), ''
    ),
    'a word': (2, changed(2, 1, 'broken'), "x_mm is 'broken' (line 4)"),
}  # fmt: skip
"""Which row is lost, the text, and why; empty: by a comment."""

REFUSED = {
    'names twice': (both('time_s;X;Y;Z;X;Y;Z'), {}, ('columns 2, 3, 4', 'columns 5, 6, 7')),
    'names with numbers': (both('time_s;x1;y1;z1;x2;y2;z2'), {}, ('columns 2, 3, 4',)),
    'two sources': (
        both('time_s;robot.x;robot.y;robot.z;tracker.x;tracker.y;tracker.z'), {}, ('robot.x', 'tracker.x')
    ),
    'nominal only': (
        both('time_s;nom x;nom y;nom z;cmd x;cmd y;cmd z'), {}, ('nominal positions only',)
    ),
    'head too long': (table(';'.join([*HEAD, 'q']), ROWS), {}, ('names 5 columns, the lines have 4',)),
    'head too short': (
        table('x_mm y_mm z_mm', [[f'"{k}"', *r[1:]] for k, r in enumerate(ROWS)], ' '), RATE,
        ('names 3 columns, the lines have 4',),
    ),
    'decimal commas between commas': (
        table(','.join(HEAD), commas(ROWS), ','), {}, ('names 4 columns, the lines have 8',)
    ),
    'thousands between commas': (
        table('time_s,x_um,y_um,z_um', grouped(',', '.'), ','), {}, ('names 4 columns, the lines have 7',)
    ),
    'points and commas mixed': (changed(0, 1, '219,3'), {}, ("line 3: x_mm: '220.0312' and line 2: x_mm: '219,3'", 'are mixed')),
    'thousands, English': (
        table('time_s;x_um;y_um;z_um', grouped(',', '.')), {}, ("line 2: x_um: '220,428.6'", 'thousands')
    ),
    'thousands, German': (
        table('Zeit [s];X [µm];Y [µm];Z [µm]', grouped('.', ',')), {}, ("line 2: X [µm]: '220.428,6'",)
    ),
    'thousands, Swiss': (
        table('Zeit [s];X [µm];Y [µm];Z [µm]', grouped("'", '.')), {}, ('thousands separators',)
    ),
    'thousands, French': (
        table('t [s]\tX [µm]\tY [µm]\tZ [µm]', grouped('\u202f', ','), '\t'), {}, ('thousands separators',)
    ),
    'thousands or decimals': (
        't;x_mm;y_mm;z_mm\n0;999;1;2\n1;1,234;5;6\n2;1,300;5;6\n', {}, ('thousands separator or decimals',)
    ),
    'counts lines, no head': (
        points(lambda k, *p: f'{k + 1};{";".join(p)}'), {}, ('column 1 counts the lines', '--rate')
    ),
    'counts lines, called t': (
        points(lambda k, *p: ('t;x;y;z\n' if k == 0 else '') + f'{k + 1};{";".join(p)}'), {},
        ('t counts the lines (1, 2, 3)', '--columns -,x,y,z --rate 1000'),
    ),
    'spherical': (
        '// AXES = SPHERICAL: R, Theta, Phi (mm)\n' + points(lambda k, *p: f'p{k}, {", ".join(p)}'), RATE,
        ('spherical coordinates',),
    ),
    'angles without a unit': (
        table('t [s];Hz;V;D [mm]', polar(-1, True, GON)), {}, ('its unit is not stated', 'Hz [gon]')
    ),
    'angles in grad': (
        table('t [s];Hz [grad];V [grad];D [mm]', polar(-1, True, GON)), {}, ("'grad' is not a supported unit of angle",)
    ),
    'vertical angle of either kind': (
        table('t [s];Hz [deg];V [deg];D [mm]', [[*r[:2], '7' if k % 2 else '80', r[3]] for k, r in enumerate(polar(-1, True, DEG))]),
        {}, ('zenith angle or an elevation',),
    ),
    'half of the lines': (
        table(';'.join(HEAD), [[r[0], '#N/A' if k % 2 else r[1], *r[2:]] for k, r in enumerate(ROWS)]), {},
        ("60 of 120 lines are not samples: 60 lines: x_mm is '#N/A' (first line 3)",),
    ),
    'time of another form': (
        table(';'.join(['time', *HEAD[1:]]), [[f'14/03/2026 09:30:0{k % 9}', *r[1:]] for k, r in enumerate(ROWS)]),
        {}, ("line 2: time: '14/03/2026 09:30:00' is not", '--time-format "%d/%m/%Y %H:%M:%S"'),
    ),
    'unit of time not stated': (
        table('t;x_mm;y_mm;z_mm', [[f'{1.5 * k}', *r[1:]] for k, r in enumerate(ROWS)]), {},
        ("the unit of '0.0', in steps of 1.5,", '--columns time_s,x_mm,y_mm,z_mm or --columns time_ms,'),
    ),
    'six digits of a spreadsheet': (
        table('timestamp;x;y;z', [['1.70000E+18', *r[1:]] for r in ROWS]), {},
        ("all 120 times are '1.70000E+18'", '--columns -,x,y,z', '--rate'),
    ),
    'groups above the names': (
        both('Take;1\n;Nominal;;;Measured;;\ntime_s;X;Y;Z;X;Y;Z'), {}, ('columns 2, 3, 4',)
    ),
}  # fmt: skip
"""Text, options, and words of the message."""

KINDS = (
    ('separator', 'tab, `;`, `\\|`, `,` or white space: the one with which most lines of the whole '
     'file have the same number of columns',
     ('commas', 'tabs', 'strokes', 'spaces', 'date and time between spaces')),
    ('quotes; encoding', 'as in RFC 4180; UTF-8, UTF-16, Windows-1252', ('quotes',)),
    ('decimal comma', 'read, also in quotes; points and commas mixed in one table are refused',
     ('decimal commas', 'decimal commas between spaces', 'quoted decimal commas',
      'points and commas mixed', 'decimal commas between commas')),
    ('thousands separators', 'refused with the line, as are numbers that may have them',
     ('thousands, English', 'thousands, German', 'thousands, Swiss', 'thousands, French',
      'thousands between commas', 'thousands or decimals')),
    ('comments', '`#`, `//`, `%`, `!` before the data; within the data only with a sign that was '
     'used before, or on a line with another number of columns',
     ('comment among the data', 'commented out')),
    ('header', 'the last line of names before the data; it must have as many columns as the lines, '
     'otherwise both numbers are stated; a separator at the end of every line adds no column; a line '
     'below may state units; anything else below it is data',
     ('separator at the end of lines', 'separator at the end of the head',
      'units in a line of their own', 'groups above the names', 'head too long',
      'head too short')),
    ('`n/a`, `---`, `#N/A`, `#DIV/0!`, `***`, empty; a field too few or too many', 'the line is left out and counted; more than '
     '10 % of such lines are refused; in points, paths, lattices and readings a single one is refused',
     ('#DIV/0!', '*** first', '#WERT!', '---', 'empty', 'n/a in the time', 'a word',
      'half of the lines', 'empty rows of a spreadsheet', 'a field too few', 'another separator')),
    ('several points in a header', 'the measured one if words identify it, in English or German (for '
     'paths and points the nominal one); otherwise refused, with a `--columns` for each',
     ('English', 'English, in brackets', 'English, one word', 'German, measured',
      'German, with units', 'only the other one is said to be nominal', 'names twice',
      'names with numbers', 'two sources', 'nominal only')),
    ('velocity, rotation, deviation next to the position', 'ignored',
     ('velocity beside', 'rotation beside', 'deviation beside', 'twist beside')),
    ('a column that counts 1, 2, 3', 'not a time: `--rate` is required, unless the header states a '
     'unit of time', ('counts lines, no head', 'counts lines, called t', 'numbers first, on request')),
    ('times', 'see below; what can be read in two ways is refused with the option that settles it',
     ('time in another form', 'time of another form', 'unit of time not stated',
      'six digits of a spreadsheet')),
    ('units', 'm, dm, cm, mm, µm (um), inch, in brackets, after `_`, `in` or `/`, below the header. '
     'If samples state none, it is inferred: mm where coordinates exceed 60; points and paths are '
     'then in m',
     ('micrometres', 'inches', 'inches in brackets', 'units after a word',
      'spaces, unit once', 'spaces, units apart')),
    ('polar coordinates', 'Hz (clockwise from above) or azimuth (counter-clockwise); V, zenith angle '
     'or elevation; slope distance; deg, gon or rad have to be stated (`grad` is both and is '
     'refused); V near 90 degrees is a zenith angle, near 0 an elevation, otherwise it is refused',
     ('Hz, V, D', 'azimuth, elevation, range', 'angles in words', 'zenith',
      'angles without a unit', 'angles in grad', 'vertical angle of either kind')),
    ('SpatialAnalyzer', 'collection, group, name or number before x, y, z, stamps after them, unit from '
     'the line `AXES = CARTESIAN: ...`; cylindrical and spherical coordinates are refused',
     ('SpatialAnalyzer, names', 'SpatialAnalyzer, numbers', 'SpatialAnalyzer, group, number',
      'SpatialAnalyzer, spaces', 'SpatialAnalyzer, stamps', 'spherical')),
    ('TUM, `x y z t`, `ros2 topic echo --csv`, number of points first', 'read', ('TUM', 'x y z t', 'number of points first')),
)  # fmt: skip
"""Kind, what is done with it, and the texts above that show it."""
