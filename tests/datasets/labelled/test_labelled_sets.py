"""Labelled image sets: reproducible by any process, correct to the pixel, and readable by other tools."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from label_specs import TREE, spec_of
from PIL import Image
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from skyherd.datasets import read_dataset
from skyherd.datasets.labelled import make
from skyherd.datasets.labelled.folder import open_folder
from skyherd.datasets.labelled.formats.outlines import area, bounding_box, visible_outline
from skyherd.datasets.labelled.labels import COVERED, OUTSIDE, SEEN, make_labels
from skyherd.datasets.labelled.make import make_dataset
from skyherd.datasets.labelled.ranges import draw_integer, draw_number
from skyherd.datasets.labelled.sampling import make_scene
from skyherd.datasets.labelled.spec import load_spec, spec_names
from skyherd.errors import InputError
from skyherd.markers.cramer_rao import pose_covariances
from skyherd.markers.dictionary import card_side
from skyherd.vision import create_detector


def contents(folder):
    """Return the bytes of every file by its path, including hidden files."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets") / "one"
    return make_dataset(spec_of(), folder)


def test_same_seed_same_bytes_whatever_the_number_of_workers(made, tmp_path):
    make_dataset(spec_of(), tmp_path / "two", jobs=2)
    assert contents(tmp_path / "two") == contents(made.path)


def test_another_seed_is_another_set(made):
    """Negative control: the other tests do not compare constants."""
    first, other = (make_scene(spec_of(seed=seed).spec, 0) for seed in (5, 6))
    assert first.pose != other.pose
    assert not np.array_equal(first.render(Path()), other.render(Path()))


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_resumed_equals_uninterrupted(made, tmp_path, jobs):
    class Interrupt:
        def update(self, *args):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(spec_of(), tmp_path, jobs=jobs, progress=Interrupt())
    begun = contents(tmp_path)
    pictures = [name for name in begun if name.endswith(".png")]
    assert 0 < len(pictures) < 10 + jobs  # two processes may have finished by then
    assert "truth.csv" not in begun
    # State of a killed process.
    (tmp_path / "images/train/.skyherd-0123456789abcdef.part").write_bytes(b"\x89PNG")
    times = {name: (tmp_path / name).stat().st_mtime_ns for name in pictures}
    make_dataset(spec_of(), tmp_path)
    assert contents(tmp_path) == contents(made.path)
    assert {name: (tmp_path / name).stat().st_mtime_ns for name in pictures} == times


@pytest.mark.smoke
def test_an_image_does_not_depend_on_how_many_there_are():
    few, many = (make_scene(spec_of(images=images).spec, 3) for images in (4, 4000))
    np.testing.assert_array_equal(few.positions_m, many.positions_m)
    np.testing.assert_array_equal(few.render(Path()), many.render(Path()))


def test_a_failing_worker_leaves_no_half_written_image(made, tmp_path, monkeypatch):
    def full(path, write):
        write(path.with_name("half"))
        path.with_name("half").unlink()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(make, "write_whole", full)
    with pytest.raises(OSError, match="No space"):
        make_dataset(spec_of(), tmp_path)
    assert not list(tmp_path.rglob("*.png"))


def test_read_back_is_what_was_drawn(made):
    assert len(made) == 10
    assert [image.split for image in made].count("val") == 3
    for index, image in enumerate(made):
        labels = make_labels(make_scene(made.spec, index))
        for field in fields(labels):
            np.testing.assert_array_equal(getattr(image.labels, field.name), getattr(labels, field.name))
        np.testing.assert_array_equal(image.read(), make_scene(made.spec, index).render(Path()))


@pytest.mark.parametrize(
    ("images", "least", "most"), [(10, 200, 3.0), pytest.param(25, 500, 2.7, marks=pytest.mark.slow)]
)
def test_truth_and_bound_agree_with_what_is_detected(images, least, most):
    """Errors over the bound's standard deviations: mean square 1 for a detector at the bound.

    With n errors the mean square of unit normal deviates has the standard deviation sqrt(2/n), 0.1 for 200
    and 0.06 for 500. Detectors may reach 1.5 times the bound. The limit is 2.25 (1 + 3 * 0.1) < 3, and 2.7
    for the larger number. Labels off by half a pixel, as with a wrong convention, give hundreds. The set has
    no lens distortion, which the detector does not know, and enough markers to find the tilted plane.
    """
    file = spec_of(
        markers={"count": 12, "side_px": (24, 32)},
        occluders={},
        camera={"psf_px": (0.6, 1.1), "tilt_deg": (0, 15)},
    )
    detector, ratios, off = create_detector("photometric"), [], []
    for index in range(images):
        scene = make_scene(file.spec, index)
        labels, found = make_labels(scene), detector.detect(scene.render(Path()), unit_id=index)
        _, here, there = np.intersect1d(labels.ids, found.ids, return_indices=True)
        away = found.centers_px[there] - labels.centers_px[here]
        ratios.append((away / labels.crb_stds[here, :2]).ravel())
        off.append(((away + 0.5) / labels.crb_stds[here, :2]).ravel())
    assert np.concatenate(ratios).size > least
    assert (np.concatenate(ratios) ** 2).mean() < most
    assert (np.concatenate(off) ** 2).mean() > 100


def coco_of(made, split):
    return COCO(str(open_folder(made.path).coco(split)))


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.parametrize("split", ["train", "val"])
def test_coco_as_pycocotools_reads_it_is_the_truth(made, split):
    coco = coco_of(made, split)
    assert [category["name"] for category in coco.loadCats(coco.getCatIds())] == ["marker"]
    images = [image for image in made if image.split == split]
    assert sorted(entry["file_name"] for entry in coco.imgs.values()) == [image.path.name for image in images]
    for number in coco.getImgIds():
        labels = made[number].labels
        annotations = coco.loadAnns(coco.getAnnIds(imgIds=[number]))
        assert [annotation["marker_id"] for annotation in annotations] == labels.ids.tolist()
        for k, annotation in enumerate(annotations):
            points = np.array(annotation["keypoints"]).reshape(5, 3)
            flags = labels.visibilities[k]
            np.testing.assert_array_equal(points[:, 2], flags)
            wanted = np.where(flags[:, None] > 0, labels.keypoints_px[k] + 0.5, 0.0)
            np.testing.assert_allclose(points[:, :2], wanted, atol=1e-6)
            assert annotation["num_keypoints"] == (flags > 0).sum()
            corners = labels.corners_px[k] + 0.5
            low, high = corners.min(axis=0).clip(0), corners.max(axis=0).clip(None, (320, 240))
            if annotation["num_keypoints"] == 5:
                np.testing.assert_allclose(annotation["bbox"], [*low, *(high - low)], atol=1e-5)
            # Pixels along the outline count as a whole or not at all.
            mask = coco.annToMask(annotation)
            around = 4 * labels.sides_px[k]
            assert abs(int(mask.sum()) - annotation["area"]) < around


def test_coco_truth_scores_perfectly_and_moved_truth_does_not(made):
    coco = coco_of(made, "train")
    scores = []
    for moved_px in (0.0, 12.0):
        results = []
        for annotation in coco.anns.values():
            points = np.array(annotation["keypoints"], dtype=float).reshape(5, 3)
            points[:, 0] += moved_px
            results.append(
                {key: annotation[key] for key in ("image_id", "category_id")}
                | {"keypoints": points.ravel().tolist(), "score": 1.0}
            )
        evaluation = COCOeval(coco, coco.loadRes(results), "keypoints")
        evaluation.params.kpt_oks_sigmas = np.full(5, 0.05)
        evaluation.evaluate()
        evaluation.accumulate()
        evaluation.summarize()
        scores.append(evaluation.stats[0])
    assert scores[0] == pytest.approx(1.0)
    assert scores[1] < 0.5


def test_yolo_labels_in_pixels_are_the_truth(made):
    folder = open_folder(made.path)
    for index, image in enumerate(made):
        lines = folder.yolo(index).read_text().splitlines()
        table = np.array([line.split() for line in lines], dtype=float).reshape(-1, 20)
        assert len(table) == len(image.labels)
        assert (table[:, 0] == 0).all()
        assert ((table >= 0) & (table <= 2)).all()
        assert (table[:, 1:5] <= 1).all()
        points = table[:, 5:].reshape(-1, 5, 3)
        seen = points[..., 2] > 0
        pixels = points[..., :2] * made.spec.size_px - 0.5
        np.testing.assert_allclose(pixels[seen], image.labels.keypoints_px[seen], atol=1e-5)
        np.testing.assert_array_equal(points[~seen], 0)
    text = folder.data_yaml.read_text()
    assert "train: images/train\n" in text
    assert "kpt_shape: [5, 3]\n" in text


def test_yolo_without_validation_names_training_twice(tmp_path):
    dataset = make_dataset(spec_of(images=2, validation=0.0), tmp_path)
    assert "val: images/train\n" in (tmp_path / "data.yaml").read_text()
    assert sorted(path.name for path in (tmp_path / "annotations").iterdir()) == ["train.json"]
    assert len(dataset) == 2


def test_visibilities_are_what_the_image_shows():
    """At a covered keypoint, well inside the occluder, the image has the occluder's grey level."""
    file = spec_of(
        markers=TREE["markers"] | {"cut": 0.5},
        sensor={"noise": 0},
        occluders={"share": 1.0, "level": 150, "radius_sides": (0.3, 0.5)},
    )
    counts = dict.fromkeys((OUTSIDE, COVERED, SEEN), 0)
    for index in range(12):
        scene = make_scene(file.spec, index)
        labels, image = make_labels(scene), scene.render(Path())
        inside = ((labels.keypoints_px > -0.5) & (labels.keypoints_px < (319.5, 239.5))).all(axis=2)
        np.testing.assert_array_equal(labels.visibilities == OUTSIDE, ~inside)
        shrunk = [
            occluder.model_copy(update={"radius_m": occluder.radius_m - 0.15})
            for occluder in scene.occluders
            if occluder.radius_m is not None
        ]
        deep = make_labels(replace(scene, occluders=shrunk))
        _, at, _ = np.intersect1d(deep.ids, labels.ids, return_indices=True)
        hidden = (deep.visibilities[at] == COVERED) & (labels.visibilities == COVERED)
        u, v = np.rint(labels.keypoints_px[hidden]).astype(int).T
        assert (np.abs(image[v, u].astype(int) - 150) <= 2).all()
        for flag in counts:
            counts[flag] += int((labels.visibilities == flag).sum())
    assert min(counts.values()) > 10


def test_markers_do_not_touch_and_are_whole_without_cut():
    file = spec_of(markers={"count": 40, "side_px": 20}, occluders={})
    for index in range(8):
        scene = make_scene(file.spec, index)
        assert 10 < len(scene.ids) <= 40
        assert scene.truth.whole.all()
        apart = np.linalg.norm(scene.positions_m[:, None] - scene.positions_m[None], axis=2)
        assert apart[np.triu_indices(len(apart), 1)].min() > card_side("4X4_50") * 2**0.5


def test_outline_cut_to_the_image():
    """A square of side 4 with a quarter in the image; coordinates from the corner, in whole pixels."""
    square = np.array([[-2.5, -2.5], [1.5, -2.5], [1.5, 1.5], [-2.5, 1.5]])
    outline = visible_outline(square, (10, 10))
    assert bounding_box(outline) == (0, 0, 2, 2)
    assert area(outline) == pytest.approx(4)
    inside = visible_outline(square + 4, (10, 10))
    np.testing.assert_array_equal(inside, square + 4.5)
    assert len(visible_outline(square + 40, (10, 10))) == 0


def test_ranges_are_filled_and_not_left():
    rng = np.random.default_rng(0)
    values = np.array([draw_number(rng, (2.0, 3.0)) for _ in range(2000)])
    assert 2 <= values.min() < 2.01 and 2.99 < values.max() <= 3
    # For each of three numbers 2000 / 3, with a standard deviation of 21.
    counts = np.bincount([draw_integer(rng, (1, 3)) for _ in range(2000)])
    assert counts[0] == 0 and (np.abs(counts[1:] - 2000 / 3) < 100).all()


def test_pictures_as_ground(tmp_path):
    floor = np.random.default_rng(1).integers(60, 200, (40, 60), dtype=np.uint8)
    Image.fromarray(floor).save(tmp_path / "floor.png")
    text = "images = 2\nsize_px = [160, 120]\nmarkers.side_px = 20\nmarkers.count = 1\nground.kinds = []\n"
    (tmp_path / "spec.toml").write_text(text + 'ground.images = ["floor.png"]\n')
    file = load_spec(str(tmp_path / "spec.toml"))
    dataset = make_dataset(file, tmp_path / "out")
    assert all(image.taken["ground"] == "floor.png" for image in dataset)
    assert dataset[0].read().std() > 10
    Image.fromarray(255 - floor).save(tmp_path / "floor.png")
    with pytest.raises(InputError, match="other pictures"):
        make_dataset(file, tmp_path / "out")


@pytest.mark.parametrize(("images", "least"), [(10, 20), pytest.param(30, 60, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", spec_names())
def test_built_in_specs_draw(name, images, least):
    file = load_spec(name)
    assert file.spec.description
    sides = [side for index in range(images) for side in make_labels(make_scene(file.spec, index)).sides_px]
    assert len(sides) > least
    # Tilt makes the nearest markers larger and the farthest smaller than those in the middle.
    assert 0.5 * file.spec.markers.side_px[0] < min(sides) < max(sides) < 2 * file.spec.markers.side_px[1]


def test_annotation_ids_are_unique_and_start_at_one(made):
    """COCO's own evaluation treats an id of 0 as no match."""
    for split in ("train", "val"):
        document = json.loads(open_folder(made.path).coco(split).read_text())
        numbers = [annotation["id"] for annotation in document["annotations"]]
        assert numbers == list(range(1, len(numbers) + 1))


def test_read_dataset_takes_a_name(made):
    assert read_dataset(str(made.path)).markers == made.markers > 20


def test_the_bound_is_that_of_the_sensors_gain_and_noise():
    """Noise, shot noise at mid-grey and the rounding's 1/12, relative to grey levels times the gain."""
    sensor = {"noise": 3.0, "shot": 0.1, "gain": 2.0}
    scene = make_scene(spec_of(sensor=sensor, ground={"kinds": ["plain"]}).spec, 0)
    expected = pose_covariances(
        scene.dictionary,
        scene.ids,
        scene.truth.images_marker,
        psf_px=scene.sensor.psf_px,
        noise=np.sqrt(9 + 0.1 * 2 * (scene.black + scene.white) / 2 + 1 / 12),
        black=2 * scene.black,
        white=2 * scene.white,
        ground=2 * scene.station.ground.mean,
    )
    assert len(scene.ids) >= 2
    np.testing.assert_allclose(scene.bounds(), expected, rtol=1e-5)


CAMERA_KEYS = {
    "lens_blur": {"disc_px": 1.5, "coma_px": 1.5, "aperture_sides": 0.3},
    "processing": {
        "demosaic": "bilinear",
        "gamma": (1.8, 2.4),
        "s_curve": 0.8,
        "denoise": 20,
        "sharpen": (1, 2),
        "h264_crf": 30,
    },
}


@pytest.mark.parametrize("table", CAMERA_KEYS)
def test_lens_and_processing_keys_change_image_but_not_scene(table):
    """All other draws are the same, including noise; with the key off, no grey level would differ."""
    sensor = TREE["sensor"]
    plain = make_scene(spec_of(sensor=sensor).spec, 1)
    image = plain.render(Path())
    for key, value in CAMERA_KEYS[table].items():
        extra = {"focus": 0.7} if key == "aperture_sides" else {}
        scene = make_scene(spec_of(sensor={**sensor, table: {key: value, **extra}}).spec, 1)
        assert scene.motion.camera_mps == plain.motion.camera_mps
        for field in ("pose", "black", "white", "motion_px", "clutter", "noise_key"):
            assert getattr(scene, field) == getattr(plain, field), key
        np.testing.assert_array_equal(scene.positions_m, plain.positions_m)
        off = {"lens_blur", "processing"}
        assert scene.sensor.model_dump(exclude=off) == plain.sensor.model_dump(exclude=off)
        assert np.abs(scene.render(Path()).astype(int) - image).max() > 3, key


def test_lens_and_processing_draws_are_in_range_and_repeatable():
    spec = load_spec("consumer").spec
    drawn = [make_scene(spec, index).sensor for index in range(40)]
    gammas = [sensor.processing.gamma for sensor in drawn]
    assert min(gammas) >= 1.8 and max(gammas) <= 2.4 and max(gammas) - min(gammas) > 0.4
    assert {sensor.processing.h264_crf for sensor in drawn} > {17, 22, 26}
    assert all(0 <= sensor.lens_blur.disc_px <= 1 for sensor in drawn)
    assert drawn == [make_scene(spec, index).sensor for index in range(40)]


def test_focus_is_a_share_of_the_distance_to_the_images_middle():
    """At 1 the middle is sharp for any tilt: the disc's radius there is 0."""
    lens = {"aperture_sides": 0.5, "focus": 1.0}
    scene = make_scene(spec_of(sensor={"lens_blur": lens}, camera={"tilt_deg": 14}).spec, 2)
    middle = (np.array(scene.camera.size_px) - 1) / 2
    blur = scene.sensor.lens_blur.make()
    assert blur.radii_px(scene.camera, scene.pose, middle) == pytest.approx(0.0, abs=1e-9)
    assert np.abs(blur.radii_px(scene.camera, scene.pose, scene.camera.corners_px)).max() > 0.3


def test_the_bound_knows_the_lens_and_the_filters():
    """Variances of blur add up; half of the pixels are green, and the noise of the others is doubled."""
    sensor = {"noise": 4.0, "lens_blur": {"disc_px": 2.0, "coma_px": 0.6}}
    sensor["processing"] = {"demosaic": "edge-aware", "red_gain": 2.0, "blue_gain": 2.0}
    scene = make_scene(spec_of(sensor=sensor, ground={"kinds": ["plain"]}).spec, 0)
    expected = pose_covariances(
        scene.dictionary,
        scene.ids,
        scene.truth.images_marker,
        psf_px=np.sqrt(scene.sensor.psf_px**2 + 2.0**2 / 4 + 0.6**2 / 3),
        noise=np.sqrt(4.0**2 / (1 / 2 + 1 / 2 / 4) + 1 / 12),
        black=scene.black,
        white=scene.white,
        ground=scene.station.ground.mean,
    )
    np.testing.assert_allclose(scene.bounds(), expected, rtol=1e-5)
