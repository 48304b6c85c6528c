# SPDX-License-Identifier: Apache-2.0
"""ROS parameters from the parameter dataclasses of the core: declared, checked, read.

A dataclass field is the only place where a parameter's default, unit, bounds and meaning stand.
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from otf_core.config import ParameterInfo, Parameters
from otf_core.errors import ConfigError
from otf_ros import frames

P = TypeVar('P', bound=Parameters)

_FOREIGN = ('use_sim_time', 'qos_overrides.', 'start_type_description_service')


def descriptor(info: ParameterInfo, read_only: bool = False) -> ParameterDescriptor:
    """Return what ``ros2 param describe`` shows of one parameter."""
    unit = f' [{info.unit}]' if info.unit else ''
    choices = f'one of: {", ".join(info.choices)}' if info.choices else ''
    result = ParameterDescriptor(
        name=info.name,
        description=info.meaning + unit,
        additional_constraints=choices,
        read_only=read_only,
    )
    bounded = info.low is not None or info.high is not None
    if bounded and isinstance(info.default, float):
        low = -sys.float_info.max if info.low is None else float(info.low)
        high = sys.float_info.max if info.high is None else float(info.high)
        result.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif bounded and isinstance(info.default, int):
        low_int = -(2**63) if info.low is None else int(info.low)
        high_int = 2**63 - 1 if info.high is None else int(info.high)
        result.integer_range = [IntegerRange(from_value=low_int, to_value=high_int, step=1)]
    return result


def _infos(name: str, group: type[Parameters]) -> Iterator[ParameterInfo]:
    """Yield what is known of every parameter of a group, by the names they have in the node."""
    for info in group.infos():
        yield replace(info, name=f'{name}.{info.name}') if name else info


class NodeParameters:
    """The parameters of one node.

    Parameters
    ----------
    *groups : subclasses of otf_core.config.Parameters
        Names must differ between the groups. Those of the frames, which every node has, come by
        themselves.
    named : mapping of str to subclasses of otf_core.config.Parameters, optional
        Groups whose parameters are declared as NAME.parameter.
    read_only : iterable of str
        Parameters for which a change while running would have no effect.

    Raises
    ------
    ConfigError
        If a value given at start has the wrong type or is out of range.
    """

    def __init__(
        self,
        node: Node,
        *groups: type[Parameters],
        named: Mapping[str, type[Parameters]] | None = None,
        read_only: Iterable[str] = (),
    ) -> None:
        self._node = node
        groups = (*groups, frames.FramesConfig)
        self._groups = [*(('', group) for group in groups), *(named or {}).items()]
        self._checks: dict[type[Parameters], Callable[[Any, Collection[str]], None]] = {}
        self._infos = {i.name: i for group in self._groups for i in _infos(*group)}
        for info in self._infos.values():
            self._declare(info, info.name in (*read_only, 'machine_frame', 'tracker_frame'))
        for name, group in self._groups:
            self.read(group, name)
        frames.use(self.read(frames.FramesConfig))
        self._warn_of_unknown()
        self._when: Callable[[Collection[str]], str] = lambda names: ''
        self._set_atomically = node.set_parameters_atomically
        node.set_parameters_atomically = self._set_and_tell  # type: ignore[method-assign]
        node.add_pre_set_parameters_callback(self._as_declared_type)
        node.add_on_set_parameters_callback(self._check)

    def read(self, group: type[P], name: str = '', changed: dict[str, Any] | None = None) -> P:
        """Return the present values of one group, checked as a whole.

        Parameters
        ----------
        group : subclass of otf_core.config.Parameters
        name : str
            Name of the group, if it has one.
        changed : dict, optional
            Values that shall replace present ones, by the names they have in the node.
        """
        start = f'{name}.' if name else ''
        values = {i.name: self._node.get_parameter(start + i.name).value for i in group.infos()}
        values |= {k: changed[start + k] for k in values if start + k in (changed or {})}
        try:
            return group(**values)
        except ConfigError as error:
            raise ConfigError(f'{start}{error}') from None

    def check_also(self, group: type[P], check: Callable[[P, Collection[str]], None]) -> None:
        """Refuse changes that a check does not let pass, besides bounds and types.

        Parameters
        ----------
        group : subclass of otf_core.config.Parameters
        check : callable
            Takes the values as they would be, and the names of those that shall change;
            ConfigError if they cannot.
        """
        self._checks[group] = check

    def tell_when(self, when: Callable[[Collection[str]], str]) -> None:
        """Tell whoever sets parameters when that takes effect, if not at once.

        ``ros2 param set`` prints the reason of a success as well; rclpy leaves it out.

        Parameters
        ----------
        when : callable
            Takes the names that were set; returns in words when they count, or nothing.
        """
        self._when = when

    def _set_and_tell(self, parameters: list[Parameter]) -> SetParametersResult:
        result = self._set_atomically(parameters)
        names = [parameter.name for parameter in parameters]
        if result.successful and (when := self._when(names)):
            result.reason = when
            self._node.get_logger().info(f'{", ".join(names)}: {when}')
        return result

    def _declare(self, info: ParameterInfo, read_only: bool) -> None:
        # first without a type: `feed:=1` shall be accepted for 1.0, and a wrong type is refused
        # with the message of the core
        free = ParameterDescriptor(dynamic_typing=True)
        try:
            value = info.check(self._node.declare_parameter(info.name, info.default, free).value)
        except ConfigError as error:
            raise ConfigError(f'{self._node.get_name()}: parameter {error}') from None
        self._node.undeclare_parameter(info.name)
        described = descriptor(info, read_only)
        self._node.declare_parameter(info.name, value, described, ignore_override=True)

    def _warn_of_unknown(self) -> None:
        given = getattr(self._node, '_parameter_overrides', {})  # rclpy keeps them to itself
        for name in sorted(set(given) - set(self._infos)):
            if not name.startswith(_FOREIGN):
                same = [known for known in self._infos if known.endswith(f'.{name}')]
                close = same or difflib.get_close_matches(name, self._infos, 1)
                hint = f"; did you mean '{close[0]}'?" if close else ''
                self._node.get_logger().warning(f"parameter '{name}' is unknown here{hint}")

    def _as_declared_type(self, parameters: list[Parameter]) -> list[Parameter]:
        return [
            Parameter(p.name, Parameter.Type.DOUBLE, float(p.value))
            if p.type_ == Parameter.Type.INTEGER
            and p.name in self._infos
            and isinstance(self._infos[p.name].default, float)
            else p
            for p in parameters
        ]

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        changed = {p.name: p.value for p in parameters}
        try:
            for name, group in self._groups:
                if concerned := changed.keys() & {i.name for i in _infos(name, group)}:
                    values = self.read(group, name, changed)
                    if check := self._checks.get(group):
                        check(values, concerned)
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)
