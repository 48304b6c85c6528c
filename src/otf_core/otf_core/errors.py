# SPDX-License-Identifier: Apache-2.0
"""Errors of the package: one root, one subclass per exit code of the command line."""


class OtfError(Exception):
    """Root of all errors raised on purpose; its message says what, where and what to do."""

    exit_code = 1


class ConfigError(OtfError):
    """A machine description, parameter, option or file name is wrong (exit code 2)."""

    exit_code = 2


class InputError(OtfError):
    """Recorded data cannot be used (exit code 3)."""

    exit_code = 3


class ShapeError(OtfError, ValueError):
    """An array has another shape than the function needs; the message names both."""


class Cancelled(OtfError):
    """The caller asked a running calibration to stop."""
