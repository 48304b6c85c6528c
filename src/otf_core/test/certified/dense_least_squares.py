# SPDX-License-Identifier: Apache-2.0
"""Tables, uncertainties and gap of the certified run by dense least squares, without otf_core.

``python3 -m certified.dense_least_squares`` writes expected.json from run.json and the CSV files.
"""

import json
from types import SimpleNamespace

import numpy as np
from certified.error_model import LIMIT, ErrorModel
from certified.exact_chain import MOTIONS, SQUARENESS
from certified.measured_rows import HERE, moved, pieces_of, read_run, rows_of, table_nodes
from certified.noise_matrix import noise_matrices

TOGETHER = np.array([3.0, 1.0, 3.0])
"""Standard deviation of the logarithms of the roughness of a motion about their median."""
PLACES = [[0.05, -0.05, -0.12], [0.13, 0.02, -0.03], [0.21, 0.11, -0.09], [0.18, 0.08, -0.075]]
"""m; where errors are predicted."""
SMOOTH, FRACTION = 20, 2
"""Parts of an axis range between the knots of cubic splines; nodes of their tables to a pitch."""


def least_squares(design, noise, prior):
    """Minimise (y - A x)' R^-1 (y - A x) + |L x|^2 for design A, noise R, prior L.

    Returns the gain G of the estimates x = G y, and their covariance (A' R^-1 A + L' L)^-1.
    """
    white = np.linalg.inv(np.linalg.cholesky(noise))
    q, r = np.linalg.qr(np.concatenate([white @ design, prior]))
    back = np.linalg.inv(r)
    return back @ q[: len(design)].T @ white, back @ back.T


def solve(run, model, noise, prior, name='samples.csv', start=None):
    """Solve until pose, points of the path and errors agree; the first step and the last.

    The noise is that at ``start``, the rigid pose if it is not given. A solution that starts from
    the pose of an earlier one knows the points of the path from the first step on: its first step
    is the last.
    """
    pieces, rigid = pieces_of(run, name)
    pose, machine = start or rigid, run['machine']
    rows = rows_of(machine, pieces, pose)
    parts = noise_matrices(rows, pieces, pieces.xyz, pose[0], machine['tracker'], noise)
    steps = []
    for _ in range(6):
        design = model.design(rows)
        gain, covariance = least_squares(design, parts[0] + parts[1], prior)
        value = gain @ rows.deviation
        steps.append(SimpleNamespace(
            pieces=pieces, parts=parts, pose=pose, rows=rows, design=design, gain=gain,
            covariance=covariance, value=value, residual=rows.deviation - design @ value,
        ))  # fmt: skip
        pose = moved(pose, value[:6])
        errors = np.append(np.zeros(6), value[6:])
        rows = rows_of(machine, pieces, pose, lambda q, x=errors: model.error_rows(q) @ x)
    return steps[-1 if start else 0], steps[-1]


def residual_check(found):
    """Rank, variance of the whitened residuals per degree of freedom, factor of correlation."""
    weights, leg, factor = found.parts[0] + found.parts[1], found.pieces.leg, 1.0
    information = found.design.T @ np.linalg.solve(weights, found.design)
    rank = int(np.sum(np.linalg.eigvalsh(information) * LIMIT**2 > 1.0))
    white = np.linalg.solve(np.linalg.cholesky(weights), found.residual).reshape(2, -1)
    for lag in range(1, len(leg) - 1):
        same = leg[lag:] == leg[:-lag]
        products = (white[:, lag:] * white[:, :-lag])[:, same]
        if same.sum() < 20 or products.mean() < 0.05 * np.mean(white**2):
            break
        factor += 2.0 * products.mean() / np.mean(white**2)
    return rank, np.sum(white**2) / (white.size - rank), factor


def roughness_information(first, model, roughness):
    """Information of the restricted likelihood of the logarithms of the roughness.

    tr(P K_i P K_j) / 2 with P = W - W A C A' W and the derivatives K_i of the prior covariance;
    the motions of a unit are drawn together.
    """
    weights = np.linalg.inv(first.parts[0] + first.parts[1])
    whitened, design = weights @ first.design, first.design
    inner = design.T @ (weights - whitened @ first.covariance @ whitened.T) @ design
    changes = model.prior_changes(roughness)
    information = np.diag(np.tile(TOGETHER**-2, len(model.motions)))
    for i, (a, one) in enumerate(changes):
        for j, (b, other) in enumerate(changes):
            information[i, j] += 0.5 * np.trace(inner[b, a] @ one @ inner[a, b] @ other)
    return information


def of_roughness(first, model, roughness):
    """Covariance of the estimates that the uncertainty of the roughness makes.

    Changes of the estimates (1 - G A) K_i A' W e for the derivatives K_i of the prior covariance.
    """
    pull = first.design.T @ np.linalg.solve(first.parts[0] + first.parts[1], first.residual)
    keep = np.eye(len(first.value)) - first.gain @ first.design
    changes = model.prior_changes(roughness)
    moves = np.stack([keep[:, a] @ (change @ pull[a]) for a, change in changes], axis=1)
    return moves @ np.linalg.solve(roughness_information(first, model, roughness), moves.T)


def sources(run, model, first, found, noise, roughness):
    """Covariance of the estimates, (free, free), source by source, and how the residuals fit."""
    prior, own = model.prior(roughness), found.covariance
    smooth = own @ prior.T @ prior @ own
    pieces, rotation, tracker = found.pieces, found.pose[0], run['machine']['tracker']
    last = noise_matrices(found.rows, pieces, pieces.xyz, rotation, tracker, noise)
    within, misfit, between, shared = (
        found.gain @ part @ found.gain.T for part in (*found.parts[:2], *last[2:])
    )
    rank, ratio, factor = residual_check(found)
    inflation = max(1.0, ratio * factor)
    fit = {'rank': rank, 'variance_ratio': ratio, 'correlation_factor': factor}
    return {
        'noise': within + between,
        'misfit': misfit + shared + (inflation - 1.0) * (own - smooth),
        'smoothness': smooth + of_roughness(first, model, roughness),
    }, {**fit, 'inflation': inflation}


def missed(motion, coefficients, nodes, values):
    """Mean square of a motion less its table, at 16 places an interval and the last node."""
    inner = nodes[:-1, None] + np.diff(nodes)[:, None] * np.arange(16) / 16
    q = np.append(inner, nodes[-1])
    return np.mean((motion.at(q) @ coefficients - np.interp(q, nodes, values)) ** 2)


def spread_of(rows, covariance):
    """Standard uncertainties of combinations ``rows`` (..., k) of values."""
    return np.sqrt(np.einsum('...i,ij,...j->...', rows, covariance, rows))


def lengths(values):
    """Lengths (p,) of the deviations (r,) of all pieces, m."""
    return np.hypot(*values.reshape(2, -1))


def tables_of(model, found, nodes):
    """Rows of squareness and nodes from the free values, variance of straight lines, tables."""
    rows, extra, motions, start = [np.eye(len(found.value))[6:9]], [np.zeros(3)], {}, 9
    full = model.gauge @ found.value
    for motion, table in zip(model.motions, model.tables(nodes), strict=True):
        at, values, stop = nodes[motion.axis], table @ found.value, start + len(motion.gauge)
        straight = 1.5 * missed(motion, full[start:stop], at, values)
        extra.append(straight * (np.abs(table).max(axis=1) > 1e-12))
        rows.append(table)
        motions[motion.name] = {'position': at, 'value': values}
        start = stop
    return np.concatenate(rows), np.concatenate(extra), motions


def calibration(run, noise, roughness, knots, degree, nodes, start=None):
    """What a calibration says: tables with given nodes, made of splines over given knots."""
    model = ErrorModel(run, knots, degree)
    first, found = solve(run, model, noise, model.prior(roughness), start=start)
    parts, fit = sources(run, model, first, found, noise, roughness)
    rows, straight, motions = tables_of(model, found, nodes)
    whole = sum(parts.values())
    u = np.hypot(spread_of(rows, whole), np.sqrt(straight))
    ends = 3 + np.cumsum([len(m['value']) for m in motions.values()])
    for motion, own in zip(motions.values(), np.split(u[3:], ends[:-1] - 3), strict=True):
        motion['u'] = own
    before, after = lengths(first.rows.deviation), lengths(found.residual)
    said = {
        'squareness': {
            s: {'value': found.value[6 + k], 'u': u[k]} for k, s in enumerate(SQUARENESS)
        },
        'motions': motions,
        'u_by_source': {
            **{name: spread_of(rows, part) for name, part in parts.items()},
            'straight lines': np.sqrt(straight),
        },
        'alignment': {'rotation': found.pose[0], 'translation': found.pose[1]},
        'fit': {
            **fit,
            'used': found.pieces.count.sum(),
            'pieces': len(found.pieces.count),
            'path_mae_before': before.mean(),
            'path_mae_after': after.mean(),
            'residual_rms': np.sqrt(np.mean(after**2)),
        },
    }
    if degree == 1:
        places = model.error_rows(np.array(PLACES))
        said['predicted'] = {'error': places @ found.value, 'u': spread_of(places, whole)}
    return said


def left_by_tables(run, roughness, name, noise=None, start=None):
    """Last step of a solution, and what tables and poses leave of its rows: (r, r).

    They are fitted with the noise specified, whatever that of the solution, and with no roughness.
    """
    model, specified = ErrorModel(run, table_nodes(run), 1), run['given']['specified']
    found = solve(run, model, noise or specified, model.prior(roughness), name, start)[1]
    pieces, tracker = found.pieces, run['machine']['tracker']
    found.parts = noise_matrices(found.rows, pieces, pieces.xyz, found.pose[0], tracker, specified)
    weights = found.parts[0] + found.parts[1]
    gain, _ = least_squares(found.design, weights, model.tie_breaker())
    return found, np.eye(len(found.design)) - found.design @ gain


def residual_um(run, roughness, name, noise=None, start=None):
    """Residual of the pieces of a run, root mean square in um."""
    found, left = left_by_tables(run, roughness, name, noise, start)
    return 1e6 * np.sqrt(np.mean(lengths(left @ found.rows.deviation) ** 2))


def gap(run, roughness):
    """Gap between the run and its simulation."""
    measured, simulated = (residual_um(run, roughness, n) for n in ('samples.csv', 'twin.csv'))
    size = np.sqrt(max(0.0, measured**2 - simulated**2))
    return {'measured_um': measured, 'simulated_um': simulated, 'before_um': size}


def simulated_square(run, roughness):
    """Squared residual that simulations leave, um^2: expectation and standard deviation."""
    found, left = left_by_tables(run, roughness, 'twin.csv')
    covariance = 1e12 * left @ (found.parts[0] + found.parts[2]) @ left.T
    count = len(found.pieces.leg)
    return np.trace(covariance) / count, np.sqrt(2.0 * np.sum(covariance**2)) / count


def given_roughness(run):
    """Roughness of every motion: variance (m^2 or rad^2) and length of its waves, kinks."""
    given = run['given']['roughness']
    return {m: given['translations' if m[1] in 'XYZ' else 'rotations'] for m in MOTIONS}


def expected(run):
    """The certified values."""
    nodes, finer = table_nodes(run), table_nodes(run, FRACTION)
    roughness, noise = given_roughness(run), run['given']['noise']
    fine = [np.linspace(n[0], n[-1], SMOOTH + 1) for n in nodes]
    return {
        'made_by': 'dense_least_squares.py from run.json, samples.csv and twin.csv',
        'straight': calibration(run, noise, roughness, nodes, 1, nodes),
        'smooth': calibration(run, noise, roughness, fine, 3, finer),
        'gap': gap(run, roughness),
    }


def plain(data):
    """Numbers of numpy as plain ones."""
    if isinstance(data, dict):
        return {key: plain(value) for key, value in data.items()}
    return data.tolist() if isinstance(data, np.ndarray | np.generic) else data


if __name__ == '__main__':
    text = json.dumps(plain(expected(read_run())), indent=1)
    (HERE / 'expected.json').write_text(text + '\n', encoding='utf-8')
