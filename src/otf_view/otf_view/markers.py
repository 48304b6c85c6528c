# SPDX-License-Identifier: Apache-2.0
"""Layers of a picture to the markers of RViz and Foxglove."""

from __future__ import annotations

from collections.abc import Iterable

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from otf_core.live.layers import LINES, POINTS, STRIP, TEXT, Layer
from otf_ros.convert import header

TYPES = {
    STRIP: Marker.LINE_STRIP,
    LINES: Marker.LINE_LIST,
    POINTS: Marker.SPHERE_LIST,
    TEXT: Marker.TEXT_VIEW_FACING,
}


def to_markers(layers: Iterable[Layer], stamp: Time) -> MarkerArray:
    """Return a whole picture: everything before it is deleted, each layer is a namespace.

    Parameters
    ----------
    stamp : builtin_interfaces.msg.Time
        Zero: drawn whatever tf knows of that time.
    """
    everything = Marker(header=header(stamp), action=Marker.DELETEALL)
    markers = [_marker(layer, stamp) for layer in layers if len(layer.points)]
    return MarkerArray(markers=[everything, *markers])


def _marker(layer: Layer, stamp: Time) -> Marker:
    red, green, blue, opacity = layer.colour
    marker = Marker(
        header=header(stamp),
        ns=layer.name,
        type=TYPES[layer.kind],
        action=Marker.ADD,
        color=ColorRGBA(r=red, g=green, b=blue, a=opacity),
        text=layer.text,
    )
    marker.pose.orientation.w = 1.0
    width = float(layer.width)
    if layer.kind == TEXT:
        marker.scale.z = width
        x, y, z = layer.points[0].tolist()
        marker.pose.position = Point(x=x, y=y, z=z)
        return marker
    marker.scale.x = width
    if layer.kind == POINTS:
        marker.scale.y = marker.scale.z = width
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in layer.points.tolist()]
    return marker
