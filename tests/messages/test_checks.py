"""Validation of constructor arguments as of scenario files: one line, with the library's own errors."""

import numpy as np
import pytest

from skyherd.control import (
    AvoidanceRule,
    BodyRule,
    Follow,
    GoalInboxes,
    Hover,
    HybridSelection,
    KeepInView,
    MarkerGains,
    Perimeter,
    PixelGains,
    RoleRule,
    SafetyRadius,
    SizeRule,
    Template,
    TreeSettings,
    Wheels,
)
from skyherd.datasets import shape_points
from skyherd.errors import SkyherdError
from skyherd.messages import Detections, MotionGoals, Proximity, UnitReport
from skyherd.vision import create_detector

NAN, INF = float("nan"), float("inf")
PAIR = [[0, 0], [1, 0]]
SHAPE = Template.from_ground_points([0, 1], PAIR)
WHEELS = Wheels(1.0, 1.0)
MARKER = {"k": 0.1, "k_omega": 0.4, "b_th": 0.01, "side_m": 0.3}
PIXEL = {"k_v": 0.1, "k_omega": 0.4, "b_th": 0.01}
AVOIDANCE = {"side_m": 0.3, "wheels": WHEELS, "nominal_age_s": 0.1, "superseded_age_s": 0.1, "step_s": 0.1}

CONSTRUCTORS = {
    MarkerGains: (MARKER, MARKER),
    PixelGains: (PIXEL, PIXEL),
    Wheels: ({"max_speed_mps": 1.0, "max_turn_radps": 1.0}, ("max_speed_mps", "max_turn_radps")),
    SafetyRadius: ({}, ("radius", "hysteresis", "dwell_s")),
    HybridSelection: ({}, ("stall_s", "progress", "floor_sides")),
    TreeSettings: ({}, ("radius", "hysteresis", "dwell_s", "gain", "firm", "silence_s", "patience_s")),
    Follow: ({}, ("desired_radius", "lateral_gain_mps", "climb_gain_mps", "dead_band")),
    Perimeter: ({}, ("desired_radius", "lateral_gain_mps", "climb_gain_mps")),
    KeepInView: (
        {"template": SHAPE},
        ("desired_radius", "zoom_gain_ps", "separation_sides", "min_side_px", "border_sides"),
    ),
    BodyRule: ({"radius_sides": 1.0}, ("radius_sides", "margin_sides", "horizon_sides")),
    AvoidanceRule: (AVOIDANCE, ("side_m", "nominal_age_s", "step_s", "lag_s", "creep_mps", "lifetime_s")),
    RoleRule: ({}, ("period_s", "gain", "starts")),
    SizeRule: ({}, ("min_sides", "max_sides")),
}
"""Constructors with numbers of 0 or more: required arguments, and the names of those numbers."""


@pytest.mark.parametrize("value", [NAN, -1.0, -1e-320, "x", None, 10**400, 1j, [1.0]])
@pytest.mark.parametrize("kind", CONSTRUCTORS)
def test_constructors_reject_invalid_numbers(kind, value):
    good, names = CONSTRUCTORS[kind]
    kind(**good)
    for name in names:
        with pytest.raises(SkyherdError, match=f"{kind.__name__}.{name}"):
            kind(**good | {name: value})


@pytest.mark.parametrize("value", [NAN, INF, -INF, None])
def test_hover_accepts_finite_rate_of_either_sign(value):
    assert Hover(-1.0).yaw_rate_radps == -1.0
    for make in (Hover, lambda rate: Perimeter(yaw_rate_radps=rate), lambda rate: Wheels(1, 1, rate)):
        with pytest.raises(SkyherdError, match="a finite number"):
            make(value)


def test_limits_may_be_infinite():
    assert Wheels(INF, INF) and SizeRule(0.0, INF) and TreeSettings(patience_s=INF)
    for kind, name in ((MarkerGains, "k"), (SafetyRadius, "radius"), (SizeRule, "min_sides")):
        with pytest.raises(SkyherdError):
            kind(**CONSTRUCTORS[kind][0] | {name: INF})


@pytest.mark.parametrize(
    "given",
    [
        ([0, 1], [0], NAN),
        ([0, 1], [0], 0.0),
        ([0, 1], [0], None),
        ([1, 0], [0], 1.0),
        ([0, 1], [1, 0], 1.0),
        ([0, 0.5], [0], 1.0),
        (None, [0], 1.0),
        ([0, 1], "units", 1.0),
        ([-1, 0], [0], 1.0),
    ],
)
def test_inboxes_reject_invalid_input(given):
    with pytest.raises(SkyherdError, match="GoalInboxes"):
        GoalInboxes(*given)
    assert GoalInboxes([0, 1], [0], 1.0).ids.tolist() == [0, 1]


def seen(**changes):
    one = {
        "unit_id": 0, "time_s": 0.0, "image_size_px": [800, 600], "ids": [3], "centers_px": [[1, 2]],
        "headings_rad": [0], "sides_px": [20], "corners_px": np.zeros((1, 4, 2)),
        "covariances": np.zeros((1, 3, 3)),
    }  # fmt: skip
    return Detections(**one | changes)


@pytest.mark.smoke
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("time_s", NAN),
        ("time_s", INF),
        ("time_s", None),
        ("ids", [0.5]),
        ("ids", [NAN]),
        ("ids", [-1]),
        ("ids", [None]),
        ("ids", ["a"]),
        ("ids", [2**70]),
        ("centers_px", [["a", "b"]]),
        ("centers_px", [[NAN, 0]]),
        ("headings_rad", None),
        ("sides_px", [0]),
        ("sides_px", [-1]),
        ("covariances", np.full((1, 3, 3), NAN)),
        ("image_size_px", [800]),
        ("image_size_px", [800, 0]),
        ("image_size_px", [-800, 600]),
    ],
)
def test_detections_reject_invalid_input(name, value):
    assert len(seen()) == 1
    with pytest.raises(SkyherdError, match=f"Detections.{name}"):
        seen(**{name: value})


REPORT = {"unit_id": 0, "image_size_px": [800, 600], "ids": [], "points_px": [], "controlled_ids": []}


@pytest.mark.parametrize("size_px", [[800, 0], [0.5, 600]])
def test_report_rejects_image_without_pixels(size_px):
    with pytest.raises(SkyherdError, match=r"UnitReport.image_size_px: .*; 1 or more"):
        UnitReport(time_s=0.0, secure_ids=[], **REPORT | {"image_size_px": size_px})


def test_messages_reject_invalid_time():
    goals = {"unit_id": 0, "ids": [], "rho_px": [], "bearings_rad": [], "sides_px": []}
    near = {"unit_id": 0, "horizon_sides": 8.0, "ids": [], "robot_ids": [], "other_ids": []}
    near |= {"distances_sides": [], "bearings_rad": [], "reaches_sides": [], "shares": []}
    for make in (
        lambda time_s: UnitReport(time_s=time_s, secure_ids=[], **REPORT),
        lambda time_s: MotionGoals(
            time_s=time_s, neighbor_ids=np.zeros((0, 3)), neighbor_distances_px=np.zeros((0, 3)), **goals
        ),
        lambda time_s: Proximity(time_s=time_s, **near),
    ):
        assert make(1.0).time_s == 1.0
        with pytest.raises(SkyherdError, match=r"time_s: nan; a finite number"):
            make(NAN)


class TestDetector:
    @pytest.mark.parametrize("flag", ["corrected", "inverted", "repeats"])
    @pytest.mark.parametrize("value", [np.zeros(0), np.ones(2), None, "no", 1], ids=repr)
    def test_rejects_non_boolean_flags(self, flag, value):
        assert create_detector("photometric", **{flag: np.True_})
        with pytest.raises(SkyherdError, match=f"create_detector: {flag}: .*; True or False"):
            create_detector("photometric", **{flag: value})

    @pytest.mark.parametrize(
        "image", [None, 3, "image.png", [[1, 2]], np.zeros((3, 3)), np.zeros((3, 3, 3), np.uint8)]
    )
    def test_rejects_non_grey_image(self, image):
        for name in ("tracking", "photometric", "opencv"):
            with pytest.raises(SkyherdError, match=r"image: .*grey, \(height, width\), uint8"):
                create_detector(name).detect(image)


class TestTemplate:
    @pytest.mark.parametrize(
        ("ids", "points"),
        [
            ([0, 1], [[0, 0], [NAN, 0]]),
            ([0, 1], [[0, 0], [INF, 0]]),
            ([0, 1], [[0, 0], [1e300, 0]]),
            ([0, -1], PAIR),
            ([0, 0.5], PAIR),
            ([0, NAN], PAIR),
            ([0, 2**70], PAIR),
            (["a", "b"], PAIR),
            (None, PAIR),
            ([[0, 1]], PAIR),
            ([0, 0], PAIR),
            ([0, 1], None),
            ([0, 1], 3.0),
            ([0, 1], "xy"),
            ([0, 1], [[1, 2, 3], [4, 5, 6]]),
            ([0, 1], [[1, 2], [3]]),
            ([0, 1], [[1, 1], [1, 1]]),
            ([], []),
            (list(range(3000)), PAIR),
        ],
    )
    def test_rejects_invalid_input(self, ids, points):
        for make in (Template.from_ground_points, Template.from_image_points):
            with pytest.raises(SkyherdError) as refusal:
                make(ids, points)
            assert len(str(refusal.value)) < 300 and "\n" not in str(refusal.value)

    def test_accepts_integral_float_ids(self):
        assert Template.from_ground_points([1.0, 0.0], PAIR).ids.tolist() == [0, 1]

    @pytest.mark.parametrize(
        "points", ["", "xy", ["1", "j x"], [10**400, 0]], ids=["empty", "text", "texts", "huge"]
    )
    def test_rejects_non_numeric_points(self, points):
        with pytest.raises(SkyherdError, match="template"):
            Template([0, 1], points)


@pytest.mark.parametrize("shape", ["star", "word:A"])
@pytest.mark.parametrize("count", [np.zeros(0), None, -1, 2.5, True, 10_001, 2**63], ids=repr)
def test_shape_rejects_invalid_robot_count(shape, count):
    """A count so large that writing a word would not end is rejected as well."""
    with pytest.raises(SkyherdError, match=r"count: .*; a whole number from 0 to 10000"):
        shape_points(shape, count)
