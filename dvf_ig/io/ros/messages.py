"""Convert values to ROS 2 messages: metres, quaternions, nanoseconds (REP 103); mm and seconds stay inside.

In a TransformStamped `header.frame_id` is the target and `child_frame_id` the source: it holds
target_from_source, which maps points of the child to the header's frame.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import MissingDependencyError, install_extra

TF, IMAGE, WRENCH = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/Image", "geometry_msgs/msg/WrenchStamped"
POSE, ARRAY = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Float64MultiArray"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
Message = Any
"""Message of rosbags' generated classes, which have no types."""


@cache
def typestore() -> Any:
    """Return definitions and encoders of ROS 2 Humble's messages.

    Raises:
        MissingDependencyError: the package rosbags is absent.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as exc:
        raise MissingDependencyError(
            f"session logs need the packages mcap and rosbags; {install_extra('log')}"
        ) from exc
    return get_typestore(Stores.ROS2_HUMBLE)


def nanoseconds(t_s: float) -> int:
    """Convert a stamp to ROS nanoseconds; not before 0, where its clock begins."""
    return max(round(t_s * 1e9), 0)


def transforms(t_s: float, placed: Sequence[tuple[str, str, FloatArray]]) -> Message:
    """Build a message of (target, source, (4, 4) or (3, 4) target_from_source in mm) at one time."""
    make = _types()
    stamped = []
    for target, source, matrix in placed:
        rotation = make("geometry_msgs/msg/Quaternion")(*_quaternion(matrix))
        moved = make("geometry_msgs/msg/Transform")(_vector(matrix[:3, 3] / 1000.0), rotation)
        stamped.append(make("geometry_msgs/msg/TransformStamped")(_header(t_s, target), source, moved))
    return make(TF)(stamped)


def pose(t_s: float, frame: str, place_mm: FloatArray) -> Message:
    """Build a pose at a point, without rotation."""
    make = _types()
    point = make("geometry_msgs/msg/Point")(*(place_mm / 1000.0).tolist())
    placed = make("geometry_msgs/msg/Pose")(point, make("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0))
    return make(POSE)(_header(t_s, frame), placed)


def wrench(t_s: float, frame: str, force_n: FloatArray) -> Message:
    """Build a force at the tool's tip, without torque."""
    make = _types()
    both = make("geometry_msgs/msg/Wrench")(_vector(force_n), _vector(np.zeros(3)))
    return make(WRENCH)(_header(t_s, frame), both)


def image(t_s: float, frame: str, grey: NDArray[np.uint8]) -> Message:
    """Build an image of (rows, columns) grey levels."""
    rows, columns = grey.shape
    return _types()(IMAGE)(
        _header(t_s, frame), rows, columns, "mono8", 0, columns, np.ascontiguousarray(grey).reshape(-1)
    )


def grey_levels(message: Message) -> NDArray[np.uint8]:
    """Return the (rows, columns) grey levels of an image.

    Raises:
        ValueError: its grey levels are not 8-bit.
    """
    if message.encoding != "mono8" or message.step != message.width:
        raise ValueError("an image is not of 8-bit grey levels")
    return np.asarray(message.data, dtype=np.uint8).reshape(message.height, message.width)


def array(values: FloatArray, labels: Sequence[str]) -> Message:
    """Build an array of numbers; the label of each axis describes its entries."""
    make = _types()
    strides = [int(np.prod(values.shape[axis:])) for axis in range(values.ndim)]
    dimensions = [
        make("std_msgs/msg/MultiArrayDimension")(label, size, stride)
        for label, size, stride in zip(labels, values.shape, strides, strict=True)
    ]
    layout = make("std_msgs/msg/MultiArrayLayout")(dimensions, 0)
    return make(ARRAY)(layout, np.ascontiguousarray(values, dtype=np.float64).reshape(-1))


def diagnostics(t_s: float, level: int, name: str, message: str, values: Mapping[str, str]) -> Message:
    """Build one status: level 0 OK, 1 warning, 2 error, 3 stale."""
    make = _types()
    pairs = [make("diagnostic_msgs/msg/KeyValue")(key, text) for key, text in values.items()]
    status = make("diagnostic_msgs/msg/DiagnosticStatus")(level, name, message, "dvf_ig", pairs)
    return make(DIAGNOSTICS)(_header(t_s, ""), [status])


def _types() -> Any:
    return typestore().types.__getitem__


def _header(t_s: float, frame: str) -> Message:
    make, stamp = _types(), nanoseconds(t_s)
    time = make("builtin_interfaces/msg/Time")(stamp // 10**9, stamp % 10**9)
    return make("std_msgs/msg/Header")(time, frame)


def _vector(xyz: FloatArray) -> Message:
    return _types()("geometry_msgs/msg/Vector3")(*xyz.tolist())


def _quaternion(matrix: FloatArray) -> list[float]:
    """Return x, y, z, w of a rotation."""
    xyzw: list[float] = Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist()
    return xyzw
