# SPDX-License-Identifier: Apache-2.0
"""Words of headings: which coordinate, and whether measured, nominal or no position at all.

English, German, French, Italian, Spanish and Chinese, as exports of tracker and coordinate
measuring software, controllers and ROS have them.
"""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

AXES = ('x', 'y', 'z')
MEASURED = (
    'meas', 'measured', 'measure', 'measurement', 'act', 'actual', 'actuals', 'real', 'observed',
    'ist', 'istwert', 'istposition', 'istkoordinate', 'gemessen', 'messwert', 'messung', 'mess',
    'messpunkt', 'mesure', 'mesures', 'mesuree', 'mesurees', 'reel', 'reelle', 'mes',
    'misurato', 'misurata', 'misurati', 'misura', 'effettivo', 'effettiva', 'reale', 'mis',
    'medido', 'medida', 'medidos', 'medidas', 'medicion', 'med',
    '实测', '实测值', '测量', '测量值', '实际', '实际值', '测点', '實測', '測量', '實際',
)  # fmt: skip
NOMINAL = (
    'nom', 'nominal', 'nominals', 'nominell', 'nominale', 'nominaux', 'nenn', 'nennwert',
    'cmd', 'command', 'commanded', 'commands', 'commande', 'consigne', 'comando', 'comandato',
    'comandado', 'consigna', 'soll', 'sollwert', 'sollposition', 'sollkoordinate', 'vorgabe',
    'set', 'setpoint', 'demand', 'demanded', 'ref', 'reference', 'referenz', 'riferimento',
    'referencia', 'theo', 'theoretical', 'theorique', 'theoretisch', 'teorico', 'teorica', 'theor',
    'ideal', 'programmed', 'prog', 'programmiert', 'planned', 'plan', 'desired', 'des', 'goal',
    'expected', 'design', 'cad', 'master', 'impostato',
    '理论', '理论值', '名义', '名义值', '标称', '标称值', '指令', '指令值', '设定', '设定值',
    '目标值', '理論', '名義', '標稱',
)  # fmt: skip
NO_POSITION = (
    'rot', 'rotation', 'rotations', 'quat', 'quaternion', 'orientation', 'orient',
    'drehung', 'euler',
    'rotazione', 'rotacion', 'giro', 'winkel', 'angle', 'angular', 'turn', 'rpy',
    'cov', 'covariance', 'std', 'stdev', 'sigma', 'rms', 'unc', 'uncertainty', 'unsicherheit',
    'incertitude', 'incertezza', 'incertidumbre', 'dif', 'diff', 'difference', 'differenz', 'dev',
    'deviation', 'abw', 'abweichung', 'ecart', 'scarto', 'deviazione', 'desviacion', 'delta',
    'err', 'error', 'errors', 'fehler', 'erreur', 'errore', 'residual', 'res', 'corr',
    'correction',
    'vel', 'velocity', 'speed', 'geschwindigkeit', 'vitesse', 'velocita', 'velocidad', 'twist',
    'linear', 'acc', 'accel', 'acceleration', 'beschleunigung', 'accelerazione', 'aceleracion',
    'force', 'kraft', 'torque', 'gyro', 'mag', 'normal', 'normale', 'vector', 'tol', 'tolerance',
    'toleranz', 'offset', 'temp', 'temperature', 'weight', 'scale', 'current', 'load',
    '旋转', '角度', '速度', '加速度', '偏差', '误差', '公差', '不确定度', '法向',
)  # fmt: skip
POSITION = (
    'pos', 'position', 'positions', 'posizione', 'posicion', 'lage', 'point', 'points', 'punkt',
    'coord', 'coordinate', 'coordinates', 'koordinate', 'koordinaten', 'coordonnee', 'coordinata',
    'coordenada', 'translation', 'trans', 'location', 'pose', 'p', 't', 'field', 'cartesian',
    'kartesisch', 'xyz', 'axis', 'achse', 'axe', '位置', '坐标', '坐标值', '座標',
)  # fmt: skip
"""Words that add nothing to a coordinate."""
LETTERS = {'r': 'no', 'q': 'no', 'v': 'no', 'a': 'no', 'd': 'no', 'u': 'no', 's': 'no', 'w': 'no',
           'f': 'no', 'n': 'no', 'o': 'no', 'm': 'no', 'p': 'is', 't': 'is'}  # fmt: skip
"""Of rx, qx, vx, dx, ux, ... and of px, tx, xt."""
STEMS = ('abweichung', 'geschwindigkeit', 'unsicherheit', 'deviation', 'velocit', 'orientation')
"""Of compounds that are no position."""
CAMEL = re.compile(r'(?<=[a-zà-ÿ])(?=[A-Z])|(?<=[XYZ])(?=[A-Z][a-z])|(?<=[A-Za-z])(?=[XYZ]\b)')
WORD = re.compile(r'[a-zß]+|\d+|[\u4e00-\u9fff]+')
GLUED = frozenset((*MEASURED, *NOMINAL, *NO_POSITION, *POSITION))


@dataclass(frozen=True)
class Coordinate:
    """What a heading says of a coordinate.

    Attributes
    ----------
    axis : str
        'x', 'y' or 'z'.
    words : tuple of str
        The others of the heading; the same for the three of a point.
    role : str
        'measured', 'nominal', 'none' (no position) or '' (not stated).
    """

    axis: str
    words: tuple[str, ...]
    role: str


def words_of(heading: str) -> list[str]:
    """Words of a heading: lower case, without accents; parts of CamelCase apart."""
    apart = CAMEL.sub(' ', heading)
    plain = unicodedata.normalize('NFKD', apart.lower())
    return WORD.findall(''.join(c for c in plain if not unicodedata.combining(c)))


def coordinate_of(heading: str) -> Coordinate | None:
    """What a heading, without its unit, says of a coordinate; None if it names none."""
    words = words_of(heading)
    axis, others = '', list[str]()
    for word in reversed(words):  # the last letter is the axis: 'axis x of y'
        found, rest = ('', [word]) if axis else _axis_of(word)
        axis = axis or found
        others = rest + others
    if not axis:
        return None
    return Coordinate(axis, tuple(others), _role(others))


def _axis_of(word: str) -> tuple[str, list[str]]:
    """Axis in a word, and what else it says: 'tx', 'xist', 'posx'."""
    if word in AXES:
        return word, []
    for axis, rest in ((word[:1], word[1:]), (word[-1:], word[:-1])):
        if axis in AXES and (rest in GLUED or rest in LETTERS):
            if rest in GLUED:
                return axis, [rest]
            if LETTERS[rest] == 'no' and axis == word[-1:]:
                return axis, ['rotation' if rest in 'rqw' else 'deviation']
    return '', [word]


def _role(words: list[str]) -> str:
    if any(w in NO_POSITION or w.startswith(STEMS) or w.endswith(STEMS) for w in words):
        return 'none'
    if words[:1] in (['u'], ['d'], ['s']):
        return 'none'
    if any(w in NOMINAL for w in words):
        return 'nominal'
    return 'measured' if any(w in MEASURED for w in words) else ''


def without_fillers(words: tuple[str, ...]) -> tuple[str, ...]:
    """Words without those that add nothing."""
    return tuple(word for word in words if word not in POSITION)
