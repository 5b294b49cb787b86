"""Serialization of two ROS 2 messages, Twist and TwistStamped, in little-endian CDR (XCDR1).

A value of n bytes is aligned to a multiple of n, counted from the end of the 4-byte encapsulation header.
"""

import struct

from skyherd.live.drivers.link import Motion

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
"""Encapsulation: plain CDR, little-endian, no options. *Defined* by the DDS wire format."""


def twist(motion: Motion) -> bytes:
    """Return a motion as `geometry_msgs/msg/Twist`: linear and angular velocity, three numbers each."""
    return LITTLE_ENDIAN + _velocities(motion)


def twist_stamped(motion: Motion, stamp_ns: int, frame_id: str) -> bytes:
    """Return a motion as `geometry_msgs/msg/TwistStamped`: a header, and then a twist.

    Args:
        motion: the velocity.
        stamp_ns: time since 1970, ns.
        frame_id: coordinate frame of the velocity.
    """
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    name = frame_id.encode() + b"\0"
    header = struct.pack("<iII", seconds, nanoseconds, len(name)) + name
    return LITTLE_ENDIAN + header + b"\0" * (-len(header) % 8) + _velocities(motion)


def _velocities(motion: Motion) -> bytes:
    linear = (motion.forward_mps, motion.left_mps, motion.up_mps)
    return struct.pack("<6d", *linear, 0.0, 0.0, motion.turn_radps)
