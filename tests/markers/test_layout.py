"""Several markers on a robot: ids, places and the keys of files."""

import numpy as np
import pytest
from five_markers import cubes, five_markers

from skyherd.datasets import RobotMarkerModel, load_mission, make_layout, make_mission
from skyherd.errors import InputError
from skyherd.geometry import to_complex, wrap_angle
from skyherd.markers.layout import MarkerLayout, Place
from skyherd.sim.physics import make_world

PLACES = [Place(0, (0.0, 0.0)), Place(10, (1.5, -2.0), np.pi / 2)]


@pytest.fixture
def five():
    return five_markers()


class TestLayout:
    def test_corners_turn_about_the_marker_and_not_the_robot(self) -> None:
        layout = MarkerLayout.make([3], PLACES)
        assert layout.ids.tolist() == [3, 13] and layout.robot_ids.tolist() == [3, 3]
        # The first corner is front left; a quarter turn puts it back left.
        np.testing.assert_allclose(layout.corners_sides[0, 0], 0.5 + 0.5j)
        np.testing.assert_allclose(layout.corners_sides[1, 0], 1.5 - 2.0j + (-0.5 + 0.5j))

    def test_robots_of_markers_leave_strangers(self) -> None:
        layout = MarkerLayout.make([1, 2], PLACES)
        assert layout.robots_of(np.array([12, 40, 1])).tolist() == [2, 40, 1]

    def test_shared_marker_is_refused(self) -> None:
        with pytest.raises(InputError, match="two robots would share the marker 10"):
            MarkerLayout.make([0, 10], PLACES)


def refused(models, robots=(0, 1), dictionary="4X4_50") -> str:
    with pytest.raises(InputError) as error:
        make_layout(models, robots, dictionary, key="robots.markers", dictionary_key="marker.dictionary")
    return str(error.value)


class TestKeys:
    def test_no_markers_mean_one_at_the_reference_point(self) -> None:
        assert make_layout([], [0], "4X4_50", key="k", dictionary_key="d") is None
        assert load_mission("star").layout is None

    def test_overlapping_cards_are_refused(self) -> None:
        """A card of 4X4_50 has 1.33 sides; turned by 45°, it reaches 0.94 sides far."""
        other = {"add_to_id": 10, "offset_sides": (1.5, 0.0)}
        touching = [RobotMarkerModel(), RobotMarkerModel(**other)]
        assert make_layout(touching, [0, 1], "4X4_50", key="k", dictionary_key="d") is not None
        turned = [RobotMarkerModel(), RobotMarkerModel(**other, yaw_deg=45)]
        assert "robots.markers.1.offset_sides: its card overlaps that of robots.markers.0" in refused(turned)

    def test_repeated_or_unknown_markers_are_refused(self) -> None:
        apart = RobotMarkerModel(add_to_id=0, offset_sides=(3.0, 0.0))
        assert "robots.markers.1.add_to_id: 0, as for robots.markers.0" in refused(
            [RobotMarkerModel(), apart]
        )
        far = [RobotMarkerModel(), RobotMarkerModel(add_to_id=49, offset_sides=(3.0, 0.0))]
        assert "markers up to 50, but 4X4_50 has 50 markers" in refused(far)
        clash = [RobotMarkerModel(), RobotMarkerModel(add_to_id=1, offset_sides=(3.0, 0.0))]
        assert "two robots would share the marker 1" in refused(clash)

    def test_obstacle_cannot_have_a_marker_of_a_robot(self, five) -> None:
        five["obstacles"] = [{"id": 21, "position_m": [5.0, 5.0]}]
        with pytest.raises(InputError, match="21 is the marker of robot 1"):
            make_mission(five)

    def test_every_marker_of_a_robot_can_be_covered(self, five) -> None:
        five["interventions"] = [{"kind": "cover", "at_s": 0.0, "marker": 41}]
        assert make_mission(five).layout is not None
        five["interventions"][0]["marker"] = 9
        with pytest.raises(InputError, match="no marker 9"):
            make_mission(five)


class TestWorld:
    def test_markers_move_rigidly_with_their_robot(self, five) -> None:
        world = make_world(mission := make_mission(five))
        layout, markers = mission.layout, world.markers
        rows = np.searchsorted(mission.ids, layout.robot_ids)
        turned = to_complex(markers.positions_m - world.positions_m[rows])
        local = turned * np.exp(-1j * world.headings_rad[rows]) / mission.scenario.marker.side_m
        np.testing.assert_allclose(local, layout.offsets_sides, atol=1e-12)
        np.testing.assert_allclose(
            wrap_angle(markers.headings_rad - world.headings_rad[rows] - layout.yaws_rad), 0, atol=1e-12
        )

    def test_marker_velocities_are_the_change_of_their_places(self, five) -> None:
        """Motion blur and rolling shutter need the velocity of each marker."""
        from skyherd.messages import VelocityCommand

        world = make_world(mission := make_mission(five))
        count = mission.ids.size
        command = VelocityCommand(mission.ids, np.full(count, 0.3), np.linspace(-1, 1, count))
        step_s = 1e-4
        world.advance(command, 0.0, step_s)
        before = world.markers.positions_m
        motion = world.motion(0)
        world.advance(command, step_s, step_s)
        found = (world.markers.positions_m - before) / step_s
        np.testing.assert_allclose(found, motion.robots_mps, atol=1e-3)
        assert np.ptp(np.linalg.norm(motion.robots_mps, axis=1)) > 0.1

    def test_faces_of_cubes_move_with_their_robots(self) -> None:
        from skyherd.messages import VelocityCommand

        world = make_world(mission := make_mission(cubes()))
        count, step_s = mission.ids.size, 1e-4
        command = VelocityCommand(mission.ids, np.linspace(0.1, 0.4, count), np.linspace(-1, 1, count))
        world.advance(command, 0.0, step_s)
        before_m, before_rad = world.positions_m.copy(), world.headings_rad.copy()
        world.advance(command, step_s, step_s)
        for unit in range(3):
            markers, motion = world.markers_facing(unit), world.motion(unit)
            rows = np.searchsorted(mission.ids, mission.layout.robots_of(markers.ids))
            np.testing.assert_array_equal(markers.positions_m, world.positions_m[rows])
            mps = (world.positions_m - before_m) / step_s
            np.testing.assert_allclose(motion.robots_mps, mps[rows], atol=1e-3)
            radps = wrap_angle(world.headings_rad - before_rad) / step_s
            np.testing.assert_allclose(motion.robots_radps, radps[rows], atol=1e-3)


class TestFaces:
    def test_faces_are_checked(self) -> None:
        low = {"face": "left", "add_to_id": 10, "offset_sides": (0.0, 1.0), "height_sides": 0.2}
        assert "robots.markers.1.height_sides: 0.2, so that its lower edge is below" in refused(
            [RobotMarkerModel(), RobotMarkerModel(**low)]
        )
        pair = [RobotMarkerModel(**low | {"height_sides": 1, "add_to_id": add}) for add in (10, 20)]
        assert "overlaps that of robots.markers.0" in refused(pair)
        moved = RobotMarkerModel(**low | {"height_sides": 1, "add_to_id": 20, "offset_sides": (0.0, 1.1)})
        assert make_layout([pair[0], moved], [0], "4X4_50", key="k", dictionary_key="d") is not None

    @pytest.mark.parametrize(
        ("key", "value", "words"),
        [
            ("perception", "ideal", "perception: 'ideal', but robots.markers are above the ground"),
            ("marker", {"side_m": 2.5}, "markers up to 3.75 m, but autopilot.min_height_m is 3"),
        ],
    )
    def test_missions_that_cannot_show_faces_are_refused(self, key, value, words) -> None:
        with pytest.raises(InputError, match=words):
            make_mission(cubes() | {key: value})
