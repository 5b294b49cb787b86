"""rosbag2 recording of a run, in an MCAP file, with the message types of ROS 2 Jazzy.

Topics, J being the number of a unit and I the id of a robot:

```text
/unit_J/detections        vision_msgs/Detection2DArray     markers of an image, px
/unit_J/image/compressed  sensor_msgs/CompressedImage      the image, if it is recorded
/unit_J/controlled        std_msgs/Int64MultiArray         robots that the unit controls
/unit_J/cmd_vel           geometry_msgs/TwistStamped       flight command, in the camera's axes
/unit_J/robot_I/goal      geometry_msgs/PointStamped       desired point in the robot's axes, m
/robot_I/cmd_vel          geometry_msgs/TwistStamped       wheel command
/robot_I/state            std_msgs/String                  driving, or the reason to stand still
/tf                       tf2_msgs/TFMessage               true poses, of a simulated run
```

The stamp of a message is the time of the image, and its time in the bag is that of the decision. Axes of the
frame `unit_J` are those of a camera in ROS: x right, y down, z forward (REP 103).
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from skyherd.files.atomic import part_folder
from skyherd.jobs.progress import Progress
from skyherd.messages import FlightCommand
from skyherd.plugins import import_extra
from skyherd.recording.export.recorded_run import Commanded, Moment, RecordedRun, Seen, Truth
from skyherd.recording.ros_messages import RosMessages
from skyherd.render import rotation_camera_world

BAG, METADATA = "bag.mcap", "metadata.yaml"
"""Names of the files of a bag."""

VERSION: Literal[9] = 9
"""Version of the metadata. Defined by ROS 2 Jazzy."""

WORLD = "map"
"""Frame of the true poses. Defined by REP 105."""


def require_rosbags() -> None:
    """Check that `rosbags` is installed.

    Raises:
        InputError: it is not.
    """
    import_extra("rosbags.rosbag2", "rosbags", "kind: rosbag2", "ros")


def write_rosbag(run: RecordedRun, folder: Path, progress: Progress) -> dict[str, int]:
    """Write the bag of a run, and return the number of messages of each type.

    Args:
        run: the run.
        folder: an existing folder, which is the bag's.
        progress: receives the time in the run.

    Raises:
        InputError: `rosbags` is not installed.
        OutputError: a file cannot be written.
    """
    require_rosbags()
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    counts: dict[str, int] = {}
    with part_folder(folder) as part:
        bag = part / Path(BAG).stem
        writer = Writer(bag, version=VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        writer.set_custom_data("run", run.name.encode("utf-8", "backslashreplace").decode())
        with writer:
            messages = _Messages(run)
            connections: dict[str, Any] = {}
            for moment in run.moments():
                progress.update(run.name, moment.time_s, run.end_s, f"{moment.time_s:.0f}/{run.end_s:.0f} s")
                logged_ns = messages.nanoseconds(
                    moment.decided_s if isinstance(moment, Seen) else moment.time_s
                )
                for topic, kind, message in messages.of(moment):
                    if topic not in connections:
                        connections[topic] = writer.add_connection(topic, kind, typestore=messages.store)
                    data = messages.store.serialize_cdr(message, kind)
                    writer.write(connections[topic], logged_ns, data)
                    counts[kind] = counts.get(kind, 0) + 1
        os.replace(bag / BAG, folder / BAG)
        os.replace(bag / METADATA, folder / METADATA)
    return counts


Message = tuple[str, str, Any]
"""Topic, type and content of a message."""


class _Messages(RosMessages):
    """Maker of the messages of a run."""

    def __init__(self, run: RecordedRun) -> None:
        super().__init__("kind: rosbag2")
        self._run = run
        self._states: dict[int, str] = {}

    def nanoseconds(self, time_s: float) -> int:
        """Return a time since the start of the run as ns since 1970."""
        return max(0, round(self._run.start_unix_s * 1e9) + round(time_s * 1e9))

    def _header_at(self, time_s: float, frame: str) -> Any:
        return self.header(self.nanoseconds(time_s), frame)

    def of(self, moment: Moment) -> Iterator[Message]:
        """Yield the messages of a record."""
        if isinstance(moment, Seen):
            yield from self._of_image(moment)
        elif isinstance(moment, Commanded):
            yield from self._of_command(moment)
        else:
            yield self._of_truth(moment)

    def _of_image(self, seen: Seen) -> Iterator[Message]:
        unit = f"unit_{seen.detections.unit_id}"
        header = self._header_at(seen.time_s, unit)
        yield (
            f"/{unit}/detections",
            "vision_msgs/msg/Detection2DArray",
            self.detections(header, seen.detections),
        )
        if seen.jpeg is not None:
            picture = self.make("sensor_msgs/CompressedImage")(
                header=header, format="mono8; jpeg compressed", data=np.frombuffer(seen.jpeg, np.uint8)
            )
            yield f"/{unit}/image/compressed", "sensor_msgs/msg/CompressedImage", picture
        if seen.report is not None:
            layout = self.make("std_msgs/MultiArrayLayout")(dim=[], data_offset=0)
            ids = self.make("std_msgs/Int64MultiArray")(layout=layout, data=seen.report.controlled_ids)
            yield f"/{unit}/controlled", "std_msgs/msg/Int64MultiArray", ids
        if seen.goals is not None:
            goals = seen.goals
            distances_m = goals.rho_px / goals.sides_px * self._run.side_m
            points_m = distances_m[:, None] * np.stack(
                [np.cos(goals.bearings_rad), np.sin(goals.bearings_rad)], axis=1
            )
            for robot, (x_m, y_m) in zip(goals.ids.tolist(), points_m.tolist(), strict=True):
                point = self.make("geometry_msgs/Point")(x=x_m, y=y_m, z=0.0)
                goal = self.make("geometry_msgs/PointStamped")(
                    header=self._header_at(seen.time_s, f"robot_{robot}"), point=point
                )
                yield f"/{unit}/robot_{robot}/goal", "geometry_msgs/msg/PointStamped", goal
        if seen.flight is not None:
            yield f"/{unit}/cmd_vel", "geometry_msgs/msg/TwistStamped", self._flight(header, seen.flight)

    def _flight(self, header: Any, flight: FlightCommand) -> Any:
        """Return a flight command in the camera's axes, of which z points down."""
        u_mps, v_mps = flight.lateral_mps.tolist()
        return self.twist(header, (u_mps, v_mps, -flight.climb_mps), -flight.yaw_rate_radps)

    def _of_command(self, command: Commanded) -> Iterator[Message]:
        rows = zip(
            command.ids.tolist(),
            command.v_mps.tolist(),
            command.omega_radps.tolist(),
            command.states,
            strict=True,
        )
        for robot, v_mps, omega_radps, state in rows:
            header = self._header_at(command.time_s, f"robot_{robot}")
            twist = self.twist(header, (v_mps, 0.0, 0.0), omega_radps)
            yield f"/robot_{robot}/cmd_vel", "geometry_msgs/msg/TwistStamped", twist
            if self._states.get(robot) != state:
                self._states[robot] = state
                yield (
                    f"/robot_{robot}/state",
                    "std_msgs/msg/String",
                    self.make("std_msgs/String")(data=state),
                )

    def _of_truth(self, truth: Truth) -> Message:
        header = self._header_at(truth.time_s, WORLD)
        transforms = [
            self.transform(header, f"robot_{robot}", (x_m, y_m, 0.0), Rotation.from_euler("z", heading_rad))
            for robot, (x_m, y_m), heading_rad in zip(
                truth.ids.tolist(), truth.positions_m.tolist(), truth.headings_rad.tolist(), strict=True
            )
        ]
        for unit in range(truth.fleet.heights_m.size):
            pose = truth.fleet.pose(unit)
            attitude = Rotation.from_matrix(rotation_camera_world(pose).T)
            place_m = (*pose.position_m, pose.height_m)
            transforms.append(self.transform(header, f"unit_{unit}", place_m, attitude))
        return "/tf", "tf2_msgs/msg/TFMessage", self.make("tf2_msgs/TFMessage")(transforms=transforms)
