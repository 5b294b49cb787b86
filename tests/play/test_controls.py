"""Controls of the page: each asks for the intervention that it stands for, and shows the present value."""

import pytest
from play_pages import moved, wait_until

from skyherd.play.controls import CAMERA, GAINS, RADIO, present_values, start_values, unit_quantities
from skyherd.play.session import Change, Undo


def last_change(page):
    """Return the last of the session's interventions as a table."""
    return page.session.added[-1].model_dump(exclude_none=True, exclude={"at_s"})


class TestSliders:
    @pytest.mark.parametrize("number", range(1 + len(CAMERA)))
    def test_every_slider_of_a_unit_changes_its_value(self, open_page, number):
        with open_page() as page:
            slider = page._panel._units[1]._sliders[number]
            quantity, node = slider.quantity, slider._node
            wanted = node.min + 0.6 * (node.max - node.min)
            wait_until(lambda: page.session._step is not None)
            moved(node, wanted)
            wait_until(lambda: page.session.added)
            table = last_change(page)
            assert (table["kind"], table["unit"]) == (quantity.kind, 1)
            assert quantity.of(table[quantity.key]) == pytest.approx(wanted)

    def test_tilt_about_one_axis_keeps_the_other(self, open_page):
        with open_page() as page:
            sliders = {one.quantity.label: one for one in page._panel._units[0]._sliders}
            wait_until(lambda: page.session._step is not None)
            moved(sliders["tilt about u, °"]._node, 12.0)
            wait_until(lambda: page._panel._units[0]._values["tilt_deg"][0] == 12.0)
            moved(sliders["tilt about v, °"]._node, -7.0)
            wait_until(lambda: len(page.session.added) == 2)
            assert last_change(page)["tilt_deg"] == (12.0, -7.0)

    def test_slider_shows_value_after_undo(self, open_page):
        with open_page() as page:
            zoom = next(one for one in page._panel._units[0]._sliders if one.quantity.key == "zoom")
            wait_until(lambda: page.session._step is not None)
            page.session.ask(Change(({"kind": "camera", "unit": 0, "zoom": 1.7},)))
            wait_until(lambda: zoom._node.value == 1.7)
            page.session.ask(Undo())
            wait_until(lambda: zoom._node.value == 1.0)
            assert len(page.session.added) == 2, "a value that is shown is no change of the operator"

    @pytest.mark.parametrize("quantity", [*RADIO, *GAINS["marker"]], ids=lambda one: one.key)
    def test_sliders_of_radio_and_gains_change_their_values(self, open_page, quantity):
        with open_page() as page:
            sliders = [slider for group in page._panel._team._sliders for slider in group._sliders]
            node = next(slider._node for slider in sliders if slider.quantity is quantity)
            wait_until(lambda: page.session._step is not None)
            moved(node, quantity.high)
            wait_until(lambda: page.session.added)
            assert last_change(page) == {"kind": quantity.kind, quantity.key: quantity.high}

    def test_values_at_start_are_those_of_the_first_step(self, open_page):
        with open_page() as page:
            wait_until(lambda: page.session._step is not None)
            mission, step = page.session.mission, page.session._step
            for unit in (None, 0, 1):
                start, now = start_values(mission, unit), present_values(mission, step, unit)
                quantities = (*RADIO, *GAINS["marker"]) if unit is None else unit_quantities(mission, unit)
                for one in quantities:
                    if one.key not in ("height_m", "yaw_deg"):
                        assert one.of(start[one.key]) == pytest.approx(one.of(now[one.key]))

    def test_fisheye_lens_has_no_bend(self, open_page):
        with open_page("handheld") as page:
            mission = page.session.mission
            for unit, model in enumerate(mission.scenario.units):
                keys = {one.key for one in unit_quantities(mission, unit)}
                assert ("distortion" in keys) == (model.camera.lens == "perspective")


class TestTeam:
    def test_unit_is_killed_and_revived_by_its_button(self, open_page):
        with open_page() as page:
            button = page._panel._lives[2]
            wait_until(lambda: page.session._step is not None)
            moved(button, True)
            wait_until(lambda: button.label == "Revive unit 2")
            moved(button, True)
            wait_until(lambda: button.label == "Kill unit 2" and len(page.session.added) == 2)
            assert [one.kind for one in page.session.added] == ["kill", "revive"]

    def test_shape_word_and_cover_become_interventions(self, open_page):
        with open_page() as page:
            panel = page._panel._team
            wait_until(lambda: page.session._step is not None)
            panel._word.value = "hi"
            for button in (panel._form, panel._write, panel._cover, panel._uncover):
                count = len(page.session.added)
                moved(button, True)
                wait_until(lambda count=count: len(page.session.added) > count)
            tables = [one.model_dump(exclude_none=True, exclude={"at_s"}) for one in page.session.added]
            assert tables == [
                {"kind": "template", "shape": "circle"},
                {"kind": "template", "shape": "word:HI"},
                {"kind": "cover", "marker": 0, "covered": True},
                {"kind": "cover", "marker": 0, "covered": False},
            ]

    def test_word_that_cannot_be_written_is_told(self, open_page):
        with open_page() as page:
            wait_until(lambda: page.session._step is not None)
            page._panel._team._word.value = "漢"
            moved(page._panel._team._write, True)
            wait_until(lambda: "漢" in page._panel._notice)
            assert not page.session.added


class TestMove:
    def test_dragged_handle_moves_its_robot_or_unit(self, open_page):
        with open_page() as page:
            grab = page._panel._grab
            wait_until(lambda: page.session._step is not None)
            for choice, table in (
                ("robot 4", {"kind": "robot", "robot": 4, "position_m": (9.0, 1.0)}),
                ("unit 1", {"kind": "unit", "unit": 1, "position_m": (9.0, 1.0), "height_m": 15.0}),
            ):
                page._panel.choose(choice)
                wait_until(lambda: grab._held is not None and grab._held.node.visible)
                count, held = len(page.session.added), grab._held
                grab._drag(held, "start", held.node.position)
                grab._drag(held, "update", [9.0, 1.0, 15.0])
                wait_until(lambda count=count: len(page.session.added) > count)
                assert last_change(page) == table
                grab._drag(held, "end", [9.0, 1.0, 15.0])
                page._panel.choose("nothing")
                wait_until(lambda: grab._held is None)

    def test_handle_follows_its_robot_while_it_is_free(self, open_page):
        with open_page() as page:
            page._panel.choose("robot 4")
            grab = page._panel._grab
            wait_until(lambda: grab._held is not None and grab._held.node.visible)
            first = grab._held.node.position.copy()
            wait_until(lambda: (grab._held.node.position != first).any())
            assert not page.session.added

    def test_dragged_handle_does_not_follow_its_robot(self, open_page):
        with open_page() as page:
            page._panel.choose("robot 4")
            grab = page._panel._grab
            wait_until(lambda: grab._held is not None and grab._held.node.visible)
            grab._drag(grab._held, "start", None)
            first, time_s = grab._held.node.position.copy(), page._step.time_s
            wait_until(lambda: page._step.time_s > time_s + 2)
            assert (grab._held.node.position == first).all()

    def test_choices_during_the_run_do_not_disturb_the_drawing(self, open_page):
        with open_page() as page:
            wait_until(lambda: page._step is not None)
            for choice in page._panel._grab.choices * 20:
                page._panel._grab.choose(choice)
            time_s = page._step.time_s
            wait_until(lambda: page._step.time_s > time_s)
