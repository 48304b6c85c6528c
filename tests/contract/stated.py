# SPDX-License-Identifier: Apache-2.0
"""A small machine, and tables of errors that are stated by hand."""

AXES = {'X': (0.0, 0.15, 0.3), 'Y': (0.0, 0.1, 0.2), 'Z': (-0.2, -0.1, 0.0)}
MACHINE = {
    'name': 'cell-300',
    'chain': 'w-b-X-Y-Z-t',
    'axes': {
        axis: {'min': at[0], 'max': at[-1], 'table_pitch': round(at[1] - at[0], 9)}
        for axis, at in AXES.items()
    },
    'target_offset': [0.0, 0.0, -0.15],
    'tracker': {'u_range': 0.5e-6, 'u_angle': 2.0e-6},
}


def tables(**errors):
    """Content of error_tables.json: errors by name, three values a motion; all others are zero."""
    motions = {}
    for axis, at in AXES.items():
        for letter in 'XYZABC':
            name = f'E{letter}{axis}'
            motions[name] = {
                'axis': axis,
                'unit': 'm' if letter in 'XYZ' else 'rad',
                'position': at,
                'value': errors.get(name, (0.0, 0.0, 0.0)),
                'u': [1e-7] * 3,
                'identifiable': True,
            }
    square = {n: {'value': errors.get(n, 0.0), 'u': 1e-6} for n in ('C0Y', 'B0Z', 'A0Z')}
    fit = dict.fromkeys(('samples', 'used', 'unknowns', 'rank'), 1)
    fit |= dict.fromkeys(('path_mae_before', 'path_mae_after', 'residual_rms'), 0.0)
    pose = {'rotation': [[1, 0, 0], [0, 1, 0], [0, 0, 1]], 'translation': [0, 0, 0]}
    return {
        'schema': 'otf-error-tables/1',
        'machine': MACHINE,
        'motions': motions,
        'squareness': square,
        'alignment': pose,
        'fit': fit,
    }
