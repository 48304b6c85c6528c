# SPDX-License-Identifier: Apache-2.0
"""Errors of the package: one root, one subclass per exit code of the command line."""


class OtfError(Exception):
    """Root of all errors raised on purpose; its message says what, where and what to do.

    Examples
    --------
    >>> try:
    ...     otf_core.load_machine('missing.yaml')
    ... except otf_core.OtfError as error:
    ...     print(error)
    missing.yaml: cannot be read (No such file or directory)
    """

    exit_code = 1


class ConfigError(OtfError):
    """A machine description, parameter, option or file name is wrong (exit code 2).

    Examples
    --------
    >>> otf_core.calibrate(recording, method='by eye')
    Traceback (most recent call last):
    otf_core.errors.ConfigError: method: 'by eye' is unknown; possible: otf, standstill
    """

    exit_code = 2


class InputError(OtfError):
    """Recorded data cannot be used (exit code 3).

    Examples
    --------
    >>> otf_core.NominalPath([[0, 0, 0], [0, 0, float('nan')]])
    Traceback (most recent call last):
    otf_core.errors.InputError: path: point 1 is not finite
    """

    exit_code = 3


class ShapeError(OtfError, ValueError):
    """An array has another shape than the function needs; the message names both.

    Examples
    --------
    >>> otf_core.NominalPath([[0, 0], [1, 1]])
    Traceback (most recent call last):
    otf_core.errors.ShapeError: a path needs points of shape (n, 3), got (2, 2)
    """


class Cancelled(OtfError):
    """The caller asked a running calibration to stop (exit code 130)."""

    exit_code = 130
