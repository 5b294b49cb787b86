"""Detection on pictures, folders of pictures and videos; annotated pictures and tables as output.

Each file gets its own detector, so that no state passes from one file to another.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from skyherd.errors import InputError
from skyherd.files.atomic import write_whole
from skyherd.files.image_streams import is_stream, open_stream, read_stream
from skyherd.files.images import Grey, read_grey
from skyherd.files.output_folder import OutputFolder
from skyherd.files.video_reader import find_files
from skyherd.files.video_writer import VideoSink
from skyherd.inspection.annotator import Annotator
from skyherd.inspection.file_result import FileResult
from skyherd.inspection.output_names import picture_names
from skyherd.inspection.table import (
    DETECTION_COLUMNS,
    REJECTION_COLUMNS,
    Format,
    Place,
    Row,
    Table,
    detection_rows,
    open_table,
    rejection_rows,
)
from skyherd.jobs.progress import NO_PROGRESS, Progress
from skyherd.markers.dictionary import canonical_name, load_dictionary, with_border
from skyherd.messages import Detections
from skyherd.vision import (
    DEFAULT_DETECTOR,
    DEFAULT_DICTIONARY,
    Detector,
    Rejection,
    create_detector,
    detect_and_explain,
    explain,
    find_dictionary,
    suggest,
)

if TYPE_CHECKING:  # metres need SciPy's optimization, which takes long to import and few detections ask for
    from skyherd.inspection.metres import MetricColumns
    from skyherd.poses import Calibration

DETECTIONS = "detections"
"""Name of the table of detections, without suffix."""

REJECTIONS = "rejected"
"""Name of the table of rejected candidates, without suffix."""

VERB = "detect"
"""Verb under which a folder's record lists these files."""

AUTO = "auto"
"""Placeholder for the dictionary that matches a file's own markers."""

FEW = 3
"""Number of detections in a picture below which a hint is searched for. Chosen: pictures of robots usually
show more."""


class Inspector:
    """Runner of a detector over files, with tables and annotated pictures as output.

    Args:
        detector: name or `module:factory`, as for `skyherd.vision.create_detector`.
        dictionary: name of the marker dictionary, or `AUTO` to find it per file. For a video, the first frame
            that shows markers decides.
        border_bits: width of the markers' black border in cells.
        inverted: True for white markers on black.
        repeats: report an id that is found at several places at each of them.
        explained: also report why candidates were rejected; takes half as long again.
        kind: format of the tables.
        topic: topic of the images in a rosbag2 recording; None for the only one.
        side_m: side of the markers, m, for positions on the ground in metres; None for pixels alone.
        calibration: of the camera, for poses in its axes instead; needs `side_m`.
        one_plane: whether all markers lie on one plane, for these poses.
        progress: receives the number of processed frames of each file.

    Raises:
        InputError: there is no such detector or dictionary, or the side is not one of a marker.
    """

    def __init__(
        self,
        detector: str,
        dictionary: str,
        *,
        border_bits: int = 1,
        inverted: bool = False,
        repeats: bool = False,
        explained: bool = False,
        kind: Format = "csv",
        topic: str | None = None,
        side_m: float | None = None,
        calibration: "Calibration | None" = None,
        one_plane: bool = False,
        progress: Progress = NO_PROGRESS,
    ) -> None:
        if calibration is not None and side_m is None:
            raise InputError("calibration", "given without side_m", "both, or side_m alone")
        self._side_m = None if side_m is None else _checked_side(side_m)
        self._calibration, self._one_plane = calibration, one_plane
        self.detector, self.explained, self.kind = detector, explained, kind
        self.dictionary = dictionary if dictionary == AUTO else canonical_name(dictionary)
        self.border_bits, self.inverted, self.repeats = border_bits, inverted, repeats
        self._topic, self._progress = topic, progress
        self._metres: MetricColumns | None = None
        usual = DEFAULT_DICTIONARY if dictionary == AUTO else self.dictionary
        load_dictionary(usual)
        self._create_detector(usual)

    def _create_detector(self, dictionary: str) -> Detector:
        return create_detector(
            self.detector,
            dictionary=dictionary,
            border_bits=self.border_bits,
            inverted=self.inverted,
            repeats=self.repeats,
        )

    def _dictionary_of(self, image: Grey) -> str | None:
        """Return the dictionary to use for an image; None if it is unknown and no marker is visible."""
        if self.dictionary != AUTO:
            return self.dictionary
        return find_dictionary(image, border_bits=self.border_bits, inverted=self.inverted)

    def _dark_on_light(self, image: Grey) -> Grey:
        """Return the image with black markers on white: its negative if they are inverted."""
        return np.asarray(255 - image, dtype=np.uint8) if self.inverted else image

    def _hint(self, image: Grey, dictionary: str) -> str | None:
        """Return advice where little was found."""
        return suggest(
            image,
            dictionary,
            border_bits=self.border_bits,
            inverted=self.inverted,
            repeats=self.repeats,
            detector=self.detector,
        )

    def inspect(self, target: Path, folder: Path, *, force: bool = False) -> list[FileResult]:
        """Run the detector over a picture, a video, a rosbag2 recording, or a folder of pictures and videos.

        In a folder, an unreadable file does not stop the others: its result has `trouble`.

        Args:
            target: the file or folder.
            folder: folder of tables and annotated files; created if missing.
            force: accept an existing `folder`; only earlier outputs in it are removed.

        Returns:
            One result per file, sorted by name.

        Raises:
            InputError: there is no file to process, no file is readable, the folder exists, or a foreign file
                in it would be replaced.
            OutputError: writing failed.
        """
        files = [target] if is_stream(target) else find_files(target)
        names = picture_names(files)
        table_names = [f"{DETECTIONS}.{self.kind}", f"{REJECTIONS}.{self.kind}"][: 2 if self.explained else 1]
        output = OutputFolder(folder, VERB, [*table_names, *names.values()], force=force, inputs=files)
        output.check()
        if files == [target] or self._topic is not None:
            _check_readable(target, self._topic)
        with output, ExitStack() as stack:
            columns = [*DETECTION_COLUMNS, *self._metric_names()]
            tables = [self._open(stack, folder / DETECTIONS, columns)]
            if self.explained:
                tables.append(self._open(stack, folder / REJECTIONS, REJECTION_COLUMNS))
            results = [self._inspect_file(file, folder / names[file], tables) for file in files]
            _check_any_readable(target, results)
            return results

    def _open(self, stack: ExitStack, path: Path, columns: list[str]) -> Table:
        return stack.enter_context(open_table(path.with_suffix(f".{self.kind}"), columns, self.kind))

    def _metric_names(self) -> list[str]:
        """Return the names of the columns in metres."""
        if self._side_m is None:
            return []
        from skyherd.inspection.metres import GROUND_COLUMNS, POSE_COLUMNS

        return GROUND_COLUMNS if self._calibration is None else POSE_COLUMNS

    def _metric_columns(self, side_m: float) -> "MetricColumns":
        """Return the measurements in metres of a new file."""
        from skyherd.inspection.metres import MetricColumns

        return MetricColumns(
            side_m,
            self._calibration,
            one_plane=self._one_plane,
            border_bits=self.border_bits,
            inverted=self.inverted,
        )

    def _inspect_file(self, file: Path, picture: Path, tables: list[Table]) -> FileResult:
        result = FileResult(file)
        self._metres = None if self._side_m is None else self._metric_columns(self._side_m)
        try:
            (self._inspect_video if is_stream(file) else self._inspect_picture)(result, picture, tables)
        except InputError as error:
            result.trouble = error
        return result

    def _inspect_picture(self, result: FileResult, picture: Path, tables: list[Table]) -> None:
        self._progress.update(result.file.name, 0, 1)
        image = read_grey(result.file)
        result.dictionary = self._dictionary_of(image) or DEFAULT_DICTIONARY
        detector = self._create_detector(result.dictionary)
        found = self._look(detector, image, Place(result.file.name), result, tables)
        annotated = Annotator((image.shape[1], image.shape[0])).draw(image, found, result.rejections)
        drawn = Image.fromarray(annotated)
        result.picture = write_whole(picture, lambda part: drawn.save(part, format="PNG", compress_level=2))
        if len(found) < FEW:
            result.hint = self._hint(image, result.dictionary)
        self._progress.update(result.file.name, 1, 1)

    def _inspect_video(self, result: FileResult, picture: Path, tables: list[Table]) -> None:
        clip = open_stream(result.file, self._topic)
        named = DEFAULT_DICTIONARY if self.dictionary == AUTO else self.dictionary
        detector, result.dictionary = self._create_detector(named), named
        searching = self.dictionary == AUTO
        sink: VideoSink | None = None
        with ExitStack() as stack:
            for frame in read_stream(clip):
                height, width = frame.image.shape
                if searching and (own := self._dictionary_of(frame.image)) is not None:
                    detector, result.dictionary, searching = self._create_detector(own), own, False
                annotator = Annotator((width, height))
                place = Place(result.file.name, frame.index, frame.time_s)
                found = self._look(detector, frame.image, place, result, tables)
                shown = _even(annotator.draw(frame.image, found, result.rejections))
                if sink is None:
                    size_px = (shown.shape[1], shown.shape[0])
                    sink = stack.enter_context(
                        VideoSink(picture, size_px, Fraction(clip.rate_hz), timed=True)
                    )
                sink.write(shown, frame.time_s)
                done = frame.index + 1
                self._progress.update(result.file.name, done, max(clip.count, done) if clip.count else None)
                if frame.index == 0 and len(found) < FEW:
                    result.hint = self._hint(frame.image, result.dictionary)
        result.picture = picture
        result.hint = None if len(result.ids) >= FEW else result.hint

    def _look(
        self, detector: Detector, image: Grey, place: Place, result: FileResult, tables: list[Table]
    ) -> Detections:
        """Detect in one picture, write its rows, and count."""
        found, result.rejections = self._detect(detector, image, result.dictionary, place.time_s or 0.0)
        result.frames += 1
        result.ids.update(found.ids.tolist())
        metric: Sequence[Row] = ()
        if self._metres is not None:
            metric = self._metres.rows(result.file.name, image, found, result.dictionary)
        for row in detection_rows(place, found, metric):
            tables[0].add(row)
        if self.explained:
            result.reasons.update(rejection.reason.value for rejection in result.rejections)
            for row in rejection_rows(place, result.rejections):
                tables[1].add(row)
        return found

    def _detect(
        self, detector: Detector, image: Grey, dictionary: str, time_s: float
    ) -> tuple[Detections, list[Rejection]]:
        """Return the markers of one picture, and why others were rejected, if that is to be explained."""
        if not self.explained:
            return detector.detect(image, time_s=time_s), []
        dictionary, dark_on_light = with_border(dictionary, self.border_bits), self._dark_on_light(image)
        if self.detector == DEFAULT_DETECTOR:
            return detect_and_explain(dark_on_light, dictionary, repeats=self.repeats, time_s=time_s)
        found = detector.detect(image, time_s=time_s)
        return found, explain(dark_on_light, dictionary, found)


def _checked_side(side_m: float) -> float:
    from skyherd.poses import check_side

    return check_side("side_m", side_m)


def _check_any_readable(target: Path, results: list[FileResult]) -> None:
    """Reject an input without any readable file, so that nothing is left of it."""
    troubles = [result.trouble for result in results if result.trouble is not None]
    if len(troubles) < len(results):
        return
    if len(troubles) == 1:
        raise troubles[0]
    raise InputError(str(target), f"none of its {len(results)} files can be read", str(troubles[0]))


def _check_readable(file: Path, topic: str | None) -> None:
    """Reject an unreadable file before a folder is created for it."""
    if topic is not None or is_stream(file):
        open_stream(file, topic)
    else:
        read_grey(file)


def _even(picture: Grey) -> Grey:
    """Return the picture with even sides, its last row or column repeated where needed."""
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
