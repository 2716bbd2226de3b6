"""What a front can ask for, and how far it came: the words of messages."""

from __future__ import annotations

from enum import Enum

__all__ = ["TAKE_OFF_FIRST", "UNTIL_OVER", "Action", "LeaseAction", "Stage"]

TAKE_OFF_FIRST, UNTIL_OVER = 1, 2
"""Bits of the number with which a mission is started: take off before it; the question is accepted
when the mission has begun, and done when it is over."""


class Action(Enum):
    """What the agent can be asked to do."""

    ACTIVATE = "activate"
    OBTAIN = "obtain"  # control authority
    RELEASE = "release"
    TAKE_OFF = "take_off"
    LAND = "land"
    GO_HOME = "go_home"
    PATTERN = "pattern"  # the simple task of that number
    HALT = "halt"  # no motion, no guided flight; a task goes on
    STOP = "stop"  # no motion, and no task
    GIMBAL_ANGLES = "gimbal_angles"
    GIMBAL_RATES = "gimbal_rates"
    TAKE_PHOTO = "take_photo"
    START_VIDEO = "start_video"
    STOP_VIDEO = "stop_video"
    ARM = "arm"
    DISARM = "disarm"
    MISSION_PLAN = "mission_plan"  # a new plan, of which the points follow
    MISSION_POINT = "mission_point"
    MISSION_START = "mission_start"
    HOTPOINT_START = "hotpoint_start"
    HOTPOINT_RADIUS = "hotpoint_radius"
    HOTPOINT_RATE = "hotpoint_rate"
    HOTPOINT_HEADING = "hotpoint_heading"  # back to where it is to point
    MISSION_STOP = "mission_stop"  # of whatever kind, like the next two
    MISSION_PAUSE = "mission_pause"
    MISSION_RESUME = "mission_resume"
    MISSION_SPEED = "mission_speed"
    VERSION = "version"
    SEND_TO_MOBILE = "send_to_mobile"
    REPLAY = "replay"  # an order to a recording; the data says which, in words


class LeaseAction(Enum):
    """What a front may want of the lease."""

    ACQUIRE = "acquire"
    RENEW = "renew"
    RELEASE = "release"
    TAKE_OVER = "take_over"  # first step: who would lose it?
    CONFIRM = "confirm"  # second step: take it from exactly that one


class Stage(Enum):
    """How far something that was asked for has come."""

    ACCEPTED = "accepted"  # the aircraft has begun; another outcome follows
    DONE = "done"
    FAILED = "failed"
