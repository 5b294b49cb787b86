"""Detections as a sequence of markers, as a table, and as one line of text."""

import sys

import numpy as np
import pytest

from skyherd.errors import InputError
from skyherd.messages import Detection, Detections, MotionGoals, Quality, UnitReport
from skyherd.messages.detections import CORNER_COLUMNS
from skyherd.messages.short_repr import short_value


def made(ids, *, known=True) -> Detections:
    """Return detections with a different value in each entry; covariances are diagonal, or zero."""
    n = len(ids)
    rng = np.random.default_rng(5)
    return Detections(
        unit_id=3,
        time_s=1.5,
        image_size_px=(640, 480),
        ids=ids,
        centers_px=rng.uniform(0, 400, (n, 2)),
        headings_rad=rng.uniform(-3, 3, n),
        sides_px=rng.uniform(10, 50, n),
        corners_px=rng.uniform(0, 400, (n, 4, 2)),
        covariances=rng.uniform(1, 2, (n, 3, 1)) * np.eye(3) * known,
        qualities=np.arange(n) % 3,
    )


class TestSequence:
    def test_items_have_the_values_of_their_rows(self) -> None:
        found = made([7, 2, 9])
        for row, marker in enumerate(found):
            assert isinstance(marker, Detection) and marker.id == found.ids[row]
            assert (marker.heading_rad, marker.side_px) == (found.headings_rad[row], found.sides_px[row])
            assert marker.quality is Quality(row)
            for name, values in (
                ("center_px", found.centers_px),
                ("corners_px", found.corners_px),
                ("covariance", found.covariances),
            ):
                np.testing.assert_array_equal(getattr(marker, name), values[row])
        assert [marker.id for marker in found] == [7, 2, 9]
        assert found[-1].id == found[np.int64(2)].id == 9

    def test_slices_masks_and_rows_give_detections(self) -> None:
        found = made([7, 2, 9])
        for rows, ids in (
            (slice(1, None), [2, 9]),
            (found.ids > 5, [7, 9]),
            ([2, 0], [9, 7]),
            (slice(0, 0), []),
        ):
            part = found[rows]
            assert isinstance(part, Detections) and part.ids.tolist() == ids
            assert (part.unit_id, part.time_s) == (3, 1.5)
            assert part.corners_px.shape == (len(ids), 4, 2)

    def test_row_beyond_the_last_is_an_index_error(self) -> None:
        with pytest.raises(IndexError):
            made([7, 2, 9])[3]
        assert list(made([])) == []

    def test_marker_cannot_change_its_detections(self) -> None:
        with pytest.raises(ValueError, match="read-only"):
            made([7])[0].center_px[0] = 0.0


class TestTable:
    def test_columns_have_the_values_in_degrees_and_pixels(self) -> None:
        pytest.importorskip("pandas")
        found = made([7, 2, 9])
        table = found.to_dataframe()
        assert table["id"].tolist() == [7, 2, 9] and set(table["unit_id"]) == {3}
        np.testing.assert_allclose(np.radians(table["heading_deg"]), found.headings_rad, rtol=1e-14)
        np.testing.assert_allclose(table["std_v_px"] ** 2, found.covariances[:, 1, 1], rtol=1e-14)
        std_rad = np.radians(table["std_heading_deg"])
        np.testing.assert_allclose(std_rad**2, found.covariances[:, 2, 2], rtol=1e-14)
        np.testing.assert_array_equal(table[list(CORNER_COLUMNS)], found.corners_px.reshape(3, 8))
        assert table["quality"].tolist() == ["corners", "robust", "photometric"]

    def test_unknown_covariance_is_nan_and_types_stay(self) -> None:
        pytest.importorskip("pandas")
        table = made([7, 2], known=False).to_dataframe()
        assert table[["std_u_px", "std_v_px", "std_heading_deg"]].isna().all(axis=None)
        empty = made([]).to_dataframe()
        assert len(empty) == 0 and empty.drop(columns="quality").dtypes.equals(
            table.drop(columns="quality").dtypes
        )


def test_table_without_pandas_is_one_line(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)  # its import then fails
    with pytest.raises(InputError) as wrong:
        made([7]).to_dataframe()
    assert str(wrong.value) == "Detections.to_dataframe: pandas is not installed; pip install pandas"


class TestRepresentation:
    def test_detections_show_number_ids_size_and_time(self) -> None:
        assert repr(made([7, 2])) == "Detections(2 marker(s): 7, 2; 640x480 px, unit 3, 1.5 s)"
        assert repr(made([])) == "Detections(0 marker(s); 640x480 px, unit 3, 1.5 s)"
        assert len(repr(made(range(1000)))) < 100

    def test_marker_shows_numbers_and_shapes_on_one_line(self) -> None:
        text = repr(made([7])[0])
        assert text.startswith("Detection(id=7, center_px=[") and text.endswith("quality=CORNERS)")
        assert "corners_px=4x2 array" in text and "\n" not in text

    def test_message_of_a_thousand_robots_is_short(self) -> None:
        n = 1000
        ones = np.ones(n)
        goals = MotionGoals(0, 0.1, np.arange(n), ones, ones, ones, np.zeros((n, 3)), np.ones((n, 3)))
        assert len(repr(goals)) < 200 and "ids=1000 array" in repr(goals)

    @pytest.mark.parametrize(
        ("value", "shown"),
        [
            (None, "None"),
            (True, "True"),
            (1 / 3, "0.333333"),
            (np.array([1.0, 2.5]), "[1, 2.5]"),
            (np.zeros((2, 2)), "2x2 array"),
            ({1: 2}, "dict of 1"),
            ("a\nb", r"'a\nb'"),
            (object(), "object(…)"),
        ],
    )
    def test_values_have_a_short_form(self, value, shown) -> None:
        assert short_value(value) == shown


@pytest.mark.parametrize(("ids", "repeated"), [([], []), ([4, 2], []), ([4, 2, 4, 7, 2, 4], [2, 4])])
def test_repeated_ids_are_those_at_several_places(make_detections, ids, repeated) -> None:
    seen = make_detections(ids, np.arange(len(ids)))
    assert seen.repeated_ids == set(repeated)
    assert seen.repeated.tolist() == [marker in repeated for marker in ids]
    assert seen.unambiguous().ids.tolist() == [marker for marker in ids if marker not in repeated]


def test_centre_distances_cannot_be_changed(make_detections) -> None:
    seen = make_detections([3], [400 + 100j])
    assert not seen.centre_distances.flags.writeable
    assert not UnitReport.of_image(seen).centre_distances.flags.writeable
