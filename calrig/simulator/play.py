"""Backlash as what it is: a gap in which the motor turns and nothing follows."""

from __future__ import annotations

import math
from collections.abc import Sequence

from calrig.simulator.trajectory import Segment


def through_play(motor: Sequence[Segment], follower_deg: float, gap_deg: float) -> list[Segment]:
    """How a follower moves that the motor pushes by one flank or the other of a gap.

    Args:
        motor: the motor's motion from rest or on its way, each segment without a change of direction, the
            last one at rest.
        follower_deg: where the follower is when the first segment starts, within gap_deg/2 of the motor.
        gap_deg: the whole width of the gap.

    Returns:
        The follower's motion over the same time; it stands wherever no flank touches.
    """
    half = 0.5 * gap_deg
    follower: list[Segment] = []
    for index, segment in enumerate(motor):
        end_s = motor[index + 1].start_s if index + 1 < len(motor) else math.inf
        follower += _pushed(segment, end_s, follower_deg, half)
        if math.isfinite(end_s):
            follower_deg = follower[-1].at(end_s)[0]
    return follower


def _pushed(segment: Segment, end_s: float, follower_deg: float, half_deg: float) -> list[Segment]:
    standing = Segment(segment.start_s, follower_deg)
    push = segment.velocity_dps or segment.acceleration_dps2
    if push == 0:
        return [standing]
    sense = math.copysign(1.0, push)
    to_contact_deg = sense * (follower_deg - segment.position_deg) + half_deg
    way_deg = sense * (segment.at(end_s)[0] - segment.position_deg)
    if to_contact_deg >= way_deg:
        return [standing]
    if to_contact_deg <= 0:
        return [segment._replace(position_deg=segment.position_deg - sense * half_deg)]
    speed, gain = sense * segment.velocity_dps, sense * segment.acceleration_dps2
    # The smaller root of speed·t + gain·t²/2 = way, in the form that survives gain = 0 and speed = 0.
    contact_s = 2 * to_contact_deg / (speed + math.sqrt(max(speed**2 + 2 * gain * to_contact_deg, 0.0)))
    at_contact = segment.start_s + contact_s
    if at_contact >= end_s:
        return [standing]
    velocity = segment.velocity_dps + segment.acceleration_dps2 * contact_s
    return [standing, Segment(at_contact, follower_deg, velocity, segment.acceleration_dps2)]
