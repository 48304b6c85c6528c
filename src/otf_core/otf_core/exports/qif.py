# SPDX-License-Identifier: Apache-2.0
"""QIF 3.0 (ISO 23952): full parametric specification of a Cartesian machine (FPSTestType).

Source: QIFMeasurementResources.xsd, types CartesianCMMType and FPSTestType. Functions are what a
high-accuracy method measures minus what the machine reports; squareness is the tangent, positive
where the angle between the positive axes is above 90 degrees. Which rotation is roll, pitch and
yaw of an axis, and their sign, the schema leaves to the reader: roll is about the axis itself,
yaw about Z (of Z about Y), pitch about the third, all right-handed; a comment in the file says so.
"""

from __future__ import annotations

import re
import uuid
from xml.sax.saxutils import escape

import numpy as np

from otf_core.exports.format import (
    TABLE_WORDS,
    ExportedFiles,
    Format,
    Request,
    lever_words,
    printable,
    rounded_tables,
)
from otf_core.model.frames import XYZ
from otf_core.model.kinematics import displacement
from otf_core.model.motions import SQUARENESS, ErrorMotion
from otf_core.model.tables import ErrorTables

NAMESPACE = 'http://qifstandards.org/xsd/qif3'
ROTATIONS = {'X': 'ABC', 'Y': 'BAC', 'Z': 'CAB'}
"""Directions of roll, pitch, yaw of each axis."""
SQUARES = (
    ('XYSquareness', 'C0Y', 1.0),
    ('XZSquareness', 'B0Z', -1.0),
    ('YZSquareness', 'A0Z', 1.0),
)
ROOT = uuid.UUID('8f9d0c2e-6f0b-5f3e-9d55-2f6f7c0c7a11')
"""Name space of the identifiers of documents; the same tables give the same identifier."""


class Qif(Format):
    """QIF 3.0 document with one machine and its 21 errors."""

    name = 'qif'
    value_words = TABLE_WORDS
    lacks = (
        'the kinematic chain and the point that rotations act about (stated in a comment); '
        'uncertainties; differences between the directions of travel'
    )

    def sign_words(self, request: Request) -> str:
        """State what the values are."""
        return (
            'functions are measured minus reported (actual minus nominal), mm and rad; squareness '
            'as tangent, positive where the angle is above 90 degrees'
        )

    def export(self, request: Request) -> ExportedFiles:
        """Make the document."""
        self.check(request)
        tables = rounded_tables(request.content.tables)
        text = '\n'.join(_document(tables, [*request.header(self), *_convention(tables)])) + '\n'
        return ExportedFiles(
            {request.name: text.encode()},
            lambda q: displacement(tables, q),
            (
                'roll, pitch and yaw are defined in a comment of the file; the reader must use '
                'the same definition',
                *request.unseen_words,
            ),
        )


def _convention(tables: ErrorTables) -> list[str]:
    return [
        'roll, pitch, yaw are right-handed rotations: X axis about X, Y, Z; Y axis about Y, X, Z; '
        'Z axis about Z, X, Y',
        lever_words(tables.machine),
    ]


def _function(name: str, position: np.ndarray, value: np.ndarray, unit: str) -> list[str]:
    scale, digits = (1e3, 6) if unit == 'mm' else (1.0, 9)
    domain = ' '.join(f'{1e3 * p + 0.0:.6f}' for p in position)
    values = ' '.join(f'{scale * v + 0.0:.{digits}f}' for v in value)
    kind = 'Linear' if unit == 'mm' else 'Angular'
    return [
        f'<{name} n="{len(position)}">',
        f'<DomainValues>{domain}</DomainValues>',
        f'<RangeValues>{values}</RangeValues>',
        f'<DomainLinearUnit>mm</DomainLinearUnit><Range{kind}Unit>{unit}</Range{kind}Unit>',
        f'</{name}>',
    ]


def _functions(tables: ErrorTables) -> list[str]:
    """The 18 functions in the order of the schema, then the squareness."""
    axes = tables.machine.axis_names
    named: list[tuple[str, ErrorMotion]] = [
        (f'{axis}Linearity', ErrorMotion(axis, axis)) for axis in axes
    ]
    for axis in axes:
        words = zip(('Roll', 'Pitch', 'Yaw'), ROTATIONS[axis], strict=True)
        named += [(f'{axis}Axis{word}', ErrorMotion(d, axis)) for word, d in words]
    for axis in axes:
        named += [(f'{axis}AxisStraightness{d}', ErrorMotion(d, axis)) for d in XYZ if d != axis]
    lines: list[str] = []
    for name, motion in named:
        table = tables.motions[motion]
        unit = 'mm' if motion.is_translation else 'rad'
        lines += _function(name, table.position, table.value, unit)
    for name, symbol, sign in SQUARES:
        value = sign * tables.squareness[symbol].value + 0.0
        lines.append(f'<{name}>{value:.9f}</{name}>')
    return lines


def _document(tables: ErrorTables, comments: list[str]) -> list[str]:
    body = _functions(tables)
    square = [repr(tables.squareness[k].value) for k in SQUARENESS]
    identifier = uuid.uuid5(ROOT, '\n'.join([*comments, *body, *square]))
    name = escape(printable(tables.machine.name))
    return [
        '<?xml version="1.0" encoding="UTF-8"?>',
        *(f'<!-- {re.sub("-(?=-)", "- ", line)} -->' for line in comments),
        f'<QIFDocument xmlns="{NAMESPACE}" versionQIF="3.0.0" idMax="1">',
        f'<QPId>{identifier}</QPId>',
        '<FileUnits><PrimaryUnits>',
        '<AngularUnit><SIUnitName>radian</SIUnitName><UnitName>rad</UnitName></AngularUnit>',
        '<LinearUnit><SIUnitName>meter</SIUnitName><UnitName>mm</UnitName>'
        '<UnitConversion><Factor>0.001</Factor></UnitConversion></LinearUnit>',
        '</PrimaryUnits></FileUnits>',
        '<MeasurementResources><MeasurementDevices n="1"><CartesianCMM id="1">',
        f'<Name>{name}</Name>',
        '<Accuracies n="1"><CartesianCMMAccuracy><EnvironmentalRange/>',
        '<CartesianCMMFPSTest>', *body, '</CartesianCMMFPSTest>',
        '<AccuracySource><OtherAccuracySource>otf calibration with a laser tracker'
        '</OtherAccuracySource></AccuracySource>',
        '</CartesianCMMAccuracy></Accuracies>',
        '</CartesianCMM></MeasurementDevices></MeasurementResources>',
        '</QIFDocument>',
    ]  # fmt: skip


FORMAT = Qif()
